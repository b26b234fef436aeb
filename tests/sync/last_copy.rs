//! Whatever was moved, lost, fetched anew or pruned from both sides: the last copy stays, and what is damaged or in the way is
//! told.

use std::fs;
use std::process::Command;

use realitysim::recording::sessions::sessions_in;
use realitysim::recording::sync::{Goal, Removal};

use super::site::{Site, Synced, contents, finish_segment, noise};

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
fn a_folder_lost_and_now_nearer_to_the_recorder_is_no_longer_relied_on() {
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
fn a_moved_session_takes_the_word_of_its_former_folder_for_its_own() {
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
                scope.spawn(move || site.run(&format!("sessions prune --captures {own} --copy {copy} --yes")).ends(0));
            }
        });
        // Session by session they take turns.
        let mut left: Vec<_> =
            [&a, &b].into_iter().flat_map(|folder| contents(&site.path(folder)).into_keys()).collect();
        left.sort();
        let all: Vec<_> = contents(&site.path("robot")).into_keys().collect();
        assert_eq!(left, all, "round {round}");
    }
}

/// What a prune has looked at may change while it reads: a segment comes, a copy goes, somebody puts a file there.
#[test]
fn what_changes_between_the_look_and_the_deletion_stays() {
    let Some(site) = Site::new() else { return };
    let copies = [site.path("stick")];
    let prune = |change: &dyn Fn(), should_go: bool| {
        for folder in ["robot", "dev", "stick"] {
            let _ = fs::remove_dir_all(site.path(folder));
        }
        two(&site, "s");
        site.sync("robot", "dev", &[]).ends(0);
        site.sync("robot", "stick", &[]).ends(0);
        let dev = site.path("dev");
        let (sessions, _) = sessions_in(&dev).expect("read");
        let mut removal = Removal::plan(&dev, &copies, &sessions, &Goal::default());
        assert!(removal.decisions[0].goes, "{:?}", removal.decisions);
        change();
        let before = contents(&dev);
        removal.carry_out().expect("carried out");
        assert_eq!(removal.decisions[0].goes, should_go, "{:?}", removal.decisions);
        if should_go {
            assert!(contents(&dev).is_empty());
        } else {
            assert!(removal.decisions[0].why.contains("prune again") && contents(&dev) == before);
        }
    };
    prune(&|| {}, true);
    prune(
        &|| {
            // The robot goes on, and the folder says that it has what came.
            finish_segment(&site.path("robot/s"), 2, &noise(3, 700));
            site.sync("robot", "dev", &[]).ends(0);
        },
        false,
    );
    prune(&|| fs::remove_file(site.path("stick/s/0001.mcap")).expect("gone"), false);
    prune(&|| fs::write(site.path("stick/s/0001.mcap"), noise(9, S[1] as usize)).expect("changed"), false);
    prune(&|| fs::write(site.path("dev/s/notes.txt"), "mine").expect("written"), false);
    prune(&|| fs::create_dir(site.path("dev/s/refined")).expect("made"), false);
    prune(&|| fs::write(site.path("dev/s/pinned"), "").expect("written"), false);
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
fn a_copy_that_was_relied_on_relies_on_nobody_who_may_have_gone_for_it() {
    let Some(site) = Site::new() else { return };
    for (session, chain) in [("s", false), ("t", true), ("u", true)] {
        two(&site, session);
        let (robot, a, b) = ("robot", format!("a-{session}"), format!("b-{session}"));
        site.sync(robot, &a, &[session]).ends(0);
        site.sync(if chain { &a } else { robot }, &b, &[session]).ends(0);
        if session == "u" {
            site.sync(robot, &a, &[session]).ends(0);
        }
        let through = if chain { String::new() } else { format!("--copy {b}") };
        site.run(&format!("sessions prune --captures {a} {through} --yes")).ends(0);
        site.run(&format!("sessions prune --captures {b} --copy {robot} --yes")).ends(0);
        assert!(contents(&site.path(&a)).is_empty() && contents(&site.path(&b)).is_empty(), "{session}");
        site.run("sessions prune --captures robot --yes").ends(0);
        assert!(site.path("robot").join(session).join("0001.mcap").is_file(), "{session}: the last copy");
    }
    // Who comes later is farther from the recorder than what was relied on, and his word counts.
    site.sync("robot", "d", &[]).ends(0);
    let hops = fs::read_to_string(site.path("d/t/received.json")).expect("read");
    assert!(hops.contains(r#""hops":3"#), "{hops}");
    site.run("sessions prune --captures robot --yes").ends(0);
    assert_eq!((contents(&site.path("robot")).len(), contents(&site.path("d")).len()), (0, 6));
}

#[test]
fn after_a_move_a_recorder_folder_takes_no_own_word_for_another_s() {
    let Some(site) = Site::new() else { return };
    two(&site, "s");
    site.sync("robot", "d", &[]).ends(0);
    site.sync("d", "robot", &[]).ends(0);
    // It is taken back, and the robot's own word for its session stays.
    site.run("sessions prune --captures d --yes --force").ends(0);
    site.sync("robot", "d", &[]).ends(0);
    fs::create_dir(site.path("x")).expect("made");
    fs::rename(site.path("robot/s"), site.path("x/s")).expect("moved");
    site.run("sessions prune --captures x --yes").ends(0);
    assert!(site.path("x/s/0001.mcap").is_file(), "the last copy");
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

/// In a mount namespace of its own, where `merged` shows the folder `robot` under other device and inode numbers, as NFS, sshfs or
/// Samba of the own machine would; its changes go to `upper`. `None` where that is not allowed.
fn under_an_overlay(site: &Site, script: &str) -> Option<Synced> {
    let program = env!("CARGO_BIN_EXE_realitysim");
    let script = format!(
        "mkdir -p upper work merged && mount -t overlay overlay -o lowerdir=robot,upperdir=upper,workdir=work merged || exit 77\n\
         rs={program}\n{script}"
    );
    let mut command = Command::new("unshare");
    command.args(["--user", "--map-root-user", "--mount", "sh", "-c", &script]).current_dir(site.path(""));
    let ended = Synced::of(command.output().ok()?);
    let refused = ended.code == Some(77) || ended.stderr.contains("unshare:");
    if refused {
        println!("skipped: no overlay can be mounted here: {ended:?}");
    }
    (!refused).then_some(ended)
}

#[test]
fn another_way_to_the_same_folder_is_no_copy_of_it() {
    let Some(site) = Site::new() else { return };
    two(&site, "s");
    let Some(ended) = under_an_overlay(&site, "$rs sessions prune --captures robot --copy merged --yes") else {
        return;
    };
    let ended = ended.ends(0);
    assert!(ended.stdout.contains("by another way") && ended.stdout.contains("stays"), "{ended:?}");
    // The other way round, what is deleted would not go from the other; but nobody can rely on an accident of mounting.
    under_an_overlay(&site, "$rs sessions prune --captures merged --copy robot --yes").expect("ran").ends(0);
    assert_eq!(contents(&site.path("robot")).len(), 2, "the only copy");
    assert_eq!(fs::read_dir(site.path("robot/s")).expect("read").count(), 4, "nothing is left of the proof");
    under_an_overlay(&site, "$rs sessions prune --captures robot --copy merged --yes --force").expect("ran").ends(0);
    assert!(contents(&site.path("robot")).is_empty(), "forced");
}

#[test]
fn another_way_to_the_same_folder_acknowledges_nothing_to_it() {
    let Some(site) = Site::new() else { return };
    two(&site, "s");
    let Some(ended) = under_an_overlay(&site, "$rs sync robot -o merged") else { return };
    ended.says("nothing is acknowledged").says("by another way").ends(1);
    site.run("sessions prune --captures robot --yes").ends(0);
    assert_eq!(contents(&site.path("robot")).len(), 2, "the only copy");
}

#[test]
fn what_a_killed_proof_left_is_nobody_s_file() {
    let Some(site) = Site::new() else { return };
    two(&site, "s");
    site.sync("robot", "dev", &[]).ends(0);
    for place in ["robot/s", "robot/s/ack", "dev/s"] {
        fs::write(site.path(place).join(".storage-probe-0123"), "").expect("written");
    }
    site.sync("robot", "dev", &[]).ends(0);
    site.run("sessions prune --captures robot --copy dev --yes").ends(0);
    assert!(contents(&site.path("robot")).is_empty());
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
fn an_acknowledgement_that_two_manifests_contradict_is_taken_back() {
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
    site.sync("robot", "dev", &[]).says("0001.mcap in no line of its manifest").ends(0);
    // It has what is written last of all.
    fs::write(site.path("robot/s/metadata.yaml"), "written last").expect("written");
    site.sync("robot", "dev", &[]).says("1 finished segments stay there").ends(1);
}

#[test]
fn segments_that_stay_behind_cost_the_exit_code() {
    let Some(site) = Site::new() else { return };
    two(&site, "s");
    fs::write(site.path("robot/s/metadata.yaml"), "written last").expect("written");
    let manifest = site.path("robot/s/manifest.jsonl");
    let text = fs::read_to_string(&manifest).expect("read");
    let left = |manifest_text: &str, dev: &str| {
        fs::write(&manifest, manifest_text).expect("written");
        site.sync("robot", dev, &["--json"]).ends(1).json()["left_there"].as_u64()
    };
    assert_eq!(left("", "emptied"), Some(2));
    assert_eq!(left(&text.replacen('{', "#", 1), "damaged"), Some(1));
    assert_eq!(left(&text.replacen("\"blake3\":\"", "\"blake3\":\"x", 1), "without"), Some(1));
    fs::write(&manifest, &text).expect("written");
    site.sync("robot", "dev", &[]).ends(0);
    let hash = text.split("\"blake3\":\"").nth(1).expect("a hash")[..64].to_owned();
    assert_eq!(left(&text.replace(&hash, &"0".repeat(64)), "dev"), Some(1));
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
