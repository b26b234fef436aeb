//! Command `realitysim measure contrast`: measures how faint lines may be until tags fail.

use std::fmt::Write;
use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use crate::cli::doc_section::Section;
use crate::cli::settings::{SettingsArguments, UsageError};
use crate::cli::{Outcome, output, paths};
use crate::evaluation::contrast::{self, Detection, PAINT, Quality, Step, Variant, WIDTHS_PX, WRONG_CM};
use crate::evaluation::cost::SweepPoint;
use crate::evaluation::{Summary, truth};
use crate::log_input::scene_source;
use crate::tagging::{FrameCache, FrameCacheOptions};

/// Find out how faint lines may be
///
/// Renders the walk of a scene ten times, with ever less paint on its lines, from well painted to none, and tags it with and
/// without refinement, by both observation models, and with more particles and line points. For each step: contrast of the lines
/// over the carpet's noise, share of valid tags, their error, and how many of them are wrong (more than 12 cm off); and, seen from the true
/// poses, how many places of lines stand out more than 99 and 90 % of the carpet beside them. The scene has an effect of the kind
/// worn_lines, whose share is varied.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim measure contrast replay/scenes/worn-lines.toml -o contrast/")]
pub struct ContrastArguments {
    /// A scene with worn lines
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
    /// Where contrast.csv and contrast.svg go
    #[arg(short, long, value_name = "DIR", default_value = "contrast")]
    output: PathBuf,
    /// Put picture and table into a document, between its marks <!-- begin: realitysim measure contrast --> and <!-- end: realitysim measure contrast -->
    #[arg(long, value_name = "FILE")]
    write_docs: Option<PathBuf>,
    #[command(flatten)]
    settings: SettingsArguments,
}

/// Seconds of the scene that are used, from its start: enough to show a walk, and few enough to be tagged sixty times.
const MEASURED_S: f64 = 15.0;

#[derive(Serialize)]
struct Report<'a> {
    scene: String,
    frames: usize,
    wrong_cm: f64,
    variants: &'a [Variant],
    steps: &'a [Step],
}

pub fn run(arguments: &ContrastArguments, json: bool) -> anyhow::Result<Outcome> {
    let settings = arguments.settings.resolve()?;
    let section = arguments.write_docs.as_deref().map(|path| Section::open(path, "measure contrast")).transpose()?;
    let named = arguments.settings.files();
    let inputs = named.iter().chain([&arguments.scene]).map(PathBuf::as_path);
    paths::check_output(&arguments.output, &inputs.collect::<Vec<_>>())?;
    let scene = scene_source::load(&arguments.scene)?;
    let options = FrameCacheOptions {
        source: arguments.scene.clone(),
        settings: settings.clone(),
        initial: None,
        from_s: 0.0,
        for_s: Some(MEASURED_S),
    };
    let variants = contrast::variants(SweepPoint::of(&settings));
    let mut progress = output::Progress::new("tagging");
    let mut done = 0;
    let (mut steps, mut full_contrast) = (Vec::new(), None);
    for paint in PAINT {
        let Some(faded) = scene.with_paint(paint)? else {
            let name = arguments.scene.display();
            return Err(
                UsageError(format!("{name}: it has no effect of the kind worn_lines, whose share is varied")).into()
            );
        };
        let cache = FrameCache::of_scene(&faded, &options, &mut |_, _| {})?;
        let truth = truth::of_scene(&faded);
        let (contrasts, noises): (Vec<f64>, Vec<f64>) =
            cache.contrasts()?.into_iter().map(|[contrast, noise]| (contrast, noise)).unzip();
        // The contrast of faint lines is computed from the paint; a measurement in images where they cannot be found is
        // worse.
        let full = *full_contrast.get_or_insert_with(|| Summary::of(&contrasts).median);
        let total = (PAINT.len() * variants.len() * cache.frames()) as u64;
        let tags = variants.iter().map(|variant| {
            let tuned = variant.sweep_point.set(cache.settings(), settings.filter.seed);
            let run = cache.try_out(&tuned, &mut |_| {
                done += 1;
                progress.set(done, Some(total));
            })?;
            Ok(Quality::of(&run, &truth))
        });
        let tags = tags.collect::<anyhow::Result<Vec<_>>>()?;
        let noise = Summary::of(&noises).median;
        let contrast_to_noise = if noise > 0.0 { paint * full / noise } else { 0.0 };
        let places = Detection::of(&cache.responses(&truth)?);
        steps.push(Step { paint, contrast_to_noise, tags, places });
    }
    progress.finish();
    let name = arguments.scene.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let frames = steps.first().and_then(|step| step.tags.first()).map_or(0, |quality| quality.frames);
    paths::make_folder(&arguments.output)?;
    let svg = contrast::chart(&variants, &steps, &format!("{name}: {frames} frames, painted ever more faintly"));
    let files = [("contrast.csv", csv(&variants, &steps)), ("contrast.svg", svg.clone())];
    for (file, content) in &files {
        paths::write(&arguments.output.join(file), content)?;
    }
    if let Some(section) = &section {
        paths::write(&section.beside("contrast.svg"), &svg)?;
        section.write(&markdown(&arguments.scene.display().to_string(), frames, &variants, &steps))?;
    }
    if json {
        output::json(&Report { scene: name, frames, wrong_cm: WRONG_CM, variants: &variants, steps: &steps })?;
    } else {
        let written = files.map(|(file, _)| arguments.output.join(file).display().to_string());
        output::lines(&format!("{}\n{}", for_people(&variants, &steps), written.join("  ")))?;
    }
    Ok(Outcome::Whole)
}

