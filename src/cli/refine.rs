//! Command `realitysim refine`: improves the tags of a whole capture afterwards.

use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;

use super::catalogue_beside::update_catalogue;
use super::paths::temporary;
use super::values::whole;
use super::{Outcome, output};
use crate::config::Settings;
use crate::database::{DatabaseError, ImageDatabase, TagLimits, add, leave_one_out};
use crate::evaluation::Summary;
use crate::evaluation::capture::read_truth;
use crate::geometry::Isometry;
use crate::localization::smoothing::Model;
use crate::recording::{RefinedConstant, RefinedInfo};
use crate::ros2::messages::FrameTag;
use crate::tagging::offline_refinement::refine;

/// Improve a capture's tags afterwards, from all frames together
///
/// Lines, odometry, IMU and mount of all frames are fitted at once, and with them what is constant: focal length and centre of the lens, the
/// mount's tilt, the camera's height. Writes CAPTURE/refined, which `db add` prefers if lines that took no part fit it better; what was
/// recorded is not touched; a folder `catalogue` beside that of the captures is brought up to date. Tells how good the tags
/// are before and after: by --truth, and by views of every so many images made from the others.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim refine captures/2026-11-21T10-00-00Z-robot --truth walk.mcap")]
pub struct RefineArguments {
    /// A capture's folder
    capture: PathBuf,
    /// A log with the true poses, to judge by
    #[arg(long, value_name = "LOG")]
    truth: Option<PathBuf>,
    /// Topic of the true poses
    #[arg(long, value_name = "TOPIC", default_value_t = crate::config::Topics::default().ground_truth)]
    truth_topic: String,
    /// Images that are left out and made from the others, for judging; 0 for none
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = whole(0..=1000u16))]
    views: u16,
}

#[derive(Serialize)]
struct Report {
    frames: usize,
    tags: usize,
    before: Judged,
    after: Judged,
    constants: Vec<RefinedConstant>,
    /// Whether `db add` takes the refined tags.
    preferred: bool,
    output: PathBuf,
}

/// Quality of a set of tags.
#[derive(Default, Serialize)]
struct Judged {
    /// RMS distance of line places that fit, pixels.
    rms_px: f64,
    /// The same for line places that took no part in the fit.
    held_out_px: f64,
    position_cm: Option<Summary>,
    angle_deg: Option<Summary>,
    /// PSNR of images that are left out and made from the others.
    view_psnr_db: Option<Summary>,
}

pub fn run(arguments: &RefineArguments, json: bool) -> anyhow::Result<Outcome> {
    let RefineArguments { capture, truth, truth_topic, views } = arguments;
    let truth = truth.as_deref().map(|log| read_truth(log, truth_topic)).transpose()?;
    let mut progress = output::Progress::new("looking");
    let refining = refine(capture, &Model::default(), &mut |done, all| progress.set(done, Some(all)))?;
    progress.finish();
    let info = refining.info();
    let preferred = info.is_better();
    let RefinedInfo { constants, frames, rms_px, held_out_px, .. } = info;
    let views = usize::from(*views);
    let judged = |capture: &Path, tags: &[FrameTag], which: usize| -> anyhow::Result<Judged> {
        let (rms_px, held_out_px) = (rms_px[which], held_out_px[which]);
        let truth = truth.as_ref().map(|truth| pose_errors(tags, &refining.stamps_ns, &truth.found));
        let (position_cm, angle_deg) = truth.flatten().unzip();
        // There are no views of tags that a database does not take.
        let view_psnr_db = if views > 0 && (which == 0 || preferred) { view_psnr(capture, views)? } else { None };
        Ok(Judged { rms_px, held_out_px, position_cm, angle_deg, view_psnr_db })
    };
    let recorded = without_refinement(capture)?;
    let before = judged(recorded.path(), &refining.tags, 0)?;
    let folder = refining.write(capture)?;
    update_catalogue(std::slice::from_ref(capture));
    let after = judged(capture, &refining.refined, 1)?;
    output::losses(&refining.losses);
    let report = Report { frames, tags: refining.tags.len(), before, after, constants, preferred, output: folder };
    if json {
        output::json(&report)?;
    } else {
        output::lines(text_report(&report).trim_end())?;
    }
    Ok(Outcome::of(&refining.losses))
}

