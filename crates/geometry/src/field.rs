//! The soccer field as painted lines on the ground.
//!
//! Coordinates are those of `map`: the origin at the field's centre, x towards one goal, y left, metres.

use core::f64::consts::{FRAC_PI_2, TAU};

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The dimensions of a field, as a field file (`config/fields/*.toml`) states them.
///
/// Lengths are measured between the centre lines of the painted lines. [`Field::new`] checks them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FieldDimensions {
    /// Name of the field, shown to people only.
    pub title: String,
    /// Distance from goal line to goal line, metres.
    pub length_m: f64,
    /// Distance from touchline to touchline, metres.
    pub width_m: f64,
    /// Width of every painted line, metres.
    pub line_width_m: f64,
    /// Width of the carpet outside the lines, metres.
    pub border_strip_m: f64,
    /// Diameter of the centre circle, metres; 0 if there is none.
    pub centre_circle_diameter_m: f64,
    /// Radius of the quarter circle around each corner of the field, metres, if the corners have one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corner_arc_radius_m: Option<f64>,
    /// Goal area in front of each goal, if it is painted.
    pub goal_area: Option<Area>,
    /// Penalty area in front of each goal, if it is painted.
    pub penalty_area: Option<Area>,
    /// Distance of each penalty mark from its goal line, metres, if the marks are painted.
    pub penalty_mark_from_goal_line_m: Option<f64>,
    /// Length of the strokes of the penalty marks' crosses, and of the centre mark, metres.
    pub mark_size_m: f64,
    /// Whether the centre of the field has a mark.
    pub centre_mark: bool,
    /// Both goals, if they stand on the field.
    pub goal: Option<Goal>,
}

/// A rectangle painted in front of each goal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Area {
    /// Extent from the goal line into the field, metres.
    pub depth_m: f64,
    /// Extent along the goal line, metres.
    pub width_m: f64,
}

/// The dimensions of both goals. The centres of their posts stand on the goal line.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Goal {
    /// Distance between the posts' axes, metres.
    pub width_m: f64,
    /// Height of the crossbar's axis, metres.
    pub height_m: f64,
    /// Extent from the goal line backwards, metres.
    pub depth_m: f64,
    /// Diameter of posts and crossbar, metres.
    pub post_diameter_m: f64,
}

/// A dimension that no field can have.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{key} is {value}: {expected}")]
pub struct FieldError {
    /// Key of the dimension in the field file, such as `goal_area.depth_m`.
    pub key: &'static str,
    /// The refused value, metres.
    pub value: f64,
    /// What would be right, as a sentence for people.
    pub expected: &'static str,
}

/// The centre line of one painted line, in `map`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stroke {
    /// A straight line.
    Segment {
        /// One end, metres.
        from: DVec2,
        /// The other end, metres.
        to: DVec2,
    },
    /// A full circle.
    Circle {
        /// Centre, metres.
        centre: DVec2,
        /// Radius, metres.
        radius: f64,
    },
    /// A quarter of a circle.
    Quarter {
        /// Centre of the circle, metres.
        centre: DVec2,
        /// Radius, metres.
        radius: f64,
        /// Signs of x and y on the side of the centre where the quarter lies, 1 or -1 each.
        ///
        /// Signs instead of an angle, so that the quarters of mirrored corners are mirrored to the last bit.
        side: DVec2,
    },
}

/// A point on the centre line of a painted line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldPoint {
    /// Position in `map`, metres.
    pub position: DVec2,
    /// Unit vector across the line.
    pub normal: DVec2,
    /// Length of painted line that this point represents, metres.
    pub length: f64,
}

/// A soccer field whose dimensions have been checked, with its painted lines.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    dimensions: FieldDimensions,
    strokes: Vec<Stroke>,
}

impl FieldDimensions {
    /// Moves touchlines and goal lines to a measured length and width, metres between centre lines.
    ///
    /// The areas, circle and marks keep their sizes, and their places relative to the goal line that they belong to.
    /// [`Field::new`] tells whether they still fit.
    #[must_use]
    pub fn of_size(self, [length_m, width_m]: [f64; 2]) -> Self {
        Self { length_m, width_m, ..self }
    }

    /// Whether both describe the same field; titles are ignored.
    pub fn is_same_as(&self, other: &Self) -> bool {
        Self { title: String::new(), ..self.clone() } == Self { title: String::new(), ..other.clone() }
    }
}

