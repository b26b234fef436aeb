//! `sessions` on both sides.

use std::fs;

use super::site::{Site, append, finish_segment, noise};

fn names(decisions: &serde_json::Value) -> Vec<&str> {
    let all = decisions["sessions"].as_array().expect("decisions").iter();
    all.filter(|one| one["goes"] == true).map(|one| one["session"].as_str().expect("a name")).collect()
}

#[test]
fn a_list_says_what_is_there_and_who_has_it() {
    let Some(site) = Site::new() else { return };
    site.session("robot", "a", &[noise(1, 1_000), noise(2, 500)]);
    site.session("robot", "b", &[noise(3, 100)]);
    site.sync("robot", "dev", &["a"]).ends(0);
    site.run("sessions pin b --captures robot").ends(0);
    let listed = site.run("sessions list --captures robot --json").ends(0).json();
    let (a, b) = (&listed[0], &listed[1]);
    assert_eq!(
        (a["segments"].as_u64(), a["synced"].as_u64(), a["bytes"].as_u64()),
        (Some(2), Some(2), Some(1_500)),
        "{listed}"
    );
    assert_eq!((a["frames"]["captured"].as_u64(), a["duration_s"].as_f64()), (Some(8), Some(119.0)), "{listed}");
    assert_eq!((b["synced"].as_u64(), b["pinned"].as_bool()), (Some(0), Some(true)), "{listed}");
    let text = site.run("sessions list --captures robot").ends(0).stdout;
    assert!(text.contains("synced") && text.contains("pinned"), "{text}");
    site.run("sessions unpin b --captures robot").ends(0);
    let shown = site.run("sessions show robot/b --json").ends(0).json();
    assert_eq!(shown["pinned"], false, "{shown}");
    site.run("sessions show c --captures robot").ends(2);
    site.run("sessions pin a c --captures robot").ends(2);
    assert!(!site.path("robot/a/pinned").exists(), "all or none");
}

#[test]
fn only_what_another_store_has_is_pruned_and_a_dry_run_changes_nothing() {
    let Some(site) = Site::new() else { return };
    for name in ["a", "b", "c"] {
        site.session("robot", name, &[noise(1, 1_000)]);
    }
    site.sync("robot", "dev", &["a"]).ends(0);
    site.sync("robot", "dev", &["b"]).ends(0);
    site.run("sessions pin b --captures robot").ends(0);
    let decided = site.run("sessions prune --captures robot --json").ends(0).json();
    assert_eq!((names(&decided), decided["done"].as_bool()), (vec!["a"], Some(false)), "{decided}");
    assert!(site.path("robot/a").is_dir());
    site.run("sessions prune --captures robot --yes").ends(0);
    assert!(!site.path("robot/a").exists() && site.path("robot/b").is_dir() && site.path("robot/c").is_dir());
    // Acknowledgements of others count, one's own do not.
    let here = site.run("sessions prune --captures dev --json").ends(0).json();
    assert_eq!(names(&here), [""; 0], "{here}");
    fs::write(site.path("robot/c/mine.txt"), "").expect("written");
    let forced = site.run("sessions prune --captures robot --force --json").ends(0).json();
    assert_eq!(names(&forced), [""; 0], "a foreign file keeps its session: {forced}");
}

#[test]
fn what_is_pruned_is_not_acknowledged_nor_fetched_again_unasked() {
    let Some(site) = Site::new() else { return };
    site.session("robot", "a", &[noise(1, 1_000)]);
    site.sync("robot", "dev", &[]).ends(0);
    site.sync("dev", "archive", &[]).ends(0);
    let decided = site.run("sessions prune --captures dev --yes --json").ends(0).json();
    assert_eq!(names(&decided), ["a"], "the archive has acknowledged it: {decided}");
    let report = site.sync("robot", "dev", &["--json"]).ends(0).json();
    assert_eq!(report["fetched"], 0, "{report}");
    assert_eq!(site.holds("robot", &["dev"]), 0, "taken back");
    site.sync("robot", "dev", &["a"]).ends(0);
    assert_eq!(site.holds("robot", &["dev"]), 1, "named, it comes again");
}

