//! The image database from end to end: captures and folders in, images out.

use std::fs;

use image::RgbImage;
use realitysim::config::Settings;
use realitysim::database::ImageDatabase;
use realitysim::ros2::messages::CompressedImage;
use realitysim::ros2::{LogMessage, Message};
use realitysim::views::{Surface, Target, World};

use super::support::{IMAGE, LENS, Room, read_capture};

pub const POSES: &str = "file,x,y,z,yaw_deg,pitch_deg,roll_deg\n";
pub const CAMERA_INFO: &str = "image_width: 320\nimage_height: 240\ncamera_name: test\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: \
    [102.5, 0, 160.75, 0, 102.5, 117.75, 0, 0, 1]\ndistortion_model: equidistant\ndistortion_coefficients:\n  rows: 1\n  cols: \
    4\n  data: [-0.012, 0.003, -0.0008, 0.0]\n";

/// A database `db` of the short walk; the capture's images in its order.
pub fn walked() -> (Room, Vec<LogMessage>) {
    let room = Room::with_walk();
    let replayed = room.replay("log.mcap");
    let session = replayed.session.strip_prefix(room.path("")).expect("inside").display().to_string();
    let run = room.run(&format!("db add {session} --db db --json")).succeeds();
    let valid = replayed.tags.iter().filter(|tag| tag.valid).count();
    assert_eq!(run.json()["images"].as_u64(), Some(valid as u64));
    let images = read_capture(&replayed.session).into_iter().filter(|message| message.channel.topic == IMAGE).collect();
    (room, images)
}

/// The pose of an image as arguments of `view`, and its stamp.
pub fn at(database: &ImageDatabase, number: usize) -> (String, i64) {
    let record = database.index().record(number);
    let (pose, euler) = (record.pose(), record.pose().euler());
    let [yaw, pitch, roll] = [euler.yaw, euler.pitch, euler.roll].map(f64::to_degrees);
    let p = pose.translation;
    (format!("--x {} --y {} --z {} --yaw {yaw} --pitch {pitch} --roll {roll}", p.x, p.y, p.z), record.stamp_ns)
}

pub fn open(room: &Room) -> ImageDatabase {
    ImageDatabase::open(&room.path("db"), &Settings::default().views).expect("a database")
}

#[test]
fn a_stored_image_comes_out_byte_for_byte() {
    let (room, images) = walked();
    let database = open(&room);
    for number in [0, database.index().len() / 2, database.index().len() - 1] {
        let (pose, stamp_ns) = at(&database, number);
        let run = room.run(&format!("view --db db {pose} -o out.jpg --json")).succeeds();
        assert_eq!(run.json()["made"], "stored");
        let stamp = |message: &LogMessage| {
            let image = CompressedImage::decode(&message.data).expect("an image");
            (image.header.stamp.to_nanoseconds(), image.data)
        };
        let (_, bytes) = images.iter().map(stamp).find(|(stamp, _)| *stamp == stamp_ns).expect("its frame");
        assert_eq!(fs::read(room.path("out.jpg")).expect("written"), bytes);
    }
}

#[test]
fn a_view_says_what_it_is_made_of() {
    let (room, _) = walked();
    let run = room
        .run("view --db db --x -1.5 --y 0.25 --z 0.5 --yaw 14 --pitch 17 -o out.png --mask mask.png --json")
        .succeeds();
    let report = run.json();
    assert!(
        report["made"] == "composed" && report["sources"].as_array().is_some_and(|sources| sources.len() > 1),
        "{report}"
    );
    assert!(report["valid_share"].as_f64() > Some(0.9) && report["expected_error_px"].as_f64() < Some(3.0), "{report}");
    for picture in ["out.png", "mask.png"] {
        let picture = image::open(room.path(picture)).expect("a picture");
        assert_eq!((picture.width(), picture.height()), (320, 240));
    }
    for form in ["npy", "png"] {
        let here = "view --db db --x -1.5 --y 0.25 --z 0.5 --yaw 14 --pitch 17";
        room.run(&format!("{here} -o out.png --depth depth.{form}")).succeeds();
    }
    let npy = fs::read(room.path("depth.npy")).expect("written");
    let (values, _) = npy[npy.len() - 4 * 320 * 240..].as_chunks::<4>();
    let png = image::open(room.path("depth.png")).expect("a picture").to_luma16();
    for (metres, millimetres) in values.iter().map(|bytes| f32::from_le_bytes(*bytes)).zip(png.as_raw()) {
        let is_none = *millimetres == 0 && (metres.is_nan() || metres > 65.5);
        assert!(is_none || (1000.0 * metres - f32::from(*millimetres)).abs() < 0.51, "{metres} m, {millimetres} mm");
    }
    assert!(png.as_raw().iter().filter(|value| **value > 0).count() > 20_000);
    let run = room.run("view --db db --x 0 --y 0 --z 0.5 --yaw 14 -o out.png --depth depth.exr");
    run.fails(2, &["depth.exr: its name must end in .npy (metres) or .png (millimetres)"]);
    let run = room.run("view --db db --x 2.5 --y 0 --z 0.5 --yaw 14 --pitch 17 -o out.png");
    run.fails(1, &["farther than the 1 m that are allowed"]);
    room.run("view --db db --x nan --y 0 --z 0.5 --yaw 14 -o out.png")
        .fails(2, &["'nan' for '--x <M>': a number from -100 to 100 is needed"]);
}

