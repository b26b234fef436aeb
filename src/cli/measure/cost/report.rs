//! Report of a sweep for people, programs and documents.

use std::path::PathBuf;

use serde::Serialize;

use crate::evaluation::cost::{self, Advice, Requirements, Row, SweepPoint};
use crate::localization::Model;
use crate::recording::Loss;

/// Everything that a sweep found.
pub struct Report {
    /// Name of the log or scene.
    pub source: String,
    pub frames: usize,
    /// The log has more frames than are held in memory.
    pub is_cut: bool,
    pub truth_source: TruthSource,
    /// Frames that have a pose to be judged by.
    pub frames_judged: usize,
    pub seeds: usize,
    /// Reduction that `image_reduction = 0` stands for with this lens.
    pub automatic_reduction: usize,
    pub configured: SweepPoint,
    /// Results by increasing time.
    pub rows: Vec<Row>,
    pub noise_cm: f64,
    pub requirements: Requirements,
    pub advice: Advice,
    pub machine: String,
    pub command: String,
    pub warnings: Vec<String>,
    /// Parts of the log that could not be used.
    pub losses: Vec<Loss>,
    pub wall_s: f64,
    pub output: PathBuf,
}

/// Poses that errors are measured against.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum TruthSource {
    GroundTruth,
    /// The valid tags of a long run with these settings. `elsewhere`: a ground truth exists, but for other times.
    Reference {
        settings: SweepPoint,
        elsewhere: bool,
    },
}

/// A result and its standing among the others.
#[derive(Serialize)]
pub struct Line<'a> {
    #[serde(flatten)]
    pub row: &'a Row,
    pub on_front: bool,
    pub recommended: bool,
    pub configured: bool,
}

#[derive(Serialize)]
pub struct Json<'a> {
    source: &'a str,
    frames: usize,
    frames_cut: bool,
    judged_by: TruthSource,
    frames_judged: usize,
    seeds: usize,
    rows: Vec<Line<'a>>,
    noise_cm: f64,
    #[serde(rename = "wish")]
    requirements: Requirements,
    recommended: Recommended<'a>,
    machine: &'a str,
    warnings: &'a [String],
    lost: &'a [Loss],
    wall_s: f64,
    output: &'a PathBuf,
}

#[derive(Serialize)]
struct Recommended<'a> {
    #[serde(flatten)]
    row: &'a Row,
    why: &'a str,
    keeps_budget: Option<bool>,
    reaches_accuracy: Option<bool>,
}

impl Report {
    pub fn recommended(&self) -> &Row {
        &self.rows[self.advice.row]
    }

