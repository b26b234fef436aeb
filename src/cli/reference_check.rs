//! Arguments of `realitysim replay --check`, which compares tags with a reference.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;
use serde_json::Value;

use super::junit::{self, TestCase};
use super::{Outcome, output, paths};
use crate::config::plain_file;
use crate::evaluation::reference::{
    Difference, Frames, Identity, MAX_REFERENCE_BYTES, Reference, Verdict, compare, settings_that_matter,
};
use crate::geometry::Pose2;
use crate::recording::read_tags;
use crate::tagging::ReplayReport;

#[derive(Args)]
pub struct ReferenceArguments {
    /// Compare the tags with this reference, bit for bit; exit code 1 if they differ
    #[arg(long = "check", value_name = "REFERENCE")]
    pub reference: Option<PathBuf>,
    /// Make the tags of this replay the reference, in place of comparing
    #[arg(long, requires = "reference")]
    bless: bool,
    /// A field that later replays may have off by so much, for example pose.pose.position.x=0.001; with --bless, which
    /// writes it into the reference; can be given several times
    #[arg(long, value_name = "FIELD=VALUE", requires = "bless", value_parser = tolerance)]
    tolerance: Vec<(String, f64)>,
    /// Write what CI servers show: a test for each field
    #[arg(long, value_name = "FILE", requires = "reference", conflicts_with = "bless")]
    junit: Option<PathBuf>,
}

/// Differing fields that a report lists; of the rest it states the number.
const LISTED_FIELDS: usize = 12;

#[derive(Serialize)]
struct Blessed<'a> {
    reference: &'a Path,
    frames: usize,
    valid: usize,
}

#[derive(Serialize)]
struct Checked<'a> {
    reference: &'a Path,
    #[serde(flatten)]
    verdict: &'a Verdict,
}

const JUNIT_NAME: &str = "realitysim replay --check";

impl ReferenceArguments {
    /// Checks the output paths before anything is written. `inputs` are the files that the replay reads.
    pub fn check_outputs(&self, inputs: &[&Path]) -> anyhow::Result<()> {
        let Some(path) = &self.reference else { return Ok(()) };
        if self.bless {
            paths::check_output(path, inputs)?;
        }
        if let Some(junit) = &self.junit {
            paths::check_output(junit, &[inputs, &[path.as_path()]].concat())?;
            junit::check_folder(junit)?;
        }
        Ok(())
    }

    /// Writes the JUnit file for a replay that failed before its tags were compared.
    pub fn write_failure(&self, error: &anyhow::Error) {
        if let Some(junit) = &self.junit {
            junit::write_failure(junit, JUNIT_NAME, error);
        }
    }

    /// Reads the reference before long work, so that an unreadable one is refused at once.
    pub fn open(&self) -> anyhow::Result<Option<ReferenceCheck<'_>>> {
        let Some(path) = &self.reference else { return Ok(None) };
        let reference = if self.bless {
            None
        } else {
            let text =
                plain_file::read_text(path, MAX_REFERENCE_BYTES).map_err(|error| paths::cannot_read(path, error))?;
            Some(Reference::parse(&text, &path.display().to_string())?)
        };
        Ok(Some(ReferenceCheck { arguments: self, path, reference }))
    }
}

/// A reference that was read, or the path that one is to be written to.
pub struct ReferenceCheck<'a> {
    arguments: &'a ReferenceArguments,
    path: &'a Path,
    reference: Option<Reference>,
}

