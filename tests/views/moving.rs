//! What stands in a source's way is found, and shown from another source or said to be unsure.

use realitysim::config::load_field;
use realitysim::geometry::Isometry;
use realitysim::scene::{Renderer, Scene, SceneFile};
use realitysim::views::{
    BlockImage, Camera, Candidate, Figures, Hall, NOTHING, Pyramid, Raster, SURE, Scenery, Surface, TagError, Target,
    UNSURE, World, mark_moving, moved_blocks, similarity, view,
};

use super::{candidate, field, lens, pose, request};

const STRAIGHT: &str = include_str!("../../replay/scenes/straight.toml");

/// Of the straight walk, with these figures.
pub fn hall(obstacles: &str) -> Renderer {
    let plain = STRAIGHT.split("[[effect]]").next().expect("a scene").replace("kid-2013", "kid-2009");
    let effect =
        if obstacles.is_empty() { String::new() } else { format!("[[effect]]\nkind = \"obstacles\"\n{obstacles}\n") };
    let file = SceneFile::from_toml(&(plain + &effect)).expect("a scene");
    let dimensions = load_field("kid-2009").expect("shipped");
    Renderer::new(&Scene::build(file, dimensions, lens().parameters().clone()).expect("a scene"))
}

pub fn picture(hall: &Renderer, camera: &Camera, pose: &Isometry, frame: u64) -> Raster {
    let mut rgb = Vec::new();
    hall.render_from(pose, frame, &mut rgb);
    Raster::from_rgb(camera.width(), camera.height(), &rgb, camera.shows()).expect("fits")
}

fn mark(raster: &mut Raster, camera: &Camera, map_from_link: Isometry) -> Figures {
    let (field, tag) = (field(), TagError::default());
    let world = World::without_goals(&field);
    mark_moving(raster, &Scenery { camera, map_from_link, tag, field: &field, world: &world, moved: None })
}

fn ground(camera: &Camera, pose: &Isometry) -> Vec<bool> {
    let (field, width) = (field(), camera.width());
    let world = World::without_goals(&field);
    let target = Target::new(camera, pose, &world);
    (0..width * camera.height()).map(|i| target.surface(i % width, i / width) == Some(Surface::Ground)).collect()
}

struct Composed {
    /// Against the empty hall, on all ground that is shown.
    psnr_db: f64,
    image: Raster,
    sure_share: f64,
}

/// From sources of these halls at these frames, with what moves marked or not.
fn composed(sources: &[(&Renderer, Isometry, u64)], wanted: &Isometry, marked: bool) -> Composed {
    let (field, camera) = (field(), Camera::new(&lens()));
    let images: Vec<Pyramid> = sources
        .iter()
        .map(|(hall, pose, frame)| {
            let mut raster = picture(hall, &camera, pose, *frame);
            let figures = if marked { mark(&mut raster, &camera, *pose) } else { Figures::default() };
            Pyramid::with_figures(raster, figures)
        })
        .collect();
    let candidates: Vec<Candidate> =
        sources.iter().zip(&images).map(|((_, pose, _), image)| candidate(&camera, *pose, image)).collect();
    let world = World::without_goals(&field);
    let answer = view(&request(&camera, *wanted, &world), &candidates).expect("a view");
    let truth = picture(&hall(""), &camera, wanted, 0);
    let shown: Vec<bool> = answer.image.pixels.iter().map(|pixel| pixel[3] != NOTHING).collect();
    let similarity = similarity(&truth.pixels, &answer.image.pixels, camera.width(), &ground(&camera, wanted), &shown);
    Composed { psnr_db: similarity.psnr_db, sure_share: answer.sure_share, image: answer.image }
}

const ROBOT: &str =
    "figures = [{ shape = \"robot\", position_m = [0.9, 0.1], colour = [210, 210, 212], accent = [172, 44, 44] }]";

#[test]
fn a_robot_in_one_source_is_shown_from_the_other() {
    let (crowded, empty) = (hall(ROBOT), hall(""));
    let wanted = pose(0.0, 0.0, 5.0);
    let sources = [(&crowded, pose(0.05, 0.02, 8.0), 0), (&empty, pose(-0.12, 0.1, 0.0), 0)];
    let (with, without) = (composed(&sources, &wanted, true), composed(&sources, &wanted, false));
    println!("marked {:.2} dB, not {:.2} dB", with.psnr_db, without.psnr_db);
    assert!(with.psnr_db > without.psnr_db + 8.0, "{} against {}", with.psnr_db, without.psnr_db);
    let unsure = |shown: &Composed| {
        let ground = ground(&Camera::new(&lens()), &wanted);
        shown.image.pixels.iter().zip(ground).filter(|(pixel, ground)| *ground && pixel[3] != SURE).count()
    };
    assert!(unsure(&with) < 150, "the other source shows the place: {}", unsure(&with));
}

