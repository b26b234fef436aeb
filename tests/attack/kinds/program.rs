//! The program itself, run with damaged files: folders of captures, single pictures, folders of pictures.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use glam::{DQuat, DVec3};
use realitysim::geometry::Isometry;
use realitysim::ros2::messages::{CompressedImage, PoseStamped};
use serde_json::Value;

use crate::case::{Case, Class, Finding, Outcome, Taken};
use crate::judge::files;
use crate::support::{IMAGE, LENS, TRUTH, decode_all};
use crate::{bytes, text};

/// A little less than a case may take, so that the child does not outlive it.
const MAX_RUN: Duration = Duration::from_secs(50);
/// A good fit, which says nothing of its accuracy, is no farther from the truth.
const TRUSTED_M: f64 = 0.5;
const CAPTURES: &str = "captures";

/// What a run of the program left.
struct Ran {
    code: i32,
    output: Vec<Value>,
}

/// In the case's folder; a process that panics, is killed or hangs is a finding.
fn run(case: &mut Case, arguments: &str) -> Result<Ran, Finding> {
    case.tell(format!("realitysim {arguments}"));
    let file = |name: &str| File::create(case.path(name)).expect("the case's folder can be written");
    let mut child = Command::new(env!("CARGO_BIN_EXE_realitysim"))
        .args(arguments.split_whitespace())
        .arg("--json")
        .current_dir(case.folder)
        // Nothing of this machine's own.
        .env("HOME", case.folder)
        .stdin(Stdio::null())
        .stdout(file("stdout"))
        .stderr(file("stderr"))
        .spawn()
        .expect("the program starts");
    let started = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().expect("a child") {
            break status;
        }
        if started.elapsed() > MAX_RUN {
            let _ = child.kill();
            let _ = child.wait();
            return Err(Finding::new(Class::Hang, format!("longer than {} s", MAX_RUN.as_secs())));
        }
        std::thread::sleep(Duration::from_millis(1));
    };
    let read = |name: &str| fs::read(case.path(name)).map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    let (stdout, stderr) = (read("stdout").unwrap_or_default(), read("stderr").unwrap_or_default());
    let said = || stderr.chars().take(600).collect::<String>().replace('\n', " ");
    if stderr.contains("memory allocation of") {
        return Err(Finding::new(Class::Memory, said()));
    }
    let code = match status.code() {
        Some(code @ 0..=3) if !stderr.contains("panicked at") => code,
        _ => return Err(Finding::new(Class::Panic, format!("{status}: {}", said()))),
    };
    let output: Result<Vec<Value>, _> = stdout.lines().map(serde_json::from_str).collect();
    let output = output.map_err(|error| Finding::new(Class::Silent, format!("its JSON is none: {error}: {stdout}")))?;
    if code != 0 && stderr.trim().is_empty() && output.is_empty() {
        return Err(Finding::new(Class::Silent, format!("exit code {code} without a word")));
    }
    Ok(Ran { code, output })
}

fn taken(ran: &Ran) -> Taken {
    if matches!(ran.code, 0 | 3) { Taken::Accepted } else { Taken::Refused }
}

/// Numbers of a text for other programs.
fn is_finite(path: &Path) -> Result<(), Finding> {
    let text = fs::read_to_string(path).unwrap_or_default();
    let mut words = text.split(|c: char| c.is_whitespace() || c == ',');
    match words.find(|word| matches!(*word, "NaN" | "inf" | "-inf" | "nan")) {
        Some(word) => Err(Finding::new(Class::NotFinite, format!("{}: {word}", path.display()))),
        None => Ok(()),
    }
}

fn copied(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("the case's folder can be written");
    for entry in fs::read_dir(from).expect("a folder").flatten() {
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copied(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).expect("copied");
        }
    }
}