/// Where a picture stands in a larger one, pixel by pixel.
fn place_of(part: &RgbImage, whole: &RgbImage) -> Option<(u32, u32)> {
    let is_at = |u: u32, v: u32| {
        let mut pixels = part.enumerate_pixels();
        pixels.all(|(column, row, pixel)| whole.get_pixel(u + column, v + row) == pixel)
    };
    let rows = 0..=whole.height().checked_sub(part.height())?;
    let columns = 0..=whole.width().checked_sub(part.width())?;
    rows.flat_map(|v| columns.clone().map(move |u| (u, v))).find(|(u, v)| is_at(*u, *v))
}

#[test]
fn side_by_side_are_the_views_of_all_methods_and_the_mask() {
    let (room, _) = walked();
    let here = "view --db db --x -1.5 --y 0.25 --z 0.5 --yaw 14 --pitch 17";
    room.run(&format!("{here} -o side.png --side-by-side")).succeeds();
    let picture = |name: &str| image::open(room.path(name)).expect("a picture").to_rgb8();
    let side = picture("side.png");
    let mut places = Vec::new();
    for method in ["nearest", "paper", "exact"] {
        room.run(&format!("{here} --method {method} -o {method}.png --width 320")).succeeds();
        let place = place_of(&picture(&format!("{method}.png")), &side);
        places.push(place.unwrap_or_else(|| panic!("the view by {method} is not there")));
    }
    // From left to right, then below; the fourth panel shows red where nothing is known.
    assert!(places[0].0 < places[1].0 && places[0].1 == places[1].1 && places[2].1 > places[0].1, "{places:?}");
    let (u, v) = (places[1].0, places[2].1);
    let mask = image::imageops::crop_imm(&side, u, v, 320, 240).to_image();
    let exact = picture("exact.png");
    let (same, red) = mask.pixels().zip(exact.pixels()).fold((0, 0), |(same, red), (of_mask, of_exact)| {
        (same + u32::from(of_mask == of_exact), red + u32::from(of_mask.0 == [200, 40, 40]))
    });
    assert!(same > 320 * 240 / 3 && same + red < 320 * 240, "{same} pixels of known geometry, {red} of nothing");
    // What a scene does, it does to all of them.
    let scene = format!("{}/replay/scenes/crowded.toml", env!("CARGO_MANIFEST_DIR"));
    room.run(&format!("{here} -o exact.png --width 320 --scene {scene}")).succeeds();
    room.run(&format!("{here} -o side.png --side-by-side --scene {scene}")).succeeds();
    let place = place_of(&picture("exact.png"), &picture("side.png"));
    assert_eq!(place, Some(places[2]), "the exact panel is not the exact view");
}

#[test]
fn size_and_scene_of_a_view_are_as_asked() {
    let (room, _) = walked();
    let here = "view --db db --x -1.5 --y 0.25 --z 0.5 --yaw 14 --pitch 17";
    room.run(&format!("{here} --width 160 -o small.png")).succeeds();
    room.run(&format!("{here} --width 200 --height 100 -o both.png")).succeeds();
    let size = |name: &str| image::open(room.path(name)).expect("a picture").to_rgb8().dimensions();
    assert_eq!((size("small.png"), size("both.png")), ((160, 120), (200, 100)));
    room.write_scene("evening.toml", |text| {
        let plain = text.split("[[effect]]").next().expect("a scene").to_owned();
        plain + "[[effect]]\nkind = \"light\"\ngain = 0.5\n"
    });
    let run = room.run(&format!("{here} --scene evening.toml -o dark.png --json")).succeeds();
    assert_eq!(run.json()["effects"], serde_json::json!(["light"]));
    let (stored, _) = at(&open(&room), 1);
    let made = |more: &str| {
        let run = room.run(&format!("view --db db {stored} -o any.png --json {more}")).succeeds();
        run.json()["made"].as_str().expect("a word").to_owned()
    };
    assert_eq!(made(""), "stored");
    assert_ne!(made("--scene evening.toml"), "stored", "it is not what was recorded");
    room.run(&format!("{here} -o bright.png")).succeeds();
    let sum = |name: &str| {
        let picture = image::open(room.path(name)).expect("a picture").to_rgb8();
        picture.iter().map(|value| f64::from(*value)).sum::<f64>()
    };
    let ratio = sum("dark.png") / sum("bright.png");
    assert!((0.47..0.53).contains(&ratio), "{ratio}");
    room.run(&format!("{here} --width 9 -o x.png")).fails(2, &["16 to 4096"]);
    room.run(&format!("{here} --scene none.toml -o x.png")).fails(1, &["none.toml"]);
    // A half-size view is the stored image's half: the lens is resized, not cut.
    let (pose, _) = at(&open(&room), 2);
    room.run(&format!("view --db db {pose} -o whole.png")).succeeds();
    room.run(&format!("view --db db {pose} --width 160 -o half.png")).succeeds();
    let (whole, half) = (image::open(room.path("whole.png")), image::open(room.path("half.png")));
    let whole =
        image::imageops::resize(&whole.expect("there").to_rgb8(), 160, 120, image::imageops::FilterType::Triangle);
    let half = half.expect("there").to_rgb8();
    let off: Vec<f64> = (20..100)
        .flat_map(|v| (30..130).map(move |u| (u, v)))
        .map(|(u, v)| (f64::from(whole.get_pixel(u, v)[1]) - f64::from(half.get_pixel(u, v)[1])).abs())
        .collect();
    let mean = off.iter().sum::<f64>() / off.len() as f64;
    assert!(mean < 6.0, "{mean}");
}