#[test]
fn where_every_source_has_the_robot_it_is_shown_and_said_to_be_unsure() {
    let crowded = hall(ROBOT);
    let wanted = pose(0.0, 0.0, 5.0);
    let sources = [(&crowded, pose(0.05, 0.02, 8.0), 0), (&crowded, pose(-0.12, 0.1, 0.0), 0)];
    let (with, without) = (composed(&sources, &wanted, true), composed(&sources, &wanted, false));
    assert!(with.sure_share < without.sure_share - 0.01, "{} {}", with.sure_share, without.sure_share);
    let black = |shown: &Composed| shown.image.pixels.iter().filter(|pixel| pixel[3] == NOTHING).count();
    assert!(black(&with) <= black(&without) + 20, "{} {}", black(&with), black(&without));
}

/// Pixels at which two pictures differ by more than noise.
fn differences(a: &Raster, b: &Raster) -> Vec<bool> {
    let differ = |(a, b): (&[u8; 4], &[u8; 4])| (0..3).any(|c| a[c].abs_diff(b[c]) > 30);
    a.pixels.iter().zip(&b.pixels).map(differ).collect()
}

/// A figure that the view shows is as a camera would have seen it, above the carpet's end as well; or nothing of it is there.
#[test]
fn a_figure_is_in_a_view_whole_or_not_at_all() {
    let (crowded, empty) = (hall(ROBOT), hall(""));
    let camera = Camera::new(&lens());
    for (x, y, yaw) in [(0.0, 0.0, 5.0), (-0.3, -0.4, 20.0), (-0.6, 0.2, -5.0), (0.3, -0.5, 40.0)] {
        let wanted = pose(x, y, yaw);
        let around = [(0.05, 0.02), (-0.06, 0.03), (0.02, -0.05), (-0.03, -0.04)];
        let sources = around.map(|(dx, dy)| (&crowded, pose(x + dx, y + dy, yaw + 30.0 * dx), 0));
        let shown = composed(&sources, &wanted, true).image;
        let (with, without) = (picture(&crowded, &camera, &wanted, 0), picture(&empty, &camera, &wanted, 0));
        let figure = differences(&with, &without);
        let is_nearer = |i: &usize| {
            let off =
                |to: &Raster| (0..3).map(|c| u32::from(shown.pixels[*i][c].abs_diff(to.pixels[*i][c]))).sum::<u32>();
            off(&with) < off(&without)
        };
        let pixels: Vec<usize> = (0..figure.len()).filter(|i| figure[*i]).collect();
        let share = pixels.iter().filter(|i| is_nearer(i)).count() as f64 / pixels.len() as f64;
        println!("({x}, {y}, {yaw}): {:.0} % of {} pixels", 100.0 * share, pixels.len());
        assert!(pixels.len() > 300 && !(0.1..0.9).contains(&share), "({x}, {y}, {yaw}): {share}");
    }
}

const PEOPLE: &str = "figures = [{ shape = \"person\", position_m = [2.2, 0.3], colour = [60, 70, 160] }, \
    { shape = \"person\", position_m = [3.9, -1.2], colour = [150, 40, 40] }]";

/// The rendered hall, 6 m beyond the carpet.
const TRUE_HALL: Hall =
    Hall { yaw_rad: 0.0, walls_m: [Some(9.7), Some(8.7), Some(9.7), Some(8.7)], ceiling_m: Some(6.5) };

/// The blocks that other images of a walk past them tell to stand before the hall.
fn moved(hall: &Renderer, camera: &Camera, own: &Isometry) -> (Raster, Vec<bool>) {
    let world = World::without_goals(&field()).with_hall(TRUE_HALL);
    let steps = [-0.9, -0.6, -0.35, 0.35, 0.6, 0.9, 1.2];
    let poses = steps.map(|y: f64| pose(0.3 * y, y, 2.0 * y));
    let pictures: Vec<Raster> = poses.iter().map(|pose| picture(hall, camera, pose, 0)).collect();
    let others: Vec<BlockImage> =
        poses.iter().zip(&pictures).map(|(pose, picture)| BlockImage::new(camera, pose, picture)).collect();
    let raster = picture(hall, camera, own, 0);
    let blocks = moved_blocks(&BlockImage::new(camera, own, &raster), &others.iter().collect::<Vec<_>>(), &world);
    (raster, blocks.expect("the hall is known"))
}

