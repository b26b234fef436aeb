//! Reads and checks the parameters of a request, from a query or from JSON. The module is pure.

use std::collections::BTreeMap;

use glam::DVec3;
use serde_json::Value;

use super::HttpProblem;
use super::live::PictureRequest;
use realitysim_geometry::{Euler, Isometry};
use realitysim_views::{MAX_FAR_M, MAX_HEIGHT_M, MAX_PLACE_M, MAX_TURN_DEG, MIN_HEIGHT_M, Method};

/// Name of every parameter of a view, and what is valid for it.
pub const PARAMETERS: [(&str, &str); 18] = [
    ("x", "metres, -100 to 100: camera_link in map"),
    ("y", "metres, -100 to 100"),
    ("z", "metres above the ground, 0.02 to 20"),
    ("yaw_deg", "degrees, -3600 to 3600"),
    ("pitch_deg", "degrees, above 0 looks down; 0 if it is left out"),
    ("roll_deg", "degrees; 0 if it is left out"),
    ("method", "exact, paper or nearest"),
    ("width", "pixels, 16 to 2048; without height the lens's proportions stay"),
    ("height", "pixels, 16 to 2048"),
    ("lens", "one of `lenses` of /v1/info; without it that of the nearest image"),
    ("scene", "one of `scenes` of /v1/info: its figures are drawn, its effects on any image applied"),
    ("figures", "draw or omit: whether the robots, people and balls that the scene places are drawn"),
    ("frame", "as which frame of the scene, 0 to 4294967295"),
    ("max_distance_m", "metres, 0 to 1000: how far away the nearest image may have been taken"),
    ("outside", "refuse (404) or warn (the best there is, with a warning), when the nearest image is farther away"),
    ("mask", "of a picture: none, alpha (a fourth channel; not for JPEG) or only (one channel)"),
    (
        "layers",
        "image, depth, mask, labels, or several of them with commas between, as arrays of one .npz instead of a picture",
    ),
    ("quality", "of a JPEG, 1 to 100"),
];

/// A request for one view.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ViewRequest {
    pub(super) map_from_link: Isometry,
    pub(super) method: Method,
    /// Width and height, pixels, where they are stated.
    pub(super) size: [Option<u32>; 2],
    pub(super) lens: Option<String>,
    pub(super) scene: Option<String>,
    /// Whether the figures of the scene are drawn.
    pub(super) figures: bool,
    /// Number of the scene's frame.
    pub(super) frame: u64,
    pub(super) max_distance_m: Option<f64>,
    /// Whether a view is refused that is farther than `max_distance_m` from the nearest image.
    pub(super) refuses: bool,
    pub(super) mask: MaskWanted,
    /// The arrays that are sent instead of a picture; none for a picture.
    pub(super) layers: Vec<Layer>,
    pub(super) quality: u8,
}

/// How the mask of valid pixels is sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum MaskWanted {
    /// Not at all.
    #[default]
    None,
    /// As a fourth channel.
    Alpha,
    /// Alone, as one channel.
    Only,
}

/// One array of a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Layer {
    /// Red, green and blue.
    Image,
    /// Metres along the ray of each pixel.
    Depth,
    /// What each pixel shows: known geometry, something beyond the ground, or nothing.
    Mask,
    /// The class of each pixel: carpet, line, goal.
    Labels,
}

const LAYERS: [(&str, Layer); 4] =
    [("image", Layer::Image), ("depth", Layer::Depth), ("mask", Layer::Mask), ("labels", Layer::Labels)];

/// Names and values of parameters, as they came.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Parameters(BTreeMap<String, String>);

/// Smallest width or height of a view, pixels.
const MIN_SIDE: u32 = 16;
/// Largest width or height of a view, pixels. Its square is the largest number of pixels of a view.
const MAX_SIDE: u32 = 2048;
/// Quality of a JPEG if the client does not state one.
const DEFAULT_QUALITY: u8 = 90;
/// Number of characters of a value that a message shows.
const SHOWN_CHARS: usize = 40;