impl ReferenceCheck<'_> {
    pub fn judge(
        &self,
        source: &Path,
        report: &ReplayReport,
        initial: Option<Pose2>,
        json: bool,
    ) -> anyhow::Result<Outcome> {
        let session = &report.session;
        let identity = Identity::of(source, session, initial)?;
        let settings = settings_that_matter(session)?;
        let frames = Frames::of(&read_tags(session)?.found);
        let Some(reference) = &self.reference else { return self.bless(identity, settings, frames, json) };
        let shown = self.path.display().to_string();
        let verdict = compare(reference, &shown, &identity, &settings, &frames)?;
        if let Some(junit) = &self.arguments.junit {
            let tests = tests(&verdict, report);
            paths::write(junit, &junit::document(JUNIT_NAME, &tests))?;
        }
        if json {
            output::json(&Checked { reference: self.path, verdict: &verdict })?;
        } else {
            output::lines(&for_people(&verdict, &shown))?;
        }
        Ok(if verdict.same { Outcome::Whole } else { Outcome::NotReached })
    }

    fn bless(&self, identity: Identity, settings: Value, frames: Frames, json: bool) -> anyhow::Result<Outcome> {
        let tolerance: BTreeMap<String, f64> = self.arguments.tolerance.iter().cloned().collect();
        let reference = Reference::new(identity, tolerance, settings, frames)?;
        paths::write(self.path, &reference.to_text())?;
        let blessed = Blessed { reference: self.path, frames: reference.frames.count, valid: reference.frames.valid() };
        if json {
            output::json(&blessed)?;
        } else {
            output::lines(&format!(
                "{} frames, {} valid, are the reference now: {}",
                blessed.frames,
                blessed.valid,
                self.path.display()
            ))?;
        }
        Ok(Outcome::Whole)
    }
}

fn for_people(verdict: &Verdict, reference: &str) -> String {
    let mut text = String::new();
    for setting in &verdict.settings {
        text.push_str(&format!("other settings than the reference's: {setting}\n"));
    }
    if verdict.same {
        let how = if verdict.tolerated == 0 { "bit for bit" } else { "within the tolerance that it states" };
        text.push_str(&format!("{} frames are as in {reference}, {how}", verdict.frames));
        return text;
    }
    if verdict.frames != verdict.frames_of_reference {
        text.push_str(&format!("{} frames, the reference has {}\n", verdict.frames, verdict.frames_of_reference));
    }
    text.push_str(&format!("{} frames differ from {reference}\n\n", verdict.frames_differ));
    text.push_str("  field                                    frames  first  largest difference\n");
    for difference in verdict.differences.iter().take(LISTED_FIELDS) {
        let Difference { field, frames, largest, first_frame, first: [then, now], .. } = difference;
        let by = largest.map_or_else(|| format!("{then} became {now}"), |largest| format!("{largest:.3e}"));
        text.push_str(&format!("  {field:<40} {frames:>6} {first_frame:>6}  {by}\n"));
    }
    if verdict.differences.len() > LISTED_FIELDS {
        text.push_str(&format!("  and {} fields more\n", verdict.differences.len() - LISTED_FIELDS));
    }
    text.push_str("\nif that is meant to be: the same command with --bless");
    text
}

fn tests(verdict: &Verdict, report: &ReplayReport) -> Vec<TestCase> {
    let of_count = (verdict.frames != verdict.frames_of_reference)
        .then(|| format!("{} frames, the reference has {}", verdict.frames, verdict.frames_of_reference));
    let lost = report.data_was_lost().then(|| "data was lost: not all of the log could be replayed".to_owned());
    let unread = report.unread().into_iter().map(|loss| loss.to_string());
    let faults = of_count.into_iter().chain(lost).chain(unread).collect();
    let frames = TestCase { name: "frames".to_owned(), seconds: report.wall_s, faults };
    let fields = verdict.compared.iter().map(|field| {
        let found = verdict.differences.iter().find(|difference| difference.field == *field);
        let fault = found.map(|difference| {
            let Difference { frames, first_frame, first: [then, now], .. } = difference;
            format!("{frames} frames differ, the first is {first_frame}: {then} became {now}")
        });
        TestCase { name: field.clone(), seconds: 0.0, faults: fault.into_iter().collect() }
    });
    core::iter::once(frames).chain(fields).collect()
}

fn tolerance(text: &str) -> Result<(String, f64), String> {
    let (field, value) = text.split_once('=').ok_or("expected FIELD=VALUE")?;
    let value = value.trim().parse().ok().filter(|value: &f64| value.is_finite() && *value > 0.0);
    Ok((field.trim().to_owned(), value.ok_or("the tolerance must be a number above 0")?))
}
