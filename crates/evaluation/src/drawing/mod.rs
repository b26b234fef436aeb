//! Pictures for people: the field from above with routes, and painted lines drawn over camera images.
//!
//! [`field_map`] shows where the robot was, [`overlay`] whether a pose fits an image, [`side_by_side`] both;
//! [`chart`] is numbers against numbers. Pure: pictures in and out, no files. Odd input (nothing to draw, NaN, a lens that sees no line) makes a plainer
//! picture, never an error.

mod canvas;
pub mod chart;
mod explanation;
mod field_map;
mod overlay;
mod paint;
mod panels;
mod plot;
mod routes;
mod side_by_side;
mod text;

pub use explanation::{LEGEND, explanation};
pub use field_map::field_map;
pub use overlay::overlay;
pub use panels::panels;
pub use side_by_side::{beside, side_by_side};

use glam::DVec2;

/// A way over the field, as [`field_map`] draws it.
#[derive(Clone, Debug, PartialEq)]
pub struct Route {
    /// For the legend.
    pub label: String,
    pub colour: [u8; 3],
    /// In `map`. A point that is not finite is a gap: nothing joins its neighbours.
    pub points: Vec<DVec2>,
    pub style: RouteStyle,
    /// A dot on every point.
    pub dots: bool,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RouteStyle {
    /// Pale and beneath all others: what should have been found.
    Wide,
    /// Strong and on top: what was found.
    #[default]
    Thin,
}

#[cfg(test)]
mod tests;