#[test]
fn people_are_masked_above_the_carpet_s_end_and_around_it() {
    let (camera, own) = (Camera::new(&lens()), pose(0.0, 0.0, 0.0));
    let (crowded, empty) = (hall(PEOPLE), hall(""));
    let (mut raster, blocks) = moved(&crowded, &camera, &own);
    let plain = picture(&empty, &camera, &own, 0);
    let people = differences(&raster, &plain);
    let (field, tag) = (field(), TagError::default());
    let world = World::without_goals(&field);
    let scenery = |moved| Scenery { camera: &camera, map_from_link: own, tag, field: &field, world: &world, moved };
    let mut alone = raster.clone();
    mark_moving(&mut raster, &scenery(Some(blocks.as_slice())));
    mark_moving(&mut alone, &scenery(None));
    let hidden = |raster: &Raster| {
        let masked = raster.pixels.iter().zip(&people).filter(|(pixel, person)| **person && pixel[3] == UNSURE).count();
        masked as f64 / people.iter().filter(|person| **person).count() as f64
    };
    println!("masked: {:.2}, by the carpet alone {:.2}", hidden(&raster), hidden(&alone));
    assert!(hidden(&raster) > 0.9 && hidden(&raster) > hidden(&alone) + 0.1);
    let (mut nobody, blocks) = moved(&empty, &camera, &own);
    mark_moving(&mut nobody, &scenery(Some(blocks.as_slice())));
    let wrong = nobody.pixels.iter().filter(|pixel| pixel[3] == UNSURE).count();
    assert!(wrong < 100, "{wrong} pixels of an empty hall");
}

#[test]
fn views_of_a_crowded_field_come_nearer_to_the_empty_one() {
    let crowd = hall("random = 14");
    let (mut gains, mut better) = (Vec::new(), 0);
    for (number, (x, y, yaw)) in
        [(-1.0, 0.3, 20.0), (0.4, -0.6, 110.0), (1.2, 0.5, -140.0), (-0.3, 0.9, -60.0)].into_iter().enumerate()
    {
        let wanted = pose(x, y, yaw);
        let frame = |step: u64| 60 * number as u64 + 90 * step;
        let around = [(0.15, 0.05), (-0.1, 0.12), (0.02, -0.16), (-0.14, -0.08)];
        let sources: Vec<_> = around
            .iter()
            .zip(0..)
            .map(|((dx, dy), step)| (&crowd, pose(x + dx, y + dy, yaw + 6.0 * dx * 10.0), frame(step)))
            .collect();
        let (with, without) = (composed(&sources, &wanted, true), composed(&sources, &wanted, false));
        println!("({x}, {y}, {yaw}): marked {:.2} dB, not {:.2} dB", with.psnr_db, without.psnr_db);
        gains.push(with.psnr_db - without.psnr_db);
        better += usize::from(with.psnr_db > without.psnr_db);
    }
    let mean = gains.iter().sum::<f64>() / gains.len() as f64;
    assert!(mean > 2.0 && better >= 3, "{gains:?}");
}

#[test]
fn nothing_is_found_on_an_empty_field_and_a_ball_on_the_line_is() {
    let (camera, empty) = (Camera::new(&lens()), hall(""));
    for place in [pose(0.0, 0.0, 5.0), pose(-2.0, 1.0, 80.0), pose(2.4, -1.4, 200.0), pose(1.0, 1.2, -100.0)] {
        let mut raster = picture(&empty, &camera, &place, 0);
        mark(&mut raster, &camera, place);
        let marked = raster.pixels.iter().filter(|pixel| pixel[3] == UNSURE).count();
        assert!(marked < 100, "{marked} pixels of {place:?}");
    }
    // Orange, a metre ahead.
    let ball = hall("figures = [{ shape = \"ball\", position_m = [1.0, 0.05], colour = [214, 96, 30] }]");
    let place = pose(0.0, 0.0, 0.0);
    let mut raster = picture(&ball, &camera, &place, 0);
    assert!(!mark(&mut raster, &camera, place).is_empty());
    let plain = picture(&empty, &camera, &place, 0);
    let (mut hidden, mut shown) = (0, 0);
    for (a, b) in raster.pixels.iter().zip(&plain.pixels) {
        if a[0].abs_diff(b[0]) > 40 {
            hidden += usize::from(a[3] == UNSURE);
            shown += usize::from(a[3] == SURE);
        }
    }
    assert!(hidden > 40 && shown * 20 < hidden, "{hidden} hidden, {shown} not");
}

#[test]
fn what_nobody_can_tell_is_left_alone() {
    let camera = Camera::new(&lens());
    let count = camera.width() * camera.height();
    // Gray all over, black, noise: there is no carpet to be seen.
    let noise: Vec<u8> = (0..3 * count as u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    for rgb in [vec![120; 3 * count], vec![0; 3 * count], noise] {
        let mut raster = Raster::from_rgb(camera.width(), camera.height(), &rgb, camera.shows()).expect("fits");
        for place in [pose(0.0, 0.0, 5.0), pose(80.0, 0.0, 5.0)] {
            mark(&mut raster, &camera, place);
            let marked = raster.pixels.iter().filter(|pixel| pixel[3] == UNSURE).count();
            assert!(marked * 3 < count, "{marked} of {count}");
        }
    }
}
