//! The page that people look at, and what it asks of captures.

use std::fs;
use std::process::{Command, Stdio};

use realitysim::ros2::messages::{CompressedImage, DiagnosticArray, DiagnosticStatus, FrameTag, Header};

use super::client::{get, get_with, post};
use super::{Served, add_images, with_captures};
use crate::replay::support::{
    IMAGE, Room, TAG, changed, decode_all, message, own_log, read_capture, session_name, walk,
};

const TOKEN: &str = "sixteen-letters-or-more";

#[test]
fn the_page_is_whole_and_loads_nothing_from_elsewhere() {
    let served = Served::new("");
    let document = get(served.address, "/");
    assert_eq!((document.status, document.header("content-type")), (200, "text/html; charset=utf-8"));
    let policy = document.header("content-security-policy");
    assert!(
        policy.contains("default-src 'none'") && !policy.contains("unsafe") && !policy.contains("http"),
        "{policy}"
    );
    let text = document.text();
    let named: Vec<&str> = text.split('"').filter(|part| part.starts_with("/page/")).collect();
    assert!(named.len() > 2, "{named:?}");
    for path in named.into_iter().chain(["/page/walk.js", "/page/captures.js", "/page/link.js"]) {
        let file = get(served.address, path);
        assert_eq!((file.status, file.header("x-content-type-options")), (200, "nosniff"), "{path}");
        assert!(file.body.len() > 100, "{path}");
    }
    assert_eq!(get(served.address, "/page/../openapi.rs").status, 404);
    assert_eq!(post(served.address, "/", "{}").status, 405);
    let foreign = get_with(served.address, "/", "Sec-Fetch-Site: cross-site\r\n");
    assert_eq!(foreign.status, 403, "a page of another site frames or scripts it");
}

#[test]
fn with_a_token_the_page_is_open_and_what_it_shows_is_not() {
    let room = Room::new();
    room.write("token", TOKEN);
    add_images(&room, "images", &super::PLACES);
    fs::create_dir(room.path("captures")).expect("a folder");
    let served = Served::of(room, "--token-file token --captures captures");
    assert_eq!(get(served.address, "/").status, 200);
    assert_eq!(get(served.address, "/page/main.js").status, 200);
    for path in ["/v1/captures", "/v1/info", "/v1/capture?capture=x", "/v1/frame?capture=x&frame=0"] {
        assert_eq!(get(served.address, path).status, 401, "{path}");
    }
    let with_token = get_with(served.address, "/v1/captures", &format!("Authorization: Bearer {TOKEN}\r\n"));
    assert_eq!((with_token.status, with_token.json()["sessions"].as_array().map(Vec::len)), (200, Some(0)));
}

#[test]
fn captures_are_listed_with_tags_frames_lines_and_reasons() {
    let (served, name) = with_captures();
    let list = get(served.address, "/v1/captures").json();
    let frames = walk().frames();
    assert_eq!((list["shown"].as_bool(), list["sessions"][0]["name"].as_str()), (Some(true), Some(name.as_str())));
    assert_eq!(list["sessions"][0]["tagged"].as_u64(), Some(frames as u64));
    let capture = get(served.address, &format!("/v1/capture?capture={name}")).json();
    for column in ["t_s", "valid", "x", "y", "yaw_deg", "sigma_m", "fitting", "image"] {
        assert_eq!(capture[column].as_array().map(Vec::len), Some(frames), "{column}");
    }
    assert!(capture["image"].as_array().expect("a column").iter().all(|there| there == 1));
    let images: Vec<CompressedImage> = decode_all(&walk().messages, IMAGE);
    for (frame, (image, tag)) in images.iter().zip(&walk().tags).enumerate().step_by(5) {
        let query = format!("capture={name}&frame={frame}");
        let shown = get(served.address, &format!("/v1/frame?{query}"));
        assert!(shown.status == 200 && shown.body == image.data, "frame {frame}");
        let told = get(served.address, &format!("/v1/tag?{query}")).json();
        assert_eq!(told["tag"]["sequence"].as_u64(), Some(tag.sequence));
        assert_eq!(told["tag"]["pose"]["pose"]["position"]["x"].as_f64(), Some(tag.pose.pose.position.x));
        assert!(told["lines"].as_array().is_some_and(|lines| lines.len() > 3), "frame {frame}");
    }
    let explained = get(served.address, &format!("/v1/explain?capture={name}&frame=4")).json();
    let expected = walk().tags[4].lines_expected;
    assert_eq!((explained["seen"].as_bool(), explained["expected"].as_u64()), (Some(true), Some(u64::from(expected))));
    assert!(explained["found"].as_array().is_some_and(|found| found.len() > 20), "{explained}");
}

