//! Over a plain folder, as from a stick: what is chosen, what is here already, several robots and several machines.

use std::fs;
use std::time::{Duration, SystemTime};

use super::site::{Site, append, contents, finish_segment, hash_of, noise};

fn five(site: &Site) -> std::path::PathBuf {
    site.session("robot", "2026-11-21T10-00-00Z-r1", &(0..5).map(|index| noise(index, 5_000)).collect::<Vec<_>>())
}

#[test]
fn segments_are_chosen_by_session_time_place_and_validity() {
    let Some(site) = Site::new() else { return };
    five(&site);
    site.session("robot", "2026-11-22T10-00-00Z-r1", &[noise(9, 100)]);
    let taken = |dev: &str, more: &[&str]| {
        site.sync("robot", dev, more).ends(0);
        let names =
            contents(&site.path(dev)).into_keys().map(|(session, name)| format!("{}/{}", &session[8..10], &name[..4]));
        names.collect::<Vec<_>>().join(" ")
    };
    assert_eq!(taken("a", &["2026-11-22"]), "22/0000");
    assert_eq!(taken("b", &["2026-11-21", "--within", "2.7,0.2,0.25"]), "21/0002");
    assert_eq!(taken("c", &["--valid", "0.75"]), "21/0003 21/0004");
    // Segments last a minute each, from 17:46:40 on.
    let times = ["2026-11-21", "--since", "2030-03-17T17:47:45Z", "--until", "2030-03-17T17:48:45Z"];
    assert_eq!(taken("d", &times), "21/0001 21/0002");
    site.sync("robot", "e", &["2027"]).ends(2).says("there are: 2026-11-21T10-00-00Z-r1, 2026-11-22T10-00-00Z-r1");
    site.sync("robot", "e", &["--within", "1,2"]).ends(2);
    site.sync("nowhere", "e", &[]).ends(2).says("there is no such folder");
}

#[test]
fn what_exists_is_known_before_it_is_here() {
    let Some(site) = Site::new() else { return };
    five(&site);
    site.sync("robot", "dev", &["--valid", "1"]).ends(0);
    let listed = site.run("sessions list --captures dev --json").ends(0).json();
    assert_eq!((listed[0]["segments"].as_u64(), listed[0]["at_source"].as_u64()), (Some(1), Some(5)), "{listed}");
    // What is here is a whole capture by its own manifest.
    let shown = site.run("sessions show 2026-11-21T10-00-00Z-r1 --captures dev --json").ends(0).json();
    assert_eq!(shown["missing"], 0, "{shown}");
}

/// In rsync's lists a comment begins with ; or #.
#[test]
fn a_folder_may_begin_with_any_sign() {
    for name in [";x", "#x", "-x", "'x y'"] {
        let Some(site) = Site::new() else { return };
        let folder = five(&site);
        fs::rename(&folder, folder.with_file_name(name)).expect("renamed");
        site.sync("robot", "dev", &[]).ends(0);
        assert_eq!(contents(&site.path("dev")).len(), 5, "{name}");
    }
}

#[test]
fn a_clock_that_is_hours_off_changes_nothing() {
    let Some(site) = Site::new() else { return };
    let folder = five(&site);
    for (hours, name) in [(30_u64, "0000.mcap"), (0, "0001.mcap")] {
        let file = fs::File::options().write(true).open(folder.join(name)).expect("opened");
        let time = SystemTime::UNIX_EPOCH + Duration::from_secs(hours * 3600);
        file.set_modified(time).expect("set");
    }
    let ahead = fs::File::options().write(true).open(folder.join("0002.mcap")).expect("opened");
    ahead.set_modified(SystemTime::now() + Duration::from_secs(5 * 3600)).expect("set");
    site.sync("robot", "dev", &[]).ends(0);
    finish_segment(&folder, 5, &noise(5, 5_000));
    // Same size, same time, other content of another session's file: times prove nothing.
    let report = site.sync("robot", "dev", &["--json"]).ends(0).json();
    assert_eq!(report["fetched"], 1, "{report}");
    assert_eq!(site.holds("robot", &["dev"]), 6);
}

#[test]
fn several_robots_and_several_machines_at_once() {
    let Some(site) = Site::new() else { return };
    for robot in ["one", "two"] {
        site.session(robot, "2026-11-21T10-00-00Z-r1", &[noise(u64::from(robot == "one"), 400_000), noise(5, 70_000)]);
    }
    let start = |robot: &str, dev: &str| site.command(robot, dev, &[]).spawn().expect("started");
    let running = [start("one", "x"), start("two", "x"), start("one", "y"), start("two", "y")];
    for sync in running {
        let output = sync.wait_with_output().expect("ended");
        assert!(output.status.success(), "{output:?}");
    }
    for robot in ["one", "two"] {
        assert_eq!(site.holds(robot, &["x", "y"]), 4, "{robot}");
    }
    // One name, two machines: two folders here, and it is said.
    assert_eq!(contents(&site.path("x")).len(), 4);
    let said = site.sync("two", "x", &["--json"]).ends(0).says("2 robots call themselves r1").json();
    assert_eq!(said["namesakes"]["r1"].as_array().map(Vec::len), Some(2), "{said}");
    assert_eq!(said["fetched"], 0, "{said}");
}