impl Field {
    /// Checks the dimensions and lays out the painted lines.
    ///
    /// # Errors
    /// [`FieldError`] names the first dimension that is out of range or does not fit the others.
    pub fn new(dimensions: FieldDimensions) -> Result<Self, FieldError> {
        validate(&dimensions)?;
        let strokes = layout(&dimensions);
        Ok(Self { dimensions, strokes })
    }

    /// The dimensions that the field was made from.
    pub fn dimensions(&self) -> &FieldDimensions {
        &self.dimensions
    }

    /// The centre lines of all painted lines; they end at the centre lines of the lines that they meet.
    pub fn strokes(&self) -> &[Stroke] {
        &self.strokes
    }

    /// The strokes as they are painted, with square ends.
    ///
    /// An end that meets another line is extended by half a line's width, to that line's far edge, so that corners are full.
    pub fn painted_strokes(&self) -> Vec<Stroke> {
        let half_width = self.line_width() / 2.0;
        let meets = |which: usize, end: DVec2| {
            let mut strokes = self.strokes.iter().enumerate();
            strokes.any(|(other, stroke)| other != which && stroke.distance(end) < half_width / 2.0)
        };
        let extended = |(which, stroke): (usize, &Stroke)| match *stroke {
            Stroke::Segment { from, to } => {
                let along = (to - from).normalize_or(DVec2::X);
                let reach = |end| if meets(which, end) { half_width } else { 0.0 };
                Stroke::Segment { from: from - along * reach(from), to: to + along * reach(to) }
            }
            // A quarter ends square at the centre of the line that it meets, whose paint covers the end.
            round => round,
        };
        self.strokes.iter().enumerate().map(extended).collect()
    }

    /// Width of the painted lines, metres.
    pub fn line_width(&self) -> f64 {
        self.dimensions.line_width_m
    }

    /// Half the length (x) and half the width (y) of the carpet, border strip included, metres.
    pub fn carpet_half_extent(&self) -> DVec2 {
        let d = &self.dimensions;
        DVec2::new(d.length_m, d.width_m) / 2.0 + DVec2::splat(d.border_strip_m)
    }

    /// The axes of the goals' posts and crossbars, each as its two ends in `map`, metres. Empty if the field has no goals.
    pub fn goal_bars(&self) -> Vec<[DVec3; 2]> {
        let Some(goal) = self.dimensions.goal else { return Vec::new() };
        let (line_x, half) = (self.dimensions.length_m / 2.0, goal.width_m / 2.0);
        let bars = |x: f64| {
            let [foot, top] = [0.0, goal.height_m].map(|z| move |y: f64| DVec3::new(x, y, z));
            [[foot(-half), top(-half)], [foot(half), top(half)], [top(-half), top(half)]]
        };
        [-line_x, line_x].into_iter().flat_map(bars).collect()
    }

    /// Whether a point of `map` lies on the carpet, border strip included.
    pub fn on_carpet(&self, point: DVec2) -> bool {
        point.abs().cmple(self.carpet_half_extent()).all()
    }

    /// Distance from a point of `map` to the centre line of the nearest painted line, metres.
    pub fn distance_to_centre_line(&self, point: DVec2) -> f64 {
        self.strokes.iter().map(|stroke| stroke.distance(point)).fold(f64::INFINITY, f64::min)
    }

    /// Samples about `count` points, evenly spaced along all lines; every stroke gets at least two.
    pub fn points(&self, count: usize) -> Vec<FieldPoint> {
        let total: f64 = self.strokes.iter().map(Stroke::length).sum();
        let spacing = total / count.max(1) as f64;
        self.strokes.iter().flat_map(|stroke| stroke.points(spacing)).collect()
    }
}

/// How the painted lines move with the length and width of the field, as by [`FieldDimensions::of_size`].
#[derive(Clone, Debug, PartialEq)]
pub struct SizeDerivative {
    strokes: Vec<Stroke>,
    /// The same strokes where the field is one metre longer, and wider.
    larger: [Vec<Stroke>; 2],
}

impl SizeDerivative {
    /// The derivative about the size that the field has.
    pub fn new(field: &Field) -> Self {
        let FieldDimensions { length_m, width_m, .. } = field.dimensions;
        let larger = [[length_m + 1.0, width_m], [length_m, width_m + 1.0]];
        let larger = larger.map(|size_m| layout(&field.dimensions.clone().of_size(size_m)));
        Self { strokes: field.strokes.clone(), larger }
    }