impl Parameters {
    /// Reads the parameters of a query; a name must not be given twice.
    pub(super) fn from_query(query: &str) -> Result<Self, HttpProblem> {
        let mut known = BTreeMap::new();
        for (name, value) in form_urlencoded::parse(query.as_bytes()) {
            if known.insert(name.clone().into_owned(), value.into_owned()).is_some() {
                return Err(HttpProblem::wrong(format!("{}: given twice", short(&name))));
            }
        }
        Ok(Self(known))
    }

    /// Reads the parameters of a JSON object, whose values must be numbers or texts.
    pub(super) fn from_json(object: &serde_json::Map<String, Value>) -> Result<Self, HttpProblem> {
        let text = |(name, value): (&String, &Value)| match value {
            Value::String(text) => Ok((name.clone(), text.clone())),
            Value::Number(number) => Ok((name.clone(), number.to_string())),
            other => Err(HttpProblem::wrong(format!(
                "{}: {}: a number or a text is needed",
                short(name),
                short(&other.to_string())
            ))),
        };
        object.iter().map(text).collect::<Result<_, _>>().map(Self)
    }

    /// Adds those of `all` that `self` does not have.
    pub(super) fn over(mut self, all: &Self) -> Self {
        for (name, value) in &all.0 {
            self.0.entry(name.clone()).or_insert_with(|| value.clone());
        }
        self
    }

    /// Refuses parameters that are not among `known`.
    pub(super) fn only(&self, known: &[&str]) -> Result<(), HttpProblem> {
        match self.0.keys().find(|name| !known.contains(&name.as_str())) {
            Some(name) => Err(HttpProblem::wrong(format!("{}: unknown: there are {}", short(name), known.join(", ")))),
            None => Ok(()),
        }
    }

    /// Returns a number within a range, if it is given.
    pub(super) fn number(&self, name: &str, low: f64, high: f64) -> Result<Option<f64>, HttpProblem> {
        let Some(text) = self.0.get(name) else { return Ok(None) };
        let value = text.trim().parse::<f64>().ok().filter(|value| (low..=high).contains(value));
        value.map(Some).ok_or_else(|| wrong(name, text, &format!("a number from {low} to {high} is needed")))
    }

    /// Returns a whole number within a range, if it is given.
    pub(super) fn whole(&self, name: &str, low: u32, high: u32) -> Result<Option<u32>, HttpProblem> {
        let Some(text) = self.0.get(name) else { return Ok(None) };
        let value = whole(text.trim()).filter(|value| (low..=high).contains(value));
        value.map(Some).ok_or_else(|| wrong(name, text, &format!("a whole number from {low} to {high} is needed")))
    }

    /// Returns a text that must be given; `right` says what it is.
    pub(super) fn text(&self, name: &str, right: &str) -> Result<&str, HttpProblem> {
        let text = self.0.get(name).map(String::as_str);
        text.ok_or_else(|| HttpProblem::wrong(format!("{name} is missing: {right}")))
    }

    /// Returns a number within a range that must be given.
    fn needed(&self, name: &str, low: f64, high: f64) -> Result<f64, HttpProblem> {
        let right = PARAMETERS.iter().find(|(known, _)| *known == name).map_or("", |(_, right)| right);
        self.number(name, low, high)?.ok_or_else(|| HttpProblem::wrong(format!("{name} is missing: {right}")))
    }

    /// Returns the value of one of several words; the first if none is given.
    fn choice<T: Copy>(&self, name: &str, choices: &[(&str, T)]) -> Result<T, HttpProblem> {
        let Some(text) = self.0.get(name) else { return Ok(choices[0].1) };
        let found = choices.iter().find(|(known, _)| known == text).map(|(_, value)| *value);
        let names: Vec<&str> = choices.iter().map(|(name, _)| *name).collect();
        found.ok_or_else(|| wrong(name, text, &format!("one of {} is needed", names.join(", "))))
    }

