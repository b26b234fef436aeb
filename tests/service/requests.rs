//! What a client asks for is what it gets.

use std::fs;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::client::{get, get_with, parts, post};
use super::{Served, add_images};

const HERE: &str = "/v1/view?x=0.22&y=0.2&z=0.5&yaw_deg=11&pitch_deg=20";

#[test]
fn a_view_comes_in_the_form_that_is_accepted_and_says_how_it_was_made() {
    let served = Served::new("");
    for (accept, kind, magic) in [
        ("image/jpeg", "image/jpeg", &[0xff, 0xd8][..]),
        ("image/png", "image/png", b"\x89PNG"),
        ("application/octet-stream", "application/octet-stream", b""),
    ] {
        let answer = get_with(served.address, HERE, &format!("Accept: {accept}\r\n"));
        assert_eq!((answer.status, answer.header("content-type")), (200, kind), "{}", answer.text());
        assert!(answer.body.starts_with(magic));
        assert_eq!(answer.header("realitysim-made"), "composed");
        let sources: serde_json::Value = serde_json::from_str(answer.header("realitysim-sources")).expect("JSON");
        assert!(sources.as_array().is_some_and(|sources| sources.len() > 1), "{sources}");
        assert!((0.01..0.2).contains(&sources[0]["distance_m"].as_f64().expect("a distance")), "{sources}");
        let share: f64 = answer.header("realitysim-valid-share").parse().expect("a number");
        let error: f64 = answer.header("realitysim-expected-error-px").parse().expect("a number");
        assert!(share > 0.9 && (0.01..3.0).contains(&error), "{:?}", answer.headers);
        assert!(answer.header("server-timing").starts_with("view;dur="));
        if kind == "application/octet-stream" {
            assert_eq!(answer.body.len(), 320 * 240 * 3);
        }
    }
    let alpha = get_with(served.address, &format!("{HERE}&mask=alpha"), "Accept: application/octet-stream\r\n");
    let only = get_with(served.address, &format!("{HERE}&mask=only"), "Accept: application/octet-stream\r\n");
    assert_eq!((alpha.header("realitysim-channels"), only.header("realitysim-channels")), ("4", "1"));
    let fourth: Vec<u8> = alpha.body.iter().skip(3).step_by(4).copied().collect();
    assert_eq!(fourth, only.body);
    assert_eq!(get_with(served.address, &format!("{HERE}&mask=alpha"), "Accept: image/jpeg\r\n").status, 406);
}

#[test]
fn a_stored_image_is_served_byte_for_byte() {
    let served = Served::new("");
    let answer = get(served.address, "/v1/view?x=0.1&y=0.2&z=0.5&yaw_deg=10&pitch_deg=20");
    assert_eq!((answer.status, answer.header("realitysim-made")), (200, "stored"));
    assert_eq!(answer.body, fs::read(served.room.path("images/0.png")).expect("there"));
    let answer =
        get_with(served.address, "/v1/view?x=0.1&y=0.2&z=0.5&yaw_deg=10&pitch_deg=20", "Accept: image/jpeg\r\n");
    assert!(answer.body.starts_with(&[0xff, 0xd8]), "another form is made of it");
}

#[test]
fn size_lens_method_and_scene_are_as_asked() {
    let room = crate::replay::support::Room::new();
    add_images(&room, "images", &super::PLACES);
    room.write_scene("evening.toml", |text| {
        let plain = text.split("[[effect]]").next().expect("a scene").to_owned();
        plain + "[[effect]]\nkind = \"worn_lines\"\nshare = 0.5\npatch_m = 0.5\n[[effect]]\nkind = \"light\"\ngain = 0.5\n"
    });
    let served = Served::of(room, "--scene evening.toml");
    let raw = "Accept: application/octet-stream\r\n";
    let small = get_with(served.address, &format!("{HERE}&width=160"), raw);
    assert_eq!((small.header("realitysim-width"), small.header("realitysim-height")), ("160", "120"));
    assert_eq!(small.body.len(), 160 * 120 * 3);
    let both = get_with(served.address, &format!("{HERE}&width=100&height=120"), raw);
    assert_eq!(both.body.len(), 100 * 120 * 3);
    let lens = get_with(served.address, &format!("{HERE}&lens=wide-640"), raw);
    assert_eq!((lens.header("realitysim-width"), lens.header("realitysim-made")), ("640", "composed"));
    let nearest = get_with(served.address, &format!("{HERE}&method=nearest"), raw);
    assert_eq!(nearest.header("realitysim-made"), "nearest");
    let paper = get_with(served.address, &format!("{HERE}&method=paper"), raw);
    assert_eq!(paper.header("realitysim-made"), "warped");
    let (bright, dark) =
        (get_with(served.address, HERE, raw), get_with(served.address, &format!("{HERE}&scene=evening"), raw));
    assert_eq!(dark.header("realitysim-effects"), "light");
    let sum = |body: &[u8]| body.iter().map(|value| f64::from(*value)).sum::<f64>();
    let ratio = sum(&dark.body) / sum(&bright.body);
    assert!((0.47..0.53).contains(&ratio), "{ratio}");
}

