//! Folders as somebody else left them: refused or set aside by name, never followed, never deleted.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::Command;

use rustix::fs::{CWD, FileType};

use super::site::{Site, Synced, append, contents, line, noise};

/// Every file under a folder with its content; links as where they lead.
fn everything(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut all = BTreeMap::new();
    for entry in fs::read_dir(folder).expect("read").map(|entry| entry.expect("an entry")) {
        let (path, kind) = (entry.path(), entry.file_type().expect("a kind"));
        let name = path.display().to_string();
        if kind.is_symlink() {
            all.insert(name, fs::read_link(&path).expect("a link").into_os_string().into_encoded_bytes());
        } else if kind.is_dir() {
            all.insert(name, Vec::new());
            all.extend(everything(&path));
        } else {
            all.insert(name, fs::read(&path).expect("read"));
        }
    }
    all
}

/// A good session and a bad one; the good one comes whatever the bad one is.
fn beside_a_good_one(bad: impl Fn(&Site, &Path), says: &[&str]) -> Option<Site> {
    let site = Site::new()?;
    site.session("robot", "good", &[noise(1, 1_000)]);
    let folder = site.session("robot", "strange", &[noise(2, 1_000), noise(3, 1_000)]);
    fs::create_dir(site.path("outside")).expect("made");
    fs::write(site.path("outside/secret"), "secret").expect("written");
    bad(&site, &folder);
    let before = (everything(&site.path("robot")), everything(&site.path("outside")));
    let mut synced = site.sync("robot", "dev", &["--no-acknowledge"]);
    // What stays behind is told by 1.
    assert!(matches!(synced.code, Some(0 | 1 | 3)) && !synced.stderr.contains("panicked"), "{synced:?}");
    for words in says {
        synced = synced.says(words);
    }
    assert!(contents(&site.path("dev")).contains_key(&("good".to_owned(), "0000.mcap".to_owned())), "{synced:?}");
    assert!(before == (everything(&site.path("robot")), everything(&site.path("outside"))), "something was changed");
    for bytes in contents(&site.path("dev")).values() {
        assert!((1..4).any(|seed| *bytes == noise(seed, 1_000)), "something else came");
    }
    Some(site)
}

#[test]
fn a_manifest_that_is_missing_torn_or_edited() {
    let says = "strange/manifest.jsonl: missing";
    beside_a_good_one(|_, folder| fs::remove_file(folder.join("manifest.jsonl")).expect("removed"), &[says]);
    beside_a_good_one(
        |_, folder| fs::write(folder.join("manifest.jsonl"), b"\0\xff\n[]\n").expect("written"),
        &["manifest.jsonl: line 1: damaged", "line 2: damaged"],
    );
    let twice = |_: &Site, folder: &Path| {
        append(&folder.join("manifest.jsonl"), &line("0000.mcap", 0, &noise(9, 1_000)).to_string());
    };
    let site = beside_a_good_one(twice, &["line 3: 0000.mcap stands twice, and not alike"]);
    if let Some(site) = site {
        assert_eq!(contents(&site.path("dev")).len(), 2, "the good one, and the line that is not doubted");
    }
    let torn = |_: &Site, folder: &Path| {
        let path = folder.join("manifest.jsonl");
        let text = fs::read_to_string(&path).expect("read");
        fs::write(&path, &text[..text.len() - 30]).expect("written");
    };
    beside_a_good_one(torn, &[]);
}