#[test]
fn the_gap_is_least_for_the_exact_view() {
    let (room, _) = walked();
    let run = room.run("measure gap --db db --frames 3 --apart 0.03 -o gap.png --json").succeeds();
    let rows = run.json();
    let row = |form: &str| {
        let rows = rows.as_array().expect("rows");
        rows.iter().find(|row| row["form"] == form).unwrap_or_else(|| panic!("{form}: {rows:?}")).clone()
    };
    let of = |form: &str, key: &str| row(form)[key].as_f64().expect("a number");
    assert!(of("exact view", "psnr_db") > of("paper's view", "psnr_db"), "{rows}");
    assert!(of("exact view", "psnr_db") > of("nearest image", "psnr_db"), "{rows}");
    let response = |form: &str| row(form)["detection"]["response"].as_f64().expect("a number");
    assert!((response("exact view") - response("recorded")).abs() < 0.15, "{rows}");
    for form in ["recorded", "exact view", "paper's view", "nearest image", "rendered"] {
        assert!(row(form)["detector"].is_null());
        assert!((0.0..=1.0).contains(&of(form, "histogram")));
    }
    assert!(of("recorded", "histogram") == 0.0 && image::open(room.path("gap.png")).is_ok());
    room.run("measure gap --db db --frames 1 --detector /bin/false").fails(1, &["exit status: 1"]);
    room.run("measure gap --db db --apart 100").fails(1, &["no image has others around it"]);
}

#[test]
fn a_walk_through_a_database_is_smooth_and_leaves_its_pictures() {
    let (room, _) = walked();
    let run = room
        .run("measure view-walk --db db --from=-1.9,0.12,12 --to=-1.2,0.27,14 --frames 12 -o walk --json")
        .succeeds();
    let report = run.json();
    assert_eq!(report["views"], 12);
    assert!(report["not_found"].as_u64() < Some(4), "{report}");
    assert!(report["jump_cm"]["median"].as_f64() < Some(2.5), "{report}");
    let table = fs::read_to_string(room.path("walk/walk.csv")).expect("written");
    assert_eq!(table.lines().count(), 13);
    assert!((0..12).all(|view| image::open(room.path(&format!("walk/frames/{view:05}.jpg"))).is_ok()));
    assert!(image::open(room.path("walk/sheet.png")).is_ok());
    room.run("measure view-walk --db none -o other").fails(1, &["there is no database here"]);
}

#[test]
fn what_changed_or_vanished_after_indexing_is_told_and_the_rest_is_used() {
    let (room, _) = walked();
    let database = open(&room);
    let record = database.index().record(3);
    let file = database.contents().sources[0].file(record.file).expect("its file");
    let mut bytes = fs::read(&file).expect("a segment");
    bytes[record.offset as usize + 500] ^= 1;
    fs::write(&file, &bytes).expect("written");
    let run = room.run("db verify --db db --json");
    assert_eq!(run.code, Some(3));
    assert_eq!(run.json()["sound"].as_u64(), Some(database.index().len() as u64 - 1));
    assert!(run.stderr.contains("changed since it was indexed"), "{run:?}");
    let (pose, _) = at(&database, 3);
    let run = room.run(&format!("view --db db {pose} -o out.png --json"));
    assert_eq!(run.code, Some(3), "made of its neighbours");
    assert!(run.json()["made"] != "stored" && run.json()["unreadable"].to_string().contains("changed"), "{run:?}");
    fs::remove_file(&file).expect("removed");
    let run = room.run(&format!("view --db db {pose} -o out.png"));
    assert!(run.code == Some(1) && run.stderr.contains("gone since it was indexed"), "{run:?}");
}

/// Two walks of the same place, one of which is on a disk that is not plugged in.
#[test]
fn a_capture_that_is_away_leaves_the_others_their_views_and_comes_back() {
    let (room, _) = walked();
    let database = open(&room);
    let (first, count) = (database.contents().sources[0].path.clone(), database.index().len());
    let second = room.replay("log.mcap").session;
    room.run(&format!("db add {} --db db", second.display())).succeeds();
    let place = database.index().record(count / 2).pose().translation;
    let pose = format!("--x {} --y {} --z {} --yaw 20 --pitch 17", place.x, place.y + 0.05, place.z);
    let away = room.path("away");
    fs::rename(&first, &away).expect("moved");
    let run = room.run(&format!("view --db db {pose} -o out.png --json"));
    assert_eq!(run.code, Some(3), "{run:?}");
    let report = run.json();
    let unreadable = report["unreadable"].as_array().expect("names");
    assert!(unreadable.len() == 1 && unreadable[0].as_str().is_some_and(|said| said.contains("gone")), "{report}");
    assert!(report["sure_share"].as_f64() > Some(0.4), "{report}");
    // Or only its segment, with more images than are given up one by one.
    fs::rename(&away, &first).expect("moved back");
    let segment = first.join("0000.mcap");
    fs::rename(&segment, room.path("segment")).expect("moved");
    let report = room.run(&format!("view --db db {pose} -o out.png --json")).json();
    let unreadable = report["unreadable"].as_array().expect("names");
    assert!(unreadable.len() == 1 && unreadable[0].as_str().is_some_and(|said| said.contains("0000.mcap")), "{report}");
    assert!(report["sure_share"].as_f64() > Some(0.4), "{report}");
    fs::rename(room.path("segment"), &segment).expect("moved back");
    fs::rename(&first, &away).expect("moved");
    // What is away is not forgotten.
    let run = room.run("db rebuild --db db --json");
    assert_eq!((run.code, run.json()["images"].as_u64()), (Some(3), Some(count as u64)), "{run:?}");
    room.run(&format!("view --db db {pose} -o out.png")).succeeds();
    fs::rename(&away, &first).expect("moved back");
    let run = room.run("db rebuild --db db --json").succeeds();
    assert_eq!(run.json()["images"].as_u64(), Some(2 * count as u64));
    room.write("db/database.json", "{");
    room.run("db rebuild --db db").fails(1, &["add its captures again"]);
}

