//! The points of a field that a robot can be put on without a ruler: crossings of its lines, and its marks.

use glam::DVec2;
use serde::Serialize;

use realitysim_config::wording::closest_name;
use realitysim_geometry::Field;
use realitysim_labels::landmarks;

/// A named point of the field. Its name is that of the landmark in labels, such as `corner_+x+y`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Crossing {
    /// Unique on its field; the signs are those of x and y in `map`.
    pub name: String,
    /// Position of the lines' centres in `map`, metres.
    pub at_m: DVec2,
}

/// All crossings of a field that lie on the ground and off the goal's posts, in the order of the landmarks.
pub fn crossings(field: &Field) -> Vec<Crossing> {
    let on_ground = landmarks(field).into_iter().filter(|landmark| !landmark.name.starts_with("post_"));
    on_ground.map(|landmark| Crossing { name: landmark.name, at_m: landmark.at.truncate() }).collect()
}

/// The places of the protocol: six crossings far from each other. Those on the outline of the field are left out if there are enough
/// others, since a robot on them that faces outwards sees no lines.
///
/// Every next one is that whose distance from those before is largest.
pub fn recommended(all: &[Crossing]) -> Vec<&Crossing> {
    const PLACES: usize = 6;
    let outline = all.iter().fold(DVec2::ZERO, |most, crossing| most.max(crossing.at_m.abs()));
    let inside = |crossing: &&Crossing| crossing.at_m.abs().cmplt(outline - 0.1).all();
    let mut others: Vec<&Crossing> = all.iter().filter(inside).collect();
    if others.len() < PLACES {
        others = all.iter().collect();
    }
    let mut chosen: Vec<&Crossing> = others.iter().filter(|crossing| crossing.name == "centre").copied().collect();
    while chosen.len() < PLACES.min(others.len()) {
        let apart = |crossing: &Crossing| {
            chosen.iter().map(|other| other.at_m.distance(crossing.at_m)).fold(f64::INFINITY, f64::min)
        };
        let Some(next) = others.iter().copied().max_by(|a, b| apart(a).total_cmp(&apart(b))) else { break };
        chosen.push(next);
    }
    chosen
}

/// Start of the text of a mark that says where the robot stands.
const AT: &str = "at ";

/// Reads the text of a mark, `at NAME HEADING_DEG`: the crossing and the heading in `map`, radians.
///
/// `None` for a mark about something else.
///
/// # Errors
///
/// What is wrong with a mark that begins with `at`, and what would be right.
pub fn parse_mark<'a>(text: &str, crossings: &'a [Crossing]) -> Option<Result<(&'a Crossing, f64), String>> {
    let rest = text.trim().strip_prefix(AT)?;
    Some(parse_place(rest, crossings))
}

fn parse_place<'a>(text: &str, crossings: &'a [Crossing]) -> Result<(&'a Crossing, f64), String> {
    let words: Vec<&str> = text.split_whitespace().collect();
    let [name, heading] = words[..] else {
        return Err("it takes a crossing and a heading, as in \"at corner_+x+y 90\"".to_owned());
    };
    let crossing = crossings.iter().find(|crossing| crossing.name.eq_ignore_ascii_case(name));
    let crossing = crossing.ok_or_else(|| unknown(name, crossings))?;
    let degrees = heading.parse::<f64>().ok().filter(|degrees| degrees.abs() <= 360.0);
    let degrees = degrees.ok_or_else(|| {
        format!(
            "{heading} is no heading: degrees are needed, -360 to 360, counter-clockwise from the x axis of the field"
        )
    })?;
    Ok((crossing, degrees.to_radians()))
}

fn unknown(name: &str, crossings: &[Crossing]) -> String {
    let names = crossings.iter().map(|crossing| crossing.name.as_str());
    match closest_name(name, names) {
        Some(closest) => format!("this field has no crossing {name}: did you mean {closest}?"),
        None => format!("this field has no crossing {name}: `realitysim accuracy --crossings` lists its names"),
    }
}
