//! The places of a field that detectors are trained to find.

use glam::{DVec2, DVec3};
use serde::Serialize;

use realitysim_geometry::Field;

/// A kind of landmark.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LandmarkKind {
    /// Two lines end at each other.
    LCrossing,
    /// A line ends at another.
    TCrossing,
    /// Two lines cross.
    XCrossing,
    /// A penalty mark.
    PenaltyMark,
    /// The centre of the field.
    Centre,
    /// The foot of a goal post.
    PostFoot,
    /// The upper end of a goal post.
    PostTop,
}

impl LandmarkKind {
    /// All kinds.
    pub const ALL: [Self; 7] = [
        Self::LCrossing,
        Self::TCrossing,
        Self::XCrossing,
        Self::PenaltyMark,
        Self::Centre,
        Self::PostFoot,
        Self::PostTop,
    ];
}

/// A landmark of a field.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Landmark {
    /// Its name, unique on its field, such as `corner_+x+y`: the signs are those of x and y in `map`.
    pub name: String,
    /// Its kind.
    pub kind: LandmarkKind,
    /// Its position in `map`, metres.
    pub at: DVec3,
}

impl Landmark {
    /// The name on the field turned by half a turn, which looks the same, or mirrored at the x axis (left and right exchanged).
    pub(crate) fn mirrored_name(&self) -> String {
        self.name.replace("+y", "?y").replace("-y", "+y").replace("?y", "-y")
    }
}

/// All landmarks of a field, in an order that its dimensions determine.
pub fn landmarks(field: &Field) -> Vec<Landmark> {
    let d = field.dimensions();
    let (x, y) = (d.length_m / 2.0, d.width_m / 2.0);
    let mut found = Vec::new();
    let mut add = |name: String, kind, at: DVec2, z: f64| found.push(Landmark { name, kind, at: at.extend(z) });
    let sign = |value: f64| if value < 0.0 { "-" } else { "+" };
    for side_x in [-1.0, 1.0] {
        for side_y in [-1.0, 1.0] {
            let at = |x: f64, y: f64| DVec2::new(side_x * x, side_y * y);
            let name = |what: &str| format!("{what}_{}x{}y", sign(side_x), sign(side_y));
            add(name("corner"), LandmarkKind::LCrossing, at(x, y), 0.0);
            for (what, area) in [("goal_area", d.goal_area), ("penalty_area", d.penalty_area)] {
                if let Some(area) = area {
                    let half = area.width_m / 2.0;
                    add(name(&format!("{what}_corner")), LandmarkKind::LCrossing, at(x - area.depth_m, half), 0.0);
                    add(name(&format!("{what}_foot")), LandmarkKind::TCrossing, at(x, half), 0.0);
                }
            }
            if let Some(goal) = d.goal {
                add(name("post_foot"), LandmarkKind::PostFoot, at(x, goal.width_m / 2.0), 0.0);
                add(name("post_top"), LandmarkKind::PostTop, at(x, goal.width_m / 2.0), goal.height_m);
            }
        }
        if let Some(mark) = d.penalty_mark_from_goal_line_m {
            let at = DVec2::new(side_x * (x - mark), 0.0);
            add(format!("penalty_mark_{}x", sign(side_x)), LandmarkKind::PenaltyMark, at, 0.0);
        }
    }
    let radius = d.centre_circle_diameter_m / 2.0;
    for side_y in [-1.0, 1.0] {
        let name = |what: &str| format!("{what}_{}y", sign(side_y));
        add(name("halfway"), LandmarkKind::TCrossing, DVec2::new(0.0, side_y * y), 0.0);
        if radius > 0.0 {
            add(name("circle"), LandmarkKind::XCrossing, DVec2::new(0.0, side_y * radius), 0.0);
        }
    }
    add("centre".to_owned(), LandmarkKind::Centre, DVec2::ZERO, 0.0);
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use realitysim_config::{field_names, load_field};

    #[test]
    fn landmarks_have_names_of_their_own_and_lie_on_lines() {
        for name in field_names() {
            let field = Field::new(load_field(&name).unwrap()).unwrap();
            let found = landmarks(&field);
            let mut names: Vec<&str> = found.iter().map(|landmark| landmark.name.as_str()).collect();
            names.sort_unstable();
            names.dedup();
            assert_eq!(names.len(), found.len(), "{name}");
            for landmark in &found {
                let on_line = field.distance_to_centre_line(landmark.at.truncate()) < 1e-9;
                let may_stand_free = matches!(landmark.kind, LandmarkKind::PenaltyMark | LandmarkKind::Centre);
                assert!(on_line || may_stand_free, "{name}: {landmark:?}");
                assert!(names.contains(&landmark.mirrored_name().as_str()), "{landmark:?}");
            }
        }
    }
}
