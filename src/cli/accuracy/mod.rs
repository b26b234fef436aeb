//! Command `realitysim accuracy`: how accurate the tags of one robot are on one field.

mod evidence;
mod page;
mod text;

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use serde::Serialize;

use super::paths::{check_output, write};
use super::settings::UsageError;
use super::{Outcome, output};
use crate::config::load_field;
use crate::evaluation::accuracy::{Crossing, Measure, Refused, ResidualMaps, SplitHalf, Taped, Turned, Use, crossings};
use crate::geometry::Field;
use crate::recording::{Loss, RefinedConstant};

pub use evidence::Evidence;

/// Tell how accurate the tags of one robot are on one field, without any alignment
///
/// The absolute error comes from taped places: put the robot on crossings of the field, and give `realitysim recorder mark "at CROSSING
/// HEADING"` while it stands. Without them the report has what needs no truth: noise by two halves of the lines, where in the image and on
/// the field lines lie off, what a fit of the whole walk changes in camera and mount. Measures that the data do not allow are named as
/// missing, and so is each mark that cannot be used (exit code 1). Ends with a verdict for labels, views and the ball's radius.
#[derive(Args)]
#[command(after_long_help = concat!(
    "Examples:",
    "\n  realitysim accuracy --crossings kid-2020 -o places.html",
    "\n  realitysim accuracy captures/2026-11-21T10-00-00Z-robot -o report.html",
))]
pub struct AccuracyArguments {
    /// A capture's folder
    #[arg(required_unless_present = "crossings")]
    capture: Option<PathBuf>,
    /// In place of a report: the names and places of a field's crossings, a shipped field or the path of a field file
    #[arg(long, value_name = "FIELD", conflicts_with = "capture")]
    crossings: Option<String>,
    /// The page to write: the report, or the field with its crossings
    #[arg(short, long, value_name = "HTML")]
    output: Option<PathBuf>,
}

/// What is known of the accuracy of a capture's tags.
#[derive(Serialize)]
pub struct Report {
    pub robot: String,
    /// Title of the field.
    pub field: String,
    /// Frames with a tag, and with a valid one.
    pub frames: [usize; 2],
    /// Whether the tags are refined ones.
    pub refined: bool,
    pub taped: Measure<Taped>,
    /// Marks that cannot be used.
    pub refused: Vec<Refused>,
    pub turned: Measure<Turned>,
    pub split_half: Vec<Measure<SplitHalf>>,
    pub residuals: ResidualMaps,
    /// What the fit of the whole walk changes in camera and mount.
    pub constants: Vec<RefinedConstant>,
    /// Root mean square of the horizontal distance between the tags and the fit, centimetres.
    pub fit_moves_cm: f64,
    pub verdicts: Vec<Use>,
    pub lost: Vec<Loss>,
}

pub fn run(arguments: &AccuracyArguments, json: bool) -> anyhow::Result<Outcome> {
    match (&arguments.crossings, &arguments.capture) {
        (Some(field), _) => list_crossings(field, arguments, json),
        (None, Some(capture)) => {
            if let Some(output) = &arguments.output {
                check_output(output, &[capture])?;
            }
            let evidence = Evidence::read(capture)?;
            report(&evidence, arguments, json)
        }
        // The parser of the command line asks for one or the other.
        (None, None) => Err(UsageError("name a capture, or give --crossings FIELD".to_owned()).into()),
    }
}

fn report(evidence: &Evidence, arguments: &AccuracyArguments, json: bool) -> anyhow::Result<Outcome> {
    let report = evidence.report()?;
    output::losses(&report.lost);
    for Refused { mark, why, .. } in &report.refused {
        output::say(&format!("mark {mark:?}: {why}"));
    }
    if let Some(output) = &arguments.output {
        write(output, &page::report(&report, &evidence.field))?;
    }
    if json {
        output::json(&report)?;
    } else {
        output::lines(text::summary(&report).trim_end())?;
    }
    Ok(if report.refused.is_empty() { Outcome::of(&report.lost) } else { Outcome::NotReached })
}

#[derive(Serialize)]
struct Places<'a> {
    field: &'a str,
    crossings: &'a [Crossing],
}

fn list_crossings(name: &str, arguments: &AccuracyArguments, json: bool) -> anyhow::Result<Outcome> {
    let field = Field::new(load_field(name)?).with_context(|| name.to_owned())?;
    let crossings = crossings(&field);
    if let Some(output) = &arguments.output {
        check_output(output, &[])?;
        write(output, &page::places(&field, &crossings))?;
    }
    if json {
        output::json(&Places { field: &field.dimensions().title, crossings: &crossings })?;
    } else {
        output::lines(text::places(&crossings).trim_end())?;
    }
    Ok(Outcome::Whole)
}