#[test]
fn what_a_crash_left_unacknowledged_is_verified_and_not_copied() {
    let Some(site) = Site::new() else { return };
    five(&site);
    site.sync("robot", "dev", &[]).ends(0);
    let receiver = fs::read_to_string(site.path("dev/.sync/receiver")).expect("a name");
    let ack = format!("2026-11-21T10-00-00Z-r1/ack/{}.jsonl", receiver.trim());
    for side in ["dev", "robot"] {
        // Torn in the middle of the third line.
        let path = site.path(side).join(&ack);
        let text = fs::read_to_string(&path).expect("read");
        let end = text.match_indices('\n').nth(1).expect("two lines").0;
        fs::write(&path, &text[..end + 20]).expect("written");
    }
    let report = site.sync("robot", "dev", &["--json"]).ends(0).json();
    assert_eq!((report["fetched"].as_u64(), report["verified"].as_u64()), (Some(0), Some(3)), "{report}");
    assert_eq!(site.holds("robot", &["dev"]), 5);
}

#[test]
fn changed_files_are_moved_aside_and_deleted_ones_not_acknowledged() {
    let Some(site) = Site::new() else { return };
    five(&site);
    site.sync("robot", "dev", &[]).ends(0);
    let here = site.path("dev/2026-11-21T10-00-00Z-r1");
    fs::write(here.join("0001.mcap"), "mine").expect("written");
    fs::remove_file(here.join("0002.mcap")).expect("removed");
    // Only another one is asked for: still, nobody may think that these two are here.
    site.sync("robot", "dev", &["--valid", "1"]).ends(0);
    fs::rename(here.join("0001.mcap"), here.join("0001.mcap.mine")).expect("renamed");
    assert_eq!(site.holds("robot", &["dev"]), 3);
    fs::rename(here.join("0001.mcap.mine"), here.join("0001.mcap")).expect("renamed");
    let report = site.sync("robot", "dev", &["--json"]).ends(0).json();
    assert_eq!(report["fetched"], 2, "{report}");
    assert_eq!(fs::read_to_string(here.join("0001.mcap.aside-1")).expect("kept"), "mine");
    assert_eq!(site.holds("robot", &["dev"]), 5);
    fs::remove_dir_all(&here).expect("removed");
    site.sync("robot", "dev", &["--valid", "1"]).ends(0);
    assert_eq!(site.holds("robot", &["dev"]), 1);
}

#[test]
fn a_session_is_known_again_when_it_is_renamed_on_either_side() {
    let Some(site) = Site::new() else { return };
    five(&site);
    site.sync("robot", "dev", &[]).ends(0);
    fs::rename(site.path("robot/2026-11-21T10-00-00Z-r1"), site.path("robot/semi final")).expect("renamed");
    fs::rename(site.path("dev/2026-11-21T10-00-00Z-r1"), site.path("dev/the one with the goal")).expect("renamed");
    finish_segment(&site.path("robot/semi final"), 5, &noise(5, 5_000));
    let report = site.sync("robot", "dev", &["--json"]).ends(0).json();
    assert_eq!((report["fetched"].as_u64(), report["already"].as_u64()), (Some(1), Some(5)), "{report}");
    assert_eq!(fs::read_dir(site.path("dev")).expect("read").count(), 2, "the session and .sync");
    assert_eq!(site.holds("robot", &["dev"]), 6);
}

#[test]
fn what_the_robot_evicted_is_with_another_machine_or_lost() {
    let Some(site) = Site::new() else { return };
    let folder = five(&site);
    site.sync("robot", "first", &["--valid", "1"]).ends(0);
    fs::remove_file(folder.join("0004.mcap")).expect("evicted");
    fs::remove_file(folder.join("0003.mcap")).expect("deleted");
    site.sync("robot", "second", &[]).ends(3).says("0004.mcap: gone there; ").says("0003.mcap: listed and not there");
    assert_eq!(site.holds("robot", &["first", "second"]), 4);
}

#[test]
fn what_is_damaged_at_the_source_is_told_and_never_acknowledged() {
    let Some(site) = Site::new() else { return };
    let folder = five(&site);
    let mut bytes = noise(2, 5_000);
    bytes[2_500] ^= 1;
    fs::write(folder.join("0002.mcap"), &bytes).expect("written");
    fs::write(folder.join("0003.mcap"), &bytes[..2_000]).expect("written");
    let said =
        site.sync("robot", "dev", &["--json"]).ends(3).says("damaged there").says("0003.mcap: has 2000 bytes").json();
    assert_eq!(said["lost"].as_array().map(Vec::len), Some(2), "{said}");
    assert_eq!(site.holds("robot", &["dev"]), 3);
    site.sync("robot", "dev", &[]).ends(3);
}