    /// Returns some of several words, with commas between and none twice; none of them if the parameter is not given.
    fn choices<T: Copy + PartialEq>(&self, name: &str, choices: &[(&str, T)]) -> Result<Vec<T>, HttpProblem> {
        let Some(text) = self.0.get(name) else { return Ok(Vec::new()) };
        let mut found = Vec::new();
        for word in text.split(',') {
            let value = choices.iter().find(|(known, _)| *known == word).map(|(_, value)| *value);
            match value.filter(|value| !found.contains(value)) {
                Some(value) => found.push(value),
                None => {
                    let names: Vec<&str> = choices.iter().map(|(name, _)| *name).collect();
                    let right = format!("{}, with commas between and none twice, are possible", names.join(", "));
                    return Err(wrong(name, text, &right));
                }
            }
        }
        Ok(found)
    }

    /// Checks the parameters of a picture of the robot that is watched.
    pub(super) fn live_picture(&self) -> Result<PictureRequest, HttpProblem> {
        self.only(&["sequence", "width", "quality"])?;
        Ok(PictureRequest {
            sequence: self.whole("sequence", 0, u32::MAX)?,
            width: self.whole("width", MIN_SIDE, MAX_SIDE)?,
            quality: self.whole("quality", 1, 100)?.map_or(DEFAULT_QUALITY, |quality| quality as u8),
        })
    }

    /// Checks all parameters of a view.
    pub(super) fn view_request(&self) -> Result<ViewRequest, HttpProblem> {
        self.only(&PARAMETERS.map(|(name, _)| name))?;
        let turn = |name: &str| Ok(self.number(name, -MAX_TURN_DEG, MAX_TURN_DEG)?.unwrap_or(0.0).to_radians());
        let place = DVec3::new(
            self.needed("x", -MAX_PLACE_M, MAX_PLACE_M)?,
            self.needed("y", -MAX_PLACE_M, MAX_PLACE_M)?,
            self.needed("z", MIN_HEIGHT_M, MAX_HEIGHT_M)?,
        );
        let yaw = self.needed("yaw_deg", -MAX_TURN_DEG, MAX_TURN_DEG)?.to_radians();
        let euler = Euler { yaw, pitch: turn("pitch_deg")?, roll: turn("roll_deg")? };
        Ok(ViewRequest {
            map_from_link: Isometry::from_euler(euler, place),
            method: self.choice(
                "method",
                &[("exact", Method::Exact), ("paper", Method::Paper), ("nearest", Method::Nearest)],
            )?,
            size: [self.whole("width", MIN_SIDE, MAX_SIDE)?, self.whole("height", MIN_SIDE, MAX_SIDE)?],
            lens: self.0.get("lens").cloned(),
            scene: self.0.get("scene").cloned(),
            figures: self.choice("figures", &[("draw", true), ("omit", false)])?,
            frame: self.whole("frame", 0, u32::MAX)?.unwrap_or(0).into(),
            max_distance_m: self.number("max_distance_m", 0.0, MAX_FAR_M)?,
            refuses: self.choice("outside", &[("refuse", true), ("warn", false)])?,
            mask: self.choice(
                "mask",
                &[("none", MaskWanted::None), ("alpha", MaskWanted::Alpha), ("only", MaskWanted::Only)],
            )?,
            layers: self.choices("layers", &LAYERS)?,
            quality: self.whole("quality", 1, 100)?.map_or(DEFAULT_QUALITY, |quality| quality as u8),
        })
    }
}

/// Parses a whole number. Since JSON has one kind of number, 64.0 and 6.4e1 are whole, too.
fn whole(text: &str) -> Option<u32> {
    let exact =
        text.parse::<f64>().ok().filter(|value| value.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(value));
    text.parse().ok().or_else(|| exact.map(|value| value as u32))
}

/// Looks up a lens or scene by its name. The refusal lists the names that there are.
pub(super) fn named<'a, T>(name: &str, wanted: &str, known: &'a BTreeMap<String, T>) -> Result<&'a T, HttpProblem> {
    known.get(wanted).ok_or_else(|| {
        let names: Vec<&str> = known.keys().map(String::as_str).collect();
        let names = if names.is_empty() { "none: see `realitysim serve --help`".to_owned() } else { names.join(", ") };
        wrong(name, wanted, &format!("there is {names}"))
    })
}

