//! Negative controls: the frames of a walk, tagged under a false assumption. No tag may then be both valid and wrong.
//!
//! [`falsehoods`] lists the assumptions, [`Falsehood::tag`] tags the frames under one of them, [`Control`] counts the
//! result.

mod pictures;

use serde::Serialize;

use super::contrast::Quality;
pub use pictures::{Distortion, Noise};
use realitysim_config::{Settings, field_names, load_field};
use realitysim_geometry::{Field, Isometry, Lens, LensParameters};
use realitysim_tagging::{Claims, FrameCache, SetupError, Trial};

/// Shifts of the pictures to the right and down, as shares of the height of the picture.
///
/// Errors here and below range from what a careless calibration leaves to what is clearly wrong. None is so large that
/// no line is found.
const SHIFT_SHARES: [[f64; 2]; 4] = [[0.0, 0.05], [0.0, 0.1], [0.0, -0.1], [0.1, 0.0]];
/// Factors of the focal length and of the size of the pictures.
const SCALES: [f64; 4] = [0.9, 0.95, 1.05, 1.1];
/// Turns of the pictures, degrees clockwise.
const TURNS_DEG: [f64; 4] = [-6.0, -3.0, 3.0, 6.0];
/// Errors of the height of the camera, metres upwards.
const HIGHER_M: [f64; 4] = [-0.10, -0.05, 0.05, 0.10];

/// A false assumption about every frame of a walk.
#[derive(Clone, Debug)]
pub enum Falsehood {
    /// No falsehood: the result under true assumptions, for comparison.
    Nothing,
    /// The robot walks on another field.
    Field {
        /// Name of the shipped field.
        name: String,
        /// The field.
        field: Field,
    },
    /// The lens has another focal length.
    Focal {
        /// Factor of the focal length.
        scale: f64,
        /// Lens with that focal length.
        lens: Lens,
    },
    /// The camera has another height.
    Mount {
        /// Error of the height, metres upwards.
        higher_m: f64,
    },
    /// The pictures are not those of the camera.
    Picture(Distortion),
}

/// Returns all falsehoods about the frames of a field and a lens, the truth first.
///
/// They are every shipped field of other dimensions, other focal lengths and heights, and pictures that are shifted,
/// scaled, turned, or replaced by noise.
pub fn falsehoods(field: &Field, lens: &Lens) -> Vec<Falsehood> {
    let mut all = vec![Falsehood::Nothing];
    for name in field_names() {
        let other = load_field(&name).ok().filter(|other| !other.is_same_as(field.dimensions()));
        if let Some(field) = other.and_then(|dimensions| Field::new(dimensions).ok()) {
            all.push(Falsehood::Field { name, field });
        }
    }
    for scale in SCALES {
        let own = lens.parameters();
        let parameters = LensParameters { fx: own.fx * scale, fy: own.fy * scale, ..own.clone() };
        all.extend(Lens::new(parameters).ok().map(|lens| Falsehood::Focal { scale, lens }));
    }
    all.extend(HIGHER_M.map(|higher_m| Falsehood::Mount { higher_m }));
    let height = f64::from(lens.height());
    let shifts = SHIFT_SHARES.map(|by| Distortion::Shift { by_px: by.map(|share| libm::round(share * height) as i32) });
    let turns = TURNS_DEG.map(|by_deg| Distortion::Turn { by_rad: by_deg.to_radians() });
    let noises = [Noise::Uniform, Noise::Blurred, Noise::Scrambled].map(Distortion::Noise);
    let scales = SCALES.map(|by| Distortion::Scale { by });
    all.extend(shifts.into_iter().chain(scales).chain(turns).chain(noises).map(Falsehood::Picture));
    all
}

impl Falsehood {
    /// Describes the falsehood in a few words, for people.
    pub fn name(&self) -> String {
        match self {
            Self::Nothing => "the truth".to_owned(),
            Self::Field { name, .. } => format!("field {name}"),
            Self::Focal { scale, .. } => format!("focal length {:+.0} %", 100.0 * (scale - 1.0)),
            Self::Mount { higher_m } => format!("camera {:+.0} cm in height", 100.0 * higher_m),
            Self::Picture(distortion) => distortion.name(),
        }
    }

    /// Returns whether this is [`Falsehood::Nothing`].
    pub fn is_true(&self) -> bool {
        matches!(self, Self::Nothing)
    }

    /// Tags the frames as if the falsehood held. With `start_is_unknown` the initial pose is withheld.
    ///
    /// `progress` is called with the number of frames that are done.
    pub fn tag(
        &self,
        cache: &FrameCache,
        settings: &Settings,
        start_is_unknown: bool,
        progress: &mut dyn FnMut(usize),
    ) -> Result<Vec<Trial>, SetupError> {
        let distorted = |index: usize, picture: &_| match self {
            Self::Picture(distortion) => distortion.apply(index, picture),
            _ => Clone::clone(picture),
        };
        let mut claims = Claims { start_is_unknown, ..Claims::default() };
        match self {
            Self::Nothing => {}
            Self::Field { field, .. } => claims.field = Some(field),
            Self::Focal { lens, .. } => claims.lens = Some(lens),
            Self::Mount { higher_m } => claims.higher_m = *higher_m,
            Self::Picture(_) => claims.picture = Some(&distorted),
        }
        cache.try_out_claiming(settings, &claims, progress)
    }
}

/// Result of tagging under one falsehood.
#[derive(Clone, Debug, Serialize)]
pub struct Control {
    /// Description of the falsehood.
    pub said: String,
    /// Whether it is the truth, for comparison.
    pub is_true: bool,
    /// Whether the initial pose was withheld.
    pub start_is_unknown: bool,
    /// Number of frames.
    pub frames: usize,
    /// Number of valid tags.
    pub valid: usize,
    /// Number of valid tags that are more than 12 cm off in x and y.
    pub wrong: usize,
    /// Largest error of the valid tags in x and y, centimetres.
    pub max_cm: f64,
}

impl Control {
    /// Counts the tags of a run. `truth` is in order of time.
    pub fn of(falsehood: &Falsehood, start_is_unknown: bool, run: &[Trial], truth: &[(i64, Isometry)]) -> Self {
        let Quality { frames, valid, wrong, position_cm, .. } = Quality::of(run, truth);
        let max_cm = position_cm.max;
        Self { said: falsehood.name(), is_true: falsehood.is_true(), start_is_unknown, frames, valid, wrong, max_cm }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use realitysim_config::load_lens;

    #[test]
    fn every_shipped_field_but_the_own_one_is_tried() {
        let own = Field::new(load_field("kid-2009").expect("shipped")).expect("checked");
        let lens = load_lens("equisolid-640").expect("shipped").lens;
        let said: Vec<String> = falsehoods(&own, &lens).iter().map(Falsehood::name).collect();
        assert_eq!(said[0], "the truth");
        assert!(said.contains(&"field kid-2020".to_owned()) && !said.contains(&"field kid-2009".to_owned()));
        assert!(
            said.contains(&"focal length +10 %".to_owned()) && said.contains(&"camera -10 cm in height".to_owned())
        );
        let mut names = said.clone();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), said.len(), "each has a name of its own: {said:?}");
    }
}
