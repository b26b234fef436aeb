//! Several robots and several dev machines at once, over real ssh, by clocks that nobody has set.

use std::fs;
use std::process::Child;

use super::site::{Site, contents, finish_segment, noise};

const SEGMENT: usize = 200_000;
/// One is a winter time off, one has been switched on without a battery behind its clock.
const ROBOTS: [(&str, i64); 3] = [("one", 0), ("two", 7), ("three", -489_922)];
const MACHINES: [&str; 3] = ["x", "y", "z"];

fn segment(robot: usize, index: usize) -> Vec<u8> {
    noise((100 * robot + index) as u64, SEGMENT + index)
}

fn all_end(syncs: Vec<Child>) {
    for sync in syncs {
        let output = sync.wait_with_output().expect("ended");
        assert!(output.status.success(), "{output:?}");
    }
}

#[test]
fn several_machines_sync_recording_robots_with_clocks_hours_apart() {
    let Some(site) = Site::with_ssh() else { return };
    let folders: Vec<_> = ROBOTS
        .iter()
        .enumerate()
        .map(|(robot, (name, ahead_h))| {
            site.session_by_a_clock(name, *ahead_h, &[segment(robot, 0), segment(robot, 1), segment(robot, 2)])
        })
        .collect();
    let everybody = || -> Vec<Child> {
        let pairs = MACHINES.iter().flat_map(|dev| ROBOTS.map(|(robot, _)| (robot, *dev)));
        pairs.map(|(robot, dev)| site.command(robot, dev, &[]).spawn().expect("started")).collect()
    };
    let syncs = everybody();
    // They record on meanwhile.
    for (robot, folder) in folders.iter().enumerate() {
        finish_segment(folder, 3, &segment(robot, 3));
    }
    all_end(syncs);
    let held = |robot: &str| site.holds(robot, &MACHINES);
    assert!(ROBOTS.iter().all(|(robot, _)| held(robot) >= 9), "three each");
    all_end(everybody());
    for (robot, _) in ROBOTS {
        assert_eq!(held(robot), 12, "{robot}");
    }
    for dev in MACHINES {
        let here = contents(&site.path(dev));
        assert_eq!(here.len(), 12, "{dev}: {:?}", here.keys());
        site.run(&format!("sessions verify --captures {dev}")).ends(0);
        // Nothing comes twice, and nobody takes another's file for his own.
        for (robot, _) in ROBOTS {
            let again = site.sync(robot, dev, &["--json"]).ends(0).says("3 robots call themselves r1").json();
            assert_eq!((again["fetched"].as_u64(), again["already"].as_u64()), (Some(0), Some(4)), "{again}");
        }
    }
    let receivers: Vec<String> =
        MACHINES.iter().map(|dev| fs::read_to_string(site.path(dev).join(".sync/receiver")).expect("a name")).collect();
    assert!(receivers.iter().all(|one| receivers.iter().filter(|other| *other == one).count() == 1), "{receivers:?}");
}

#[test]
fn two_robots_whose_sessions_bear_one_name_do_not_mix() {
    let Some(site) = Site::with_ssh() else { return };
    // One session's name: the second robot's clock is an hour back, and it was started an hour later.
    for (robot, name) in ["one", "two"].into_iter().enumerate() {
        site.session_by_a_clock(name, -1, &[segment(robot, 0), segment(robot, 1)]);
    }
    all_end(["one", "two"].map(|robot| site.command(robot, "dev", &[]).spawn().expect("started")).into());
    assert_eq!((site.holds("one", &["dev"]), site.holds("two", &["dev"])), (2, 2));
    let listed = site.run("sessions list --captures dev --json").ends(0).json();
    let names: Vec<_> = listed.as_array().expect("rows").iter().map(|row| row["session"].as_str()).collect();
    assert!(names.len() == 2 && names[0] != names[1], "{names:?}");
}

#[test]
fn times_asked_for_are_those_of_the_recordings_own_clock() {
    let Some(site) = Site::with_ssh() else { return };
    for (robot, ahead_h) in [("one", 0), ("two", 7)] {
        site.session_by_a_clock(robot, ahead_h, &(0..3).map(|index| segment(0, index)).collect::<Vec<_>>());
    }
    // Segments last a minute each, from 17:46:40 on, by the clock of the first robot.
    let between = ["--since", "2030-03-17T17:47:45Z", "--until", "2030-03-17T17:48:30Z", "--json"];
    let fetched = |robot: &str| site.sync(robot, "dev", &between).ends(0).json()["fetched"].as_u64();
    assert_eq!((fetched("one"), fetched("two")), (Some(1), Some(0)));
}
