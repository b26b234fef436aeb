//! One rendered frame, and what is known of it.

use glam::DVec3;
use realitysim::geometry::{Euler, Field, Isometry, Lens, Pose2};
use realitysim::localization::{Formula, Model, observation};
use realitysim::log_input::scene_source;
use realitysim::scene::Renderer;
use realitysim::vision::{Observations, Picture, Vision, VisionSettings};

pub struct View {
    pub lens: Lens,
    pub field: Field,
    pub picture: Picture,
    pub footprint_from_optical: Isometry,
    /// Where the robot stands.
    pub pose: Pose2,
    pub vision: Vision,
    pub seen: Observations,
}

impl View {
    /// 640 x 480, near the centre circle.
    pub fn new() -> Self {
        let scene = scene_source::load("replay/scenes/straight.toml").expect("a scene of the shelf");
        let lens = scene.lens().clone();
        let field = scene.field().clone();
        let pose = Pose2::new(-1.4, 0.3, 0.2);
        let footprint_from_link =
            Isometry::from_euler(Euler { yaw: 0.0, pitch: 0.3, roll: 0.0 }, DVec3::new(0.04, 0.0, 0.49));
        let (mut rgb, renderer) = (Vec::new(), Renderer::new(&scene));
        renderer.render_clean(&(pose.to_isometry() * footprint_from_link), 0, &mut rgb);
        let picture =
            Picture::from_rgb(lens.width() as usize, lens.height() as usize, &rgb).expect("of the lens's size");
        let settings = VisionSettings {
            reading: observation::reading(Model::Gauss, Formula::Corrected),
            line_width_m: field.line_width(),
            tilt_sigma_rad: 0.012,
            reduction: 0,
        };
        let vision = Vision::new(&lens, settings);
        let footprint_from_optical = footprint_from_link * Isometry::link_from_optical();
        let seen = vision.look(&picture, &footprint_from_optical, None);
        Self { lens, field, picture, footprint_from_optical, pose, vision, seen }
    }
}