#[test]
fn a_source_that_cannot_be_written_is_said_to_know_nothing() {
    let Some(site) = Site::new() else { return };
    let folder = five(&site);
    // A file where the folder should be: works for root, whom no permission stops.
    fs::write(folder.join("ack"), "").expect("written");
    site.sync("robot", "dev", &[]).ends(1).says("nothing is acknowledged there");
    site.sync("robot", "dev", &["--no-acknowledge"]).ends(0);
    assert_eq!(contents(&site.path("dev")).len(), 5);
}

#[test]
fn an_edited_manifest_does_not_make_two_truths() {
    let Some(site) = Site::new() else { return };
    let folder = five(&site);
    site.sync("robot", "dev", &[]).ends(0);
    let text = fs::read_to_string(folder.join("manifest.jsonl")).expect("read");
    let other = noise(77, 5_000);
    fs::write(folder.join("0001.mcap"), &other).expect("written");
    fs::write(folder.join("manifest.jsonl"), text.replace(&hash_of(&noise(1, 5_000)), &hash_of(&other)))
        .expect("written");
    site.sync("robot", "dev", &[]).says("0001.mcap: its manifest has another hash than the manifest here");
    assert_eq!(
        contents(&site.path("dev"))[&("2026-11-21T10-00-00Z-r1".to_owned(), "0001.mcap".to_owned())],
        noise(1, 5_000)
    );
    append(&folder.join("manifest.jsonl"), "");
}

#[test]
fn what_rots_here_is_no_longer_acknowledged_once_verify_has_seen_it() {
    let Some(site) = Site::new() else { return };
    five(&site);
    site.sync("robot", "dev", &[]).ends(0);
    let rotten = site.path("dev/2026-11-21T10-00-00Z-r1/0002.mcap");
    let mut bytes = fs::read(&rotten).expect("read");
    bytes[100] ^= 1;
    fs::write(&rotten, bytes).expect("written");
    let listed = || site.run("sessions list --captures dev").ends(0).stdout;
    assert!(!listed().contains("not verified"), "{}", listed());
    site.run("sessions verify --captures dev").ends(3);
    assert!(listed().contains("5 segments here, not ended at ") && listed().contains("1 not verified"), "{}", listed());
    // Whatever is asked for, the robot hears of it.
    site.sync("robot", "dev", &["--valid", "1"]).ends(0);
    let acks = fs::read_dir(site.path("robot/2026-11-21T10-00-00Z-r1/ack")).expect("read");
    let acks: String = acks.map(|ack| fs::read_to_string(ack.expect("one").path()).expect("text")).collect();
    assert!(!acks.contains("0002.mcap") && acks.contains("0001.mcap"), "{acks}");
    let report = site.sync("robot", "dev", &["--json"]).ends(0).json();
    assert_eq!(report["fetched"], 1, "{report}");
    assert_eq!(site.holds("robot", &["dev"]), 5);
    site.run("sessions verify --captures dev").ends(0);
}

#[test]
fn a_folder_that_was_deleted_with_all_it_knew_takes_back_what_it_had_said() {
    let Some(site) = Site::new() else { return };
    five(&site);
    site.sync("robot", "dev", &[]).ends(0);
    assert_eq!(site.holds("robot", &["dev"]), 5);
    fs::remove_dir_all(site.path("dev")).expect("removed");
    site.sync("robot", "dev", &["--valid", "1"]).ends(0);
    assert_eq!(site.holds("robot", &["dev"]), 1);
    let acks = fs::read_dir(site.path("robot/2026-11-21T10-00-00Z-r1/ack")).expect("read");
    assert_eq!(acks.count(), 1, "one folder, one name");
}

#[test]
fn a_stick_that_is_away_for_a_while_is_waited_for() {
    let Some(site) = Site::new() else { return };
    five(&site);
    let mut watch = site.command("robot", "dev", &["--watch", "--every", "1"]).spawn().expect("ran");
    let waits = |name: &str| {
        let began = std::time::Instant::now();
        while !site.path("dev/2026-11-21T10-00-00Z-r1").join(name).exists() {
            assert!(began.elapsed().as_secs() < 60, "{name} does not come");
            std::thread::sleep(std::time::Duration::from_millis(50));
        }
    };
    waits("0004.mcap");
    fs::rename(site.path("robot"), site.path("away")).expect("renamed");
    std::thread::sleep(std::time::Duration::from_millis(2500));
    finish_segment(&site.path("away/2026-11-21T10-00-00Z-r1"), 5, &noise(5, 5_000));
    let ended = watch.try_wait().expect("asked");
    fs::rename(site.path("away"), site.path("robot")).expect("renamed");
    assert_eq!(ended, None, "it went on");
    waits("0005.mcap");
    watch.kill().expect("ended");
    watch.wait().expect("ended");
}