    /// Displacement of a point of the nearest line for each metre of length, and of width.
    pub fn at(&self, point: DVec2) -> [DVec2; 2] {
        let distances = self.strokes.iter().map(|stroke| stroke.distance(point)).enumerate();
        let nearest = distances.min_by(|(_, a), (_, b)| a.total_cmp(b)).map(|(which, _)| which);
        let moved = |larger: &Vec<Stroke>| {
            nearest.map_or(DVec2::ZERO, |which| self.strokes[which].moved_to(&larger[which], point))
        };
        [moved(&self.larger[0]), moved(&self.larger[1])]
    }
}

impl Stroke {
    /// Displacement of a point of this stroke when the stroke becomes `other`, which is of the same kind.
    fn moved_to(&self, other: &Self, point: DVec2) -> DVec2 {
        match (*self, *other) {
            (Stroke::Segment { from, to }, Stroke::Segment { from: new_from, to: new_to }) => {
                let along = to - from;
                let t = (point - from).dot(along) / along.length_squared();
                (new_from - from).lerp(new_to - to, t)
            }
            (
                Stroke::Circle { centre, .. } | Stroke::Quarter { centre, .. },
                Stroke::Circle { centre: new_centre, .. } | Stroke::Quarter { centre: new_centre, .. },
            ) => new_centre - centre,
            _ => DVec2::ZERO,
        }
    }

    /// Length of the centre line, metres.
    pub fn length(&self) -> f64 {
        match *self {
            Stroke::Segment { from, to } => from.distance(to),
            Stroke::Circle { radius, .. } => TAU * radius,
            Stroke::Quarter { radius, .. } => FRAC_PI_2 * radius,
        }
    }

    /// Distance of a point of `map` from the centre line, metres.
    pub fn distance(&self, point: DVec2) -> f64 {
        match *self {
            Stroke::Segment { from, to } => {
                let along = to - from;
                let t = ((point - from).dot(along) / along.length_squared()).clamp(0.0, 1.0);
                point.distance(from + along * t)
            }
            Stroke::Circle { centre, radius } => (point.distance(centre) - radius).abs(),
            Stroke::Quarter { centre, radius, side } => {
                let off = (point - centre) * side;
                if off.min_element() >= 0.0 {
                    (off.length() - radius).abs()
                } else {
                    off.distance(DVec2::X * radius).min(off.distance(DVec2::Y * radius))
                }
            }
        }
    }

    /// Samples evenly spaced points, about `spacing` metres apart, at least two.
    ///
    /// Each point lies in the middle of one of equal pieces, so that none lies on a corner.
    pub fn points(&self, spacing: f64) -> Vec<FieldPoint> {
        let pieces = libm::round(self.length() / spacing).max(2.0);
        let length = self.length() / pieces;
        (0..pieces as usize)
            .map(|piece| {
                let t = (piece as f64 + 0.5) / pieces;
                match *self {
                    Stroke::Segment { from, to } => {
                        FieldPoint { position: from.lerp(to, t), normal: (to - from).normalize().perp(), length }
                    }
                    Stroke::Circle { centre, radius } => {
                        let (sin, cos) = libm::sincos(TAU * t);
                        let normal = DVec2::new(cos, sin);
                        FieldPoint { position: centre + normal * radius, normal, length }
                    }
                    Stroke::Quarter { centre, radius, side } => {
                        let (sin, cos) = libm::sincos(FRAC_PI_2 * t);
                        let normal = DVec2::new(cos, sin) * side;
                        FieldPoint { position: centre + normal * radius, normal, length }
                    }
                }
            })
            .collect()
    }
}

