//! Files that people write: what is accepted is used.

use std::path::Path;

use glam::DVec2;
use realitysim::config::lenses::LensWanted;
use realitysim::config::{Settings, parse_field, parse_lens};
use realitysim::evaluation::reference::Reference;
use realitysim::evaluation::suite::Suite;
use realitysim::geometry::Field;
use realitysim::log_input::scene_source::{SceneSource, parse};

use crate::case::{Case, Class, Finding, Outcome, Taken};
use crate::fields::fields;
use crate::foreign::{KALIBR, ROS, VISUAL_MESH};
use crate::judge::{self, Judge};
use crate::support::{CAMERA_INFO, LENS, own_log, without};
use crate::text::damage;
use crate::walks::{SCENE, options, replayed};

const ROBOT: &str = include_str!("../../../config/robot.toml");
const FIELDS: [&str; 2] =
    [include_str!("../../../config/fields/kid-2009.toml"), include_str!("../../../config/fields/kid-2020.toml")];
const OPENCV: &str = include_str!("../../data/lenses/opencv-12.xml");
const OCAM: &str = include_str!("../../data/lenses/calib_results.txt");
const MRCAL: &str = include_str!("../../data/lenses/camera.cameramodel");
/// Of the walks' camera.
pub const CALIBRATED: &str = "image_width: 320\nimage_height: 240\ncamera_name: test\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: \
    [102.5, 0, 160.75, 0, 102.5, 117.75, 0, 0, 1]\ndistortion_model: equidistant\ndistortion_coefficients:\n  rows: 1\n  cols: \
    4\n  data: [-0.012, 0.003, -0.0008, 0.0]\n";
/// Whoever asks for more waits longer: no fault.
const MAX_PARTICLE_ITERATIONS: usize = 20_000;

/// Numbers in what only explains the rest change nothing.
fn without_comments(text: &str) -> String {
    let lines = text.lines().map(|line| line.split('#').next().unwrap_or_default().trim_end());
    lines.filter(|line| !line.is_empty()).map(|line| format!("{line}\n")).collect()
}

/// The damaged text; what it says is told by its lines that are not in the sound one.
fn damaged(case: &mut Case, sound: &str) -> Vec<u8> {
    let bytes = damage(&mut case.draw, sound);
    let text = String::from_utf8_lossy(&bytes).into_owned();
    let new: Vec<&str> = text.lines().filter(|line| !sound.contains(*line)).take(4).collect();
    case.tell(new.join("; ").chars().take(400).collect::<String>());
    bytes
}

/// A robot's config, and a walk with it.
pub fn settings(case: &mut Case) -> Outcome {
    let bytes = damaged(case, &without_comments(ROBOT));
    let path = case.write("robot.toml", bytes);
    let Ok(settings) = Settings::load(&path.to_string_lossy()) else { return Ok(Taken::Refused) };
    if let Err(what) = settings.check() {
        return Err(Finding::new(Class::Silent, format!("taken, and then not: {what}")));
    }
    let filter = &settings.filter;
    if filter.particles.saturating_mul(filter.iterations) > MAX_PARTICLE_ITERATIONS {
        return Ok(Taken::Accepted);
    }
    walk_with(case, settings, false)
}

/// Nothing is known of the truth then: what a person says wrongly in a possible way is believed.
fn walk_with(case: &mut Case, settings: Settings, own_lens: bool) -> Outcome {
    let walk = &case.walks.all[0];
    let log = if own_lens { own_log(&without(&walk.messages, CAMERA_INFO)) } else { walk.log() };
    let (source, captures) = (case.write("log.mcap", log), case.path("captures"));
    let report = replayed(&options(source, captures.clone(), settings));
    judge::replay(&report, &captures, Judge { truth: None, mirrored: true })
}

