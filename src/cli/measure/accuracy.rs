//! Command `realitysim measure accuracy`: how well the measures of `accuracy` predict the true error.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use clap::Args;
use glam::DVec2;
use serde::Serialize;

use crate::cli::accuracy::{Evidence, Report};
use crate::cli::doc_section::Section;
use crate::cli::host_info::cores;
use crate::cli::paths::{cannot_read, temporary};
use crate::cli::settings::UsageError;
use crate::cli::{Outcome, output};
use crate::config::{Settings, plain_file};
use crate::evaluation::accuracy::validation::{FAULTS, Fault, TrueError, correlation, range};
use crate::evaluation::accuracy::verdict::Verdict;
use crate::evaluation::accuracy::{Crossing, crossings};
use crate::evaluation::statistics::quantile;
use crate::evaluation::truth;
use crate::geometry::Field;
use crate::localization::smoothing::Model;
use crate::log_input::{InputSource, scene_source};
use crate::scene::{START_STAMP_NS, Scene};
use crate::tagging::offline_refinement::refine;
use crate::tagging::{ReplayOptions, replay};

/// Find out how well each measure of `accuracy` predicts the true error
///
/// Renders each walk as it is, and with a fault in the calibration that the robot is told: the camera stands 2 cm higher, its mount is
/// pitched by 1 degree, its focal length is 1 % off. Tags and refines it, and compares each measure with the true error, by correlation over
/// all runs. Where a walk stands at waypoints on crossings (stand_s), these are taped places.
#[derive(Args)]
#[command(
    after_long_help = "Example:\n  realitysim measure accuracy replay/accuracy/taped.toml replay/scenes/demo.toml"
)]
pub struct AccuracyArguments {
    /// Scenes that walk, without a calibration_error of their own
    #[arg(value_name = "SCENE", required = true)]
    scenes: Vec<PathBuf>,
    /// Put the tables into a document, between its marks <!-- begin: realitysim measure accuracy --> and
    /// <!-- end: realitysim measure accuracy -->
    #[arg(long, value_name = "FILE")]
    write_docs: Option<PathBuf>,
}

/// One walk with one fault.
#[derive(Serialize)]
struct Run {
    scene: String,
    fault: &'static str,
    truth: TrueError,
    report: Report,
}

/// A measure as it is compared with the truth.
struct Compared {
    name: &'static str,
    /// What it is said to predict.
    against: &'static str,
    /// The measure and the truth of a run, centimetres.
    pair: fn(&Run) -> Option<(f64, f64)>,
    blind: &'static str,
}

#[derive(Serialize)]
struct Predicted {
    measure: &'static str,
    predicts: &'static str,
    /// Runs with the measure, and different walks among them: runs of one walk share its images, and tell little more than one.
    runs: usize,
    walks: usize,
    /// Smallest and largest truth, centimetres.
    truth_cm: Option<[f64; 2]>,
    /// `None` if there are too few walks, or if the truth hardly varies.
    correlation: Option<f64>,
    /// Median of the measure over the truth.
    ratio: Option<f64>,
}

const COMPARED: [Compared; 6] = [
    Compared {
        name: "taped places, rms",
        against: "true error, rms",
        pair: |run| Some((run.report.taped.known()?.rms_cm, run.truth.rms_cm)),
        blind: "how the robot was put there",
    },
    Compared {
        name: "opposite headings",
        against: "true offset that turns with the robot",
        pair: |run| Some((run.report.turned.known()?.forward_left_cm.length(), run.truth.forward_left_cm.length())),
        blind: "what does not turn with the robot",
    },
    Compared {
        name: "odd and even metres, noise",
        against: "true error without its offset, rms",
        pair: |run| Some((run.report.split_half[0].known()?.noise_cm, run.truth.rest_cm)),
        blind: "field, IMU, odometry, lens and mount as far as they move both halves alike",
    },
    Compared {
        name: "left and right of the image, noise",
        against: "true error without its offset, rms",
        pair: |run| Some((run.report.split_half[1].known()?.noise_cm, run.truth.rest_cm)),
        blind: "the same, but a lens that is wrong on one side shows",
    },
    Compared {
        name: "residuals over the image (px)",
        against: "true error, rms",
        pair: |run| Some((run.report.residuals.image_px, run.truth.rms_cm)),
        blind: "what the fit has put into poses and constants",
    },
    Compared {
        name: "residuals over the field",
        against: "true error, rms",
        pair: |run| Some((run.report.residuals.field_cm, run.truth.rms_cm)),
        blind: "the same, and a field that was laid out wrong where it was not seen",
    },
];