#[test]
fn another_version_or_no_session_at_all() {
    let head = |text: &'static str| {
        move |_: &Site, folder: &Path| fs::write(folder.join("session.json"), text).expect("written")
    };
    beside_a_good_one(head(r#"{"format":2}"#), &["strange: session.json: written in format 2"]);
    beside_a_good_one(head("{"), &["strange: session.json: "]);
    beside_a_good_one(
        |_, folder| fs::remove_file(folder.join("session.json")).expect("removed"),
        &["strange: no session"],
    );
}

/// Segments that were recorded once, and that nobody can say anything of.
#[test]
fn a_session_without_a_head_fails_sync_verify_and_repair_by_name() {
    let Some(site) = Site::new() else { return };
    site.session("robot", "good", &[noise(1, 1_000)]);
    let folder = site.session("robot", "strange", &[noise(2, 1_000), noise(3, 1_000)]);
    let left = |dev: &str| site.sync("robot", dev, &["--json"]).ends(1).json()["left_there"].as_u64();
    for (head, dev) in [(r#"{"format":2}"#, "newer"), ("{", "torn"), ("", "empty")] {
        fs::write(folder.join("session.json"), head).expect("written");
        assert_eq!(left(dev), Some(2), "{head:?}");
    }
    fs::remove_file(folder.join("session.json")).expect("removed");
    assert_eq!(left("without"), Some(2));
    fs::remove_file(folder.join("manifest.jsonl")).expect("removed");
    assert_eq!(left("without_both"), Some(2));
    for command in ["verify", "repair"] {
        let told = site.run(&format!("sessions {command} --captures robot"));
        assert!(told.code != Some(0) && told.stdout.contains("strange: has no session.json"), "{told:?}");
    }
}

#[test]
fn names_that_try_to_leave_the_folder() {
    for name in
        ["../outside/secret", "/etc/passwd", "..", "0000.mcap/../../x", "0001.mcap\0", "-e sh", "a/0000.mcap", ""]
    {
        let edited = |_: &Site, folder: &Path| {
            append(&folder.join("manifest.jsonl"), &line(name, 2, b"secret").to_string());
        };
        beside_a_good_one(edited, &["strange/manifest.jsonl: line 3: ", "is no segment's name"]);
    }
}

#[test]
fn links_are_not_followed() {
    let segment = |site: &Site, folder: &Path| {
        fs::remove_file(folder.join("0000.mcap")).expect("removed");
        symlink(site.path("outside/secret"), folder.join("0000.mcap")).expect("linked");
    };
    beside_a_good_one(segment, &["strange/0000.mcap: a link: not followed"]);
    let session = |site: &Site, _: &Path| symlink(site.path("outside"), site.path("robot/elsewhere")).expect("linked");
    beside_a_good_one(session, &["elsewhere: a link"]);
    let manifest = |site: &Site, folder: &Path| {
        fs::remove_file(folder.join("manifest.jsonl")).expect("removed");
        symlink(site.path("outside/secret"), folder.join("manifest.jsonl")).expect("linked");
    };
    beside_a_good_one(manifest, &["strange/manifest.jsonl: "]);
}

#[test]
fn foreign_files_are_named_and_left_alone() {
    let foreign = |_: &Site, folder: &Path| {
        fs::write(folder.join("notes.txt"), "mine").expect("written");
        fs::write(folder.join("12345.mcap.bak"), "mine").expect("written");
        fs::create_dir(folder.join("thumbs")).expect("made");
        rustix::fs::mknodat(rustix::fs::CWD, folder.join("pipe"), rustix::fs::FileType::Fifo, 0o600.into(), 0)
            .expect("made");
    };
    let says =
        ["strange/notes.txt: not of this session", "12345.mcap.bak", "thumbs", "strange/pipe: not of this session"];
    // A pipe cannot be read for the comparison before and after: it is looked at by its name alone.
    let Some(site) = Site::new() else { return };
    let folder = site.session("robot", "strange", &[noise(2, 1_000)]);
    foreign(&site, &folder);
    let mut synced = site.sync("robot", "dev", &[]).ends(0);
    for words in says {
        synced = synced.says(words);
    }
    assert_eq!(site.holds("robot", &["dev"]), 1);
    assert!(folder.join("notes.txt").exists() && folder.join("thumbs").is_dir() && folder.join("pipe").exists());
    let here: Vec<_> =
        fs::read_dir(site.path("dev/strange")).expect("read").map(|e| e.expect("one").file_name()).collect();
    assert!(!here.iter().any(|name| name == "notes.txt" || name == "pipe"), "{here:?}");
}

#[test]
fn a_copied_session_is_one_session() {
    let copied = |site: &Site, folder: &Path| {
        fs::create_dir(site.path("robot/strange-copy")).expect("made");
        for name in ["session.json", "manifest.jsonl", "0000.mcap"] {
            fs::copy(folder.join(name), site.path("robot/strange-copy").join(name)).expect("copied");
        }
    };
    beside_a_good_one(copied, &["strange-copy: the same session as strange"]);
}

#[test]
fn what_lies_in_the_way_here_is_neither_followed_nor_overwritten() {
    let Some(site) = Site::new() else { return };
    site.session("robot", "s", &[noise(1, 1_000)]);
    fs::create_dir_all(site.path("outside/empty")).expect("made");
    fs::create_dir_all(site.path("dev")).expect("made");
    symlink(site.path("outside/empty"), site.path("dev/s")).expect("linked");
    site.sync("robot", "dev", &[]).ends(0).says("not followed");
    assert_eq!(fs::read_dir(site.path("outside/empty")).expect("read").count(), 0);
    fs::remove_dir_all(site.path("dev")).expect("removed");
    fs::create_dir_all(site.path("dev")).expect("made");
    symlink(site.path("outside/empty"), site.path("dev/s")).expect("linked");
    fs::remove_file(site.path("dev/s")).expect("removed");
    fs::create_dir(site.path("dev/s")).expect("made");
    fs::write(site.path("dev/s/session.json"), r#"{"format":1,"robot":"other","started":"x"}"#).expect("written");
    // A folder of that name with another session: ours gets a name of its own.
    site.sync("robot", "dev", &[]).ends(0);
    assert_eq!(fs::read_dir(site.path("dev/s")).expect("read").count(), 1);
    assert_eq!(contents(&site.path("dev")).len(), 1);
    // A link in place of a segment is moved aside, not written through.
    let folder = contents(&site.path("dev")).into_keys().next().expect("one").0;
    let segment = site.path("dev").join(folder).join("0000.mcap");
    fs::remove_file(&segment).expect("removed");
    fs::write(site.path("outside/secret"), "secret").expect("written");
    symlink(site.path("outside/secret"), &segment).expect("linked");
    site.sync("robot", "dev", &[]).ends(0);
    assert_eq!(fs::read_to_string(site.path("outside/secret")).expect("read"), "secret");
    assert!(segment.symlink_metadata().expect("there").is_file());
}

#[test]
fn nothing_is_synced_into_a_capture_or_into_its_own_source() {
    let Some(site) = Site::new() else { return };
    site.session("robot", "s", &[noise(1, 1_000)]);
    site.sync("robot", "robot/s", &[]).ends(2);
    site.sync("robot", "robot", &[]).ends(2);
    site.sync("robot", "robot/new", &[]).ends(2);
}

#[test]
fn a_damaged_copy_does_not_hide_the_whole_session() {
    let Some(site) = Site::new() else { return };
    let whole = site.session("robot", "s", &[noise(1, 1_000), noise(2, 1_000)]);
    fs::create_dir(site.path("robot/0-copy")).expect("made");
    for name in ["session.json", "manifest.jsonl", "0000.mcap"] {
        fs::copy(whole.join(name), site.path("robot/0-copy").join(name)).expect("copied");
    }
    site.sync("robot", "dev", &[]).ends(0).says("0-copy: the same session as s");
    assert_eq!(contents(&site.path("dev")).len(), 2);
}

#[test]
fn a_session_is_no_folder_of_captures() {
    let Some(site) = Site::new() else { return };
    site.session("robot", "s", &[noise(1, 1_000)]);
    site.sync("robot/s", "dev", &[]).ends(2).says("sync robot s");
}

#[test]
fn counts_that_are_absurd_do_not_wrap() {
    let Some(site) = Site::new() else { return };
    let folder = site.session("robot", "s", &[noise(1, 1_000), noise(2, 1_000)]);
    let path = folder.join("manifest.jsonl");
    let text =
        fs::read_to_string(&path).expect("read").replacen("\"captured\":4", "\"captured\":18446744073709551615", 1);
    fs::write(&path, text).expect("written");
    let listed = site.run("sessions list --captures robot --json").ends(0).json();
    assert_eq!(listed[0]["frames"]["captured"].as_u64(), Some(u64::MAX), "{listed}");
}

#[test]
fn a_pipe_or_a_device_in_the_place_of_a_file_is_named_and_not_waited_for() {
    let Some(site) = Site::new() else { return };
    for name in [
        "0000.mcap",
        "0002.mcap",
        "0002.mcap.active",
        "session.json",
        "manifest.jsonl",
        "evicted.jsonl",
        "coverage.json",
    ] {
        for kind in [FileType::Fifo, FileType::CharacterDevice] {
            let folder = site.session("robot", "s", &[noise(1, 1_000), noise(2, 1_000)]);
            let _ = fs::remove_file(folder.join(name));
            // /dev/zero never ends.
            let made = rustix::fs::mknodat(CWD, folder.join(name), kind, 0o600.into(), rustix::fs::makedev(1, 5));
            if made.is_err() && kind == FileType::CharacterDevice {
                println!("skipped: only root makes devices");
                continue;
            }
            made.expect("made");
            for command in [
                "log info --quick robot/s",
                "log info robot/s",
                "replay robot/s -o replayed",
                "export robot/s -o ex --to tum",
                "sessions list --captures robot",
                "sessions show robot/s",
                "sessions verify --captures robot",
                "sessions repair --captures robot",
                "sessions prune --captures robot",
                "sync robot -o dev",
            ] {
                let program = env!("CARGO_BIN_EXE_realitysim");
                let mut run = Command::new("timeout");
                run.args(["20", program]).args(command.split(' ')).current_dir(site.path(""));
                let ended = Synced::of(run.output().expect("ran"));
                // Nothing rests on these two; and what no manifest lists is not for repair to mend, or for prune to delete.
                let is_quiet = ["coverage.json", "evicted.jsonl"].contains(&name)
                    || command.contains("prune")
                    || command.contains("repair") && name.starts_with("0002");
                assert!(
                    matches!(ended.code, Some(0..=3)) && !ended.stderr.contains("panicked"),
                    "{name}, {command}: {ended:?}"
                );
                let said = format!("{}{}", ended.stdout, ended.stderr);
                assert!(is_quiet || ended.code != Some(0) || said.contains(name), "{name}, {command}: {ended:?}");
            }
            assert!(!folder.join(name).symlink_metadata().expect("it stays").is_file());
            fs::remove_dir_all(site.path("robot")).expect("removed");
            let _ = fs::remove_dir_all(site.path("dev"));
        }
    }
}

#[test]
fn what_is_written_beside_a_file_does_not_lead_away() {
    let Some(site) = Site::new() else { return };
    let folder = site.session("robot", "s", &[noise(1, 1_000), noise(2, 1_000)]);
    fs::write(site.path("secret"), "secret").expect("written");
    symlink(site.path("secret"), folder.join("manifest.new")).expect("linked");
    symlink(site.path("secret"), folder.join("metadata.new")).expect("linked");
    fs::remove_file(folder.join("manifest.jsonl")).expect("removed");
    site.run("sessions repair --captures robot");
    assert_eq!(fs::read_to_string(site.path("secret")).expect("read"), "secret");
}
