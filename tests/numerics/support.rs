//! One robot on the shipped scene's field, with whatever picture or measurement a test wants to give it.

use glam::{DVec2, DVec3};
use realitysim::config::{Settings, load_field, load_lens};
use realitysim::geometry::{Euler, Field, Isometry, Lens, LensParameters, Pose2};
use realitysim::localization::observation::reading;
use realitysim::localization::{LocalizerState, Rejection};
use realitysim::log_input::synchroniser::{InitialPose, RobotState};
use realitysim::log_input::transforms::CameraPlace;
use realitysim::ros2::messages::FrameTag;
use realitysim::scene::{Renderer, Scene, SceneFile};
use realitysim::tagging::Tagger;
use realitysim::vision::{Picture, Vision, VisionSettings};

const SCENE: &str = include_str!("../../replay/scenes/straight.toml");

/// A valid tag is never off by more than this.
pub const TRUSTED_M: f64 = 0.10;
pub const FRAME_NS: i64 = 100_000_000;

/// A fisheye of a quarter of the usual pixels.
pub fn small_lens() -> LensParameters {
    let full = load_lens("fisheye-640").expect("a shipped lens").lens.parameters().clone();
    resized(&full, 320, 240)
}

/// The same lens with another number of pixels.
pub fn resized(lens: &LensParameters, width: u32, height: u32) -> LensParameters {
    let [across, down] = [f64::from(width) / f64::from(lens.width), f64::from(height) / f64::from(lens.height)];
    let scale = across.min(down);
    let centre = |c: f64, old: u32, new: u32| (c - f64::from(old) / 2.0) * scale + f64::from(new) / 2.0;
    LensParameters {
        width,
        height,
        fx: lens.fx * scale,
        fy: lens.fy * scale,
        cx: centre(lens.cx, lens.width, width),
        cy: centre(lens.cy, lens.height, height),
        ..lens.clone()
    }
}

/// A camera above the robot's footprint, as the scene's robot has it: 49 cm up, 17 degrees down.
pub fn usual_place() -> Isometry {
    place(0.49, 0.0, 17f64.to_radians(), 0.0)
}

pub fn place(height_m: f64, yaw: f64, pitch: f64, roll: f64) -> Isometry {
    Isometry::from_euler(Euler { yaw, pitch, roll }, DVec3::new(0.04, 0.0, height_m))
}

#[derive(Clone)]
pub struct Robot {
    renderer: Renderer,
    vision: Vision,
    tagger: Tagger,
    lens: Lens,
    /// Footprint from `camera_link`: true, and what the robot is told.
    pub place: Isometry,
    pub told_place: Isometry,
    /// Where it really is.
    pub pose: Pose2,
    pub odometry: Option<Pose2>,
    /// Since the frame before, by gyro.
    pub turned_rad: Option<f64>,
    pub stamp_ns: i64,
}

impl Robot {
    /// Knows where it stands.
    pub fn at(pose: Pose2, lens: &LensParameters, settings: &Settings) -> Self {
        let mut robot = Self::nowhere(pose, lens, settings);
        robot.tagger.start_at(&InitialPose { map_from_footprint: pose, xy_m: None, yaw_rad: None });
        robot
    }

    /// Was told nothing.
    pub fn nowhere(pose: Pose2, lens: &LensParameters, settings: &Settings) -> Self {
        settings.check().expect("possible settings");
        let dimensions = load_field("kid-2009").expect("a shipped field");
        // No effects: no noise, no errors but those that a test makes.
        let plain = SCENE.split("[[effect]]").next().expect("a first part");
        let file = SceneFile::from_toml(plain).expect("a readable scene");
        let scene = Scene::build(file, dimensions.clone(), lens.clone()).expect("a possible scene");
        let lens = Lens::new(lens.clone()).expect("a possible lens");
        let field = Field::new(dimensions).expect("a possible field");
        let f = &settings.filter;
        let vision = VisionSettings {
            reading: reading(f.model, f.formula),
            line_width_m: field.line_width(),
            tilt_sigma_rad: f.tilt_sigma_deg.to_radians(),
            reduction: f.image_reduction,
        };
        Self {
            renderer: Renderer::new(&scene),
            vision: Vision::new(&lens, vision),
            tagger: Tagger::new(settings, field, &lens, LocalizerState::default()),
            lens,
            place: usual_place(),
            told_place: usual_place(),
            pose,
            odometry: Some(Pose2::default()),
            turned_rad: None,
            stamp_ns: 1_700_000_000_000_000_000,
        }
    }

    /// What its camera really sees.
    pub fn view(&self) -> Picture {
        let mut pixels = Vec::new();
        self.renderer.render_clean(&(self.pose.to_isometry() * self.place), 0, &mut pixels);
        Picture::from_rgb(self.lens.width() as usize, self.lens.height() as usize, &pixels).expect("a picture")
    }

