//! Command `realitysim measure paper`: repeats the paper's experiments on rendered scenes.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use serde::Serialize;

use crate::cli::doc_section::Section;
use crate::cli::values::any_whole;
use crate::cli::{Outcome, host_info, output, paths};
use crate::config::Settings;
use crate::evaluation::Summary;
use crate::evaluation::paper::{METHODS, PAPER_PARTICLES, PAPER_WALK_CM, Paper, Plan, Run, charts, reproduce};
use crate::localization::SimdPath;

/// Repeat the paper's experiments on rendered scenes
///
/// Fig. 9 (error and time against the number of particles) and Table 2 (distance against Gauss) on images taken standing on
/// a grid of 30 cm, Fig. 10 on a straight walk; with the formulas as printed, corrected, and refined as this program does
/// by default. Field, camera and particles are those of the paper. docs/explanation/paper.md says what comes out, and why.
///
/// Writes paper.md (the results as Markdown), paper.csv and three pictures. Takes some minutes; --quick takes seconds.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim measure paper --quick")]
pub struct PaperArguments {
    /// Where the results go
    #[arg(short, long, value_name = "DIR", default_value = "paper")]
    output: PathBuf,
    /// Few places and few frames: shows that it works, says little
    #[arg(long)]
    quick: bool,
    /// Seed of all random numbers of the filter
    #[arg(long, value_name = "S", default_value_t = 1, value_parser = any_whole::<u64>)]
    seed: u64,
    /// Put the results into a document, between its marks <!-- begin: realitysim measure paper --> and
    /// <!-- end: realitysim measure paper -->, and the pictures beside it
    #[arg(long, value_name = "FILE")]
    write_docs: Option<PathBuf>,
}

#[derive(Serialize)]
struct Report<'a> {
    #[serde(flatten)]
    paper: &'a Paper,
    quick: bool,
    machine: &'a str,
    warning: Option<&'a str>,
    wall_s: f64,
    output: &'a Path,
}

pub fn run(arguments: &PaperArguments, json: bool) -> anyhow::Result<Outcome> {
    let (started, waited_s) = (Instant::now(), host_info::waited_s());
    let section = arguments.write_docs.as_deref().map(|path| Section::open(path, "measure paper")).transpose()?;
    let folder = &arguments.output;
    paths::check_output(folder, &[])?;
    paths::make_folder(folder)?;
    let plan = if arguments.quick { Plan::quick() } else { Plan::full() };
    let mut settings = Settings::default();
    settings.filter.seed = arguments.seed;
    let mut bar: Option<(&str, output::Progress)> = None;
    let paper = reproduce(&plan, &settings, &mut |what, done, total| {
        if bar.as_ref().is_none_or(|(shown, _)| *shown != what) {
            if let Some((_, finished)) = bar.take() {
                finished.finish();
            }
            bar = Some((what, output::Progress::new(what)));
        }
        if let Some((_, bar)) = &mut bar {
            bar.set(done, total);
        }
    })?;
    if let Some((_, bar)) = bar {
        bar.finish();
    }
    let wall_s = started.elapsed().as_secs_f64();
    let waited_s = host_info::waited_s().zip(waited_s).map(|(now, before)| now - before);
    let warning = host_info::busy_warning(waited_s, wall_s);
    let machine = host_info::describe(SimdPath::Auto);
    let report = Report {
        paper: &paper,
        quick: arguments.quick,
        machine: &machine,
        warning: warning.as_deref(),
        wall_s,
        output: folder,
    };

    let text = markdown(&report);
    paths::write(&folder.join("paper.md"), &text)?;
    paths::write(&folder.join("paper.csv"), &csv(&paper))?;
    for (name, picture) in charts::charts(&paper) {
        paths::write(&folder.join(name), &picture)?;
        if let Some(section) = &section {
            paths::write(&section.beside(name), &picture)?;
        }
    }
    if let Some(section) = &section {
        section.write(&text)?;
    }
    if let Some(warning) = &warning {
        eprintln!("realitysim: {warning}");
    }
    if json {
        output::json(&report)?;
    } else {
        output::lines(&format!("{}\n{}", text.trim_end(), folder.display()))?;
    }
    Ok(Outcome::Whole)
}