#[test]
fn a_folder_of_captures_stands_for_those_that_are_not_known() {
    let (room, _) = walked();
    let count = open(&room).index().len();
    let first = open(&room).contents().sources[0].path.clone();
    let second = room.replay("log.mcap").session;
    let folder = second.parent().expect("captures").to_owned();
    // What `captures/*` is to a shell: beside captures stands what their recorder keeps.
    let all: Vec<String> = fs::read_dir(&folder)
        .expect("captures")
        .map(|entry| entry.expect("one").path().display().to_string())
        .collect();
    assert!(all.iter().any(|path| path.ends_with("last_state.bin")), "{all:?}");
    room.run(&format!("db add {} --db other", all.join(" "))).succeeds();
    let run = room.run(&format!("db add {} --db db --json", folder.display())).succeeds();
    assert_eq!(run.json()["images"].as_u64(), Some(count as u64), "only the new one");
    assert_eq!(open(&room).index().len(), 2 * count);
    let segment = first.join("0000.mcap");
    room.run(&format!("db add {} --db db", segment.display())).fails(1, &["there already"]);
    room.run(&format!("db add {} {} --db third", segment.display(), first.display())).fails(1, &["there already"]);
    assert!(!room.path("third/database.json").exists());
}

/// A dense walk: the nearest images of a pose that looks elsewhere all show the same part of its view. By nearness alone these
/// views showed 45, 40 and 23 % of their picture.
#[test]
fn images_of_a_walk_are_chosen_such_that_they_complete_each_other() {
    let (room, _) = walked();
    for (yaw_deg, least) in [(120, 0.48), (-110, 0.46), (-160, 0.3)] {
        let here = format!("view --db db --x -1.53 --y 0.2 --z 0.496 --yaw={yaw_deg} --pitch 17");
        let report = room.run(&format!("{here} -o out.png --json")).succeeds().json();
        assert!(report["valid_share"].as_f64() > Some(least), "{yaw_deg} deg: {report}");
    }
}

/// `camera_info` says nothing of where a lens ends, images do: 100 degrees off the axis. A view has the same outline, in any size.
#[test]
fn a_view_by_the_lens_of_its_images_ends_where_they_do() {
    let (room, _) = walked();
    let database = open(&room);
    let lens = &database.contents().sources[0].lens;
    let fov_deg = lens.fov_deg.expect("found");
    assert!((195.0..=201.0).contains(&fov_deg), "{fov_deg}");
    let looks = "--x -1.53 --y 0.2 --z 0.496 --yaw 120 --pitch 17";
    for (size, scale) in [("", 1.0), ("--width 160", 0.5)] {
        let report =
            room.run(&format!("view --db db {looks} -o out.png --mask mask.png {size} --json")).succeeds().json();
        let mask = image::open(room.path("mask.png")).expect("a picture").into_luma8();
        let from_axis = |u: u32, v: u32| {
            let of = |at: u32, centre: f64| (f64::from(at) + 0.5) / scale - 0.5 - centre;
            of(u, lens.cx).hypot(of(v, lens.cy))
        };
        let lit = mask.enumerate_pixels().filter(|(_, _, pixel)| pixel.0[0] > 0).map(|(u, v, _)| from_axis(u, v));
        let farthest = lit.fold(0.0, f64::max);
        assert!(
            (160.0..173.0).contains(&farthest),
            "{farthest} px: the corners are 200 px away, and images end at 172"
        );
        // What it does not show it does not draw at all: the share is of what it draws.
        let (lit, drawn) = mask.enumerate_pixels().fold((0, 0), |(lit, drawn), (u, v, pixel)| {
            (lit + u32::from(pixel.0[0] > 0), drawn + u32::from(from_axis(u, v) < 170.0))
        });
        let share = f64::from(lit) / f64::from(drawn);
        assert!((report["valid_share"].as_f64().expect("a share") - share).abs() < 0.02, "{share}: {report}");
    }
    // The same lens, whose file says 200 degrees.
    room.write("lens.toml", LENS);
    let (pose, _) = at(&database, 0);
    let report = room.run(&format!("view --db db {pose} --lens lens.toml -o out.jpg --json"));
    assert_eq!(report.succeeds().json()["made"], "stored");
}

