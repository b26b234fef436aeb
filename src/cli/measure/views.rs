//! Command `realitysim measure views`: measures the quality of views.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use crate::cli::doc_section::Section;
use crate::cli::settings::field_size;
use crate::cli::{Outcome, output};
use crate::config::load_field_of_size;
use crate::evaluation::views::{Pair, Plan, Row, Scores, displacements, pairs};
use crate::geometry::Field;

/// Measure how good made-up views are
///
/// Views of a rendered lawn, made from images taken a known way off, against the truth: the nearest image unchanged, the
/// paper's quadratic map, and the exact map from one and from four images. With --pairs also real images that were taken
/// from one place. docs/explanation/views.md says what comes out.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim measure views --quick")]
pub struct ViewsArguments {
    /// Two poses a row instead of eight
    #[arg(long)]
    quick: bool,
    /// A folder of VisualMesh images with lens files and same_centre_pairs.csv
    #[arg(long, value_name = "DIR")]
    pairs: Option<PathBuf>,
    /// A shipped field (config/fields) or the path of a field file
    #[arg(long, value_name = "NAME", default_value = "kid-2009")]
    field: String,
    /// Length and width of the field between the centres of its lines, metres: see `replay`
    #[arg(long, value_name = "LxW", value_parser = field_size)]
    field_size: Option<[f64; 2]>,
    /// Put the results into a document, between its marks <!-- begin: realitysim measure views --> and
    /// <!-- end: realitysim measure views -->
    #[arg(long, value_name = "FILE")]
    write_docs: Option<PathBuf>,
}

#[derive(Serialize)]
struct Report {
    rows: Vec<Row>,
    pairs: Vec<Pair>,
}

pub fn run(arguments: &ViewsArguments, json: bool) -> anyhow::Result<Outcome> {
    let section = arguments.write_docs.as_deref().map(|path| Section::open(path, "measure views")).transpose()?;
    let field = Field::new(load_field_of_size(&arguments.field, arguments.field_size)?)?;
    let plan = if arguments.quick { Plan::quick() } else { Plan::full() };
    let mut progress = output::Progress::new("rendering");
    let rows = displacements(&field, &plan, &mut |done, total| progress.set(done, Some(total)))?;
    progress.finish();
    let pairs = arguments.pairs.as_deref().map(|folder| pairs(folder, &field)).transpose()?.unwrap_or_default();
    let report = Report { rows, pairs };
    let text = markdown(&report, &plan);
    if let Some(section) = section {
        section.write(&text)?;
    }
    if json {
        output::json(&report)?;
    } else {
        output::lines(text.trim_end())?;
    }
    Ok(Outcome::Whole)
}

fn markdown(report: &Report, plan: &Plan) -> String {
    let mut text =
        format!("Means over {} poses. PSNR in dB / SSIM, on the ground that the first source shows.\n\n", plan.poses);
    text.push_str(
        "| off by | nearest unchanged | paper | exact, 1 source | exact, 4 sources | ground covered by 1, by 4 | quadratic \
         residual px: fitted in the image, on a 25 cm grid | map p99 px |\n| --- | --- | --- | --- | --- | --- | --- | --- |\n",
    );
    let scores = |s: &Scores| format!("{:.1} / {:.2}", s.psnr_db, s.ssim);
    for row in &report.rows {
        text.push_str(&format!(
            "| {:.0} cm, {:.0} deg | {} | {} | {} | {} | {:.1} %, {:.1} % | {:.2}, {:.2} | {:.3} |\n",
            100.0 * row.displacement.metres,
            row.displacement.yaw_deg,
            scores(&row.nearest),
            scores(&row.paper),
            scores(&row.exact),
            scores(&row.four),
            100.0 * row.exact.covered,
            100.0 * row.four.covered,
            row.residual_px,
            row.residual_25cm_px,
            row.map_p99_px
        ));
    }
    if report.pairs.is_empty() {
        return text;
    }
    let mut gains: Vec<f64> = report.pairs.iter().map(|pair| pair.gain_db).collect();
    gains.sort_by(f64::total_cmp);
    text.push_str(&format!(
        "\n{} pairs of real images: after one gain per channel least {:.1}, median {:.1} dB.\n\n",
        gains.len(),
        gains[0],
        gains[gains.len() / 2]
    ));
    text.push_str("| source, target | overlap px | raw dB | after gain dB / SSIM |\n| --- | --- | --- | --- |\n");
    for pair in &report.pairs {
        let Pair { source, target, overlap, raw_db, gain_db, gain_ssim } = pair;
        text.push_str(&format!("| {source}, {target} | {overlap} | {raw_db:.1} | {gain_db:.1} / {gain_ssim:.3} |\n"));
    }
    text
}
