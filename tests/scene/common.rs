//! Fields, lenses and scenes for the tests.

use realitysim::geometry::field::Area;
use realitysim::geometry::{FieldDimensions, LensModel, LensParameters};
use realitysim::scene::{Renderer, Scene, SceneFile};

pub const STRAIGHT: &str = include_str!("../../replay/scenes/straight.toml");
pub const LOOP: &str = include_str!("../../replay/scenes/loop.toml");
pub const DEMO: &str = include_str!("../../replay/scenes/demo.toml");

pub fn kid_2009() -> FieldDimensions {
    FieldDimensions {
        title: "test".into(),
        length_m: 6.0,
        width_m: 4.0,
        line_width_m: 0.05,
        border_strip_m: 0.7,
        centre_circle_diameter_m: 1.2,
        corner_arc_radius_m: None,
        goal_area: Some(Area { depth_m: 0.6, width_m: 2.2 }),
        penalty_area: None,
        penalty_mark_from_goal_line_m: Some(1.8),
        mark_size_m: 0.1,
        centre_mark: false,
        goal: None,
    }
}

pub fn fisheye_640() -> LensParameters {
    LensParameters {
        width: 640,
        height: 480,
        fx: 205.0,
        fy: 205.0,
        cx: 322.0,
        cy: 236.0,
        model: LensModel::KannalaBrandt { k: [-0.012, 0.003, -0.0008, 0.0] },
        fov_deg: Some(200.0),
    }
}

pub fn scene(toml: &str) -> Scene {
    let file = SceneFile::from_toml(toml).expect("a readable scene");
    Scene::build(file, kid_2009(), fisheye_640()).expect("a possible scene")
}

/// The scene file without its effects.
pub fn plain(toml: &str) -> String {
    toml.split("[[effect]]").next().expect("a first part").to_owned()
}

/// The scene file with these effects in place of none.
pub fn with_effects(plain: &str, effects: &[&str]) -> String {
    effects.iter().fold(plain.to_owned(), |toml, effect| format!("{toml}\n[[effect]]\n{effect}\n"))
}

/// The straight walk with these effects in place of its own.
pub fn straight_with(effects: &[&str]) -> Scene {
    scene(&with_effects(&plain(STRAIGHT), effects))
}

/// The pixels of one frame.
pub fn image(scene: &Scene, index: u64) -> Vec<u8> {
    let mut pixels = Vec::new();
    Renderer::new(scene).render(index, &mut pixels);
    pixels
}

/// Every scene of `replay/scenes` with the field and lens that it names.
pub fn shelf() -> Vec<(String, Scene)> {
    let entries = std::fs::read_dir("replay/scenes").expect("the shelf");
    let mut paths: Vec<_> = entries.map(|entry| entry.expect("an entry").path()).collect();
    paths.sort();
    let named = |path: &std::path::PathBuf| {
        let name = path.file_stem().expect("a name").to_string_lossy().into_owned();
        (
            name,
            realitysim::log_input::scene_source::load(path.to_str().expect("a plain path")).expect("a possible scene"),
        )
    };
    paths.iter().map(named).collect()
}
