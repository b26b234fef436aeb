//! Robots, people and balls: those of a recording are left out of its views, those of a scene are drawn into them.

use realitysim::config::Settings;
use realitysim::database::{ImageDatabase, ViewQuery};
use realitysim::views::{Method, UNSURE};

use super::support::{Room, session_name};

const CROWD: &str = "[[effect]]\nkind = \"obstacles\"\nfigures = [\n{ shape = \"robot\", position_m = [-0.9, -0.2] },\n\
    { shape = \"ball\", position_m = [-1.0, 0.4], colour = [214, 96, 30] }]\n";

#[test]
fn what_stands_in_a_recorded_image_is_marked_unless_the_config_says_no() {
    let room = Room::new();
    room.write_scene("scene.toml", |text| text.split("[[effect]]").next().expect("a scene").to_owned() + CROWD);
    room.run("scene render scene.toml -o log.mcap").succeeds();
    let session = session_name(&room.replay("log.mcap"));
    room.run(&format!("db add {session} --db db")).succeeds();
    let mut settings = Settings::default().views;
    let seen = |settings: &realitysim::config::ViewsSettings| {
        let database = ImageDatabase::open(&room.path("db"), settings).expect("a database");
        let pose = database.index().record(3).pose();
        let (method, camera, max_distance_m) = (Method::Exact, None, f64::INFINITY);
        let asked =
            ViewQuery { map_from_link: pose, method, camera, max_distance_m, may_be_stored: true, without: Vec::new() };
        let stored = database.view(&asked).expect("a view");
        let marked = stored.answer.image.pixels.iter().filter(|pixel| pixel[3] == UNSURE).count();
        (marked, stored.stored.is_some(), stored.answer.sure_share)
    };
    let (marked, stored, masked_share) = seen(&settings);
    assert!(marked > 300 && stored, "{marked} pixels");
    settings.mask_moving = false;
    let (marked, stored, share) = seen(&settings);
    assert!(marked == 0 && stored && share > masked_share, "{marked} pixels, {share} and {masked_share}");
}

#[test]
fn a_scene_s_figures_are_drawn_into_a_view_or_left_out() {
    let (room, _) = super::database::walked();
    room.write_scene("crowd.toml", |text| {
        let plain = text.split("[[effect]]").next().expect("a scene").to_owned();
        plain + "[[effect]]\nkind = \"obstacles\"\nfigures = [{ shape = \"robot\", position_m = [-0.6, 0.35], colour = [250, 0, 250] }]\n"
    });
    let here = "view --db db --x -1.5 --y 0.25 --z 0.5 --yaw 14 --pitch 17";
    room.run(&format!("{here} -o plain.png")).succeeds();
    let run = room.run(&format!("{here} --scene crowd.toml -o drawn.png --mask mask.png --json")).succeeds();
    assert_eq!(run.json()["effects"], serde_json::json!(["obstacles"]));
    let run = room.run(&format!("{here} --scene crowd.toml --figures omit -o omitted.png --json")).succeeds();
    assert_eq!(run.json()["effects"], serde_json::json!([]));
    let picture = |name: &str| image::open(room.path(name)).expect("a picture").to_rgb8();
    let (plain, drawn) = (picture("plain.png"), picture("drawn.png"));
    assert_eq!(picture("omitted.png"), plain);
    let violet: Vec<(u32, u32)> = drawn
        .enumerate_pixels()
        .filter(|(.., pixel)| pixel.0[0] > 120 && pixel.0[1] < 40)
        .map(|(u, v, _)| (u, v))
        .collect();
    assert!(violet.len() > 100, "{} pixels", violet.len());
    let mask = picture("mask.png");
    assert!(violet.iter().filter(|(u, v)| mask.get_pixel(*u, *v).0[0] == 255).count() * 10 > violet.len() * 9);
    // A stored image is one no longer when somebody stands in it, and of another method too.
    for method in ["nearest", "paper"] {
        room.run(&format!("{here} --method {method} --scene crowd.toml -o other.png")).succeeds();
        let count = picture("other.png").pixels().filter(|pixel| pixel.0[0] > 120 && pixel.0[1] < 40).count();
        assert!(count > 100, "{method}: {count}");
    }
    room.run(&format!("{here} --method nearest --width 160 --scene crowd.toml -o small.png")).succeeds();
    room.write_scene("elsewhere.toml", |text| {
        let plain = text.split("[[effect]]").next().expect("a scene").replace("kid-2009", "spl-2020");
        plain + "[[effect]]\nkind = \"obstacles\"\nrandom = 3\n"
    });
    room.run(&format!("{here} --scene elsewhere.toml -o x.png")).fails(1, &["leave the figures out"]);
    room.run(&format!("{here} --scene elsewhere.toml --figures omit -o x.png")).succeeds();
}