#[derive(Serialize)]
struct Validation {
    runs: Vec<Run>,
    predicted: Vec<Predicted>,
}

pub fn run(arguments: &AccuracyArguments, json: bool) -> anyhow::Result<Outcome> {
    let section = arguments.write_docs.as_deref().map(|path| Section::open(path, "measure accuracy")).transpose()?;
    let mut runs = Vec::new();
    for path in &arguments.scenes {
        for fault in &FAULTS {
            runs.push(one(path, fault)?);
        }
    }
    let validation = Validation { predicted: COMPARED.iter().map(|it| it.over(&runs)).collect(), runs };
    if let Some(section) = &section {
        section.write(&validation.markdown(arguments))?;
    }
    if json {
        output::json(&validation)?;
    } else {
        output::lines(validation.tables().trim_end())?;
    }
    Ok(Outcome::Whole)
}

/// Tags, refines and judges a walk with a fault.
fn one(path: &Path, fault: &Fault) -> anyhow::Result<Run> {
    let folder = temporary()?;
    let source = folder.path().join("scene.toml");
    let scene = with_fault(path, fault, &source)?;
    let options = ReplayOptions {
        source,
        captures: folder.path().join("captures"),
        settings: Settings::default(),
        initial: None,
        threads: cores(),
        realtime: false,
        warm_start: false,
    };
    let mut progress = output::Progress::new("tagging");
    let capture = replay(&options, &mut |done, all| progress.set(done, all))?.session;
    progress.finish();
    let mut progress = output::Progress::new("refining");
    refine(&capture, &Model::default(), &mut |done, all| progress.set(done, Some(all)))?.write(&capture)?;
    progress.finish();
    let mut evidence = Evidence::read(&capture)?;
    evidence.marks = marks(&scene, &evidence.field);
    let mut tags: Vec<_> = evidence.valid_tags().collect();
    tags.sort_by_key(|(stamp_ns, _)| *stamp_ns);
    let truth = TrueError::of(&tags, &truth::of_scene(&scene)).unwrap_or_default();
    let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
    Ok(Run { scene: name, fault: fault.name, truth, report: evidence.report()? })
}

/// Fewest walks of which a correlation is stated.
const MIN_WALKS: usize = 3;
/// Largest scene file, bytes.
const MAX_SCENE_BYTES: u64 = 1 << 20;
/// Effects that have to stand after a calibration error.
const AFTER: [&str; 2] = ["camera_fault", "serial_noise"];

/// Writes the scene with a fault, and loads it. Names of fields and lenses beside the scene do not change.
fn with_fault(path: &Path, fault: &Fault, to: &Path) -> anyhow::Result<Scene> {
    if !InputSource::is_scene(path) {
        return Err(
            UsageError(format!("{}: a scene file (.toml) is needed, whose truth is known", path.display())).into()
        );
    }
    scene_source::load(path)?;
    let text = plain_file::read_text(path, MAX_SCENE_BYTES).map_err(|error| cannot_read(path, error))?;
    let mut file: toml::Table = text.parse()?;
    let effects = file.entry("effect").or_insert_with(|| toml::Value::Array(Vec::new())).as_array_mut();
    if let (Some(effects), Some((key, value))) = (effects, fault.key) {
        let kind = |effect: &toml::Value| effect.get("kind").and_then(toml::Value::as_str).map(str::to_owned);
        if effects.iter().any(|effect| kind(effect).as_deref() == Some("calibration_error")) {
            return Err(UsageError(format!("{}: it has a calibration_error of its own", path.display())).into());
        }
        let at = effects.iter().position(|effect| kind(effect).is_some_and(|kind| AFTER.contains(&kind.as_str())));
        let mut error = toml::Table::new();
        error.insert("kind".to_owned(), "calibration_error".into());
        error.insert(key.to_owned(), value.into());
        effects.insert(at.unwrap_or(effects.len()), error.into());
    }
    std::fs::write(to, toml::to_string(&file)?)?;
    Ok(scene_source::load(to)?)
}

