//! What is named to a command may be no file at all, or one without an end: it is refused at once, in words that name it.

use std::fs;
use std::process::Command;

use rustix::fs::{CWD, FileType, Mode, mknodat};

use super::support::Room;

/// Every place of every command that takes a file, `@`.
const PLACES: [&str; 31] = [
    "replay @ -o captures",
    "replay log.mcap -o captures --config @",
    "replay log.mcap -o captures --field @",
    "replay log.mcap -o captures --set camera.lens=@",
    "replay log.mcap -o captures --set camera.body_mask=@",
    "record -o captures --config @",
    "doctor --config @",
    "scene render @ -o made.mcap",
    "scene check @",
    "scene apply @ --image image.png -o made.png",
    "scene apply scene.toml --image @ -o made.png",
    "tag @ --lens lens.toml --field kid-2009",
    "tag image.png --lens @ --field kid-2009",
    "tag image.png --lens lens.toml --attitude 0,20 --height 0.5 --field @",
    "eval CAPTURE --truth @",
    "eval @ --truth log.mcap",
    "export @ --to tum -o made.txt",
    "log info @",
    "check @",
    "measure cost @",
    "log cut @ --from 0 --to 1 -o made.mcap",
    "refine @",
    "log play @ --video made.avi",
    "db add @ --db made --field kid-2009",
    "db add images --db made --field @",
    "db stats --db @",
    "view --db @ --x 0 --y 0 --z 0.5 --yaw 0 -o made.png",
    "serve --db @ --listen 127.0.0.1:0",
    "serve --db db --listen 127.0.0.1:0 --token-file @",
    "serve --db db --listen 127.0.0.1:0 --scene @",
    "serve --db db --listen 127.0.0.1:0 --lens name=@",
];
/// Of address space. A process that is refused more ends with a signal or a panic.
const MEMORY_KB: u32 = 1_500_000;
const MAX_S: u32 = 20;

#[test]
fn what_is_no_file_or_has_no_end_is_refused_at_once_by_every_command() {
    let room = Room::with_walk();
    room.write("lens.toml", super::support::LENS);
    room.write_scene("scene.toml", |text| text);
    image::RgbImage::new(320, 240).save(room.path("image.png")).expect("saved");
    crate::service::add_images(&room, "images", &crate::service::PLACES);
    room.write("empty", "");
    fs::create_dir(room.path("folder")).expect("made");
    fs::File::create(room.path("sparse")).and_then(|file| file.set_len(8 << 30)).expect("made");
    mknodat(CWD, room.path("pipe"), FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).expect("a pipe");
    let _socket = std::os::unix::net::UnixListener::bind(room.path("socket")).expect("a socket");
    let capture = super::support::session_name(&room.replay("log.mcap"));
    let mut wrong = Vec::new();
    for place in PLACES.map(|place| place.replace("CAPTURE", &capture)) {
        for file in ["empty", "folder", "sparse", "pipe", "socket", "/dev/zero", "none"] {
            // A config may say nothing: everything has a default.
            if file == "empty" && place.contains("--config") {
                continue;
            }
            let line = format!(
                "ulimit -v {MEMORY_KB}; exec timeout -k 1 {MAX_S} {} {}",
                env!("CARGO_BIN_EXE_realitysim"),
                place.replace('@', file)
            );
            let mut shell = Command::new("sh");
            let run = shell.args(["-c", &line]).current_dir(room.path("")).output().expect("a shell");
            let said = String::from_utf8_lossy(&run.stderr);
            let is_named = said.contains(file) && said.starts_with("realitysim: ") && !said.contains("panicked");
            if !matches!(run.status.code(), Some(1 | 2)) || !is_named {
                wrong.push(format!("{}: {:?}: {said}", place.replace('@', file), run.status.code()));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