    pub fn lines(&self) -> Vec<Line<'_>> {
        let on = cost::front(&self.rows.iter().map(Row::point).collect::<Vec<_>>());
        let line = |(index, (row, on_front))| Line {
            row,
            on_front,
            recommended: index == self.advice.row,
            configured: row.sweep_point == self.configured,
        };
        self.rows.iter().zip(on).enumerate().map(line).collect()
    }

    pub fn chart(&self) -> String {
        let title = format!(
            "{}: {} frames, {} settings \u{d7} {} seeds",
            self.source,
            self.frames,
            self.rows.len(),
            self.seeds
        );
        cost::chart(&self.rows, Some(&self.advice), &self.requirements, &title)
    }

    pub fn as_json(&self) -> Json<'_> {
        let Advice { why, keeps_budget, reaches_accuracy, .. } = &self.advice;
        let (keeps_budget, reaches_accuracy) = (*keeps_budget, *reaches_accuracy);
        Json {
            source: &self.source,
            frames: self.frames,
            frames_cut: self.is_cut,
            judged_by: self.truth_source,
            frames_judged: self.frames_judged,
            seeds: self.seeds,
            rows: self.lines(),
            noise_cm: self.noise_cm,
            requirements: self.requirements,
            recommended: Recommended { row: self.recommended(), why, keeps_budget, reaches_accuracy },
            machine: &self.machine,
            warnings: &self.warnings,
            lost: &self.losses,
            wall_s: self.wall_s,
            output: &self.output,
        }
    }

    pub fn for_people(&self) -> String {
        let mut text = format!("{}\n\n", self.judged_by());
        text.push_str(
            "      model     particles   T  points  image  refined    p50 ms  p99 ms   mean cm  p95 cm     +-   valid %\n",
        );
        for line in self.lines() {
            text.push_str(&self.row_for_people(&line));
        }
        let is_capped = self.rows.iter().any(|row| row.sweep_point.budget_ms > 0.0);
        let capped = if is_capped { "capped: with filter.budget_ms, as no other row keeps the budget\n  " } else { "" };
        text.push_str(&format!(
            "\n  * Pareto front   > recommended   = as configured   - tags too few frames to be compared\n  \
             {capped}image: how much smaller a copy is looked at; +-: scatter of the mean over {} seeds\n\n\
             {}\n\n{:.0} s on a {}\n",
            self.seeds, self.advice.why, self.wall_s, self.machine
        ));
        let files = ["cost.csv", "cost.svg", "cost.toml"].map(|name| self.output.join(name).display().to_string());
        text.push_str(&files.join("  "));
        text
    }

    fn row_for_people(&self, line: &Line) -> String {
        let Row { sweep_point, p50_ms, p99_ms, position_cm, scatter_cm, valid_share, judged, evasive, .. } = line.row;
        let sign = |is: bool, sign: char| if is { sign } else { ' ' };
        let errors = if *judged > 0 {
            format!("{:>9.2} {:>7.2} {:>6.2}", position_cm.mean, position_cm.p95, scatter_cm)
        } else {
            format!("{:>9} {:>7} {:>6}", "?", "?", "?")
        };
        format!(
            " {}{}{}{} {:<9} {:>9} {:>3} {:>7}  {:>5}  {:<7} {:>9.2} {:>7.2} {errors} {:>9.1}{}\n",
            sign(line.recommended, '>'),
            sign(line.on_front, '*'),
            sign(line.configured, '='),
            sign(*evasive, '-'),
            model_name(sweep_point.model),
            particles(sweep_point),
            sweep_point.iterations,
            sweep_point.line_points,
            self.image(sweep_point),
            if sweep_point.refinement { "yes" } else { "no" },
            p50_ms,
            p99_ms,
            100.0 * valid_share,
            if sweep_point.budget_ms > 0.0 { "  capped" } else { "" },
        )
    }

    /// Says in one sentence what the errors are measured against.
    fn judged_by(&self) -> String {
        let Self { source, frames, frames_judged, .. } = self;
        let cut = if self.is_cut { " (there are more: --from and --for choose others)" } else { "" };
        let by = match self.truth_source {
            TruthSource::GroundTruth if frames_judged == frames => "judged by the ground truth".to_owned(),
            TruthSource::GroundTruth => {
                format!("judged by the ground truth, which covers {frames_judged} of them: only these count")
            }
            TruthSource::Reference { settings, elsewhere } => {
                let why = if elsewhere { "the ground truth is of other times" } else { "there is no ground truth" };
                format!(
                    "judged by a long run of the filter itself ({settings}), valid on {frames_judged} of them, because {why}: \
                     what both get wrong does not show"
                )
            }
        };
        format!("{frames} frames of {source}{cut}, {by}.")
    }

    fn image(&self, sweep_point: &SweepPoint) -> String {
        let reduction =
            if sweep_point.image_reduction == 0 { self.automatic_reduction } else { sweep_point.image_reduction };
        format!("1/{reduction}")
    }

    /// Table of the front, the configured row and the recommendation, with the command and machine that made it.
    pub fn markdown(&self) -> String {
        let shown: Vec<Line> = self.lines().into_iter().filter(|line| line.on_front || line.configured).collect();
        let mut text = format!("    {}\n\n{} {}.\n", self.command, self.judged_by(), self.measured());
        for warning in &self.warnings {
            text.push_str(&format!("**Careful:** {warning}.\n"));
        }
        text.push_str("\n![Error against time for each setting](cost.svg)\n\n");
        text.push_str("| | model | particles x T | line points | image | refined | p50 ms | p99 ms | mean cm | p95 cm | valid |\n");
        text.push_str("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n");
        for line in &shown {
            let Row { sweep_point, p50_ms, p99_ms, position_cm, valid_share, .. } = line.row;
            let what = [
                (line.recommended, "**recommended**"),
                (line.configured, "configured"),
                (line.on_front, "front"),
                (sweep_point.budget_ms > 0.0, "capped"),
            ];
            let what: Vec<&str> = what.iter().filter(|(is, _)| *is).map(|(_, name)| *name).collect();
            text.push_str(&format!(
                "| {} | {} | {} x {} | {} | {} | {} | {p50_ms:.2} | {p99_ms:.2} | {:.2} | {:.2} | {:.1} % |\n",
                what.join(", "),
                model_name(sweep_point.model),
                particles(sweep_point),
                sweep_point.iterations,
                sweep_point.line_points,
                self.image(sweep_point),
                if sweep_point.refinement { "yes" } else { "no" },
                position_cm.mean,
                position_cm.p95,
                100.0 * valid_share,
            ));
        }
        let behind = self.rows.len() - shown.len();
        text.push_str(&format!("\nThe other {behind} settings lie behind the front.\n\n> {}", self.advice.why));
        text
    }

    fn measured(&self) -> String {
        format!("{} settings x {} seeds in {:.0} s on a {}", self.rows.len(), self.seeds, self.wall_s, self.machine)
    }
}

pub fn model_name(model: Model) -> &'static str {
    match model {
        Model::Gauss => "gauss",
        Model::Distance => "distance",
    }
}

/// Number of particles, with a sign for "at most" if it is adaptive.
fn particles(sweep_point: &SweepPoint) -> String {
    format!("{}{}", if sweep_point.adaptive { "\u{2264}" } else { "" }, sweep_point.particles)
}
