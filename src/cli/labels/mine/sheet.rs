//! A page of the images in which the detector is most surely wrong.

use glam::DVec2;
use image::{Rgb, RgbImage};

use super::super::super::marks::{UPRIGHT, cross, frame_box, line, rgb};
use super::asking::{Asking, Judged};
use crate::evaluation::drawing::{panels, scaled};
use crate::labels::{Disagreement, Fault, LabelBox};

/// Name of the page.
pub(super) const FILE: &str = "sheet.jpg";
/// Most images on the page.
const IMAGES: usize = 24;
/// Columns of the page.
const COLUMNS: u32 = 3;
/// Width of an image on the page, pixels.
const WIDTH_PX: u32 = 560;
/// Half the length of a cross, pixels of the page.
const CROSS_PX: i64 = 6;
/// Half the side of a box around a place that has none of its own, pixels of the page.
const PLACE_PX: f64 = 9.0;

const FOUND: Rgb<u8> = Rgb([0, 255, 255]);
const MISSED: Rgb<u8> = Rgb([255, 0, 0]);
const DISPLACED: Rgb<u8> = Rgb([255, 255, 0]);
const FALSE: Rgb<u8> = Rgb([255, 0, 255]);

/// Draws the worst images; `None` if there is no disagreement. Images come sorted.
pub(super) fn draw(asking: &Asking, judged: &[Judged]) -> anyhow::Result<Option<RgbImage>> {
    let worst = judged.iter().filter(|judged| !judged.compared.disagreements.is_empty()).take(IMAGES);
    let pictures = worst.map(|judged| Ok((picture(asking, judged)?, words(asking, judged))));
    let pictures = pictures.collect::<anyhow::Result<Vec<_>>>()?;
    Ok((!pictures.is_empty()).then(|| panels(&pictures, COLUMNS)))
}

/// One image with truth and detections.
fn picture(asking: &Asking, judged: &Judged) -> anyhow::Result<RgbImage> {
    let image = asking.images.database().image(judged.number).map_err(anyhow::Error::msg)?;
    let shown = image.full().mask();
    let posed = asking.images.posed(&judged.record, &shown).map_err(anyhow::Error::msg)?;
    let small = rgb(image.full())?;
    let scale = f64::from(WIDTH_PX) / f64::from(small.width());
    let height = (f64::from(small.height()) * scale).round().max(1.0) as u32;
    let mut page = scaled(&small, WIDTH_PX, height);
    let boxes = asking.labeller.landmark_boxes(&posed);
    let keypoints = asking.labeller.keypoints(&posed);
    for landmark in &judged.compared.right {
        mark(&mut page, scale, boxes[*landmark].as_ref(), keypoints[*landmark].at, FOUND);
    }
    // The surest disagreement is drawn last, over the others.
    for Disagreement { fault, landmark, truth, found, .. } in judged.compared.disagreements.iter().rev() {
        let own_box = landmark.and_then(|landmark| boxes[landmark].as_ref());
        match (fault, truth, found) {
            (Fault::Missed, Some(at), _) => mark(&mut page, scale, own_box, *at, MISSED),
            (Fault::Displaced, Some(at), Some(found)) => {
                mark(&mut page, scale, own_box, *at, DISPLACED);
                line(&mut page, on_page(*at, scale), on_page(*found, scale), DISPLACED);
                cross(&mut page, on_page(*found, scale), UPRIGHT, CROSS_PX, DISPLACED);
            }
            (_, _, Some(found)) => mark(&mut page, scale, None, *found, FALSE),
            _ => {}
        }
    }
    Ok(page)
}

/// Draws a box with a cross at a place, whose first pixel's centre is (0, 0).
fn mark(page: &mut RgbImage, scale: f64, own_box: Option<&LabelBox>, at: DVec2, colour: Rgb<u8>) {
    let at = on_page(at, scale);
    let (from, to) =
        own_box.map_or((at - PLACE_PX, at + PLACE_PX), |own_box| (own_box.from * scale, own_box.to * scale));
    frame_box(page, from, to, colour);
    cross(page, at, UPRIGHT, CROSS_PX, colour);
}

fn on_page(at: DVec2, scale: f64) -> DVec2 {
    (at + 0.5) * scale - 0.5
}

/// The image's number and its surest disagreement.
fn words(asking: &Asking, judged: &Judged) -> String {
    let disagreements = &judged.compared.disagreements;
    let surest = disagreements.first().map_or(String::new(), |found| {
        let class = asking.classes.names.get(found.class).copied().unwrap_or_default();
        format!("{class} {}, certainty {:.2}", found.fault.name(), found.certainty)
    });
    let more = disagreements.len().saturating_sub(1);
    format!("image {:06}: {surest}; {more} more", judged.number)
}