#[test]
fn a_copy_that_is_verified_now_is_as_good_as_an_acknowledgement() {
    let Some(site) = Site::new() else { return };
    site.session("robot", "a", &[noise(1, 1_000)]);
    site.sync("robot", "dev", &["--no-acknowledge"]).ends(0);
    let pruned = |copy: &str| site.run(&format!("sessions prune --captures robot --copy {copy} --json")).ends(0).json();
    assert_eq!(names(&pruned("dev")), ["a"]);
    let mut bytes = noise(1, 1_000);
    bytes[7] ^= 4;
    fs::write(site.path("dev/a/0000.mcap"), bytes).expect("written");
    assert_eq!(names(&pruned("dev")), [""; 0], "one bit is enough");
}

#[test]
fn however_folders_acknowledge_each_other_the_last_copy_stays() {
    // In circles of two and of three, along a chain, among siblings, in every order of the first two steps.
    let ways: [&[(&str, &str)]; 6] = [
        &[("robot", "a"), ("a", "b"), ("b", "a")],
        &[("robot", "a"), ("a", "b"), ("b", "c"), ("c", "a")],
        &[("robot", "a"), ("robot", "b"), ("robot", "c"), ("a", "b"), ("c", "a"), ("b", "c")],
        &[("robot", "a"), ("robot", "b"), ("a", "b"), ("b", "a"), ("a", "b")],
        &[("robot", "a"), ("a", "robot"), ("robot", "a")],
        &[("robot", "a"), ("a", "b"), ("b", "robot"), ("robot", "b")],
    ];
    for way in ways {
        let Some(site) = Site::new() else { return };
        site.session("robot", "s", &[noise(1, 1_000), noise(2, 500)]);
        for (from, to) in way {
            site.sync(from, to, &[]).ends(0);
        }
        for _ in 0..2 {
            for folder in ["robot", "a", "b", "c"].into_iter().filter(|folder| site.path(folder).is_dir()) {
                site.run(&format!("sessions prune --captures {folder} --yes")).ends(0);
            }
        }
        let left = ["robot", "a", "b", "c"].into_iter().filter(|folder| site.path(folder).join("s").is_dir());
        assert!(left.count() > 0, "all gone after {way:?}");
        assert!(!site.path("robot/s").exists(), "the robot may rely on who synced from it: {way:?}");
    }
}

#[test]
fn a_session_that_had_not_ended_at_its_source_is_not_called_whole() {
    let Some(site) = Site::new() else { return };
    let folder = site.session("robot", "s", &[noise(1, 1_000)]);
    fs::write(folder.join("0001.mcap.active"), "being written").expect("written");
    site.sync("robot", "dev", &[]).ends(0);
    // The robot is away now: what was seen last is all that is known.
    fs::rename(site.path("robot"), site.path("away")).expect("renamed");
    let state_of = |text: &str| text.lines().find(|line| line.starts_with("s ")).expect("a row").to_owned();
    let listed = || state_of(&site.run("sessions list --captures dev").ends(0).stdout);
    let shown = || state_of(&site.run("sessions show s --captures dev").ends(0).stdout);
    let said = listed();
    assert!(
        said.contains("1 segments here, not ended at ") && said.contains(" s ago") && !said.contains("whole"),
        "{said}"
    );
    assert!(shown().contains("1 segments here, not ended at "), "{}", shown());
    fs::rename(site.path("away"), site.path("robot")).expect("renamed");
    fs::remove_file(folder.join("0001.mcap.active")).expect("removed");
    finish_segment(&folder, 1, &noise(2, 1_000));
    site.sync("robot", "dev", &[]).ends(0);
    assert!(listed().contains("2 segments here, not ended at "), "nothing says that it is over: {}", listed());
    fs::write(folder.join("metadata.yaml"), "written last of all").expect("written");
    site.sync("robot", "dev", &[]).ends(0);
    // Columns are as wide as what stands in them.
    let words = |row: &str| row.split_whitespace().map(str::to_owned).collect::<Vec<_>>();
    assert!(listed().contains("whole here") && words(&shown()) == words(&listed()), "{} {}", shown(), listed());
    let row = site.run("sessions show s --captures dev --json").ends(0).json();
    assert_eq!((row["source"]["ended"].as_bool(), row["at_source"].as_u64()), (Some(true), Some(2)), "{row}");
}