#[test]
fn what_is_wrong_is_answered_with_what_would_be_right() {
    let mut served = Served::new("");
    for (path, status, words) in [
        ("/v1/view?x=0&y=0&z=0.5", 400, "yaw_deg is missing"),
        ("/v1/view?x=nan&y=0&z=0.5&yaw_deg=0", 400, "a number from -100 to 100 is needed"),
        ("/v1/view?x=0&y=0&z=50&yaw_deg=0", 400, "0.02 to 20"),
        ("/v1/view?x=0&y=0&z=0.5&yaw_deg=0&lens=/etc/passwd", 400, "there is equisolid-640"),
        ("/v1/view?x=0&y=0&z=0.5&yaw_deg=0&scene=../../etc/passwd", 400, "there is none"),
        ("/v1/view?x=0&y=0&z=0.5&yaw_deg=0&height=2048", 400, "at most 4194304 pixels"),
        ("/v1/view?x=9&y=9&z=0.5&yaw_deg=0", 404, "farther than the 1 m that are allowed"),
        ("/v1/coverage?cell_m=0.02&headings=360", 400, "at most 1000000 are counted"),
        ("/v1/coverage?cell=1", 400, "unknown: there are cell_m, headings"),
        ("/v1/info?x=1", 400, "x: unknown"),
        ("/v2", 404, "there are /v1/view"),
        ("/../../../etc/passwd", 404, "there is no such path"),
        ("/images/0.png", 404, "there is no such path"),
        ("/v1/views", 405, "POST"),
    ] {
        let answer = get(served.address, path);
        let problem = answer.json();
        let detail = problem["detail"].as_str().expect("words");
        assert!(answer.status == status && detail.contains(words), "{path}: {} {detail}", answer.status);
        assert_eq!((answer.header("content-type"), &problem["status"]), ("application/problem+json", &status.into()));
        let folder = served.room.path("").display().to_string();
        assert!(!answer.text().contains(&folder), "{path}: names a folder of this machine: {detail}");
    }
    let far = get(served.address, "/v1/view?x=3&y=0.2&z=0.5&yaw_deg=10&pitch_deg=20&outside=warn");
    assert_eq!(far.status, 200, "{}", far.text());
    assert!(far.header("realitysim-warning").contains("farther than 1 m"));
    assert!(served.is_running());
    assert_eq!(served.ended(), Some(0));
}

#[test]
fn a_batch_comes_in_its_order_and_one_wrong_pose_spoils_nothing() {
    let served = Served::new("");
    let body = r#"{"z": 0.5, "pitch_deg": 20, "poses": [{"x": 0.1, "y": 0.2, "yaw_deg": 10}, {"x": 50, "y": 0, "yaw_deg": 0},
        {"x": 0.22, "y": 0.2, "yaw_deg": 11}, {"x": 0.1}]}"#;
    let answer = post(served.address, "/v1/views", body);
    assert_eq!(answer.status, 200, "{}", answer.text());
    let parts = parts(&answer);
    let statuses: Vec<&str> = parts.iter().map(|(headers, _)| headers["realitysim-status"].as_str()).collect();
    assert_eq!(statuses, ["200", "404", "200", "400"]);
    assert_eq!(parts[0].1, fs::read(served.room.path("images/0.png")).expect("there"));
    assert!(String::from_utf8_lossy(&parts[1].1).contains("farther than"));
    assert_eq!(parts[2].0["realitysim-made"], "composed");
    assert!(String::from_utf8_lossy(&parts[3].1).contains("poses[3]: y is missing"));
}

