//! Command `realitysim labels mine`: finds the images in which a team's detector is most surely wrong.

mod asking;
mod files;
mod sheet;

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::super::export::frames::fill_own_folder;
use super::super::opened_database::OpenedDatabase;
use super::super::paths::check_output;
use super::super::values::number;
use super::super::{Outcome, output};
use super::make::Classes;
use super::posed_images::PosedImages;
use crate::database::TagLimits;
use crate::labels::{Disagreement, Fault, Labeller};
use crate::recording::Loss;
use asking::Judged;

/// Find the images in which a detector of landmarks is most surely wrong
///
/// The detector is a command that is started once, reads names of PNGs from standard input, and prints what it finds in each, a line for
/// each landmark and an empty line at the end: `class u v [score]` or `class u_min v_min u_max v_max [score]`. What it finds is held against where the tags put crossings, marks and goal posts:
/// missed, false, or displaced. A miss of what is large, in plain view and known to a fraction of a pixel counts most.
///
/// sheet.jpg has the worst images: found landmarks cyan, missed ones red, displaced ones yellow with a line to where they were found,
/// false detections magenta. disagreements.csv lists all, the surest first.
#[derive(Args)]
#[command(after_long_help = concat!(
    "Example:",
    "\n  realitysim labels mine images/ --detector ./detect.py -o mined/",
))]
pub struct MineArguments {
    /// A capture's folder, one of its segments, or a database's folder
    #[arg(value_name = "CAPTURE|DB")]
    input: PathBuf,
    /// Run in a shell; reads names of PNGs and prints the landmarks that it finds
    #[arg(long, value_name = "COMMAND")]
    detector: String,
    /// Folder to write, outside of any capture
    #[arg(short, long)]
    output: PathBuf,
    /// The detector's classes: one for each kind of landmark, or those of Booster's RoboCup demo
    #[arg(long, default_value = "landmarks")]
    classes: Classes,
    /// A landmark is found within this distance and twice its own standard deviation, pixels, 0.5 to 100; up to four times as far it is
    /// displaced
    #[arg(long, value_name = "PX", default_value_t = 5.0, value_parser = number(0.5..=100.0))]
    within: f64,
}

#[derive(Serialize)]
struct Report {
    output: PathBuf,
    /// Images that the detector has answered for.
    images: usize,
    /// Images for which it failed.
    failed: usize,
    right: usize,
    missed: usize,
    #[serde(rename = "false")]
    false_detections: usize,
    displaced: usize,
    classes: Vec<ClassRow>,
    /// Images with disagreements, the surest first.
    frames: Vec<FrameRow>,
    lost: Vec<Loss>,
}

/// Counts of one class.
#[derive(Serialize)]
struct ClassRow {
    class: &'static str,
    right: usize,
    missed: usize,
    #[serde(rename = "false")]
    false_detections: usize,
    displaced: usize,
}

/// An image in the report.
#[derive(Serialize)]
struct FrameRow {
    /// Number of the image in the database.
    image: usize,
    /// Its capture or folder.
    source: PathBuf,
    stamp_ns: i64,
    /// Certainty of the surest disagreement.
    certainty: f64,
    disagreements: usize,
}

pub fn run(arguments: &MineArguments, json: bool) -> anyhow::Result<Outcome> {
    let MineArguments { input, output, .. } = arguments;
    check_output(output, &[input])?;
    let report = fill_own_folder(output, || mine(arguments))?;
    output::losses(&report.lost);
    if json {
        output::json(&report)?;
    } else {
        output::lines(&text(&report))?;
    }
    Ok(Outcome::of(&report.lost))
}

fn mine(arguments: &MineArguments) -> anyhow::Result<Report> {
    let max_sigma_m = TagLimits::default().sigma_m;
    let opened = OpenedDatabase::of(&arguments.input, max_sigma_m)?;
    let database = &opened.database;
    let (chosen, _) = crate::database::training_set::precise_records(database, max_sigma_m)?;
    let images = PosedImages::new(database)?;
    let labeller = Labeller::new(database.field(), database.world().has_goals());
    let asking = asking::Asking {
        images: &images,
        labeller: &labeller,
        classes: arguments.classes.list(),
        command: &arguments.detector,
        within_px: arguments.within,
    };
    let mut answers = asking.ask_all(&chosen)?;
    answers.judged.sort_by(Judged::surest_first);
    files::write(&arguments.output, &asking, &answers.judged)?;
    let lost = opened.lost.iter().cloned().chain(answers.losses(&arguments.output)).collect();
    Ok(report(arguments, &asking, &answers, lost))
}

fn report(arguments: &MineArguments, asking: &asking::Asking, answers: &asking::Answers, lost: Vec<Loss>) -> Report {
    let judged = &answers.judged;
    let all = || judged.iter().flat_map(|judged| &judged.compared.disagreements);
    let count = |fault: Fault, of: &dyn Fn(&Disagreement) -> bool| all().filter(|d| d.fault == fault && of(d)).count();
    let right = || judged.iter().flat_map(|judged| &judged.compared.right);
    let class_of = |landmark: &usize| asking.classes.class(asking.labeller.landmarks()[*landmark].kind);
    let row = |(number, class): (usize, &&'static str)| ClassRow {
        class,
        right: right().filter(|landmark| class_of(landmark) == Some(number)).count(),
        missed: count(Fault::Missed, &|d| d.class == number),
        false_detections: count(Fault::False, &|d| d.class == number),
        displaced: count(Fault::Displaced, &|d| d.class == number),
    };
    let rows = asking.classes.names.iter().enumerate().map(row);
    let is_met = |row: &ClassRow| row.right + row.missed + row.false_detections + row.displaced > 0;
    let wrong = judged.iter().filter(|judged| !judged.compared.disagreements.is_empty());
    Report {
        output: arguments.output.clone(),
        images: judged.len(),
        failed: answers.failed.len(),
        right: right().count(),
        missed: count(Fault::Missed, &|_| true),
        false_detections: count(Fault::False, &|_| true),
        displaced: count(Fault::Displaced, &|_| true),
        classes: rows.filter(is_met).collect(),
        frames: wrong.map(|judged| files::frame_row(asking, judged)).collect(),
        lost,
    }
}

fn text(report: &Report) -> String {
    let Report { images, right, missed, false_detections, displaced, output, frames, .. } = report;
    let mut text = format!(
        "{images} images: {right} landmarks found, {missed} missed, {displaced} displaced, {false_detections} false detections\n\
         class             found  missed  displaced   false"
    );
    for ClassRow { class, right, missed, displaced, false_detections } in &report.classes {
        text += &format!("\n{class:16}{right:7}{missed:8}{displaced:11}{false_detections:8}");
    }
    let sheet = if frames.is_empty() { "disagreements.csv" } else { sheet::FILE };
    text + &format!("\n{}", output.join(sheet).display())
}
