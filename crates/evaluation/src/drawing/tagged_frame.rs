//! A frame with its tag: the projected lines over the image, and below it the place on the field, its ellipse and words.

use glam::DVec2;
use image::RgbImage;

use super::canvas::{Canvas, Ink};
use super::ellipse::Ellipse;
use super::field_map::{draw_ellipse, field_map};
use super::overlay::outline;
use super::plot::{Plot, TEXT};
use super::scaling::scaled;
use super::text;
use realitysim_geometry::{Field, Isometry, Lens};

/// Smallest width of the image, pixels: narrower ones are enlarged, so that a line of one pixel covers little of what it is compared with.
const MIN_WIDTH_PX: u32 = 1_280;
/// Width of the map of the field, pixels.
const MAP_PX: u32 = 420;
/// Radius of the circle that magnifies the ellipse, pixels.
const GLASS_PX: f64 = 88.0;
/// Size of the words, pixels.
const TEXT_SIZE: f64 = 19.0;
/// Distance between lines of words, pixels.
const LINE_PX: f64 = 28.0;
/// Space around the parts, pixels.
const MARGIN_PX: f64 = 14.0;
/// Width of the projected lines, pixels of the enlarged image.
const LINE_WIDTH_PX: f64 = 1.0;
/// Length of the arrow that shows where the camera looks, metres.
const ARROW_M: f64 = 0.7;
const PAGE: [u8; 3] = [255, 255, 255];
const VALID: [u8; 3] = [230, 30, 60];
const INVALID: [u8; 3] = [255, 170, 0];
const MIRROR: [u8; 3] = [110, 110, 110];
/// Radii of the magnifying circle, metres.
const SCALES_M: [f64; 12] = [0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0];

/// The tag of a frame, as it is shown.
#[derive(Clone, Debug, PartialEq)]
pub struct ShownTag {
    /// Pose of `camera_link` in `map`.
    pub map_from_camera: Isometry,
    /// Covariance of x and y, square metres: xx, xy, yy.
    pub covariance: [f64; 3],
    /// Whether the pose may be used. The lines of one that may not are orange.
    pub valid: bool,
    /// Position of the mirror pose, metres, if it is as good.
    pub mirror: Option<DVec2>,
    /// Words beside the map, a line each.
    pub words: Vec<String>,
}

/// Draws frames of one camera on one field with their tags, all of one size.
pub struct FrameSheet {
    lens: Lens,
    field: Field,
    /// The field from above, without a camera.
    map: RgbImage,
    plot: Plot,
}

impl FrameSheet {
    /// Prepares the parts that all frames share.
    pub fn new(lens: Lens, field: Field) -> Self {
        let map = field_map(&field, &[], MAP_PX, &[]);
        let plot = Plot::new(&field, MAP_PX);
        Self { lens, field, map, plot }
    }

    /// Draws a frame: the image enlarged to at least 1280 pixels, with thin lines where the tag puts them, above a strip with the
    /// camera on the field, its ellipse of 95 % magnified, and the words.
    pub fn draw(&self, image: &RgbImage, tag: &ShownTag) -> RgbImage {
        let times = MIN_WIDTH_PX.div_ceil(image.width().max(1)).clamp(1, 8);
        let (width, height) = (image.width() * times, image.height() * times);
        let strip = self.strip_height();
        let Some(mut canvas) = Canvas::filled(width, height + strip, PAGE) else { return image.clone() };
        canvas.place(&scaled(image, width, height), [0, 0]);
        canvas.place(&self.map, [0, height]);
        let size = DVec2::new(f64::from(width), f64::from(height));
        canvas.clip_to(DVec2::ZERO, size);
        let lines = outline(size, &self.lens, &tag.map_from_camera, &self.field);
        canvas.stroke(&lines, Ink { colour: tag.colour(), alpha: 0.85 }.pen(LINE_WIDTH_PX));
        canvas.unclip();
        self.draw_camera(&mut canvas, size.y, tag);
        let left = f64::from(MAP_PX) + MARGIN_PX;
        draw_glass(&mut canvas, DVec2::new(left + GLASS_PX, size.y + MARGIN_PX + GLASS_PX), tag);
        draw_words(&mut canvas, DVec2::new(left + 2.0 * GLASS_PX + 2.0 * MARGIN_PX, size.y), size.x, &tag.words);
        canvas.into_image()
    }

