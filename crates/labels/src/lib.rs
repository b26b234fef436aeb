//! Annotations for the training of detectors, made from the pose of the camera and the field.
//!
//! A [`Labeller`] knows a field. For a [`PosedImage`] it says what each pixel shows ([`Labeller::classes`]), where the field's landmarks
//! are ([`Labeller::keypoints`]) and boxes around them ([`Labeller::boxes`]). Pixels so near to an edge that the covariance of the pose
//! does not tell on which side they are have the class [`Class::Ignore`], so that labels state their own error. [`coco`] and [`yolo`]
//! write the formats of these names. [`parse_detections`] reads what a detector found, and [`Labeller::match_detections`] says of which
//! landmarks that is.
//!
//! A [`RestingSphere`] is a ball or robot that a person points at in one image, with its box in others; its [`Appearance`] tells whether it
//! is still there. [`Labeller::compare`] holds the answers of a detector against the landmarks.
//!
//! The crate is pure: poses, lenses and masks go in, annotations come out. See `docs/howto/training.md`.
//!
//! ```rust
//! use realitysim_geometry::{Euler, Field, Isometry};
//! use realitysim_labels::{Class, Labeller, PoseCovariance, PosedImage};
//! use realitysim_views::{Camera, SURE};
//!
//! let camera = Camera::new(&realitysim_config::load_lens("fisheye-640")?.lens);
//! let labeller = Labeller::new(&Field::new(realitysim_config::load_field("kid-2020")?)?, true);
//! // A camera 0.5 m above the centre of the field that looks 30 degrees down, whose place is known to 3 mm.
//! let euler = Euler { yaw: 0.0, pitch: 30f64.to_radians(), roll: 0.0 };
//! let map_from_link = Isometry::from_euler(euler, glam::DVec3::new(0.0, 0.0, 0.5));
//! let shown = vec![SURE; camera.width() * camera.height()];
//! let covariance = PoseCovariance::isotropic(0.003, 0.001);
//! let image = PosedImage { camera: &camera, map_from_link, covariance, shown: &shown, body: &[] };
//! let classes = labeller.classes(&image);
//! assert!(classes.contains(&Class::Line) && classes.contains(&Class::Carpet));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod annotation;
mod appearance;
mod class_list;
mod class_map;
pub mod coco;
mod detections;
mod disagreement;
mod goals;
mod landmarks;
mod outlines;
mod paint;
mod pose_covariance;
mod sphere;
pub mod yolo;

pub use annotation::{Keypoint, LabelBox, Visibility};
pub use appearance::Appearance;
pub use class_list::{BOOSTER_CLASSES, ClassList, LANDMARK_CLASSES};
pub use class_map::{Class, PosedImage};
pub use detections::{Detection, DetectionError, parse_detections};
pub use disagreement::{Comparison, Disagreement, Fault};
pub use landmarks::{Landmark, LandmarkKind, landmarks};
pub use outlines::Outline;
pub use pose_covariance::PoseCovariance;
pub use sphere::{MIN_SHOWN_SHARE, NoBox, NoSphere, POINTING_SIGMA_PX, RestingSphere, SphereBox};

use glam::DVec2;

use realitysim_geometry::Field;

/// Makes annotations of images of one field.
#[derive(Clone, Debug)]
pub struct Labeller {
    field: Field,
    goals: goals::Goals,
    paint: paint::Paint,
    /// Half extents of the carpet, metres.
    half: DVec2,
    landmarks: Vec<Landmark>,
}

impl Labeller {
    /// A labeller for a field; `goals` says whether the field's goals stand there.
    pub fn new(field: &Field, goals: bool) -> Self {
        let is_there =
            |landmark: &Landmark| goals || !matches!(landmark.kind, LandmarkKind::PostFoot | LandmarkKind::PostTop);
        Self {
            field: field.clone(),
            goals: goals::Goals::new(field, goals),
            paint: paint::Paint::new(field),
            half: field.carpet_half_extent(),
            landmarks: landmarks(field).into_iter().filter(is_there).collect(),
        }
    }

    /// The landmarks of the field, in the order of [`Labeller::keypoints`].
    pub fn landmarks(&self) -> &[Landmark] {
        &self.landmarks
    }
}