#[test]
fn a_session_is_named_by_the_beginning_of_its_name_if_there_is_one_such() {
    let Some(site) = Site::new() else { return };
    for name in ["2026-11-21-a", "2026-11-21-b", "2026-11-22-a"] {
        site.session("robot", name, &[noise(1, 1_000)]);
    }
    site.session("robot", "2026-11-21", &[noise(2, 1_000)]);
    let shown = site.run("sessions show 2026-11-22 --captures robot --json").ends(0).json();
    assert_eq!(shown["session"], "2026-11-22-a");
    let whole = site.run("sessions show 2026-11-21 --captures robot --json").ends(0).json();
    assert_eq!(whole["session"], "2026-11-21", "the name itself");
    let pinned = site.run("sessions pin 2026-11-22 --captures robot --json").ends(0).json();
    assert_eq!(pinned["sessions"][0], "2026-11-22-a", "{pinned}");
    let decided = site.run("sessions prune 2026-11-22 --captures robot --json --force --pinned").ends(0).json();
    assert_eq!(names(&decided), ["2026-11-22-a"], "{decided}");
    for command in ["show", "pin", "prune", "verify", "repair"] {
        let said = site.run(&format!("sessions {command} 2026-11-21- --captures robot")).ends(2);
        assert!(said.stderr.contains("2026-11-21-a, 2026-11-21-b"), "{said:?}");
        site.run(&format!("sessions {command} 2025 --captures robot")).ends(2);
    }
}

#[test]
fn what_was_removed_to_make_room_is_shown_as_such() {
    let Some(site) = Site::new() else { return };
    let folder = site.session("robot", "s", &(0..3).map(|index| noise(index, 1_000)).collect::<Vec<_>>());
    site.sync("robot", "dev", &[]).ends(0);
    let hash = super::site::hash_of(&noise(0, 1_000));
    let note = serde_json::json!({ "file": "0000.mcap", "bytes": 1_000, "blake3": hash, "receiver": "dev" });
    append(&folder.join("evicted.jsonl"), &note.to_string());
    fs::remove_file(folder.join("0000.mcap")).expect("removed");
    fs::remove_file(folder.join("0001.mcap")).expect("removed");
    let shown = site.run("sessions show s --captures robot --json").ends(3).json();
    let states: Vec<_> = shown["manifest"].as_array().expect("lines").iter().map(|line| &line["state"]).collect();
    assert_eq!(states, ["evicted", "missing", "here"], "{shown}");
    let text = site.run("sessions show s --captures robot").ends(3).stdout;
    assert!(text.lines().any(|line| line.contains("0000.mcap") && line.ends_with("removed after a sync")), "{text}");
    assert!(text.lines().any(|line| line.contains("0001.mcap") && line.contains("missing")), "{text}");
}

#[test]
fn a_folder_that_has_lost_its_name_takes_no_acknowledgement_for_another_s() {
    let Some(site) = Site::new() else { return };
    site.session("robot", "s", &[noise(1, 1_000)]);
    site.sync("robot", "dev", &[]).ends(0);
    fs::remove_dir_all(site.path("dev/.sync")).expect("removed");
    let left = |captures: &str| {
        let decided = site.run(&format!("sessions prune --captures {captures} --json")).ends(0).json();
        assert_eq!(names(&decided), [""; 0], "its own word only: {decided}");
    };
    left("dev");
    // Elsewhere it gets another name, and what it said under the first one is not another store's word either.
    fs::rename(site.path("dev"), site.path("moved")).expect("renamed");
    site.sync("robot", "moved", &[]).ends(0);
    left("moved");
    // Another store's word counts again as soon as it is heard.
    site.sync("moved", "archive", &[]).ends(0);
    let decided = site.run("sessions prune --captures moved --json").ends(0).json();
    assert_eq!(names(&decided), ["s"], "{decided}");
}

