//! A scene's figures drawn into pictures that something else has made.

use glam::DVec3;
use realitysim::geometry::field::Goal;
use realitysim::geometry::{Euler, Field, FieldDimensions, Isometry, Lens};
use realitysim::scene::{Figures, Renderer, Scene, SceneFile, ViewOverlay};
use realitysim::views::{
    Camera, Candidate, Method, Pyramid, Raster, Request, SURE, Surface, SynthesizedView, TagError, Target,
    ViewSettings, Vignetting, World, view,
};

use super::common::{STRAIGHT, fisheye_640, kid_2009, plain, straight_with, with_effects};

const BALL_AND_ROBOT: &str = "kind = \"obstacles\"\nfigures = [{ shape = \"ball\", position_m = [-1.9, 0.0] },\n\
    { shape = \"robot\", path = [[-1.2, 0.6], [0.4, -0.8]], speed_m_s = 0.3, colour = [200, 20, 200] }]";

fn everywhere(_: usize, _: usize) -> f32 {
    f32::INFINITY
}

#[test]
fn figures_upon_an_empty_picture_are_those_of_the_renderer() {
    let (empty, full) = (straight_with(&[]), straight_with(&[BALL_AND_ROBOT]));
    let figures = Figures::new(&full, full.lens()).expect("it places some");
    for frame in [0, 25, 60] {
        let pose = full.truth(full.frame_time_s(frame)).map_from_camera_link;
        let (mut drawn, mut wanted) = (Vec::new(), Vec::new());
        Renderer::new(&empty).render_from(&pose, frame, &mut drawn);
        let before = drawn.clone();
        let shown = figures.draw(frame, &pose, everywhere, &mut drawn);
        Renderer::new(&full).render_from(&pose, frame, &mut wanted);
        assert_eq!(drawn, wanted);
        let count = shown.iter().filter(|distance| distance.is_finite()).count();
        let changed = before.chunks_exact(3).zip(drawn.chunks_exact(3)).filter(|(a, b)| a != b).count();
        assert!(count > 500 && changed >= count * 9 / 10, "{count} pixels of figures, {changed} changed");
    }
    assert!(Figures::new(&empty, empty.lens()).is_none(), "nobody is there");
}

#[test]
fn what_stands_nearer_than_a_figure_hides_it_and_its_shadow() {
    let full = straight_with(&[BALL_AND_ROBOT]);
    let figures = Figures::new(&full, full.lens()).expect("it places some");
    let pose = full.truth(0.0).map_from_camera_link;
    let mut pixels = vec![100; 640 * 480 * 3];
    assert!(figures.draw(0, &pose, |_, _| 0.3, &mut pixels).iter().all(|distance| distance.is_infinite()));
    assert!(pixels.iter().all(|value| *value == 100), "all of it is behind");
    // The ball is a metre ahead, the robot farther: a curtain between them hides one of them.
    let distances = figures.draw(0, &pose, everywhere, &mut pixels);
    let [nearest, farthest] = [f32::min, f32::max].map(|choice| {
        distances.iter().copied().filter(|distance| distance.is_finite()).reduce(choice).expect("figures are seen")
    });
    assert!((0.8..1.3).contains(&nearest) && farthest > 1.3, "{nearest} to {farthest} m");
    let shown = figures.draw(0, &pose, |_, _| 1.3, &mut pixels).iter().filter(|distance| distance.is_finite()).count();
    let all = figures.draw(0, &pose, everywhere, &mut pixels).iter().filter(|distance| distance.is_finite()).count();
    assert!(shown > 50 && all > 2 * shown, "{shown} of {all}");
}

/// A view of gray ground, and the pieces that it was made with.
/// The camera is 1.4 m before the goal line, 0.5 m high.
fn with_view<T>(field: &Field, use_it: impl FnOnce(&Camera, &World, SynthesizedView) -> T) -> T {
    let camera = Camera::new(&Lens::new(fisheye_640()).expect("good"));
    let world = World::new(field);
    let euler = Euler { yaw: 0.0, pitch: 0.2, roll: 0.0 };
    let pose = Isometry::from_euler(euler, DVec3::new(1.6, 0.1, 0.5));
    let count = camera.width() * camera.height();
    let gray = Raster::from_rgb(camera.width(), camera.height(), &vec![90; 3 * count], camera.shows()).expect("fits");
    let image = Pyramid::new(gray);
    let near = Isometry { translation: pose.translation + DVec3::new(0.05, 0.02, 0.0), ..pose };
    let (tag, vignetting, settings) = (TagError::default(), Vignetting::default(), ViewSettings::default());
    let source = Candidate { id: 0, camera: &camera, map_from_link: near, image: &image, tag, vignetting };
    let (method, world_of) = (Method::Exact, &world);
    let request = Request { camera: &camera, map_from_link: pose, method, world: world_of, vignetting, settings };
    let answer = view(&request, &[source]).expect("a view");
    use_it(&camera, &world, answer)
}