/// One file of a capture is damaged, and what people do with captures is done with it.
pub fn capture(case: &mut Case) -> Outcome {
    copied(case.walks.captures(), &case.path(CAPTURES));
    let name = case.walks.session().file_name().expect("a name").to_string_lossy().into_owned();
    let session = format!("{CAPTURES}/{name}");
    let names = [
        "manifest.jsonl",
        "manifest.jsonl",
        "session.json",
        "metadata.yaml",
        "coverage.json",
        "0000.mcap",
        "0000.mcap",
    ];
    let damaged = *case.draw.one_of(&names);
    let path = case.path(&session).join(damaged);
    let sound = fs::read(&path).expect("a capture");
    let mut changed = sound.clone();
    if damaged.ends_with("mcap") || case.draw.chance(0.1) {
        bytes::damage(&mut case.draw, &mut changed);
    } else {
        changed = text::damage(&mut case.draw, &String::from_utf8_lossy(&sound));
        let (new, old) = (String::from_utf8_lossy(&changed).into_owned(), String::from_utf8_lossy(&sound).into_owned());
        let at = new.bytes().zip(old.bytes()).take_while(|(one, other)| one == other).count();
        let around = new.bytes().skip(at.saturating_sub(40)).take(90).collect::<Vec<u8>>();
        case.tell(format!("{:?}", String::from_utf8_lossy(&around)));
    }
    fs::write(&path, &changed).expect("written");
    case.tell(format!("{damaged} is damaged"));
    match case.draw.below(13) {
        0 => run(case, &format!("log info {session}")).map(|ran| taken(&ran)),
        1 => run(case, &format!("sessions list --captures {CAPTURES}")).map(|ran| taken(&ran)),
        2 => run(case, &format!("sessions show {name} --captures {CAPTURES}")).map(|ran| taken(&ran)),
        3 => {
            let ran = run(case, &format!("sessions verify --captures {CAPTURES}"))?;
            if damaged.ends_with("mcap") && changed != sound && ran.code == 0 {
                return Err(Finding::new(Class::Silent, "a segment that has changed is verified"));
            }
            Ok(taken(&ran))
        }
        4 => {
            let ran = run(case, &format!("sessions repair --captures {CAPTURES}"))?;
            // "A second run changes nothing."
            let before = contents(&case.path(CAPTURES));
            run(case, &format!("sessions repair --captures {CAPTURES}"))?;
            let same = before == contents(&case.path(CAPTURES));
            if same { Ok(taken(&ran)) } else { Err(Finding::new(Class::Silent, "a second repair changes something")) }
        }
        5 => {
            case.write("truth.mcap", case.walks.all[0].log());
            run(case, &format!("eval {session} --truth truth.mcap")).map(|ran| taken(&ran))
        }
        6 => {
            let ran = run(case, &format!("export --to tum -o out.tum {session}"))?;
            is_finite(&case.path("out.tum"))?;
            Ok(taken(&ran))
        }
        7 => {
            let ran = run(case, &format!("export --to images -o out {session}"))?;
            is_finite(&case.path("out/tags.csv"))?;
            Ok(taken(&ran))
        }
        8 => run(case, &format!("replay {session} -o again")).map(|ran| taken(&ran)),
        9 => run(case, &format!("refine {session}")).map(|ran| taken(&ran)),
        10 => {
            let ran = run(case, &format!("db add {session} --db db"))?;
            if ran.code == 0 {
                run(case, "db verify --db db")?;
                run(case, "db stats --db db")?;
                run(case, "view --db db --x -1.9 --y 0.1 --z 0.5 --yaw 5 --pitch 17 --width 64 -o view.png")?;
            }
            Ok(taken(&ran))
        }
        11 => {
            let ran = run(case, &format!("log cut {session} --from 0.2 --to 0.6 -o piece.mcap"))?;
            if ran.code == 0 {
                run(case, "log info piece.mcap")?;
            }
            Ok(taken(&ran))
        }
        _ => synced(case, &session),
    }
}

fn contents(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut all = Vec::new();
    let mut entries: Vec<PathBuf> =
        fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            all.extend(contents(&path));
        } else {
            all.push((path.clone(), fs::read(&path).unwrap_or_default()));
        }
    }
    all
}

/// What is acknowledged is there, with the hash that is acknowledged.
fn synced(case: &mut Case, session: &str) -> Outcome {
    if Command::new("rsync").arg("--version").stdout(Stdio::null()).status().is_err_and(is_missing) {
        return Ok(Taken::Refused);
    }
    let ran = run(case, &format!("sync {CAPTURES} -o copies"))?;
    let hashes: Vec<String> = contents(&case.path("copies"))
        .iter()
        .filter(|(path, _)| path.extension().is_some_and(|ending| ending == "mcap"))
        .map(|(_, bytes)| blake3::hash(bytes).to_hex().to_string())
        .collect();
    for acknowledged in files(&case.path(session).join("ack"), "jsonl") {
        for line in fs::read_to_string(acknowledged).unwrap_or_default().lines() {
            let line: Value = serde_json::from_str(line).unwrap_or_default();
            if !hashes.iter().any(|hash| line["blake3"] == **hash) {
                return Err(Finding::new(Class::Silent, format!("acknowledged, and not there: {line}")));
            }
        }
    }
    run(case, &format!("sync {CAPTURES} -o copies"))?;
    Ok(taken(&ran))
}