fn csv(variants: &[Variant], steps: &[Step]) -> String {
    let mut text =
        "paint,contrast_to_noise,variant,frames,valid,wrong,mean_cm,p95_cm,max_cm,ellipse95_share\n".to_owned();
    for Step { paint, contrast_to_noise, tags, .. } in steps {
        for (Variant { name, .. }, quality) in variants.iter().zip(tags) {
            let Quality { frames, valid, wrong, position_cm: p, ellipse95_share } = quality;
            let _ = writeln!(
                text,
                "{paint},{contrast_to_noise:.3},\"{name}\",{frames},{valid},{wrong},{:.4},{:.4},{:.4},{ellipse95_share:.4}",
                p.mean, p.p95, p.max
            );
        }
    }
    text
}

/// Share of valid tags, their mean error, and the number of wrong tags.
fn cell(quality: &Quality) -> String {
    let wrong = if quality.wrong > 0 { format!(", {} wrong", quality.wrong) } else { String::new() };
    match quality.valid {
        0 => "none".to_owned(),
        _ => format!("{:.0} %, {:.2} cm{wrong}", 100.0 * quality.valid_share(), quality.position_cm.mean),
    }
}

fn for_people(variants: &[Variant], steps: &[Step]) -> String {
    let mut text = format!("{:>6} {:>9}", "paint", "contrast");
    variants.iter().for_each(|variant| text.push_str(&format!("  {:>26}", variant.name)));
    text.push_str(&format!("\n{:>6} {:>9}\n", "left", "to noise"));
    for Step { paint, contrast_to_noise, tags, .. } in steps {
        text.push_str(&format!("{:>4.0} % {contrast_to_noise:>9.2}", 100.0 * paint));
        tags.iter().for_each(|quality| text.push_str(&format!("  {:>26}", cell(quality))));
        text.push('\n');
    }
    let _ = writeln!(text, "\n{PLACES}:\n");
    let _ = write!(text, "{:>6} {:>9}", "paint", "contrast");
    widths().for_each(|width| text.push_str(&format!("  {width:>18}")));
    text.push_str(&format!("\n{:>6} {:>9}\n", "left", "to noise"));
    for Step { paint, contrast_to_noise, places, .. } in steps {
        text.push_str(&format!("{:>4.0} % {contrast_to_noise:>9.2}", 100.0 * paint));
        places.iter().for_each(|detection| text.push_str(&format!("  {:>18}", found(detection))));
        text.push('\n');
    }
    text
}

const PLACES: &str = "Seen from the true poses: share of the line places that stand out more than 99 % and more than 90 % of the places on plain \
                      carpet beside lines, and how often a line's stands out more than carpet's (area under the curve, 0.5 by chance)";

fn widths() -> impl Iterator<Item = String> {
    let ends = WIDTHS_PX.iter().skip(1).map(|to| format!(" to {to}")).chain([" and wider".to_owned()]);
    WIDTHS_PX.iter().zip(ends).map(|(from, to)| format!("{from}{to} px"))
}

fn found(detection: &Detection) -> String {
    let Detection { places, found_at_1_percent, found_at_10_percent, area } = detection;
    match places {
        0 => "none".to_owned(),
        _ => format!("{:.0}, {:.0} %, {area:.2}", 100.0 * found_at_1_percent, 100.0 * found_at_10_percent),
    }
}

fn markdown(scene: &str, frames: usize, variants: &[Variant], steps: &[Step]) -> String {
    let mut text = format!(
        "    realitysim measure contrast {scene} --write-docs docs/explanation/lines.md\n\n{frames} frames in each step. Valid tags, their mean error, and how many \
         of them are more than 12 cm off.\n\n![Share of valid tags and their error against line contrast to noise](contrast.svg)\n\n\
         | paint left | contrast to noise |"
    );
    variants.iter().for_each(|variant| text.push_str(&format!(" {} |", variant.name)));
    text.push_str("\n| --- | --- |");
    text.push_str(&" --- |".repeat(variants.len()));
    for Step { paint, contrast_to_noise, tags, .. } in steps {
        text.push_str(&format!("\n| {:.0} % | {contrast_to_noise:.2} |", 100.0 * paint));
        tags.iter().for_each(|quality| text.push_str(&format!(" {} |", cell(quality))));
    }
    let _ =
        write!(text, "\n\n{PLACES}, by the width that the line is drawn with.\n\n| paint left | contrast to noise |");
    widths().for_each(|width| text.push_str(&format!(" {width} |")));
    text.push_str("\n| --- | --- |");
    text.push_str(&" --- |".repeat(WIDTHS_PX.len()));
    for Step { paint, contrast_to_noise, places, .. } in steps {
        text.push_str(&format!("\n| {:.0} % | {contrast_to_noise:.2} |", 100.0 * paint));
        places.iter().for_each(|detection| text.push_str(&format!(" {} |", found(detection))));
    }
    text
}
