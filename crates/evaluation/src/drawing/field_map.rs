//! Maps of the field from above, with routes, legend and caption.

use glam::DVec2;
use image::RgbImage;

use super::canvas::{Canvas, Ink, Pen};
use super::ellipse::Ellipse;
use super::paint::{Edge, Patch, patches};
use super::plot::{Plot, TEXT};
use super::routes::{self, START_RADIUS, draw_end, draw_sample, draw_start};
use super::{Route, RouteStyle, text};
use realitysim_geometry::Field;

const PAGE: [u8; 3] = [255, 255, 255];
const CARPET: Ink = Ink::solid([113, 158, 112]);
const PAINT: Ink = Ink::solid([255, 255, 255]);
const POST_BORDER: Ink = Ink::solid([45, 50, 45]);
const NET: Ink = Ink { colour: [255, 255, 255], alpha: 0.45 };

/// Smallest and largest width of a map, pixels: narrower ones could not be read, wider ones not be kept in memory.
const WIDTHS_PX: [u32; 2] = [64, 8_192];
/// Height of a line of text, in units of the size of the text.
const LINE_HEIGHT: f64 = 1.45;
/// Length of a sample in the legend, in the same units.
const SAMPLE_LENGTH: f64 = 2.0;
/// Space between legend and caption, in the same units.
const GAP: f64 = 0.5;
/// Straight pieces of a quarter circle: each of them is off by less than a thousandth of the radius.
const QUARTER_PIECES: u32 = 24;
/// Largest number of lines of legend and of caption.
const MAX_LINES: usize = 40;

/// Draws field and routes to scale, `size_px` wide (64 to 8192) and as high as field, legend and caption need.
///
/// x points to the right, y up, and metres stand at the border. Lines and posts are as thick as in reality, but never
/// invisible. Every route starts at a circle and ends at a cross. Caption lines that are too long are broken between
/// words.
pub fn field_map(field: &Field, routes: &[Route], size_px: u32, caption: &[String]) -> RgbImage {
    route_map(field, routes, &[], size_px, caption)
}

/// Draws a [`field_map`] with the ellipses of 95 % below the routes.
pub fn route_map(field: &Field, routes: &[Route], ellipses: &[Ellipse], size_px: u32, caption: &[String]) -> RgbImage {
    let width = size_px.clamp(WIDTHS_PX[0], WIDTHS_PX[1]);
    let plot = Plot::new(field, width);
    let size = plot.text_size;
    let (left, right) = (plot.low.x.min(3.9 * size), f64::from(width) - 0.9 * size);
    let legend = legend_rows(routes, size, right - left);
    let caption = caption.iter().flat_map(|line| text::wrap(size, line, right - left)).take(MAX_LINES);
    let caption: Vec<String> = caption.collect();
    let lines = (legend.len() + caption.len()) as f64;
    let gap = if legend.is_empty() || caption.is_empty() { 0.0 } else { GAP * size };
    let height = plot.bottom() + lines * LINE_HEIGHT * size + gap + 0.7 * size;
    let height = libm::ceil(height) as u32;
    let Some(mut canvas) = Canvas::filled(width, height, PAGE) else { return RgbImage::new(width, height) };

    draw_field(&mut canvas, &plot, field);
    canvas.clip_to(plot.low, plot.high);
    ellipses.iter().for_each(|ellipse| draw_ellipse(&mut canvas, &plot, ellipse));
    routes::draw(&mut canvas, &plot, routes);
    canvas.unclip();
    plot.draw_axes(&mut canvas);

    let mut baseline = plot.bottom() + LINE_HEIGHT * size;
    for row in legend {
        let mut x = left;
        for entry in row {
            entry.draw(&mut canvas, DVec2::new(x, baseline), size);
            x += entry.width(size);
        }
        baseline += LINE_HEIGHT * size;
    }
    baseline += gap;
    for line in caption {
        canvas.text(DVec2::new(left, baseline), size, TEXT, &line);
        baseline += LINE_HEIGHT * size;
    }
    canvas.into_image()
}

pub(super) fn draw_ellipse(canvas: &mut Canvas, plot: &Plot, ellipse: &Ellipse) {
    let Some(border) = ellipse.border().filter(|_| ellipse.centre.is_finite()) else { return };
    let border = border.into_iter().map(|offset| plot.pixel(ellipse.centre + offset)).collect();
    canvas.stroke(&[border], Ink { colour: ellipse.colour, alpha: 0.6 }.pen(0.07 * plot.text_size));
}