#[test]
fn a_piece_of_a_capture_replays_to_the_tags_of_the_capture() {
    let (served, name) = with_captures();
    let piece = get(served.address, &format!("/v1/piece?capture={name}&frame=20&seconds=1"));
    assert_eq!((piece.status, piece.header("content-type")), (200, "application/octet-stream"), "{}", piece.text());
    served.room.write("piece.mcap", &piece.body);
    let replayed = served.room.replay("piece.mcap");
    let tags = &walk().tags;
    assert!(replayed.tags.iter().any(|tag| tag.header.stamp == tags[20].header.stamp), "the frame is in it");
    for tag in &replayed.tags {
        let recorded = tags.iter().find(|recorded| recorded.header.stamp == tag.header.stamp).expect("a frame of it");
        assert_eq!(tag.pose.pose, recorded.pose.pose);
    }
    assert!(replayed.tags.len() < tags.len(), "{} frames", replayed.tags.len());
}

#[test]
fn marks_gaps_and_bad_minutes_of_a_capture_are_told() {
    let room = Room::with_walk();
    let replayed = room.replay("log.mcap");
    let name = session_name(&replayed).rsplit('/').next().expect("a name").to_owned();
    let half = walk().frames() as u64 / 2;
    let mut messages = changed(&read_capture(&replayed.session), TAG, |tag: &mut FrameTag| {
        if tag.sequence > half {
            (tag.valid, tag.reason) = (false, "few_lines".to_owned());
        }
    });
    let time_ns = messages.last().expect("messages").log_time_ns;
    for (about, said) in [("mark", "goal kick"), ("gap", "7 frames were not recorded"), ("camera", "unplugged")] {
        let name = format!("realitysim: {about}");
        let status = DiagnosticStatus { name, message: said.to_owned(), ..DiagnosticStatus::default() };
        let report = DiagnosticArray { header: Header::default(), status: vec![status] };
        messages.push(message(200, "/diagnostics", time_ns, &report));
    }
    fs::write(replayed.session.join("0000.mcap"), own_log(&messages)).expect("written");
    add_images(&room, "images", &super::PLACES);
    let served = Served::of(room, "--captures captures");
    let capture = get(served.address, &format!("/v1/capture?capture={name}")).json();
    assert_eq!(
        (capture["marks"][0]["what"].as_str(), capture["marks"].as_array().map(Vec::len)),
        (Some("goal kick"), Some(1))
    );
    assert_eq!(capture["gaps"][0]["what"], "7 frames were not recorded");
    assert!(
        capture["bad"][0]["valid_share"].as_f64().is_some_and(|share| (0.3..0.7).contains(&share)),
        "{}",
        capture["bad"]
    );
    let reason = capture["reason"].as_array().and_then(|column| column.last()).and_then(|last| last.as_u64());
    assert_eq!(capture["reasons"][reason.expect("a reason") as usize], "few_lines");
}

#[test]
fn no_name_of_a_client_leads_out_of_the_captures() {
    let (served, name) = with_captures();
    fs::create_dir_all(served.room.path("other")).expect("a folder");
    fs::rename(served.room.path(&format!("captures/{name}")), served.room.path(&format!("other/{name}")))
        .expect("moved");
    std::os::unix::fs::symlink(served.room.path(&format!("other/{name}")), served.room.path("captures/link"))
        .expect("a link");
    let absolute = served.room.path(&format!("other/{name}")).display().to_string();
    for wanted in ["..", ".", "", "link", &name, &format!("../other/{name}"), &absolute, "..%2Fother", "%00"] {
        for path in
            ["/v1/capture?", "/v1/frame?frame=0&", "/v1/tag?frame=0&", "/v1/explain?frame=0&", "/v1/piece?frame=0&"]
        {
            let answer = get(served.address, &format!("{path}capture={wanted}"));
            assert_eq!(answer.status, 404, "{path}{wanted}: {}", answer.text());
            assert!(!answer.text().contains(&*served.room.path("").to_string_lossy()), "{}", answer.text());
        }
    }
    let aside = get(served.address, "/v1/captures").json();
    assert_eq!(aside["set_aside"][0]["name"], "link", "{aside}");
}

