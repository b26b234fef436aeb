//! Lines, dots and end marks of routes, on the map and in the legend.

use glam::DVec2;

use super::canvas::{Canvas, Ink};
use super::plot::Plot;
use super::{Route, RouteStyle};

const WHITE: Ink = Ink::solid([255, 255, 255]);
/// Opacity of wide routes.
const PALE: f64 = 0.6;
/// Radius of the circle at a start, in units of the size of the text.
pub(super) const START_RADIUS: f64 = 0.46;

/// Draws routes: wide ones beneath thin ones, otherwise in their order.
pub(super) fn draw(canvas: &mut Canvas, plot: &Plot, routes: &[Route]) {
    for style in [RouteStyle::Wide, RouteStyle::Thin] {
        for route in routes.iter().filter(|route| route.style == style) {
            draw_line(canvas, plot, route);
        }
    }
    // Marks are drawn last, crosses after circles: a route that returns to its start must hide neither.
    for style in [RouteStyle::Wide, RouteStyle::Thin] {
        for route in routes.iter().filter(|route| route.style == style) {
            if let Some(first) = route.points.iter().find(|point| point.is_finite()) {
                draw_start(canvas, plot.pixel(*first), plot.text_size, style, route.colour);
            }
        }
        for route in routes.iter().filter(|route| route.style == style) {
            let mut ends = route.points.iter().filter(|point| point.is_finite());
            if let (Some(_), Some(last)) = (ends.next(), ends.next_back()) {
                draw_end(canvas, plot.pixel(*last), plot.text_size, style, route.colour);
            }
        }
    }
}

/// Draws a short piece of the line of a route around `middle`.
pub(super) fn draw_sample(canvas: &mut Canvas, middle: DVec2, length: f64, text_size: f64, route: &Route) {
    let half = DVec2::new(length / 2.0, 0.0);
    canvas.stroke(&[vec![middle - half, middle + half]], route.ink().pen(line_width(text_size, route)).square());
    if route.dots {
        for at in [-0.5, 0.0, 0.5] {
            canvas.fill_circle(middle + half * at, dot_radius(text_size, route.style), route.ink());
        }
    }
}

/// Draws the circle at the start of a route.
pub(super) fn draw_start(canvas: &mut Canvas, at: DVec2, text_size: f64, style: RouteStyle, colour: [u8; 3]) {
    let radius = START_RADIUS * text_size;
    let width = 0.14 * text_size;
    match style {
        RouteStyle::Wide => canvas.fill_circle(at, 1.55 * radius, Ink::solid(colour)),
        RouteStyle::Thin => {
            canvas.fill_circle(at, radius + width, WHITE);
            canvas.stroke_circle(at, radius, Ink::solid(colour).pen(width));
        }
    }
}

/// Draws the cross at the end of a route.
pub(super) fn draw_end(canvas: &mut Canvas, at: DVec2, text_size: f64, style: RouteStyle, colour: [u8; 3]) {
    // A thin cross fits into the circle of a start, and a wide cross shows around a thin one.
    let (arm, width) = match style {
        RouteStyle::Wide => (0.55 * text_size, 0.34 * text_size),
        RouteStyle::Thin => (0.27 * text_size, 0.16 * text_size),
    };
    let (a, b) = (DVec2::splat(arm), DVec2::new(arm, -arm));
    let cross = [vec![at - a, at + a], vec![at - b, at + b]];
    if style == RouteStyle::Thin {
        canvas.stroke(&cross, WHITE.pen(1.9 * width));
    }
    canvas.stroke(&cross, Ink::solid(colour).pen(width));
}

fn draw_line(canvas: &mut Canvas, plot: &Plot, route: &Route) {
    let runs: Vec<Vec<DVec2>> = route
        .points
        .split(|point| !point.is_finite())
        .map(|run| run.iter().map(|point| plot.pixel(*point)).collect())
        .collect();
    canvas.stroke(&runs, route.ink().pen(line_width(plot.text_size, route)));
    let radius = dot_radius(plot.text_size, route.style);
    for run in &runs {
        // A single point between two gaps has no line.
        if route.dots || run.len() == 1 {
            run.iter().for_each(|point| canvas.fill_circle(*point, radius, route.ink()));
        }
    }
}

fn line_width(text_size: f64, route: &Route) -> f64 {
    let share = match route.style {
        RouteStyle::Wide => 0.55,
        // With dots, the line is only a guide.
        RouteStyle::Thin if route.dots => 0.08,
        RouteStyle::Thin => 0.13,
    };
    share * text_size
}

fn dot_radius(text_size: f64, style: RouteStyle) -> f64 {
    match style {
        RouteStyle::Wide => 0.4 * text_size,
        RouteStyle::Thin => 0.12 * text_size,
    }
}

impl Route {
    fn ink(&self) -> Ink {
        let alpha = match self.style {
            RouteStyle::Wide => PALE,
            RouteStyle::Thin => 1.0,
        };
        Ink { colour: self.colour, alpha }
    }
}