fn draw_field(canvas: &mut Canvas, plot: &Plot, field: &Field) {
    canvas.fill_rectangle(plot.low, plot.high, CARPET);
    let scale = plot.pixels_per_metre;
    let paint = |half_width: f64| Pen { ink: PAINT, width: (2.0 * half_width * scale).max(1.0), round: false };
    for patch in patches(field) {
        match patch {
            Patch::Bar { from, to, half_width } => {
                canvas.stroke(&[vec![plot.pixel(from), plot.pixel(to)]], paint(half_width));
            }
            Patch::Ring { centre, radius, half_width } => {
                canvas.stroke_circle(plot.pixel(centre), radius * scale, paint(half_width));
            }
            Patch::Quarter { centre, side, radius, half_width } => {
                let edge = Edge::Quarter { centre, side, radius };
                let points = (0..=QUARTER_PIECES).map(|piece| f64::from(piece) / f64::from(QUARTER_PIECES));
                canvas.stroke(&[points.map(|t| plot.pixel(edge.at(t))).collect()], paint(half_width));
            }
        }
    }
    let dimensions = field.dimensions();
    let Some(goal) = dimensions.goal else { return };
    for side in [-1.0, 1.0] {
        let post = DVec2::new(side * dimensions.length_m / 2.0, goal.width_m / 2.0);
        let back = post + DVec2::new(side * goal.depth_m, 0.0);
        let mirror = DVec2::new(1.0, -1.0);
        let net = [post, back, back * mirror, post * mirror].map(|point| plot.pixel(point)).to_vec();
        canvas.stroke(&[net], NET.pen((0.12 * plot.text_size).max(1.0)));
        for post in [post, post * mirror] {
            let radius = (goal.post_diameter_m / 2.0 * scale).max(2.0);
            canvas.fill_circle(plot.pixel(post), radius, PAINT);
            canvas.stroke_circle(plot.pixel(post), radius, POST_BORDER.pen((0.09 * plot.text_size).max(0.8)));
        }
    }
}

/// An entry of the legend.
#[derive(Clone, Copy)]
enum Entry<'a> {
    Line(&'a Route),
    Start,
    End,
}

impl Entry<'_> {
    fn label(&self) -> &str {
        match self {
            Entry::Line(route) => &route.label,
            Entry::Start => "start",
            Entry::End => "end",
        }
    }

    /// Returns the width of the sign, pixels.
    fn sign_width(&self, size: f64) -> f64 {
        match self {
            Entry::Line(_) => SAMPLE_LENGTH * size,
            Entry::Start | Entry::End => 2.3 * START_RADIUS * size,
        }
    }

    /// Returns the width of sign, label and the space to the next entry, pixels.
    fn width(&self, size: f64) -> f64 {
        self.sign_width(size) + text::width(size, self.label()) + 1.9 * size
    }

    fn draw(&self, canvas: &mut Canvas, baseline: DVec2, size: f64) {
        let sign = self.sign_width(size);
        let middle = baseline + DVec2::new(sign / 2.0, -0.32 * size);
        match self {
            Entry::Line(route) => {
                // With carpet beneath, pale and white lines look in the legend as they do on the map.
                let half = DVec2::new(sign / 2.0, 0.5 * size);
                canvas.fill_rectangle(middle - half, middle + half, CARPET);
                draw_sample(canvas, middle, sign, size, route);
            }
            Entry::Start => draw_start(canvas, middle, size, RouteStyle::Thin, TEXT),
            Entry::End => draw_end(canvas, middle, size, RouteStyle::Thin, TEXT),
        }
        canvas.text(baseline + DVec2::new(sign + 0.5 * size, 0.0), size, TEXT, self.label());
    }
}

/// Breaks the entries of the legend into rows no wider than `room` pixels.
fn legend_rows(routes: &[Route], size: f64, room: f64) -> Vec<Vec<Entry<'_>>> {
    if routes.is_empty() {
        return Vec::new();
    }
    let entries = routes.iter().map(Entry::Line).chain([Entry::Start, Entry::End]);
    let (mut rows, mut used) = (vec![Vec::new()], 0.0);
    for entry in entries {
        let width = entry.width(size);
        if used > 0.0 && used + width > room {
            rows.push(Vec::new());
            used = 0.0;
        }
        if let Some(row) = rows.last_mut() {
            row.push(entry);
        }
        used += width;
    }
    rows.truncate(MAX_LINES);
    rows
}