#[test]
fn what_is_wrong_or_gone_is_said() {
    let (served, name) = with_captures();
    for (path, status, words) in [
        (format!("/v1/capture?name={name}"), 400, "name: unknown: there are capture"),
        ("/v1/capture".to_owned(), 400, "capture is missing"),
        (format!("/v1/frame?capture={name}"), 400, "frame is missing"),
        (format!("/v1/frame?capture={name}&frame=-1"), 400, "a whole number from 0"),
        (format!("/v1/frame?capture={name}&frame=9999"), 404, "there is no frame 9999: they are 0 to"),
        (format!("/v1/explain?capture={name}&frame=9999"), 404, "there is no frame 9999"),
        (format!("/v1/piece?capture={name}&frame=4&seconds=61"), 400, "a whole number from 1 to 60"),
        (format!("/v1/piece?capture={name}&frame=9999"), 404, "there is no frame 9999"),
        ("/v1/captures?x=1".to_owned(), 400, "unknown"),
    ] {
        let answer = get(served.address, &path);
        assert!(
            answer.status == status && answer.text().contains(words),
            "{path}: {} {}",
            answer.status,
            answer.text()
        );
    }
    // The capture is read, and then its segment is cut short.
    let first = format!("/v1/frame?capture={name}&frame=12");
    assert_eq!(get(served.address, &first).status, 200);
    let segment = served.room.path(&format!("captures/{name}/0000.mcap"));
    let bytes = fs::read(&segment).expect("a segment");
    fs::write(&segment, &bytes[..bytes.len() / 3]).expect("cut");
    let gone = get(served.address, &first);
    assert!(gone.status == 404, "{}: {}", gone.status, gone.text());
    let read_again = get(served.address, &format!("/v1/capture?capture={name}")).json();
    assert!(read_again["lost"].as_array().is_some_and(|lost| !lost.is_empty()), "{read_again}");
}

#[test]
fn without_captures_the_service_says_how_to_show_some() {
    let served = Served::new("");
    assert_eq!(get(served.address, "/v1/captures").json()["shown"], false);
    let none = get(served.address, "/v1/capture?capture=x");
    assert!(none.status == 404 && none.text().contains("--captures DIR"), "{}", none.text());
    let room = Room::with_walk();
    let session = session_name(&room.replay("log.mcap"));
    room.run(&format!("db add {session} --db db")).succeeds();
    room.run("serve --db db --captures none").fails(2, &["--captures none", "no such folder"]);
    let words = ["it is a capture, and the folder that holds captures is needed"];
    room.run(&format!("serve --db db --captures {session}")).fails(2, &words);
}

/// A browser's document after it has run the page, if a browser is there.
///
/// The browser's virtual time runs ahead of a machine that is busy, and the page may be dumped before its answers have come: it is asked
/// again until it has the words.
fn browsed(address: &str, hash: &str, words: &[&str]) -> Option<String> {
    const ATTEMPTS: usize = 5;
    let mut page = String::new();
    for _ in 0..ATTEMPTS {
        page = dumped(address, hash)?;
        if words.iter().all(|words| page.contains(words)) {
            return Some(page);
        }
    }
    panic!("{words:?} are missing: {page}");
}

fn dumped(address: &str, hash: &str) -> Option<String> {
    let profile = tempfile::tempdir().expect("a folder");
    for program in ["chromium", "chromium-browser", "google-chrome"] {
        let mut browser = Command::new(program);
        browser.args(["--headless=new", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=20000", "--dump-dom"]);
        browser.arg(format!("--user-data-dir={}", profile.path().display())).arg(format!("http://{address}/{hash}"));
        if let Ok(output) = browser.stderr(Stdio::null()).output() {
            return Some(String::from_utf8_lossy(&output.stdout).into_owned());
        }
    }
    println!("skipped: there is no Chromium");
    None
}

#[test]
fn a_browser_shows_a_view_and_a_capture() {
    let (served, name) = with_captures();
    let address = served.address.to_string();
    // The words below the view, and that it is drawn.
    let words = ["of known geometry", "data-views="];
    if browsed(&address, "#walk?x=0.22&y=0.2&z=0.5&yaw=11&pitch=20", &words).is_none() {
        return;
    }
    let valid = format!("of {} tags are valid", walk().frames());
    browsed(&address, &format!("#captures?capture={name}&frame=3"), &[&valid, "data-frame=\"3\""]);
}

#[test]
fn a_capture_without_tags_is_listed_and_shown_empty() {
    let room = Room::with_walk();
    let replayed = room.replay("log.mcap");
    let name = session_name(&replayed).rsplit('/').next().expect("a name").to_owned();
    let mut messages = read_capture(&replayed.session);
    messages.retain(|message| message.channel.topic != TAG);
    fs::write(replayed.session.join("0000.mcap"), own_log(&messages)).expect("written");
    add_images(&room, "images", &super::PLACES);
    let served = Served::of(room, "--captures captures");
    assert_eq!(get(served.address, "/v1/captures").json()["sessions"][0]["name"], name.as_str());
    let capture = get(served.address, &format!("/v1/capture?capture={name}"));
    assert_eq!((capture.status, capture.json()["t_s"].as_array().map(Vec::len)), (200, Some(0)));
    for path in ["/v1/frame", "/v1/tag", "/v1/explain"] {
        let none = get(served.address, &format!("{path}?capture={name}&frame=0"));
        assert_eq!(none.status, 404, "{path}: {}", none.text());
    }
    let words = ["This capture has no tags"];
    browsed(&served.address.to_string(), &format!("#captures?capture={name}"), &words);
}