/// A hundred images along a line look one way, two from farther off look elsewhere: of all that are near by the metric these
/// are the last, and by those alone 55, 43, 34 and 35 % were shown.
#[test]
fn the_one_image_that_looks_there_is_found_among_a_hundred_nearer_ones() {
    let room = Room::new();
    fs::create_dir(room.path("one")).expect("a folder");
    let picture =
        RgbImage::from_fn(320, 240, |u, v| image::Rgb([60 + (u % 9) as u8 * 10, 120 + (v % 7) as u8 * 9, 90]));
    picture.save(room.path("one/a.png")).expect("saved");
    room.write("one/camera_info.yaml", CAMERA_INFO);
    let line: String = (0..100).map(|i| format!("a.png,{},0,0.5,0,20,0\n", f64::from(i) * 0.01 - 1.0)).collect();
    let others = "a.png,-0.5,-1.4,0.5,90,20,0\na.png,-0.5,-1.4,0.5,180,20,0\n";
    room.write("one/poses.csv", format!("{POSES}{line}{others}"));
    room.run("db add one --db db --field kid-2009").succeeds();
    for yaw_deg in [90, 120, 150, 180] {
        let here = format!("view --db db --x=-0.5 --y 0 --z 0.5 --yaw {yaw_deg} --pitch 20");
        let report = room.run(&format!("{here} -o out.png --json")).succeeds().json();
        assert!(report["valid_share"].as_f64() > Some(0.98), "{yaw_deg} deg: {report}");
    }
}

/// The same walk before a goal, as it was rendered, without one, and with one painted where the field file has it.
#[test]
fn goals_stand_where_images_show_them() {
    let room = Room::new();
    room.write_scene("near.toml", |text| text.replace("[[-2.0, 0.1], [-1.1, 0.3]]", "[[0.6, 0.0], [1.5, 0.1]]"));
    room.run("scene render near.toml -o near.mcap").succeeds();
    let replayed = room.replay("near.mcap");
    let session = replayed.session.display().to_string();
    room.run(&format!("db add {session} --db db")).succeeds();
    let database = open(&room);
    assert!(!database.contents().sources[0].goals, "none was drawn");
    let world = World::new(database.field());
    fs::create_dir(room.path("painted")).expect("a folder");
    room.write("painted/camera_info.yaml", CAMERA_INFO);
    let mut poses = POSES.to_owned();
    for message in read_capture(&replayed.session).iter().filter(|message| message.channel.topic == IMAGE) {
        let stored = CompressedImage::decode(&message.data).expect("an image");
        let stamp_ns = stored.header.stamp.to_nanoseconds();
        let record = database.index().records().find(|record| record.stamp_ns == stamp_ns).expect("indexed");
        let target = Target::new(database.camera(&record).expect("known"), &record.pose(), &world);
        let mut picture = image::load_from_memory(&stored.data).expect("a picture").into_rgb8();
        for (u, v, pixel) in picture.enumerate_pixels_mut() {
            if target.surface(u as usize, v as usize) == Some(Surface::Goal) {
                pixel.0 = [235, 235, 230];
            }
        }
        picture.save(room.path(&format!("painted/{stamp_ns}.png"))).expect("saved");
        let (place, euler) = (record.pose().translation, record.pose().euler());
        let [yaw, pitch, roll] = [euler.yaw, euler.pitch, euler.roll].map(f64::to_degrees);
        poses += &format!("{stamp_ns}.png,{},{},{},{yaw},{pitch},{roll}\n", place.x, place.y, place.z);
    }
    room.write("painted/poses.csv", poses);
    room.run("db add painted --db other --field kid-2009").succeeds();
    let other = ImageDatabase::open(&room.path("other"), &Settings::default().views).expect("a database");
    assert!(other.contents().sources[0].goals);
    assert!(!room.run("db stats --db other").stdout.contains("without goals"));
    assert!(room.run("db stats --db db").stdout.contains("without goals"));
}

/// The mask lies beside its config, on a robot that nobody of the database can ask.
#[test]
fn the_robot_s_own_body_is_left_out_wherever_the_capture_goes() {
    let room = Room::with_walk();
    fs::create_dir(room.path("robot")).expect("a folder");
    let hides = |u: u32, v: u32| u < 160 && v >= 120;
    let body = image::GrayImage::from_fn(320, 240, |u, v| image::Luma([if hides(u, v) { 0 } else { 255 }]));
    body.save(room.path("robot/body.png")).expect("written");
    room.write("robot/robot.toml", "[camera]\nbody_mask = [{ png = \"body.png\" }]\n");
    let replayed = room.replay("log.mcap --config robot/robot.toml");
    fs::remove_dir_all(room.path("robot")).expect("away");
    room.run("db add captures --db db").succeeds();
    let masks = || {
        let names = fs::read_dir(room.path("db")).expect("a database").map(|entry| entry.expect("read").file_name());
        names.filter(|name| name.to_string_lossy().ends_with(".png")).count()
    };
    // The lens's dark corners, and the body.
    assert_eq!(masks(), 2);
    fs::write(room.path("db/dark-00000000.png"), "of an addition that came to nothing").expect("written");
    let tag = replayed.tags.iter().find(|tag| tag.valid).expect("a valid tag");
    let (p, yaw_deg) = (&tag.pose.pose.position, tag.yaw.to_degrees());
    room.write("one.toml", "[views]\nsources = 1\n");
    let view = "view --db db --config one.toml --pitch 17 -o out.png --mask mask.png";
    room.run(&format!("{view} --x {} --y {} --z {} --yaw {yaw_deg}", p.x, p.y, p.z + 0.02)).succeeds();
    let mask = image::open(room.path("mask.png")).expect("a mask").into_luma8();
    let shown = |u, v| mask.get_pixel(u, v).0[0] > 0;
    assert!(!shown(100, 200) && shown(220, 200) && shown(100, 60), "only the body is left out");
    let session = replayed.session.strip_prefix(room.path("")).expect("inside").display().to_string();
    room.run(&format!("db remove {session} --db db")).succeeds();
    assert_eq!(masks(), 0, "nobody's masks are left");
}