/// Errors of position (cm) and angle (degrees) of the tags that took part, against true poses with the same stamp.
fn pose_errors(tags: &[FrameTag], stamps_ns: &[i64], truth: &[(i64, Isometry)]) -> Option<(Summary, Summary)> {
    let (mut centimetres, mut degrees) = (Vec::new(), Vec::new());
    for tag in tags.iter().filter(|tag| tag.valid) {
        let stamp = tag.header.stamp.to_nanoseconds();
        let at = truth.binary_search_by_key(&stamp, |(stamp, _)| *stamp);
        if let (Ok(at), Ok(_)) = (at, stamps_ns.binary_search(&stamp)) {
            let pose = Isometry::from(tag.pose.pose);
            centimetres.push(100.0 * pose.translation.distance(truth[at].1.translation));
            degrees.push(crate::views::angle_between(&pose, &truth[at].1).to_degrees());
        }
    }
    (!centimetres.is_empty()).then(|| (Summary::of(&centimetres), Summary::of(&degrees)))
}

/// Makes a temporary capture without the tags of an earlier refinement, which would else be taken for the recorded ones.
/// They stay in place until better ones are there.
fn without_refinement(capture: &Path) -> std::io::Result<tempfile::TempDir> {
    let folder = tempfile::tempdir()?;
    for entry in std::fs::read_dir(capture)? {
        let (name, path) = entry.map(|entry| (entry.file_name(), entry.path()))?;
        let to = folder.path().join(&name);
        if name.to_string_lossy().contains(".mcap") {
            std::os::unix::fs::symlink(path.canonicalize()?, to)?;
        } else if path.is_file() {
            // Files that describe a capture are not read through links, so they are copied.
            std::fs::copy(path, to)?;
        }
    }
    Ok(folder)
}

/// PSNR of views with the capture's present tags. Goals are left out: rendered captures have none, and real ones are judged
/// by the ground.
fn view_psnr(capture: &Path, views: usize) -> anyhow::Result<Option<Summary>> {
    let folder = temporary()?;
    let db = folder.path().join("db");
    // Ambiguous tags are included: a walk in the wrong half is as consistent in itself.
    let limits = TagLimits { ambiguous: true, ..TagLimits::default() };
    match add(&db, &[capture.to_owned()], None, limits, &mut |_| ()) {
        Err(DatabaseError::Nothing(_)) => return Ok(None),
        added => added?,
    };
    let settings = crate::config::ViewsSettings { goals: false, ..Settings::default().views };
    let database = ImageDatabase::open(&db, &settings)?;
    let found = leave_one_out(&database, views, &mut |_| ())?;
    Ok((!found.is_empty()).then(|| Summary::of(&found)))
}

fn text_report(report: &Report) -> String {
    let mut text = format!("{} of {} tags refined\n", report.frames, report.tags);
    let median =
        |summary: &Option<Summary>| summary.as_ref().map_or("-".to_owned(), |summary| format!("{:.2}", summary.median));
    let mut row = |name: &str, of: &dyn Fn(&Judged) -> String| {
        text.push_str(&format!("  {name:<34} {:>8} before {:>8} after\n", of(&report.before), of(&report.after)));
    };
    row("lines, rms px", &|judged| format!("{:.2}", judged.rms_px));
    row("lines that took no part, rms px", &|judged| format!("{:.3}", judged.held_out_px));
    row("position, median cm", &|judged| median(&judged.position_cm));
    row("angle, median deg", &|judged| {
        judged.angle_deg.as_ref().map_or("-".to_owned(), |s| format!("{:.3}", s.median))
    });
    row("views of the ground, median dB", &|judged| median(&judged.view_psnr_db));
    for RefinedConstant { name, unit, value, known, observable, .. } in &report.constants {
        let doubt = match *observable {
            false => "  (not observable in this walk)",
            true if name.starts_with("tilt") => "  (of mount and IMU together)",
            true => "",
        };
        text.push_str(&format!("  {name:<26} {value:+.5} +- {known:.5} {unit}{doubt}\n"));
    }
    text.push_str(&report.output.display().to_string());
    if !report.preferred {
        text.push_str("\nlines that took no part fit no better: `db add` keeps the tags that were recorded");
    }
    text
}