    /// Height of the strip below the image, pixels. It is even, as videos need it.
    fn strip_height(&self) -> u32 {
        let least = (2.0 * (GLASS_PX + MARGIN_PX) + LINE_PX) as u32;
        self.map.height().max(least).next_multiple_of(2)
    }

    /// Draws the camera, where it looks, and its mirror pose on the map.
    fn draw_camera(&self, canvas: &mut Canvas, top: f64, tag: &ShownTag) {
        let at = tag.map_from_camera.translation.truncate();
        if !tag.map_from_camera.is_finite() {
            return;
        }
        let plot = Plot {
            low: self.plot.low + DVec2::new(0.0, top),
            high: self.plot.high + DVec2::new(0.0, top),
            ..self.plot
        };
        canvas.clip_to(plot.low, plot.high);
        draw_ellipse(canvas, &plot, &tag.ellipse());
        let ahead = at + ARROW_M * DVec2::from_angle(tag.map_from_camera.euler().yaw);
        canvas.stroke(&[vec![plot.pixel(at), plot.pixel(ahead)]], Ink::solid(tag.colour()).pen(2.5));
        canvas.fill_circle(plot.pixel(at), 5.0, Ink::solid(tag.colour()));
        if let Some(mirror) = tag.mirror {
            canvas.stroke_circle(plot.pixel(mirror), 5.0, Ink::solid(MIRROR).pen(2.0));
        }
        canvas.unclip();
    }
}

impl ShownTag {
    fn colour(&self) -> [u8; 3] {
        if self.valid { VALID } else { INVALID }
    }

    fn ellipse(&self) -> Ellipse {
        let centre = self.map_from_camera.translation.truncate();
        Ellipse { centre, covariance: self.covariance, colour: self.colour() }
    }
}

/// Draws the ellipse of 95 % in a circle whose radius is the least round length that holds it.
fn draw_glass(canvas: &mut Canvas, centre: DVec2, tag: &ShownTag) {
    canvas.stroke_circle(centre, GLASS_PX, Ink::solid(TEXT).pen(1.0));
    let ellipse = tag.ellipse();
    let Some([major, _]) = ellipse.half_axes() else { return };
    let Some(scale_m) = SCALES_M.into_iter().find(|scale| *scale >= 1.1 * major) else { return };
    let pixels = |offset: DVec2| centre + DVec2::new(offset.x, -offset.y) * (GLASS_PX / scale_m);
    if let Some(border) = ellipse.border() {
        canvas.stroke(&[border.into_iter().map(pixels).collect()], Ink::solid(tag.colour()).pen(2.0));
    }
    let arm = 4.0;
    let cross = [DVec2::X, DVec2::Y].map(|axis| vec![centre - arm * axis, centre + arm * axis]);
    canvas.stroke(&cross, Ink::solid(TEXT).pen(1.0));
    let words = format!("95 %; radius {}", length(scale_m));
    let x = centre.x - text::width(15.0, &words) / 2.0;
    canvas.text(DVec2::new(x, centre.y + GLASS_PX + 20.0), 15.0, TEXT, &words);
}

/// Writes a length with a unit that needs no decimals.
fn length(metres: f64) -> String {
    match metres {
        metres if metres < 0.01 => format!("{:.0} mm", 1e3 * metres),
        metres if metres < 1.0 => format!("{:.0} cm", 1e2 * metres),
        metres => format!("{metres:.0} m"),
    }
}

fn draw_words(canvas: &mut Canvas, corner: DVec2, right: f64, words: &[String]) {
    let room = right - corner.x - MARGIN_PX;
    let lines = words.iter().flat_map(|line| text::wrap(TEXT_SIZE, line, room));
    for (index, line) in lines.enumerate() {
        canvas.text(corner + DVec2::new(0.0, LINE_PX * (index as f64 + 1.2)), TEXT_SIZE, TEXT, &line);
    }
}