fn markdown(report: &Report) -> String {
    let Report { paper, quick, machine, wall_s, .. } = report;
    let flag = if *quick { " --quick" } else { "" };
    let mut text = format!(
        "    realitysim paper{flag}\n\n{wall_s:.0} s on a {machine}. {} images on a grid of {:.0} cm, {} of a straight walk.\n",
        paper.still_frames,
        100.0 * paper.grid_m,
        paper.walk_frames
    );
    if *quick {
        text.push_str("**Short form:** too few images to say anything.\n");
    }
    if let Some(warning) = report.warning {
        text.push_str(&format!("**Careful:** {warning}.\n"));
    }
    text.push_str(&format!("\n### Table 2: distance against Gauss, {PAPER_PARTICLES} particles, standing\n\n"));
    text.push_str("| | mean cm | median cm | p95 cm | yaw, mean deg | ms a frame (p50) | the paper |\n");
    text.push_str("| --- | --- | --- | --- | --- | --- | --- |\n");
    for run in paper.still.iter().filter(|run| run.particles == PAPER_PARTICLES) {
        let reported =
            run.method.reported.map_or("".to_owned(), |r| format!("{} cm, {:.0} ms", r.error_cm, 1e3 * r.seconds));
        text.push_str(&format!("{} {reported} |\n", row(run).trim_end()));
    }
    text.push_str("\n### Fig. 9: error and time against the number of particles, standing\n\n");
    text.push_str(
        "![Error against particles](paper-fig9-error.svg)\n\n![Time against particles](paper-fig9-time.svg)\n\n",
    );
    text.push_str(&fig9(paper));
    text.push_str(&format!("\n### Fig. 10: straight walk, {PAPER_PARTICLES} particles\n\n"));
    text.push_str("![Error along the walk](paper-fig10.svg)\n\n");
    let seeds = paper.walk.first().map_or(0, |run| run.seed_means_cm.len());
    text.push_str(&format!("Of {seeds} seeds; the picture shows the first.\n\n"));
    text.push_str(
        "| | mean cm | median cm | p95 cm | yaw, mean deg | ms a frame (p50) | best and worst seed, mean cm |\n",
    );
    text.push_str("| --- | --- | --- | --- | --- | --- | --- |\n");
    for run in &paper.walk {
        let best = run.seed_means_cm.iter().copied().fold(f64::INFINITY, f64::min);
        let worst = run.seed_means_cm.iter().copied().fold(0.0, f64::max);
        text.push_str(&format!("{} {best:.2}, {worst:.2} |\n", row(run).trim_end()));
    }
    text.push_str(&format!("| *the paper, on its robot* | {PAPER_WALK_CM} | | | | | |\n"));
    text
}

fn row(run: &Run) -> String {
    let Run { method, position_cm: Summary { mean, median, p95, .. }, yaw_deg, p50_ms, .. } = run;
    format!("| {} | {mean:.2} | {median:.2} | {p95:.2} | {:.2} | {p50_ms:.1} |\n", method.name, yaw_deg.mean)
}

/// Table of mean error in cm and time in ms for each number of particles.
fn fig9(paper: &Paper) -> String {
    let mut counts: Vec<usize> = paper.still.iter().map(|run| run.particles).collect();
    counts.dedup();
    let cells =
        |of: &dyn Fn(usize) -> String| counts.iter().map(|count| format!(" {} |", of(*count))).collect::<String>();
    let mut text = format!("| mean cm / ms at particles: |{}\n", cells(&|count| count.to_string()));
    text.push_str(&format!("| --- |{}\n", cells(&|_| "---".to_owned())));
    for method in METHODS.iter().filter(|method| method.in_fig9) {
        let cell = |count: usize| {
            let run = paper.still.iter().find(|run| run.method == *method && run.particles == count);
            run.map_or(String::new(), |run| format!("{:.2} / {:.1}", run.position_cm.mean, run.p50_ms))
        };
        text.push_str(&format!("| {} |{}\n", method.name, cells(&cell)));
    }
    text
}

fn csv(paper: &Paper) -> String {
    let mut text =
        "experiment,method,particles,seeds,mean_cm,median_cm,p95_cm,max_cm,yaw_mean_deg,p50_ms,p99_ms\n".to_owned();
    for (experiment, runs) in [("still", &paper.still), ("walk", &paper.walk)] {
        for run in runs {
            let Summary { mean, median, p95, max } = run.position_cm;
            text.push_str(&format!(
                "{experiment},\"{}\",{},{},{mean:.3},{median:.3},{p95:.3},{max:.3},{:.4},{:.3},{:.3}\n",
                run.method.name,
                run.particles,
                run.seed_means_cm.len(),
                run.yaw_deg.mean,
                run.p50_ms,
                run.p99_ms
            ));
        }
    }
    text
}