/// Refuses the value of a parameter, and says what is valid.
fn wrong(name: &str, value: &str, right: &str) -> HttpProblem {
    HttpProblem::wrong(format!("{name} is {:?}: {right}", short(value)))
}

/// Shortens a text for a message.
fn short(text: &str) -> String {
    if text.chars().count() <= SHOWN_CHARS {
        text.to_owned()
    } else {
        text.chars().take(SHOWN_CHARS).chain("...".chars()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn asked(query: &str) -> Result<ViewRequest, HttpProblem> {
        Parameters::from_query(query)?.view_request()
    }

    #[test]
    fn what_is_wrong_is_named_with_what_would_be_right() {
        for (query, words) in [
            ("", "x is missing: metres, -100 to 100"),
            ("x=1&y=2&z=0.5", "yaw_deg is missing: degrees"),
            ("x=nan&y=2&z=0.5&yaw_deg=0", "x is \"nan\": a number from -100 to 100 is needed"),
            ("x=inf&y=2&z=0.5&yaw_deg=0", "x is \"inf\""),
            ("x=1&y=2&z=-3&yaw_deg=0", "z is \"-3\": a number from 0.02 to 20 is needed"),
            ("x=1&x=2", "x: given twice"),
            ("x=1&y=2&z=0.5&yaw_deg=0&width=9999", "width is \"9999\": a whole number from 16 to 2048 is needed"),
            ("x=1&y=2&z=0.5&yaw_deg=0&method=best", "one of exact, paper, nearest is needed"),
            (
                "x=1&y=2&z=0.5&yaw_deg=0&layers=depth,classes",
                "layers is \"depth,classes\": image, depth, mask, labels, with commas",
            ),
            ("x=1&y=2&z=0.5&yaw_deg=0&layers=mask,mask", "none twice"),
            ("x=1&y=2&z=0.5&yaw_deg=0&layers=", "layers is \"\": image, depth, mask, labels"),
            ("x=1&y=2&z=0.5&yaw_deg=0&yaw=3", "yaw: unknown: there are x, y, z, yaw_deg"),
        ] {
            let refusal = asked(query).expect_err(query);
            assert!(refusal.what.contains(words) && refusal.status == 400, "{query}: {}", refusal.what);
        }
    }

    #[test]
    fn a_query_and_its_json_ask_for_the_same() {
        let query = asked("x=1&y=-2.5&z=0.5&yaw_deg=30&pitch_deg=10&method=paper&width=64&mask=only&outside=warn")
            .expect("right");
        let object = serde_json::json!({ "x": 1, "y": -2.5, "z": 0.5, "yaw_deg": 30, "pitch_deg": 10.0, "method": "paper",
            "width": 64, "mask": "only", "outside": "warn" });
        let json = Parameters::from_json(object.as_object().expect("an object"))
            .expect("values")
            .view_request()
            .expect("right");
        assert_eq!(query, json);
        assert!(!query.refuses && query.mask == MaskWanted::Only && query.size == [Some(64), None]);
    }

    #[test]
    fn whole_numbers_are_whole_however_they_are_written() {
        for (text, value) in [("64", Some(64)), ("64.0", Some(64)), ("6.4e1", Some(64)), ("64.5", None), ("-1", None)] {
            assert_eq!(whole(text), value, "{text}");
        }
        assert_eq!((whole("4294967295"), whole("4294967296"), whole("nan")), (Some(u32::MAX), None, None));
    }

    proptest! {
        #[test]
        fn no_query_panics(query in "[ -~]{0,200}", name in 0..PARAMETERS.len(), value in "\\PC{0,60}") {
            let _ = asked(&query);
            let mut form = form_urlencoded::Serializer::new(String::new());
            form.append_pair(PARAMETERS[name].0, &value);
            let refusal = asked(&form.finish()).expect_err("the pose is missing");
            prop_assert!(refusal.what.len() < 400, "{}", refusal.what);
        }
    }
}