/// What a person would mark where the walk stands: the crossing and the heading, in whole degrees.
fn marks(scene: &Scene, field: &Field) -> Vec<(i64, String)> {
    const SAME_M: f64 = 0.01;
    let all = crossings(field);
    let stands = scene.stands();
    let mark = |(from_s, until_s, pose): &(f64, f64, crate::geometry::Pose2)| {
        let is_there = |crossing: &&Crossing| crossing.at_m.distance(DVec2::new(pose.x, pose.y)) < SAME_M;
        let crossing = all.iter().find(is_there)?;
        let stamp_ns = START_STAMP_NS + (5e8 * (from_s + until_s)) as i64;
        Some((stamp_ns, format!("at {} {:.0}", crossing.name, pose.yaw.to_degrees())))
    };
    stands.iter().filter_map(mark).collect()
}

impl Compared {
    fn over(&self, runs: &[Run]) -> Predicted {
        let with_pair = || runs.iter().filter_map(|run| Some((run, (self.pair)(run)?)));
        let pairs: Vec<(f64, f64)> = with_pair().map(|(_, pair)| pair).collect();
        let walks: BTreeSet<&str> = with_pair().map(|(run, _)| run.scene.as_str()).collect();
        let mut ratios: Vec<f64> = pairs.iter().map(|(measured, truth)| measured / truth).collect();
        ratios.sort_by(f64::total_cmp);
        Predicted {
            measure: self.name,
            predicts: self.against,
            runs: pairs.len(),
            walks: walks.len(),
            truth_cm: (!pairs.is_empty()).then(|| range(pairs.iter().map(|pair| pair.1))),
            correlation: (walks.len() >= MIN_WALKS).then(|| correlation(&pairs)).flatten(),
            ratio: (!ratios.is_empty()).then(|| quantile(&ratios, 0.5)),
        }
    }
}

impl Validation {
    fn markdown(&self, arguments: &AccuracyArguments) -> String {
        let scenes: Vec<String> = arguments.scenes.iter().map(|scene| scene.display().to_string()).collect();
        let document = arguments.write_docs.as_deref().map_or(String::new(), |path| path.display().to_string());
        format!("    realitysim measure accuracy {} --write-docs {document}\n\n{}", scenes.join(" "), self.tables())
    }

    fn tables(&self) -> String {
        let mut text = String::from(
            "| measure | predicts | runs (walks) | truth, cm | correlation | measure / truth, median | cannot see |\n\
             | --- | --- | --- | --- | --- | --- | --- |\n",
        );
        let number = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.2}"));
        for (compared, predicted) in COMPARED.iter().zip(&self.predicted) {
            let Predicted { measure, predicts, runs, walks, truth_cm, correlation, ratio } = predicted;
            let truth = truth_cm.map_or("-".to_owned(), |[low, high]| format!("{low:.2} to {high:.2}"));
            let (correlation, ratio, blind) = (number(*correlation), number(*ratio), compared.blind);
            text += &format!(
                "| {measure} | {predicts} | {runs} ({walks}) | {truth} | {correlation} | {ratio} | {blind} |\n"
            );
        }
        text += "\nIn centimetres:\n\n| walk | fault | true error | its offset | the rest | taped | opposite | metres | sides | image, px \
                 | field | verdicts |\n| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n";
        self.runs.iter().for_each(|run| text += &run.row());
        text
    }
}

impl Run {
    fn row(&self) -> String {
        let Self { scene, fault, truth, report } = self;
        let figures = COMPARED
            .iter()
            .map(|compared| (compared.pair)(self).map_or("-".to_owned(), |(measured, _)| format!("{measured:.2}")));
        let verdicts = report.verdicts.iter().map(|verdict| match verdict.verdict {
            Verdict::Yes => "yes",
            Verdict::No => "no",
            Verdict::NotShown => "-",
        });
        format!(
            "| `{scene}` | {fault} | {:.2} | {:.2} | {:.2} | {} | {} |\n",
            truth.rms_cm,
            truth.forward_left_cm.length(),
            truth.rest_cm,
            figures.collect::<Vec<_>>().join(" | "),
            verdicts.collect::<Vec<_>>().join(", ")
        )
    }
}