/// Lays out the centre lines of a field.
fn layout(d: &FieldDimensions) -> Vec<Stroke> {
    let (x, y) = (d.length_m / 2.0, d.width_m / 2.0);
    let segment = |ax, ay, bx, by| Stroke::Segment { from: DVec2::new(ax, ay), to: DVec2::new(bx, by) };
    let mut strokes = vec![segment(-x, y, x, y), segment(-x, -y, x, -y), segment(0.0, -y, 0.0, y)];
    if d.centre_circle_diameter_m > 0.0 {
        strokes.push(Stroke::Circle { centre: DVec2::ZERO, radius: d.centre_circle_diameter_m / 2.0 });
    }
    let mut cross = |cx: f64| {
        let half = d.mark_size_m / 2.0;
        strokes.push(segment(cx - half, 0.0, cx + half, 0.0));
        strokes.push(segment(cx, -half, cx, half));
    };
    if d.mark_size_m > 0.0 {
        if let Some(from_goal_line) = d.penalty_mark_from_goal_line_m {
            cross(-x + from_goal_line);
            cross(x - from_goal_line);
        }
        // The halfway line covers the other stroke of this cross.
        if d.centre_mark {
            let half = d.mark_size_m / 2.0;
            strokes.push(segment(-half, 0.0, half, 0.0));
        }
    }
    for side in [-1.0, 1.0] {
        strokes.push(segment(side * x, -y, side * x, y));
        for area in [d.goal_area, d.penalty_area].into_iter().flatten() {
            let (front, half) = (side * (x - area.depth_m), area.width_m / 2.0);
            strokes.push(segment(front, -half, front, half));
            strokes.push(segment(side * x, half, front, half));
            strokes.push(segment(side * x, -half, front, -half));
        }
    }
    if let Some(radius) = d.corner_arc_radius_m {
        let signs = [DVec2::new(1.0, 1.0), DVec2::new(-1.0, 1.0), DVec2::new(-1.0, -1.0), DVec2::new(1.0, -1.0)];
        let arc = |sign: DVec2| Stroke::Quarter { centre: sign * DVec2::new(x, y), radius, side: -sign };
        strokes.extend(signs.map(arc));
    }
    strokes
}

/// Checks each dimension against its range and against those that it has to fit into.
fn validate(d: &FieldDimensions) -> Result<(), FieldError> {
    let within = |key, value: f64, low: f64, high: f64, expected| {
        if value.is_finite() && value >= low && value <= high {
            Ok(())
        } else {
            Err(FieldError { key, value, expected })
        }
    };
    within("length_m", d.length_m, 1.0, 200.0, "a field is 1 to 200 m long")?;
    within("width_m", d.width_m, 1.0, 200.0, "a field is 1 to 200 m wide")?;
    within("line_width_m", d.line_width_m, 0.005, 0.5, "a line is 0.005 to 0.5 m wide")?;
    within("border_strip_m", d.border_strip_m, 0.0, 20.0, "0 to 20 m of carpet outside the lines")?;
    within("mark_size_m", d.mark_size_m, 0.0, 1.0, "a mark is 0 to 1 m long")?;
    let shorter = d.length_m.min(d.width_m);
    within("centre_circle_diameter_m", d.centre_circle_diameter_m, 0.0, shorter, "the circle must fit on the field")?;
    for (depth_key, width_key, area) in [
        ("goal_area.depth_m", "goal_area.width_m", d.goal_area),
        ("penalty_area.depth_m", "penalty_area.width_m", d.penalty_area),
    ] {
        if let Some(area) = area {
            within(depth_key, area.depth_m, 0.05, d.length_m / 2.0, "the area must end before the halfway line")?;
            within(width_key, area.width_m, 0.05, d.width_m, "the area must fit between the touchlines")?;
        }
    }
    if let Some(radius) = d.corner_arc_radius_m {
        let areas = [d.goal_area, d.penalty_area].into_iter().flatten().map(|area| area.width_m);
        let beside_areas = (d.width_m - areas.fold(0.0, f64::max)) / 2.0;
        let room = beside_areas.min(d.length_m / 2.0);
        within("corner_arc_radius_m", radius, 0.05, room, "an arc of 0.05 m or more must end before the areas")?;
    }
    if let Some(mark) = d.penalty_mark_from_goal_line_m {
        let expected = "the mark lies between goal line and halfway line";
        within("penalty_mark_from_goal_line_m", mark, 0.05, d.length_m / 2.0, expected)?;
    }
    if let Some(goal) = d.goal {
        within("goal.width_m", goal.width_m, 0.1, d.width_m, "the goal must fit between the touchlines")?;
        within("goal.height_m", goal.height_m, 0.1, 10.0, "a goal is 0.1 to 10 m high")?;
        within("goal.depth_m", goal.depth_m, 0.0, 10.0, "a goal is 0 to 10 m deep")?;
        within("goal.post_diameter_m", goal.post_diameter_m, 0.01, 0.5, "a post is 0.01 to 0.5 m thick")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