#[test]
fn what_is_only_known_from_a_source_is_shown_too() {
    let Some(site) = Site::new() else { return };
    site.session("robot", "2026-11-21-a", &[noise(1, 1_000), noise(2, 1_000)]);
    site.session("robot", "2026-11-22-a", &[noise(3, 1_000)]);
    site.sync("robot", "dev", &["2026-11-22"]).ends(0);
    let shown = site.run("sessions show 2026-11-21 --captures dev --json").ends(0).json();
    assert_eq!((shown["segments"].as_u64(), shown["at_source"].as_u64()), (Some(0), Some(2)), "{shown}");
    assert_eq!((&shown["manifest"][1]["state"], &shown["missing"]), (&"source".into(), &0.into()), "{shown}");
    let text = site.run("sessions show 2026-11-21 --captures dev").ends(0).stdout;
    let listed = site.run("sessions list --captures dev").ends(0).stdout;
    let state = "0 of 2 segments here, not ended at ";
    assert!(text.contains(state) && listed.contains(state), "{text}{listed}");
    site.run("sessions pin 2026-11-21 --captures dev").ends(2);
    site.run("sessions show 2027 --captures dev").ends(2);
}

/// Changes what a line of the manifest says.
fn edit(site: &Site, path: &str, row: usize, change: impl Fn(&mut serde_json::Value)) {
    let path = site.path(path);
    let text = fs::read_to_string(&path).expect("read");
    let rows = text.lines().enumerate().map(|(index, text)| {
        let mut value = serde_json::from_str(text).expect("JSON");
        if index == row {
            change(&mut value);
        }
        value.to_string() + "\n"
    });
    fs::write(&path, rows.collect::<String>()).expect("written");
}

#[test]
fn a_segment_without_messages_is_of_no_time() {
    let Some(site) = Site::new() else { return };
    site.session("robot", "s", &[noise(1, 1_000), noise(2, 1_000)]);
    edit(&site, "robot/s/manifest.jsonl", 1, |line| {
        for key in ["messages", "first_ns", "last_ns"] {
            line[key] = 0.into();
        }
    });
    let listed = site.run("sessions list --captures robot --json").ends(0).json();
    assert_eq!(listed[0]["duration_s"].as_f64(), Some(59.0), "{listed}");
    let fetched = |more: &[&str]| site.sync("robot", "dev", more).ends(0).json()["fetched"].as_u64();
    assert_eq!(fetched(&["--json", "--until", "2020-01-01"]), Some(0));
    assert_eq!(fetched(&["--json", "--since", "1960-01-01"]), Some(1));
    assert_eq!(fetched(&["--json"]), Some(1));
}

#[test]
fn what_a_repair_has_cut_off_is_told_by_list_and_show() {
    let Some(site) = Site::new() else { return };
    site.session("robot", "s", &[noise(1, 1_000), noise(2, 1_000)]);
    edit(&site, "robot/s/manifest.jsonl", 1, |line| line["cut_bytes"] = 258_000.into());
    let listed = site.run("sessions list --captures robot").ends(0).stdout;
    assert!(listed.contains("258.0 kB lost in a repair"), "{listed}");
    let shown = site.run("sessions show s --captures robot").ends(0).stdout;
    let row = shown.lines().find(|line| line.contains("0001.mcap")).expect("a row");
    assert!(row.contains("258.0 kB lost in a repair"), "{shown}");
}

#[test]
fn what_a_session_says_of_itself_moves_no_cursor() {
    let Some(site) = Site::new() else { return };
    site.session("robot", "s", &[noise(1, 1_000)]);
    edit(&site, "robot/s/session.json", 0, |head| {
        head["robot"] = "r\u{1b}[2J1".into();
        head["started"] = "\u{1b}[31m2026-11-21T10:00:00Z".into();
    });
    for command in ["sessions list", "sessions show s"] {
        let said = site.run(&format!("{command} --captures robot")).ends(0);
        assert!(!said.stdout.contains('\u{1b}'), "{said:?}");
    }
}
