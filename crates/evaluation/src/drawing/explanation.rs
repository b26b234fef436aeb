//! The evidence of one frame, drawn over its picture.

use glam::DVec2;
use image::RgbImage;

use super::canvas::{Canvas, Ink};
use super::overlay::outline;
use super::scaling::scaled;
use realitysim_geometry::{Field, Isometry, Lens};
use realitysim_localization::Evidence;
use realitysim_localization::refinement::line_measurement::Finding;

/// Smallest width of the result, pixels: narrower pictures are enlarged, so that marks of a pixel can be told apart.
const MIN_WIDTH_PX: u32 = 1_000;
const OUTLINE: Ink = Ink { colour: [255, 230, 60], alpha: 0.45 };
const FOUND: Ink = Ink::solid([40, 230, 80]);
const MISSING: Ink = Ink::solid([240, 40, 50]);
const HIDDEN: Ink = Ink { colour: [150, 150, 150], alpha: 0.8 };
const EXPLAINED: Ink = Ink { colour: [60, 200, 255], alpha: 0.35 };
const UNEXPLAINED: Ink = Ink { colour: [255, 60, 230], alpha: 0.6 };
const CARPET: Ink = Ink { colour: [255, 160, 40], alpha: 0.9 };

/// Meaning of the marks of [`explanation`], for a caption.
pub const LEGEND: &str = "green: a line place found, red: missing, gray: hidden or in changing light; blue: shows a line and is painted there, \
     magenta: shows a line and is not; yellow: the field's paint as the pose has it; orange: the carpet's border";

/// Draws the evidence of a frame over its picture.
///
/// Marks show the places at which the pose has lines and what the picture shows there, and the places that show a line
/// and whether the field has one. Outlines show the paint of the field and the border of the carpet.
pub fn explanation(
    picture: &RgbImage,
    lens: &Lens,
    map_from_camera_link: &Isometry,
    field: &Field,
    evidence: &Evidence,
) -> RgbImage {
    let times = MIN_WIDTH_PX.div_ceil(picture.width().max(1)).clamp(1, 8);
    let (width, height) = (picture.width() * times, picture.height() * times);
    let large = scaled(picture, width, height);
    let Some(mut canvas) = Canvas::on_top_of(&large) else { return large };
    let scale = f64::from(times);
    // Evidence counts pixels from their centres.
    let place = |pixel: DVec2| (pixel + 0.5) * scale;
    for (pixel, is_on_line) in &evidence.shown {
        canvas.fill_circle(place(*pixel), 0.45 * scale, if *is_on_line { EXPLAINED } else { UNEXPLAINED });
    }
    let size = DVec2::new(f64::from(width), f64::from(height));
    canvas.stroke(&outline(size, lens, map_from_camera_link, field), OUTLINE.pen(1.0));
    if let Some(first) = evidence.carpet.first() {
        let border = evidence.carpet.iter().chain([first]).map(|corner| place(*corner)).collect();
        canvas.stroke(&[border], CARPET.pen(1.5));
    }
    for line in &evidence.lines {
        let at = place(line.pixel);
        let radius = (0.5 + line.visibility) * scale;
        match line.finding {
            Finding::Found(found) => canvas.fill_circle(place(found), 0.8 * radius, FOUND),
            Finding::Missing => canvas.stroke_circle(at, radius, MISSING.pen(1.5)),
            Finding::Hidden => canvas.stroke_circle(at, 0.5 * scale, HIDDEN.pen(1.0)),
        }
    }
    canvas.into_image()
}