#[test]
fn a_trajectory_is_a_view_for_each_of_its_poses() {
    let served = Served::new("");
    let body = r#"{"z": 0.5, "pitch_deg": 20, "width": 64, "from": {"x": 0.1, "y": 0.2, "yaw_deg": 10},
        "to": {"x": 0.3, "y": 0.2, "yaw_deg": 10}, "count": 9}"#;
    let answer = post(served.address, "/v1/views", body);
    let parts = parts(&answer);
    assert_eq!(parts.len(), 9);
    assert!(parts.iter().all(|(headers, _)| headers["realitysim-width"] == "64"), "{parts:?}");
    let refused = post(served.address, "/v1/views", r#"{"poses": "all"}"#);
    assert!(refused.status == 400 && refused.text().contains("either poses (a list)"));
    let long = format!("{{\"poses\": [{}]}}", " ".repeat(2 << 20));
    assert_eq!(post(served.address, "/v1/views", &long).status, 413);
}

#[test]
fn info_coverage_and_metrics_tell_of_the_database() {
    let served = Served::new("");
    let info = get(served.address, "/v1/info").json();
    assert_eq!((&info["images"], &info["sources"][0]["name"]), (&4.into(), &"images".into()));
    assert!(info["lenses"]["wide-640"]["width"] == 640 && info["field"]["length_m"].is_number(), "{info}");
    let coverage = get(served.address, "/v1/coverage?cell_m=0.5&headings=8").json();
    let counts = coverage["counts"].as_array().expect("counts");
    assert_eq!(counts.iter().map(|count| count.as_u64().unwrap_or(0)).sum::<u64>(), 4);
    assert_eq!(counts.len() as u64, coverage["cells"].as_u64().expect("cells"));
    let picture = get_with(served.address, "/v1/coverage", "Accept: image/png\r\n");
    assert!(image::load_from_memory(&picture.body).is_ok());
    get(served.address, HERE);
    get(served.address, "/v1/view");
    let metrics = get(served.address, "/metrics");
    for line in [
        "realitysim_images 4",
        "realitysim_requests_total{route=\"/v1/view\",status=\"200\"} 1",
        "realitysim_requests_total{route=\"/v1/view\",status=\"400\"} 1",
        "realitysim_view_seconds_count{made=\"composed\"} 1",
    ] {
        assert!(metrics.text().lines().any(|own| own == line), "{line}: {}", metrics.text());
    }
}

#[test]
fn images_that_are_added_while_it_serves_are_served() {
    let served = Served::new("");
    let there = "/v1/view?x=2&y=1&z=0.5&yaw_deg=0&pitch_deg=20";
    assert_eq!(get(served.address, there).status, 404);
    add_images(&served.room, "more", &[(2.0, 1.0, 0.0)]);
    let started = Instant::now();
    let answer = loop {
        let answer = get(served.address, there);
        if answer.status == 200 || started.elapsed() > Duration::from_secs(60) {
            break answer;
        }
        std::thread::sleep(Duration::from_millis(50));
    };
    assert_eq!((answer.status, answer.header("realitysim-made")), (200, "stored"));
    // A damaged database is not taken over.
    let (file, good) =
        (served.room.path("db/database.json"), fs::read(served.room.path("db/database.json")).expect("there"));
    fs::write(&file, b"{").expect("written");
    let damaged = || get(served.address, "/metrics").text().contains("realitysim_failed_reloads_total 0");
    while damaged() && started.elapsed() < Duration::from_secs(120) {
        std::thread::sleep(Duration::from_millis(50));
    }
    assert_eq!(get(served.address, there).status, 200, "the old one goes on");
    fs::write(&file, good).expect("written");
}

#[test]
fn views_are_whole_while_images_are_added_again_and_again() {
    let served = Served::new("");
    let is_over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let walker = scope.spawn(|| {
            let mut views = 0;
            while !is_over.load(Ordering::Relaxed) || views == 0 {
                let answer = get(served.address, HERE);
                assert_eq!(answer.status, 200, "{}", answer.text());
                image::load_from_memory(&answer.body).expect("a whole picture");
                views += 1;
            }
        });
        for round in 0..4 {
            add_images(&served.room, &format!("more{round}"), &[(0.2 + 0.01 * f64::from(round), 0.2, 10.0)]);
        }
        is_over.store(true, Ordering::Relaxed);
        walker.join().expect("every view was whole");
    });
}

#[test]
fn segments_that_vanish_cost_their_views_and_not_the_service() {
    let mut served = Served::new("");
    fs::remove_dir_all(served.room.path("images")).expect("removed");
    let answer = get(served.address, HERE);
    assert!(answer.status == 500 && answer.text().contains("vanished or changed"), "{}", answer.text());
    assert!(!answer.text().contains(&served.room.path("").display().to_string()));
    assert_eq!(get(served.address, "/v1/info").status, 200);
    assert!(served.is_running());
}