fn scene_on(field: &FieldDimensions, figures: &str) -> Scene {
    let effect = format!("kind = \"obstacles\"\nfigures = [{figures}]");
    let file = SceneFile::from_toml(&with_effects(&plain(STRAIGHT), &[&effect])).expect("readable");
    Scene::build(file, field.clone(), fisheye_640()).expect("possible")
}

#[test]
fn a_goal_of_the_view_hides_only_figures_behind_it() {
    let goal = Some(Goal { width_m: 1.5, height_m: 0.9, depth_m: 0.5, post_diameter_m: 0.1 });
    let dimensions = FieldDimensions { goal, ..kid_2009() };
    let field = Field::new(dimensions.clone()).expect("a field");
    let wall = |x: f64| {
        format!("{{ shape = \"box\", position_m = [{x}, 0.0], width_m = 0.6, height_m = 1.5, colour = [250, 0, 250] }}")
    };
    let violet = |x: f64| {
        let scene = scene_on(&dimensions, &wall(x));
        with_view(&field, |camera, world, mut answer| {
            let (width, pose) = (camera.width(), answer.map_from_link);
            let target = Target::new(camera, &pose, world);
            let bars: Vec<usize> = (0..answer.image.pixels.len())
                .filter(|i| target.surface(i % width, i / width) == Some(Surface::Goal))
                .collect();
            ViewOverlay::new(&scene, camera.lens(), true).apply(0, camera, world, &mut answer);
            let is_violet = |i: &&usize| answer.image.pixels[**i][1] < 30;
            (bars.iter().filter(is_violet).count(), bars.len(), answer)
        })
    };
    let (behind, bars, answer) = violet(3.5);
    let far = answer.image.pixels.iter().filter(|pixel| pixel[1] < 30 && pixel[3] == SURE).count();
    assert!(bars > 300 && far > 1000, "{bars} pixels of the goal, {far} of the box behind it");
    // Bars are taken to be wider by a soft edge: there what is behind shows through.
    assert!(behind * 2 < bars, "{behind} of {bars}");
    let (before, bars, _) = violet(2.4);
    assert!(before * 3 > bars, "{before} of {bars}");
}

#[test]
fn figures_are_drawn_or_left_out_and_only_upon_their_own_field() {
    let dimensions = kid_2009();
    let field = Field::new(dimensions.clone()).expect("a field");
    let scene =
        scene_on(&dimensions, "{ shape = \"robot\", position_m = [2.7, 0.1], height_m = 0.8, colour = [250, 0, 250] }");
    let lens = Lens::new(fisheye_640()).expect("good");
    let (drawn, omitted) = (ViewOverlay::new(&scene, &lens, true), ViewOverlay::new(&scene, &lens, false));
    assert_eq!((drawn.effects(), omitted.effects()), (vec!["obstacles"], vec![]));
    with_view(&field, |camera, world, answer| {
        let (mut with, mut without) = (answer.clone(), answer.clone());
        drawn.apply(0, camera, world, &mut with);
        omitted.apply(0, camera, world, &mut without);
        assert_eq!(without, answer);
        let changed = with.image.pixels.iter().zip(&answer.image.pixels).filter(|(a, b)| a != b).count();
        assert!(changed > 1000, "{changed}");
        assert!(with.sure_share > answer.sure_share, "a head above the horizon is known: {with:?}");
    });
    let other =
        Field::new(FieldDimensions { length_m: 9.0, title: "other".into(), ..dimensions.clone() }).expect("a field");
    let said = drawn.check(&other).expect_err("refused").to_string();
    assert!(
        said.contains("\"test\"") && said.contains("\"other\"") && said.contains("leave the figures out"),
        "{said}"
    );
    assert_eq!((omitted.check(&other), drawn.check(&field)), (Ok(()), Ok(())));
    let renamed = Field::new(FieldDimensions { title: "the same".into(), ..dimensions }).expect("a field");
    assert_eq!(drawn.check(&renamed), Ok(()), "titles are for people");
}