/// Poses that somebody wrote down do not say how good they are; they are not the best there are because of that.
#[test]
fn poses_of_unknown_accuracy_are_said_to_be() {
    let room = Room::new();
    crate::service::add_images(&room, "images", &crate::service::PLACES);
    let stats = room.run("db stats --db db --json").succeeds().json();
    assert!(stats["sigma_m"].is_null() && stats["sigma_deg"].is_null() && stats["without_sigma"] == 4, "{stats}");
    assert!(room.run("db stats --db db").succeeds().stdout.contains("poses of unknown accuracy: 4"));
    let view = "view --db db --y 0.2 --z 0.5 --pitch 20 -o out.png --json";
    let near = room.run(&format!("{view} --x 0.2 --yaw 10")).succeeds().json();
    assert!(near["expected_error_px"].as_f64() > Some(0.5) && near["warning"].is_null(), "{near}");
    // They all look the other way.
    let away = room.run(&format!("{view} --x 0.2 --yaw 160")).succeeds().json();
    assert!(away["warning"].as_str().is_some_and(|words| words.contains("look elsewhere")), "{away}");
    let before = fs::read(room.path("images/0.png")).expect("there");
    for order in [
        view.replace("out.png", "images/0.png") + " --x 0.2 --yaw 10",
        "db coverage --db db -o images/0.png".to_owned(),
    ] {
        room.run(&order).fails(2, &["choose another place"]);
    }
    assert_eq!(fs::read(room.path("images/0.png")).expect("there"), before);
}

#[test]
fn of_two_images_of_one_place_the_better_one_is_taken() {
    let room = Room::new();
    fs::create_dir(room.path("images")).expect("a folder");
    room.write("images/camera_info.yaml", CAMERA_INFO);
    let sharp = RgbImage::from_fn(320, 240, |u, v| image::Rgb([if (u / 8 + v / 8) % 2 == 0 { 180 } else { 60 }; 3]));
    let blurred = image::imageops::blur(&sharp, 6.0);
    let dark = RgbImage::from_fn(320, 240, |u, v| image::Rgb(sharp.get_pixel(u, v).0.map(|value| value / 8)));
    for (name, picture) in [("blurred", blurred), ("dark", dark), ("sharp", sharp)] {
        picture.save(room.path(&format!("images/{name}.png"))).expect("saved");
    }
    // The best one is the farthest, by a little.
    let rows = "blurred.png,0.1,0.2,0.5,10,20,0\ndark.png,0.1003,0.2,0.5,10,20,0\nsharp.png,0.1006,0.2,0.5,10,20,0\n";
    room.write("images/poses.csv", format!("{POSES}{rows}"));
    room.run("db add images --db db --field kid-2009").succeeds();
    let view = "view --db db --x 0.08 --y 0.2 --z 0.5 --yaw 10 --pitch 20 --method nearest -o out.png --json";
    let report = room.run(view).succeeds().json();
    let file = report["sources"][0]["file"].as_str().expect("a file");
    assert!(file.ends_with("sharp.png"), "{report}");
}

/// Right if the images were scaled, wrong if they were cut: the user knows.
#[test]
fn a_lens_that_is_scaled_to_its_images_is_told() {
    let room = Room::new();
    fs::create_dir(room.path("images")).expect("a folder");
    room.write("images/camera_info.yaml", CAMERA_INFO);
    RgbImage::from_pixel(160, 120, image::Rgb([120; 3])).save(room.path("images/0.png")).expect("saved");
    room.write("images/poses.csv", format!("{POSES}0.png,0.1,0.2,0.5,10,20,0\n"));
    let run = room.run("db add images --db db --field kid-2009 --json").succeeds();
    assert_eq!(run.json()["scaled"][0]["stated"], serde_json::json!([320, 240]));
    assert!(run.stderr.contains("320 x 240, but these have 160 x 120: it was scaled to them"), "{run:?}");
}

