//! A scene's robots, people and balls in served views.

use super::client::{get, get_with, parts, post};
use super::{PLACES, Served, add_images};
use crate::replay::support::Room;

const HERE: &str = "/v1/view?x=0.22&y=0.2&z=0.5&yaw_deg=11&pitch_deg=20";
const RAW: &str = "Accept: application/octet-stream\r\n";

fn served() -> Served {
    let room = Room::new();
    add_images(&room, "images", &PLACES);
    let with = |field: &str, figures: &str| {
        let (field, figures) = (field.to_owned(), figures.to_owned());
        move |text: String| {
            let plain = text.split("[[effect]]").next().expect("a scene").replace("kid-2009", &field);
            format!("{plain}[[effect]]\nkind = \"obstacles\"\n{figures}\n")
        }
    };
    room.write_scene(
        "match.toml",
        with("kid-2009", "figures = [{ shape = \"robot\", path = [[1.0, 0.8], [1.2, -0.4]], speed_m_s = 0.5 }]"),
    );
    room.write_scene("elsewhere.toml", with("spl-2020", "random = 4"));
    Served::of(room, "--scene match.toml --scene elsewhere.toml")
}

#[test]
fn figures_are_drawn_or_omitted_and_said() {
    let served = served();
    let of = |more: &str| get_with(served.address, &format!("{HERE}{more}"), RAW);
    let (plain, drawn, omitted) = (of(""), of("&scene=match"), of("&scene=match&figures=omit"));
    assert_eq!(drawn.header("realitysim-effects"), "obstacles");
    assert!(omitted.headers.iter().all(|(name, _)| name != "realitysim-effects"));
    assert_eq!(omitted.body, plain.body);
    let changed = drawn.body.chunks_exact(3).zip(plain.body.chunks_exact(3)).filter(|(a, b)| a != b).count();
    assert!(changed > 300, "{changed} pixels");
    assert_ne!(of("&scene=match&frame=20").body, drawn.body, "it walks");
    assert_eq!(of("&scene=match").body, drawn.body);
    assert_eq!(of("&scene=match&figures=maybe").status, 400);
    let refused = of("&scene=elsewhere");
    assert!(refused.status == 400 && refused.text().contains("leave the figures out"), "{}", refused.text());
    assert_eq!(of("&scene=elsewhere&figures=omit").status, 200);
    assert_eq!(get(served.address, "/v1/info").json()["scenes"]["match"], serde_json::json!(["obstacles"]));
}

#[test]
fn a_trajectory_is_a_walk_through_the_scene_s_frames() {
    let served = served();
    let pose = r#"{"x": 0.22, "y": 0.2, "z": 0.5, "yaw_deg": 11, "pitch_deg": 20}"#;
    let ask = |figures: &str| {
        let body = format!(
            r#"{{"from": {pose}, "to": {pose}, "count": 3, "scene": "match", "frame": 4, "figures": "{figures}"}}"#
        );
        let answer = post(served.address, "/v1/views", &body);
        parts(&answer).into_iter().map(|(_, body)| body).collect::<Vec<_>>()
    };
    let (walking, gone) = (ask("draw"), ask("omit"));
    assert!(walking.len() == 3 && walking[0] != walking[1] && walking[1] != walking[2], "every view has its own frame");
    assert!(gone[0] == gone[1] && gone[1] == gone[2]);
    let one = get(served.address, &format!("{HERE}&scene=match&frame=6"));
    assert_eq!(one.body, walking[2]);
}
