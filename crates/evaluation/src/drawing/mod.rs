//! Pictures for people: the field from above with routes, and painted lines drawn over camera images.
//!
//! [`field_map`](fn@field_map) shows where the robot was, [`overlay`](fn@overlay) whether a pose fits an image,
//! [`side_by_side`](fn@side_by_side) both, and [`explanation`](fn@explanation) what was seen in a frame. [`FrameSheet`] shows a frame
//! with its tag, [`route_map`] how well each place of a route is known, and [`coverage_map`](fn@coverage_map) where images were taken.
//! [`chart`] draws numbers over numbers.
//! All functions take and return pictures and read no files. Odd input (nothing to draw, NaN, a lens that sees no line)
//! makes a plainer picture, never an error.

mod canvas;
mod cell_map;
pub mod chart;
mod coverage_map;
mod ellipse;
mod explanation;
mod field_map;
mod field_svg;
mod overlay;
mod paint;
mod panels;
mod plot;
mod routes;
mod scaling;
mod side_by_side;
mod svg;
mod tagged_frame;
mod text;

pub use cell_map::{Cell, cell_map};
pub use coverage_map::{WalkGuide, WalkPlace, coverage_map};
pub use ellipse::{Ellipse, SIGMAS_OF_95};
pub use explanation::{LEGEND, explanation};
pub use field_map::{field_map, route_map};
pub use field_svg::FieldSvg;
pub use overlay::{overlay, projected_lines};
pub use panels::panels;
pub use scaling::scaled;
pub use side_by_side::{beside, side_by_side};
pub use tagged_frame::{FrameSheet, ShownTag};

use glam::DVec2;

/// A route over the field, as [`field_map`](fn@field_map) draws it.
#[derive(Clone, Debug, PartialEq)]
pub struct Route {
    /// Name in the legend.
    pub label: String,
    /// Colour, RGB.
    pub colour: [u8; 3],
    /// Points in `map`, metres. A point that is not finite is a gap: nothing joins its neighbours.
    pub points: Vec<DVec2>,
    /// How the route is drawn.
    pub style: RouteStyle,
    /// Whether each point gets a dot.
    pub dots: bool,
}

/// Width and order of a route.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RouteStyle {
    /// Wide, pale and beneath all others: what should have been found.
    Wide,
    /// Thin, strong and on top: what was found.
    #[default]
    Thin,
}

#[cfg(test)]
mod tests;