/// Never lit in specks, as a camera's noise leaves it in the dark: more edges than any body has.
#[test]
fn a_picture_with_many_dark_specks_is_no_body_and_is_read() {
    let room = Room::new();
    fs::create_dir(room.path("images")).expect("a folder");
    room.write("images/camera_info.yaml", CAMERA_INFO);
    let is_dark = |u: u32, v: u32| u < 120 && (u + v).is_multiple_of(2);
    let picture = RgbImage::from_fn(320, 240, |u, v| image::Rgb(if is_dark(u, v) { [0; 3] } else { [120; 3] }));
    picture.save(room.path("images/0.png")).expect("saved");
    room.write("images/poses.csv", format!("{POSES}0.png,0.1,0.2,0.5,10,20,0\n"));
    room.run("db add images --db db --field kid-2009").succeeds();
    room.run("view --db db --x 0.15 --y 0.2 --z 0.5 --yaw 10 --pitch 20 -o out.png").succeeds();
}

#[test]
fn a_folder_whose_first_image_is_torn_gives_the_others() {
    let room = Room::new();
    crate::service::add_images(&room, "images", &crate::service::PLACES);
    let whole = fs::read(room.path("images/0.png")).expect("there");
    fs::write(room.path("images/0.png"), &whole[..whole.len() / 2]).expect("written");
    let run = room.run("db add images --db other --field kid-2009 --json");
    assert!(run.code == Some(3) && run.json()["images"] == 3 && run.stderr.contains("0.png"), "{run:?}");
}

#[test]
fn an_open_database_is_usable_while_it_is_changed() {
    let (room, _) = walked();
    let before = open(&room);
    let count = before.index().len();
    assert!(before.reopened().expect("readable").is_none());
    let source = before.contents().sources[0].path.display().to_string();
    let run = room.run(&format!("db add {source} --db db"));
    assert!(run.code == Some(1) && run.stderr.contains("there already"), "{run:?}");
    room.run(&format!("db remove {source} --db db")).succeeds();
    // The old index is gone by name, and still whole for who has it open.
    assert!(before.image(0).is_ok() && before.index().len() == count);
    let after = before.reopened().expect("readable").expect("changed");
    assert_eq!(after.index().len(), 0);
    let run = room.run("view --db db --x 0 --y 0 --z 0.5 --yaw 0 -o out.png");
    assert!(run.code == Some(1) && run.stderr.contains("the database has no image"), "{run:?}");
    room.run(&format!("db add {source} --db db")).succeeds();
    room.run("db rebuild --db db").succeeds();
    assert_eq!(open(&room).index().len(), count);
    let run = room.run("db remove elsewhere --db db");
    assert!(run.code == Some(1) && run.stderr.contains("not in the database, which holds"), "{run:?}");
    let run = room.run("db coverage --db db -o coverage.png --json").succeeds();
    assert!(run.json()["filled"].as_u64() > Some(3));
    assert_eq!(room.run("db stats --db db --json").json()["images"].as_u64(), Some(count as u64));
}

/// Two folders of one picture with a circle, the second with a robot in it.
fn two_folders() -> Room {
    let room = Room::new();
    for (name, arm) in [("one", 0), ("two", 120)] {
        fs::create_dir(room.path(name)).expect("a folder");
        let picture = RgbImage::from_fn(320, 240, |u, v| {
            let is_lit = f64::hypot(f64::from(u) - 160.75, f64::from(v) - 117.75) < 100.0;
            image::Rgb(if is_lit { [70, 120, 60] } else { [0; 3] })
        });
        picture.save(room.path(&format!("{name}/a.png"))).expect("saved");
        let body = image::GrayImage::from_fn(320, 240, |u, v| image::Luma([if u < arm && v > 160 { 0 } else { 255 }]));
        if arm > 0 {
            body.save(room.path(&format!("{name}/body_mask.png"))).expect("saved");
        }
        room.write(&format!("{name}/camera_info.yaml"), CAMERA_INFO);
        room.write(&format!("{name}/poses.csv"), format!("{POSES}a.png,0.1,0.2,0.5,10,20,0\n"));
    }
    room
}

#[test]
fn whoever_opens_a_database_that_changes_has_the_old_one_or_the_new() {
    let room = two_folders();
    room.run("db add one --db db --field kid-2009").succeeds();
    // By processes of their own, as people do it: a child that this one has just forked holds the lock for a moment.
    let change = || {
        for _ in 0..20 {
            for order in ["db add two --db db", "db rebuild --db db", "db remove two --db db"] {
                room.run(order).succeeds();
            }
        }
    };
    let mut opened = 0;
    std::thread::scope(|scope| {
        let changing = scope.spawn(change);
        while !changing.is_finished() {
            let database =
                ImageDatabase::open(&room.path("db"), &Settings::default().views).expect("the old one or the new");
            assert!((1..=2).contains(&database.index().len()));
            opened += 1;
        }
    });
    assert!(opened > 20, "{opened}");
}

#[test]
fn a_mask_that_is_damaged_or_gone_is_named_and_made_anew() {
    let room = two_folders();
    room.run("db add one two --db db --field kid-2009").succeeds();
    let masks = || {
        let names = fs::read_dir(room.path("db")).expect("a database").map(|entry| entry.expect("read").path());
        names.filter(|path| path.extension().is_some_and(|ending| ending == "png")).collect::<Vec<_>>()
    };
    assert_eq!(masks().len(), 2, "both are dark at the same places");
    let view = "view --db db --x 0.3 --y 0.2 --z 0.5 --yaw 10 --pitch 20 -o out.png";
    room.run(view).succeeds();
    for (mask, damage) in masks().into_iter().zip([None, Some("no picture")]) {
        match damage {
            Some(content) => fs::write(&mask, content).expect("written"),
            None => fs::remove_file(&mask).expect("removed"),
        }
        let name = mask.file_name().and_then(|name| name.to_str()).expect("a name");
        room.run(view).fails(1, &[name, "realitysim db rebuild"]);
        room.run("db verify --db db").fails(3, &[name, "realitysim db rebuild"]);
        room.run("db rebuild --db db").succeeds();
        room.run(view).succeeds();
    }
}