    /// A picture whose every pixel on the ground has the colour that `ground` gives it; the rest is dark gray.
    pub fn rendered(&self, ground: impl Fn(DVec2) -> [u8; 3]) -> Picture {
        let optical = self.place * Isometry::link_from_optical();
        let (width, height) = (self.lens.width() as usize, self.lens.height() as usize);
        let colour = |index: usize| {
            let pixel = DVec2::new((index % width) as f64, (index / width) as f64);
            let Some(ray) = self.lens.unproject(pixel) else { return [0; 3] };
            let ray = optical.transform_vector(ray);
            if ray.z > -0.02 {
                return [40; 3];
            }
            ground((optical.translation - ray * (optical.translation.z / ray.z)).truncate())
        };
        let pixels: Vec<u8> = (0..width * height).flat_map(colour).collect();
        Picture::from_rgb(width, height, &pixels).expect("a picture")
    }

    fn told(&self) -> RobotState {
        RobotState {
            odometry: self.odometry,
            odometry_until_ns: Some(self.stamp_ns),
            place: Ok(CameraPlace {
                footprint_from_link: self.told_place,
                footprint_from_optical: self.told_place * Isometry::link_from_optical(),
                base_from_optical: self.told_place * Isometry::link_from_optical(),
                age_ns: 0,
                tilt_is_measured: true,
                lean_rad: None,
            }),
            head: None,
            turned_rad: self.turned_rad,
            // Something measures that it stands: odometry that does not change is believed.
            swayed_rad: Some(0.0),
            camera_twist: None,
            turn_is_measured: true,
            stale: false,
            stamp_sigma_s: 0.0,
            tilt_sigma_rad: 0.0,
            initial_pose: None,
            anchor: None,
        }
    }

    /// The tag of this picture; checked for what must hold of every tag.
    pub fn tag(&mut self, picture: &Picture) -> FrameTag {
        let told = self.told();
        let seen = self.vision.look(picture, &(self.told_place * Isometry::link_from_optical()), None);
        let tag = self.tagger.tag(self.stamp_ns, &told, &seen, &mut |_| true);
        assert_sound(&tag);
        if tag.valid {
            let off = self.error_m(&tag);
            assert!(off < TRUSTED_M, "valid and {off:.3} m off: {tag:?}");
        }
        tag
    }

    /// The tag of what the camera really sees, and on to the next frame.
    pub fn step(&mut self) -> FrameTag {
        let tag = self.tag(&self.view());
        self.stamp_ns += FRAME_NS;
        tag
    }

    /// What it makes of odometry alone.
    pub fn predict_ahead(&mut self, ahead: &mut LocalizerState) -> Option<FrameTag> {
        let told = self.told();
        let tag = self.tagger.predict_ahead(self.stamp_ns, &told, ahead, Rejection::NoFrame);
        tag.iter().for_each(assert_sound);
        tag
    }

    pub fn state(&self) -> LocalizerState {
        self.tagger.state()
    }

    /// Stands until it is sure of its pose.
    pub fn settle(&mut self) {
        let valid = (0..6).any(|_| self.step().valid);
        assert!(valid, "a standing robot with lines in view knows where it is");
    }

    /// How far the tag's camera is from the true one, seen from above; of an ambiguous tag the mirror pose counts as well.
    fn error_m(&self, tag: &FrameTag) -> f64 {
        let truth = (self.pose.to_isometry() * self.place).translation;
        let off = |at: &realitysim::ros2::messages::Point| f64::hypot(at.x - truth.x, at.y - truth.y);
        let (own, mirror) = (off(&tag.pose.pose.position), off(&tag.mirror_pose.position));
        if tag.ambiguous { own.min(mirror) } else { own }
    }
}

pub fn assert_sound(tag: &FrameTag) {
    assert_eq!(unsound(tag), None, "{tag:?}");
}

/// What is wrong with the numbers of a tag: each must be finite, the rotation one, and the covariance one.
pub fn unsound(tag: &FrameTag) -> Option<String> {
    let text = serde_json::to_string(tag).expect("writable");
    let q = &tag.pose.pose.orientation;
    let length = (q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w).sqrt();
    let covariance = nalgebra::Matrix6::from_row_slice(&tag.pose.covariance);
    // Of no particles it is 0: weights that add up to 1 have at least one particle's worth.
    let fewest = if tag.particles == 0 { 0.0 } else { 1.0 - 1e-9 };
    let particles = fewest..=f64::from(tag.particles) * (1.0 + 1e-9);
    let checks = [
        (text.contains("null"), format!("a number is not finite: {text}")),
        ((length - 1.0).abs() > 1e-9, format!("no rotation: {q:?}")),
        (covariance != covariance.transpose(), format!("the covariance is not symmetric: {covariance}")),
        (covariance.cholesky().is_none(), format!("the covariance is not positive definite: {covariance}")),
        (
            !particles.contains(&tag.effective_sample_size),
            format!("effective sample size {}", tag.effective_sample_size),
        ),
        (tag.valid != tag.reason.is_empty(), format!("valid is {} because of {:?}", tag.valid, tag.reason)),
    ];
    checks.into_iter().find(|(wrong, _)| *wrong).map(|(_, what)| what)
}
