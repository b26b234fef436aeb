//! Goals stand where they should.

use realitysim::evaluation::views::TruthRenderer;
use realitysim::views::{Camera, NOTHING, Pyramid, Surface, Target, World, similarity, view};

use super::{candidate, field, lens, pose, request};

#[test]
fn posts_and_crossbar_are_drawn_where_they_stand() {
    let (field, lens) = (field(), lens());
    let (camera, lawn) = (Camera::new(&lens), TruthRenderer::new(&field, &lens, true));
    let wanted = pose(1.4, 0.1, 5.0);
    let (truth, _) = lawn.render(&wanted);
    let places = [pose(1.25, -0.15, 0.0), pose(1.3, 0.35, 8.0)];
    let images = places.map(|place| Pyramid::new(lawn.render(&place).0));
    let sources: Vec<_> = places.iter().zip(&images).map(|(place, image)| candidate(&camera, *place, image)).collect();
    let world = World::new(&field);
    let target = Target::new(&camera, &wanted, &world);
    let on_goal: Vec<bool> = (0..320 * 240).map(|i| target.surface(i % 320, i / 320) == Some(Surface::Goal)).collect();
    let pixels = on_goal.iter().filter(|on| **on).count();
    assert!(pixels > 500, "{pixels} pixels of a goal");
    let score = |world: &World| {
        let answer = view(&request(&camera, wanted, world), &sources).expect("a view");
        let shown: Vec<bool> = answer.image.pixels.iter().map(|pixel| pixel[3] != NOTHING).collect();
        similarity(&truth.pixels, &answer.image.pixels, 320, &on_goal, &shown)
    };
    let (with, without) = (score(&world), score(&World::without_goals(&field)));
    println!("with goals {with:?}, without {without:?}");
    assert!(with.psnr_db > without.psnr_db + 6.0 && with.psnr_db > 20.0, "{with:?} {without:?}");
    assert!(with.compared > 0.97, "{with:?}");
}
