//! A route's line, its dots, and the marks at its ends; the same in small for the legend.

use glam::DVec2;

use super::canvas::{Canvas, Ink};
use super::plot::Plot;
use super::{Route, RouteStyle};

const WHITE: Ink = Ink::solid([255, 255, 255]);
/// Of the pale line beneath the others.
const PALE: f64 = 0.5;

/// Wide ones beneath thin ones, otherwise the first beneath the last.
pub(super) fn draw(canvas: &mut Canvas, plot: &Plot, routes: &[Route]) {
    for style in [RouteStyle::Wide, RouteStyle::Thin] {
        for route in routes.iter().filter(|route| route.style == style) {
            draw_line(canvas, plot, route);
        }
    }
    // Marks last: a start must not vanish beneath a way that comes back to it.
    for style in [RouteStyle::Wide, RouteStyle::Thin] {
        for route in routes.iter().filter(|route| route.style == style) {
            let mut ends = route.points.iter().filter(|point| point.is_finite());
            let Some(first) = ends.next() else { continue };
            let size = mark_size(plot.text_size, style);
            draw_start(canvas, plot.pixel(*first), size, route.ink());
            if let Some(last) = ends.next_back() {
                draw_end(canvas, plot.pixel(*last), size, route.ink());
            }
        }
    }
}

/// A short piece of the line, from `left` to the right.
pub(super) fn draw_sample(canvas: &mut Canvas, left: DVec2, length: f64, text_size: f64, route: &Route) {
    let right = left + DVec2::new(length, 0.0);
    canvas.stroke(&[vec![left, right]], route.ink().pen(line_width(text_size, route.style)));
    if route.dots {
        canvas.fill_circle((left + right) / 2.0, dot_radius(text_size, route.style), route.ink());
    }
}

pub(super) fn draw_start(canvas: &mut Canvas, at: DVec2, size: f64, ink: Ink) {
    let width = 0.45 * size;
    canvas.stroke_circle(at, size, WHITE.pen(2.2 * width));
    canvas.fill_circle(at, size, WHITE);
    canvas.stroke_circle(at, size, Ink { alpha: 1.0, ..ink }.pen(width));
}

pub(super) fn draw_end(canvas: &mut Canvas, at: DVec2, size: f64, ink: Ink) {
    let width = 0.5 * size;
    let (a, b) = (DVec2::splat(0.9 * size), DVec2::new(0.9 * size, -0.9 * size));
    let cross = [vec![at - a, at + a], vec![at - b, at + b]];
    canvas.stroke(&cross, WHITE.pen(2.2 * width));
    canvas.stroke(&cross, Ink { alpha: 1.0, ..ink }.pen(width));
}

pub(super) fn mark_size(text_size: f64, style: RouteStyle) -> f64 {
    match style {
        RouteStyle::Wide => 0.55 * text_size,
        RouteStyle::Thin => 0.34 * text_size,
    }
}

fn draw_line(canvas: &mut Canvas, plot: &Plot, route: &Route) {
    let runs: Vec<Vec<DVec2>> = route
        .points
        .split(|point| !point.is_finite())
        .map(|run| run.iter().map(|point| plot.pixel(*point)).collect())
        .collect();
    canvas.stroke(&runs, route.ink().pen(line_width(plot.text_size, route.style)));
    let radius = dot_radius(plot.text_size, route.style);
    for run in &runs {
        // A lone point between two gaps would not show otherwise.
        if route.dots || run.len() == 1 {
            run.iter().for_each(|point| canvas.fill_circle(*point, radius, route.ink()));
        }
    }
}

fn line_width(text_size: f64, style: RouteStyle) -> f64 {
    match style {
        RouteStyle::Wide => 0.55 * text_size,
        RouteStyle::Thin => 0.13 * text_size,
    }
}

fn dot_radius(text_size: f64, style: RouteStyle) -> f64 {
    match style {
        RouteStyle::Wide => 0.4 * text_size,
        RouteStyle::Thin => 0.17 * text_size,
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
