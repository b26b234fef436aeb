//! Whatever was moved, lost, fetched anew or pruned from both sides: the last copy stays, and what is damaged or in the way is
//! told.

use std::fs;

use super::site::{Site, contents, noise};

const S: [u64; 2] = [1_000, 500];

fn two(site: &Site, name: &str) {
    site.session("robot", name, &[noise(1, S[0] as usize), noise(2, S[1] as usize)]);
}

fn prune_all(site: &Site, folders: &[&str]) -> usize {
    for folder in folders {
        site.run(&format!("sessions prune --captures {folder} --yes")).ends(0);
    }
    folders.iter().filter(|folder| contents(&site.path(folder)).len() >= 2).count()
}

#[test]
fn a_folder_that_was_lost_and_is_nearer_to_the_recorder_now_is_relied_on_no_longer() {
    let Some(site) = Site::new() else { return };
    two(&site, "s");
    for (from, to) in [("robot", "m"), ("m", "a"), ("a", "c")] {
        site.sync(from, to, &[]).ends(0);
    }
    fs::remove_dir_all(site.path("c")).expect("lost");
    site.sync("robot", "c", &[]).ends(0);
    site.sync("c", "a", &[]).ends(0);
    assert!(prune_all(&site, &["a", "c", "m", "robot"]) > 0, "all gone");
}

#[test]
fn a_session_that_is_moved_to_another_folder_takes_its_former_folder_s_word_for_its_own() {
    let Some(site) = Site::new() else { return };
    two(&site, "s");
    two(&site, "t");
    site.sync("robot", "a", &[]).ends(0);
    site.sync("robot", "d", &["t"]).ends(0);
    site.run("sessions prune --captures robot --yes").ends(0);
    fs::rename(site.path("a/s"), site.path("d/s")).expect("moved");
    site.run("sessions prune --captures d --yes").ends(0);
    assert!(site.path("d/s/0001.mcap").is_file(), "the last copy");
}

#[test]
fn two_folders_that_are_pruned_for_each_other_s_copy_at_once_keep_one() {
    let Some(site) = Site::new() else { return };
    for round in 0..6 {
        let (a, b) = (format!("a{round}"), format!("b{round}"));
        two(&site, &format!("s{round}"));
        site.sync("robot", &a, &[]).ends(0);
        site.sync("robot", &b, &[]).ends(0);
        std::thread::scope(|scope| {
            for (own, copy) in [(&a, &b), (&b, &a)] {
                let site = &site;
                scope.spawn(move || site.run(&format!("sessions prune --captures {own} --copy {copy} --yes")));
            }
        });
        let left = [&a, &b].into_iter().filter(|folder| !contents(&site.path(folder)).is_empty()).count();
        assert_eq!(left, 1, "round {round}");
    }
}

#[test]
fn a_copy_that_relied_on_what_is_pruned_relies_on_it_no_longer() {
    let Some(site) = Site::new() else { return };
    two(&site, "s");
    site.sync("robot", "a", &[]).ends(0);
    site.sync("a", "b", &[]).ends(0);
    site.run("sessions prune --captures b --copy a --yes").ends(0);
    assert!(contents(&site.path("b")).is_empty());
    assert!(prune_all(&site, &["a"]) > 0, "the last but the robot's");
}

#[test]
fn a_folder_is_no_copy_of_itself_however_it_is_linked() {
    let Some(site) = Site::new() else { return };
    two(&site, "s");
    fs::create_dir_all(site.path("linked/s")).expect("made");
    for name in ["session.json", "manifest.jsonl", "0000.mcap", "0001.mcap"] {
        fs::hard_link(site.path("robot/s").join(name), site.path("linked/s").join(name)).expect("linked");
    }
    site.run("sessions prune --captures robot --copy linked --yes").ends(0);
    assert!(site.path("robot/s").is_dir());
}

#[test]
fn what_a_killed_prune_left_goes_with_the_next() {
    let Some(site) = Site::new() else { return };
    two(&site, "s");
    two(&site, "t");
    fs::rename(site.path("robot/s"), site.path("robot/.pruned-0123")).expect("renamed");
    site.sync("robot", "dev", &[]).ends(0);
    site.run("sessions prune --captures robot --yes").ends(0);
    assert!(!site.path("robot/.pruned-0123").exists() && !site.path("robot/t").exists());
    assert_eq!(contents(&site.path("dev")).len(), 2);
}

#[test]
fn a_word_for_what_two_manifests_contradict_each_other_about_is_taken_back() {
    let Some(site) = Site::new() else { return };
    two(&site, "s");
    site.sync("robot", "dev", &[]).ends(0);
    assert_eq!(site.holds("robot", &["dev"]), 2);
    let manifest = site.path("dev/s/manifest.jsonl");
    let text = fs::read_to_string(&manifest).expect("read");
    let first = text.lines().next().expect("a line");
    let hash =
        serde_json::from_str::<serde_json::Value>(first).expect("JSON")["blake3"].as_str().expect("text").to_owned();
    fs::write(&manifest, text.replace(&hash, &"0".repeat(64))).expect("written");
    site.sync("robot", "dev", &[]).says("neither is believed");
    site.run("sessions prune --captures robot --yes").ends(0);
    assert!(site.path("robot/s/0000.mcap").is_file(), "the only copy that is right");
}

#[test]
fn sessions_may_be_renamed_in_any_language() {
    let Some(site) = Site::new() else { return };
    two(&site, "Übung 1 – 試合");
    site.sync("robot", "dev", &[]).ends(0);
    assert_eq!(contents(&site.path("dev")).len(), 2);
    assert!(site.path("dev/Übung 1 – 試合").is_dir());
}

#[test]
fn segments_that_a_shortened_manifest_does_not_list_are_told() {
    let Some(site) = Site::new() else { return };
    two(&site, "s");
    let manifest = site.path("robot/s/manifest.jsonl");
    let text = fs::read_to_string(&manifest).expect("read");
    fs::write(&manifest, format!("{}\n", text.lines().next().expect("a line"))).expect("written");
    site.sync("robot", "dev", &[]).says("0001.mcap in no line of its manifest");
}

#[test]
fn what_lies_in_the_way_of_one_session_does_not_keep_the_others() {
    let Some(site) = Site::new() else { return };
    two(&site, "s");
    two(&site, "t");
    fs::create_dir(site.path("dev")).expect("made");
    std::os::unix::fs::symlink("/nowhere", site.path("dev/s")).expect("linked");
    site.sync("robot", "dev", &[]).ends(0);
    assert_eq!(contents(&site.path("dev")).len(), 4);
    assert!(fs::symlink_metadata(site.path("dev/s")).expect("there").is_symlink(), "left alone");
}