/// A white arm is lit in every picture: only a mask tells.
#[test]
fn of_a_folder_of_images_the_robot_can_be_masked() {
    let room = Room::new();
    fs::create_dir(room.path("images")).expect("a folder");
    let is_arm = |u: u32, v: u32| u < 120 && v >= 160;
    let picture = RgbImage::from_fn(320, 240, |u, v| image::Rgb(if is_arm(u, v) { [255; 3] } else { [70, 120, 60] }));
    picture.save(room.path("images/a.png")).expect("saved");
    room.write("images/camera_info.yaml", CAMERA_INFO);
    room.write("images/poses.csv", format!("{POSES}a.png,0.1,0.2,0.5,10,20,0\n"));
    let mask = |width: u32, side: u32| {
        let hides = move |u: u32, v: u32| if is_arm(u * side, v) { image::Luma([0]) } else { image::Luma([255]) };
        image::GrayImage::from_fn(width, 240, hides).save(room.path("images/body_mask.png")).expect("saved");
    };
    mask(160, 2);
    let add = "db add images --db db --field kid-2009";
    room.run(add).fails(1, &["images/body_mask.png", "the mask has 160 x 240 pixels, the camera 320 x 240"]);
    let path = room.path("images/body_mask.png");
    image::GrayImage::new(320, 240).save(&path).expect("saved");
    room.run(add).fails(1, &["images/body_mask.png", "hides nearly all of the picture"]);
    fs::remove_file(&path).expect("removed");
    std::os::unix::fs::symlink("elsewhere.png", &path).expect("linked");
    room.run(add).fails(1, &["images/body_mask.png", "not a plain file"]);
    fs::remove_file(&path).expect("removed");
    mask(320, 1);
    room.run(add).succeeds();
    room.run("view --db db --x 0.3 --y 0.2 --z 0.5 --yaw 10 --pitch 20 -o out.png").succeeds();
    let view = image::open(room.path("out.png")).expect("a picture").into_rgb8();
    assert!(view.pixels().all(|pixel| pixel.0[0] < 100), "an arm stands on the field");
    assert!(view.pixels().filter(|pixel| pixel.0[1] > 100).count() > 40_000, "beside it the field is seen");
}

#[test]
fn a_folder_of_images_is_read_and_its_mistakes_are_named() {
    let room = Room::new();
    fs::create_dir(room.path("images")).expect("a folder");
    let picture = image::RgbImage::from_fn(320, 240, |u, v| image::Rgb([u as u8, v as u8, 200]));
    picture.save(room.path("images/a.png")).expect("saved");
    picture.save(room.path("images/b.png")).expect("saved");
    room.write("images/poses.csv", format!("{POSES}a.png,0.1,0.2,0.5,10,20,0\nb.png,0.3,0.2,0.5,10,20,0\n"));
    let refused = |arguments: &str, words: &str| {
        let run = room.run(arguments);
        assert!(run.code != Some(0) && run.stderr.contains(words), "{words}: {run:?}");
    };
    refused("view --db db --x 0 --y 0 --z 0.5 --yaw 0 -o out.png", "there is no database here");
    refused("db add images --db db --field kid-2009", "without camera_info.yaml");
    room.write("images/camera_info.yaml", CAMERA_INFO);
    refused("db add images --db db", "name it with --field");
    room.run("db add images --db db --field kid-2009").succeeds();
    let run = room.run("view --db db --x 0.1 --y 0.2 --z 0.5 --yaw 10 --pitch 20 -o out.png --json").succeeds();
    assert_eq!(run.json()["made"], "stored");
    assert_eq!(fs::read(room.path("out.png")).expect("written"), fs::read(room.path("images/a.png")).expect("there"));
    for (table, words) in [
        ("file,x\n", "line 1: the head is \"file,x\""),
        ("a.png,0.1,0.2,0.5,10,20\n", "line 2: 6 cells"),
        ("a.png,0.1,nan,0.5,10,20,0\n", "\"nan\" is no number"),
        ("../images/a.png,0.1,0.2,0.5,10,20,0\n", "does not lie in this folder"),
    ] {
        let head = if table.starts_with("file") { "" } else { POSES };
        room.write("images/poses.csv", format!("{head}{table}"));
        refused("db add images --db other --field kid-2009", words);
    }
    fs::create_dir(room.path("more")).expect("a folder");
    fs::copy(room.path("images/a.png"), room.path("more/a.png")).expect("copied");
    room.write("more/camera_info.yaml", CAMERA_INFO);
    room.write("more/poses.csv", format!("{POSES}a.png,0.1,0.2,0.5,10,20,0\ngone.png,0.1,0.2,0.5,10,20,0\n"));
    refused("db add more --db db --field spl-2020", "a database is of one field");
    let run = room.run("db add more --db db");
    assert!(run.code == Some(3) && run.stderr.contains("gone.png"), "{run:?}");
}
