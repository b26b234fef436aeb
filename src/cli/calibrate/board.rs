//! Calibration of a lens by pictures of a board.

use std::path::Path;

use anyhow::Context;
use serde::Serialize;

use super::board_images::BoardImages;
use super::files;
use super::image_report::{Constant, ImageReport, MIN_PICTURES};
use crate::cli::paths::{check_output, make_folder};
use crate::cli::settings::UsageError;
use crate::cli::{Outcome, output};
use crate::config::{Settings, load_board, load_lens_for_image};
use crate::tagging::board_calibration::{BoardCalibration, BoardPictures};
use crate::vision::Picture;

/// Height of the camera for which the report says what errors of the lens mean on the ground, metres.
const EXAMPLE_HEIGHT_M: f64 = 0.5;

/// The report of a calibration by a board.
#[derive(Serialize)]
pub(super) struct BoardReport {
    /// Number of all pictures, of those in which the board was found, and of those that took part.
    pictures: [usize; 3],
    /// Number of corners, and of those that do not fit.
    corners: [usize; 2],
    /// Largest angle off the axis at which corners were seen, degrees.
    farthest_deg: f64,
    fits_distortion: bool,
    constants: Vec<Constant>,
    /// Names of what the pictures do not determine.
    not_determined: Vec<&'static str>,
    #[serde(flatten)]
    image: ImageReport,
}

pub(super) fn run(
    board: &Path,
    pictures: &Path,
    folder: &Path,
    settings: &Settings,
    json: bool,
) -> anyhow::Result<Outcome> {
    check_output(folder, &[board, pictures])?;
    let lens = settings.camera.lens.as_deref().ok_or_else(|| {
        UsageError("--lens is missing: a rough angle of view is enough, as in --lens equidistant:180deg".to_owned())
    })?;
    let printed = load_board(board)?;
    let mut images = BoardImages::open(pictures, &settings.topics.image)?;
    let mut collected: Option<BoardPictures> = None;
    let mut progress = output::Progress::new("looking for the board");
    let mut done = 0;
    while let Some((name, picture)) = images.next()? {
        done += 1;
        progress.set(done, images.count());
        let Picture { width, height, .. } = picture;
        let into = match &mut collected {
            Some(into) => into,
            None => {
                let start = load_lens_for_image(lens, width as u32, height as u32)?.lens;
                collected.insert(BoardPictures::new(printed.clone(), start.parameters().clone()))
            }
        };
        into.add(picture).with_context(|| name)?;
    }
    progress.finish();
    let collected = collected.with_context(|| format!("{}: there is no picture in it", pictures.display()))?;
    let found = collected.calibrate().with_context(|| pictures.display().to_string())?;
    let lost = images.losses();
    output::losses(&lost);
    let report = BoardReport::of(&found);
    make_folder(folder)?;
    files::write_board(&found, &report, folder)?;
    if json {
        output::json(&report)?;
    } else {
        output::lines(&format!("{}{}", report.text(), folder.display()))?;
    }
    Ok(if found.determines_lens() { Outcome::of(&lost) } else { Outcome::NotReached })
}

impl BoardReport {
    fn of(found: &BoardCalibration) -> Self {
        let not_determined = found.constants.iter().filter(|constant| !constant.determined);
        Self {
            pictures: found.pictures,
            corners: found.corners,
            farthest_deg: found.farthest_rad.to_degrees(),
            fits_distortion: found.fits_distortion(),
            constants: Constant::all(&found.constants),
            not_determined: not_determined.map(|constant| constant.name).collect(),
            image: ImageReport::of(&found.image, EXAMPLE_HEIGHT_M, MIN_PICTURES),
        }
    }

    /// The report for people; it ends with a new line.
    pub(super) fn text(&self) -> String {
        let ([all, with_board, used], [corners, outliers]) = (self.pictures, self.corners);
        let mut text = format!(
            "{all} pictures, {with_board} with the board, {used} from different places; {corners} corners, {outliers} of which do not fit; the \
             others lie {:.2} px (rms) from where they are drawn\n{}corrections of the lens at the start:\n",
            self.image.rms_px,
            self.image.lens_text()
        );
        self.constants.iter().for_each(|constant| text.push_str(&constant.text("these pictures")));
        if !self.not_determined.is_empty() {
            text.push_str("no lens was written: move the board until its corners fill the image\n");
        }
        if !self.fits_distortion {
            text.push_str("only focal length and centre were fitted: distortion is found for Kannala-Brandt lenses (--lens equidistant:180deg)\n");
        }
        text.push_str(&format!("corners were seen up to {:.1} degrees off the axis\n", self.farthest_deg));
        text.push_str(
            "a board that is larger or smaller than its file says fits as well, and gives the same lens: its size cannot be checked by pictures\n",
        );
        text.push_str(&self.image.text("the pictures", "corners"));
        text + &format!("(for a camera {EXAMPLE_HEIGHT_M} m above the ground)\n")
    }
}