fn is_missing(error: io::Error) -> bool {
    error.kind() == io::ErrorKind::NotFound
}

/// The first frame of the first walk.
fn frame(case: &Case) -> Vec<u8> {
    let image = decode_all::<CompressedImage>(&case.walks.all[0].messages, IMAGE).into_iter().next();
    image.expect("a frame").data
}

/// One picture, with a lens. A good fit is one that is near the truth, and of what shows no field there is none.
pub fn picture(case: &mut Case) -> Outcome {
    let shows_nothing = case.draw.chance(0.2);
    let mut image = if shows_nothing { super::log::picture(&mut case.draw) } else { frame(case) };
    if case.draw.chance(0.3)
        && let Ok(pixels) = image::load_from_memory(&image).map(|image| image.to_rgb8())
    {
        let mut png = io::Cursor::new(Vec::new());
        pixels.write_to(&mut png, image::ImageFormat::Png).expect("encodes");
        image = png.into_inner();
    }
    if case.draw.chance(0.9) {
        bytes::damage(&mut case.draw, &mut image);
    }
    case.write("picture", image);
    let another_lens = case.draw.chance(0.2);
    let lens = if another_lens { text::damage(&mut case.draw, LENS) } else { LENS.into() };
    case.write("lens.toml", lens);
    // To search a whole field takes long.
    let near = if case.draw.chance(0.8) { "--initial=-1.96,0.1,3" } else { "" };
    let truth =
        decode_all::<PoseStamped>(&case.walks.all[0].messages, TRUTH).into_iter().next().expect("of every frame");
    let (p, q) = (truth.pose.position, truth.pose.orientation);
    let euler = Isometry::new(DQuat::from_xyzw(q.x, q.y, q.z, q.w), DVec3::new(p.x, p.y, p.z)).euler();
    let tilt = format!("--attitude={:.3},{:.3} --height {:.4}", euler.roll.to_degrees(), euler.pitch.to_degrees(), p.z);
    let ran = run(case, &format!("tag picture --lens lens.toml {tilt} --field kid-2009 {near}"))?;
    let Some(line) = ran.output.first().filter(|_| ran.code == 0) else { return Ok(taken(&ran)) };
    let [x, y] = ["x", "y"].map(|name| line["best"]["pose"][name].as_f64().unwrap_or(f64::NAN));
    let off_m = [1.0, -1.0].map(|sign| f64::hypot(x - sign * p.x, y - sign * p.y)).into_iter().fold(f64::NAN, f64::min);
    if !off_m.is_finite() {
        return Err(Finding::new(Class::NotFinite, format!("exit code 0, and no pose: {line}")));
    }
    if line["fit"] == "good" && !another_lens && (shows_nothing || off_m > TRUSTED_M) {
        return Err(Finding::new(Class::Wrong, format!("a good fit {off_m:.2} m off: {line}")));
    }
    Ok(taken(&ran))
}

/// A folder of pictures with their poses, into a database.
pub fn pictures(case: &mut Case) -> Outcome {
    let folder = case.path("pictures");
    fs::create_dir_all(&folder).expect("the case's folder can be written");
    let info = super::texts::CALIBRATED;
    let mut poses = "file,x,y,z,yaw_deg,pitch_deg,roll_deg\n".to_owned();
    for (number, x) in [-1.96, -1.9, -1.85].into_iter().enumerate() {
        poses += &format!("{number}.jpg,{x},0.1,0.5,3,17,0\n");
        fs::write(folder.join(format!("{number}.jpg")), frame(case)).expect("written");
    }
    let (mut poses, mut info) = (poses.into_bytes(), info.as_bytes().to_vec());
    match case.draw.below(3) {
        0 => poses = text::damage(&mut case.draw, &String::from_utf8_lossy(&poses)),
        1 => info = text::damage(&mut case.draw, &String::from_utf8_lossy(&info)),
        _ => {
            let mut image = frame(case);
            bytes::damage(&mut case.draw, &mut image);
            fs::write(folder.join("1.jpg"), image).expect("written");
        }
    }
    fs::write(folder.join("poses.csv"), poses).expect("written");
    fs::write(folder.join("camera_info.yaml"), info).expect("written");
    let ran = run(case, "db add pictures --db db --field kid-2009")?;
    if ran.code == 0 {
        run(case, "db verify --db db")?;
        run(case, "db coverage --db db -o coverage.png")?;
        let at = "--x -1.9 --y 0.12 --z 0.5 --yaw 5 --pitch 17";
        run(case, &format!("view --db db {at} -o view.png"))?;
    }
    Ok(taken(&ran))
}