pub fn lens(case: &mut Case) -> Outcome {
    let sound = *case.draw.one_of(&[LENS, LENS, CALIBRATED, CALIBRATED, ROS, KALIBR, VISUAL_MESH, OPENCV, OCAM, MRCAL]);
    let bytes = damaged(case, sound);
    let path = case.write(if sound == LENS { "lens.toml" } else { "lens.yaml" }, &bytes);
    let Ok(text) = String::from_utf8(bytes) else { return Ok(Taken::Refused) };
    let wanted = LensWanted { camera: None, image_size: Some([320, 240]) };
    let Ok(file) = parse_lens(&text, "lens", wanted) else { return Ok(Taken::Refused) };
    let far = DVec2::new(f64::from(file.lens.width()), f64::from(file.lens.height()));
    for at in [(0.0, 0.0), (0.5, 0.5), (1.0, 1.0), (0.3, 0.9), (-0.1, 0.5)] {
        let pixel = DVec2::from(at) * far;
        let Some(ray) = file.lens.unproject(pixel) else { continue };
        let back = file.lens.project(ray);
        if !ray.is_finite() || (ray.length() - 1.0).abs() > 1e-9 || back.is_some_and(|back| !back.is_finite()) {
            return Err(Finding::new(Class::NotFinite, format!("{pixel} is seen along {ray}, and that at {back:?}")));
        }
    }
    let mut settings = Settings::default();
    settings.camera.lens = Some(path.to_string_lossy().into_owned());
    walk_with(case, settings, true)
}

pub fn field(case: &mut Case) -> Outcome {
    let sound = without_comments(FIELDS[*case.draw.one_of(&[0, 0, 1])]);
    let bytes = damaged(case, &sound);
    let path = case.write("field.toml", &bytes);
    let Ok(text) = String::from_utf8(bytes) else { return Ok(Taken::Refused) };
    let Ok(dimensions) = parse_field(&text, "field") else { return Ok(Taken::Refused) };
    let Ok(field) = Field::new(dimensions) else { return Ok(Taken::Refused) };
    let distance = field.distance_to_centre_line(DVec2::new(0.3, -7.0));
    if !distance.is_finite() || field.points(200).iter().any(|point| !point.position.is_finite()) {
        return Err(Finding::new(Class::NotFinite, "the field's lines"));
    }
    let settings = Settings { field: path.to_string_lossy().into_owned(), ..Settings::default() };
    walk_with(case, settings, false)
}

/// A scene and its first messages.
pub fn scene(case: &mut Case) -> Outcome {
    const SCENES: [&str; 5] = [
        include_str!("../../../replay/scenes/crowded.toml"),
        include_str!("../../../replay/scenes/push-and-fall.toml"),
        include_str!("../../../replay/scenes/bright-window.toml"),
        include_str!("../../../replay/scenes/head-scan.toml"),
        include_str!("../../../replay/scenes/rolling-shutter.toml"),
    ];
    let lens = case.write("lens.toml", LENS);
    let sound = if case.draw.chance(0.3) { SCENE } else { *case.draw.one_of(&SCENES) };
    // Small pictures: what they cost is no matter here.
    let lines = without_comments(sound)
        .lines()
        .map(|line| match line.starts_with("lens = ") {
            true => format!("lens = {lens:?}\n"),
            false => format!("{line}\n"),
        })
        .collect::<String>();
    let bytes = damaged(case, &lines);
    let Ok(text) = String::from_utf8(bytes) else { return Ok(Taken::Refused) };
    let Ok(scene) = parse(&text, "scene.toml") else { return Ok(Taken::Refused) };
    let mut frames = 0;
    for message in SceneSource::new(&scene).take(600) {
        let Ok(message) = message else { return Ok(Taken::Refused) };
        let wild = fields(&message)
            .into_iter()
            .find(|field| field.float(&message.data).is_some_and(|value| !value.is_finite()));
        if let Some(field) = wild {
            return Err(Finding::new(Class::NotFinite, format!("{}: {}", message.channel.topic, field.name)));
        }
        frames += u32::from(message.channel.topic.contains("image"));
        if frames == 4 {
            break;
        }
    }
    Ok(Taken::Accepted)
}

/// What a gate in continuous integration reads.
pub fn gate(case: &mut Case) -> Outcome {
    let reference: String =
        include_str!("../../../replay/references/demo.jsonl").split_inclusive('\n').take(6).collect();
    let suite = without_comments(include_str!("../../../replay/shelf.toml"));
    let sound = if case.draw.chance(0.5) { suite } else { reference };
    let bytes = damaged(case, &sound);
    let Ok(text) = String::from_utf8(bytes) else { return Ok(Taken::Refused) };
    let suite = Suite::parse(&text, Path::new("folder/suite.toml"));
    let reference = Reference::parse(&text, "file");
    if let Ok(reference) = &reference
        && !Reference::parse(&reference.to_text(), "file").is_ok_and(|again| again.to_text() == reference.to_text())
    {
        return Err(Finding::new(Class::Silent, "a reference is not what it was when it is written and read again"));
    }
    Ok(if suite.is_ok() || reference.is_ok() { Taken::Accepted } else { Taken::Refused })
}
