//! Command `realitysim scene apply`: applies a scene's effects to a stored image.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Args;
use jpeg_encoder::ColorType;
use serde::Serialize;

use crate::cli::values::any_whole;
use crate::cli::{Outcome, output, paths};
use crate::config::plain_file;
use crate::log_input::encode::jpeg;
use crate::log_input::{decode, scene_source};
use crate::scene::Scene;

/// Apply a scene's effects to a stored image, for tests of vision code
///
/// Only those that make sense on any image: light without a gradient, and sensor noise; the others are named and left out. If
/// none is left the stored bytes are written as they are. The same scene, image and --frame give the same result.
#[derive(Args)]
#[command(after_long_help = concat!(
    "Example:",
    "\n  realitysim scene apply replay/scenes/crowded.toml --image frame.jpg -o noisy.png",
))]
pub struct ApplyArguments {
    /// A scene file
    #[arg(value_name = "SCENE")]
    scene: String,
    /// A JPEG or PNG
    #[arg(long, value_name = "FILE")]
    image: PathBuf,
    /// The image to write: .png, or .jpg with the scene's camera.jpeg_quality
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// As which frame of the scene: its noise, and what is drawn per frame
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = any_whole::<u64>)]
    frame: u64,
}

#[derive(Serialize)]
struct Report<'a> {
    output: &'a PathBuf,
    applied: Vec<&'static str>,
    left_out: Vec<&'static str>,
}

const DEFAULT_JPEG_QUALITY: u8 = 90;

pub fn run(arguments: &ApplyArguments, json: bool) -> anyhow::Result<Outcome> {
    let ApplyArguments { image, output: path, frame, .. } = arguments;
    paths::check_output(path, &[image, Path::new(&arguments.scene)])?;
    let scene = scene_source::load(&arguments.scene)?;
    let stored =
        plain_file::read(image, decode::MAX_IMAGE_FILE_BYTES).map_err(|error| paths::cannot_read(image, error))?;
    let (applied, left_out) = scene.effects_on_images();
    let written = if applied.is_empty() { stored } else { apply_effects(&scene, &stored, arguments, *frame)? };
    paths::write_bytes(path, &written)?;
    let report = Report { output: path, applied, left_out };
    if json {
        output::json(&report)?;
    } else {
        let list = |names: &[&str]| if names.is_empty() { "nothing".to_owned() } else { names.join(", ") };
        output::lines(&format!(
            "applied: {}; left out: {}\n{}",
            list(&report.applied),
            list(&report.left_out),
            path.display()
        ))?;
    }
    Ok(Outcome::Whole)
}

fn apply_effects(scene: &Scene, stored: &[u8], arguments: &ApplyArguments, frame: u64) -> anyhow::Result<Vec<u8>> {
    let shown = || arguments.image.display().to_string();
    let picture = decode::compressed(stored).with_context(shown)?;
    let (width, height) = (picture.width as u32, picture.height as u32);
    let mut pixels = picture.to_rgb();
    scene.apply_to_image(frame, &mut pixels);
    let mut written = Vec::new();
    let ending = arguments.output.extension().and_then(|ending| ending.to_str()).unwrap_or_default();
    match ending.to_ascii_lowercase().as_str() {
        "png" => {
            let encoder = image::codecs::png::PngEncoder::new(&mut written);
            image::ImageEncoder::write_image(encoder, &pixels, width, height, image::ExtendedColorType::Rgb8)?;
        }
        "jpg" | "jpeg" => {
            let quality = scene.file().camera.jpeg_quality.unwrap_or(DEFAULT_JPEG_QUALITY);
            written = jpeg(&pixels, picture.width, picture.height, ColorType::Rgb, quality).with_context(shown)?;
        }
        _ => {
            let message = format!("{}: its name must end in .png or .jpg", arguments.output.display());
            return Err(crate::cli::settings::UsageError(message).into());
        }
    }
    Ok(written)
}