#[test]
fn an_empty_database_is_served_and_says_so() {
    let room = crate::replay::support::Room::new();
    add_images(&room, "images", &super::PLACES);
    room.run("db remove images --db db").succeeds();
    let served = Served::of(room, "");
    let answer = get(served.address, HERE);
    assert!(answer.status == 404 && answer.text().contains("the database has no image"), "{}", answer.text());
    assert_eq!(get(served.address, &format!("{HERE}&width=64")).status, 404);
}

#[test]
fn only_one_at_a_time_changes_a_database() {
    let room = crate::replay::support::Room::new();
    add_images(&room, "images", &super::PLACES);
    let lock = fs::File::create(room.path("db/database.lock")).expect("a file");
    lock.lock().expect("locked");
    room.run("db remove images --db db").fails(1, &["another process is changing this database"]);
    lock.unlock().expect("free");
    room.run("db remove images --db db").succeeds();
}

#[test]
fn a_lens_that_sees_nothing_of_the_ground_gets_a_clear_answer() {
    let room = crate::replay::support::Room::new();
    add_images(&room, "images", &super::PLACES);
    let narrow = "title = \"narrow\"\nwidth = 160\nheight = 120\nfx = 300.0\nfy = 300.0\ncx = 79.5\ncy = 59.5\nmodel = \"plumb_bob\"\n\
                  d = [0.0, 0.0, 0.0, 0.0, 0.0]\n";
    room.write("narrow.toml", narrow);
    let mut served = Served::of(room, "--lens narrow=narrow.toml");
    // The images look 20 degrees down with 80 degrees to each side: straight up there is nothing, a little up the far wall.
    let up = "/v1/view?x=0.22&y=0.2&z=0.5&yaw_deg=11&lens=narrow";
    let paper = get(served.address, &format!("{up}&pitch_deg=-40&method=paper"));
    assert!(paper.status == 404 && paper.text().contains("the quadratic map cannot be fitted"), "{}", paper.text());
    let wall = get(served.address, &format!("{up}&pitch_deg=-25"));
    assert_eq!((wall.status, wall.header("realitysim-sure-share")), (200, "0.0000"), "{}", wall.text());
    let nothing = get(served.address, &format!("{up}&pitch_deg=-90&roll_deg=180"));
    let told = nothing.status == 404 && nothing.text().contains("no image shows anything of this view");
    assert!(told || nothing.status == 200, "{}", nothing.text());
    assert!(served.is_running());
}

/// One default and the same bounds: what the one refuses the other does not show.
#[test]
fn the_command_line_refuses_the_poses_that_the_service_refuses() {
    let served = Served::new("");
    let pose = |x: &str, z: &str, yaw: &str| {
        let asked = get(served.address, &format!("/v1/view?x={x}&y=0.2&z={z}&yaw_deg={yaw}&pitch_deg=20"));
        let shown =
            served.room.run(&format!("view --db db --x {x} --y 0.2 --z {z} --yaw {yaw} --pitch 20 -o view.png"));
        (asked, shown)
    };
    for (x, z, yaw, status, code, words) in [
        ("99", "0.5", "10", 404, 1, "m away, farther than the 1 m that are allowed"),
        ("2", "0.5", "10", 404, 1, "m away, farther than the 1 m that are allowed"),
        ("101", "0.5", "10", 400, 2, "a number from -100 to 100 is needed"),
        ("0.2", "0.01", "10", 400, 2, "a number from 0.02 to 20 is needed"),
        ("0.2", "0.5", "3601", 400, 2, "a number from -3600 to 3600 is needed"),
    ] {
        let (asked, shown) = pose(x, z, yaw);
        assert!(asked.status == status && asked.text().contains(words), "{x}, {z}, {yaw}: {}", asked.text());
        shown.fails(code, &[words]);
    }
    assert!(!served.room.path("view.png").exists());
    let (asked, shown) = pose("0.22", "0.5", "11");
    assert_eq!(asked.status, 200);
    shown.succeeds();
    // Asked for all the same, it says that nothing is known of how wrong it is.
    let far = "view --db db --x 99 --y 0.2 --z 0.5 --yaw 10 --pitch 0 -o view.png --outside warn";
    let shown = served.room.run(far).succeeds();
    assert!(shown.stdout.contains("no known geometry: nothing can be said of its error"), "{shown:?}");
    assert!(shown.stderr.contains("m away, farther than 1 m"), "{shown:?}");
    assert!(served.room.run(&format!("{far} --json")).json()["expected_error_px"].is_null());
}
