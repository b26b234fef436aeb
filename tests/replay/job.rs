//! `realitysim job`: many sessions, each done once, whoever does it and however often it is killed.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use serde_json::Value;

use super::support::{CAPTURES, Room};

const SESSIONS: [&str; 3] = ["friday", "saturday", "sunday"];

/// Three sessions of the beginning of one walk.
fn league() -> Room {
    let room = Room::with_walk();
    room.run("log cut log.mcap --from 0 --to 0.8 -o begin.mcap").succeeds();
    let replayed = room.replay("begin.mcap");
    for name in SESSIONS {
        copy(&replayed.session, &room.path(CAPTURES).join(name));
    }
    fs::remove_dir_all(&replayed.session).unwrap();
    room
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(|entry| entry.unwrap().path()) {
        let to = to.join(entry.file_name().unwrap());
        if entry.is_dir() {
            copy(&entry, &to);
        } else {
            fs::copy(&entry, to).unwrap();
        }
    }
}

/// All files in a folder with their content, hidden ones too.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(inside) = folders.pop() {
        for path in fs::read_dir(inside).unwrap().map(|entry| entry.unwrap().path()) {
            if path.is_dir() {
                folders.push(path);
            } else {
                found.insert(path.strip_prefix(folder).unwrap().to_owned(), fs::read(&path).unwrap());
            }
        }
    }
    found
}

fn states(report: &Value) -> Vec<&str> {
    report["units"].as_array().unwrap().iter().map(|unit| unit["state"].as_str().unwrap()).collect()
}

#[test]
fn each_step_gives_the_same_bits_whoever_does_it() {
    let room = league();
    for (step, file) in [
        ("tag", "tags.mcap"),
        ("refine", "refined/refined.json"),
        ("labels", "annotations.json"),
        ("depth", "images/database.json"),
        ("check", "unit.json"),
    ] {
        let whole = room.run(&format!("job {CAPTURES} --step {step} -o whole --workers 1 --json")).succeeds().json();
        assert_eq!(states(&whole), ["done"; 3]);
        let folder = room.path(whole["units"][0]["folder"].as_str().unwrap());
        assert!(folder.join(file).is_file(), "{step}: {folder:?}");
        let mut done = BTreeSet::new();
        for shard in ["1/2", "2/2"] {
            let run = room.run(&format!("job {CAPTURES}/. --step {step} --shard {shard} -o parts --workers 2 --json"));
            let part = run.succeeds().json();
            let names = part["units"].as_array().unwrap().iter().map(|unit| unit["session"].to_string());
            assert!(names.clone().all(|name| done.insert(name)), "{part}");
        }
        assert_eq!(done.len(), SESSIONS.len());
        let again = room.run(&format!("job {CAPTURES} --step {step} -o parts --json")).succeeds().json();
        assert_eq!(states(&again), ["present"; 3]);
        assert_eq!(again["units"][0]["summary"], whole["units"][0]["summary"]);
    }
    assert!(files(&room.path("whole")) == files(&room.path("parts")));
}

#[test]
fn a_catalogue_names_the_sessions_of_a_job() {
    let room = league();
    // The three are copies of one session, of which a catalogue takes the first.
    room.run(&format!("catalogue add {CAPTURES}/friday -o catalogue")).succeeds();
    let job = |from: &str, to: &str| room.run(&format!("job {from} --step check -o {to} --json"));
    let whole = job(CAPTURES, "whole").succeeds().json();
    let named = job("catalogue", "named").succeeds().json();
    assert_eq!((states(&named), &named["sessions"]), (vec!["done"], &Value::from(1)));
    assert_eq!(named["units"][0]["summary"], whole["units"][0]["summary"]);
    fs::remove_dir_all(room.path(CAPTURES).join("friday")).unwrap();
    let run = job("catalogue", "named").fails(1, &["friday"]);
    assert_eq!(states(&run.json()), ["failed"]);
    job("whole/check", "none").fails(1, &["holds no capture", "a catalogue of them"]);
}

/// A job in the background.
fn begin(room: &Room, call: &str) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_realitysim"));
    command.args(call.split_whitespace()).current_dir(room.path("")).stdout(Stdio::null()).stderr(Stdio::null());
    command.spawn().unwrap()
}

#[test]
fn two_jobs_at_once_leave_each_result_once() {
    let room = league();
    let call = format!("job {CAPTURES} --step tag -o results");
    let mut both = [begin(&room, &call), begin(&room, &call)];
    assert!(both.iter_mut().all(|child| child.wait().unwrap().success()));
    room.run(&call.replace("-o results", "-o alone")).succeeds();
    assert!(files(&room.path("results")) == files(&room.path("alone")));
    assert_eq!(fs::read_dir(room.path("results/tag")).unwrap().count(), SESSIONS.len());
}

#[test]
fn a_killed_job_is_ended_by_the_same_call() {
    let room = league();
    let call = format!("job {CAPTURES} --step tag -o results --workers 1 --json");
    let results = room.path("results/tag");
    let mut child = begin(&room, &call);
    let names = || -> Vec<String> {
        let entries = fs::read_dir(&results).into_iter().flatten().flatten();
        entries.map(|entry| entry.file_name().into_string().unwrap()).collect()
    };
    // Killed where the first session is done and the second one begun, or later.
    while child.try_wait().unwrap().is_none()
        && !(names().iter().any(|name| !name.starts_with('.')) && names().iter().any(|name| name.starts_with('.')))
    {
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    let _ = child.kill();
    child.wait().unwrap();
    let whole = names().iter().filter(|name| !name.starts_with('.')).count();
    let report = room.run(&call).succeeds().json();
    assert!(whole > 0);
    assert_eq!(states(&report).iter().filter(|state| **state == "present").count(), whole);
    let left: Vec<String> = names().into_iter().filter(|name| name.starts_with('.')).collect();
    assert!(left.is_empty() && names().len() == SESSIONS.len(), "{left:?}");
    room.run(&call.replace("-o results", "-o fresh")).succeeds();
    assert!(files(&room.path("fresh")) == files(&room.path("results")));
}

#[test]
fn a_session_that_fails_is_named_and_the_others_are_done() {
    let room = league();
    let captures = room.path(CAPTURES);
    fs::write(captures.join("friday/session.json"), "{}").unwrap();
    let segment = captures.join("saturday/0000.mcap");
    let mut bytes = fs::read(&segment).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&segment, bytes).unwrap();
    let call = format!("job {CAPTURES} --step check -o results --json");
    let first = room.run(&call).fails(1, &["friday: ", "session.json", "saturday: 0000.mcap: its bytes are not"]);
    let first = first.json();
    assert_eq!(states(&first), ["failed", "done", "done"]);
    fs::remove_dir_all(captures.join("friday")).unwrap();
    // What is lost stays lost, and is told again.
    let again = room.run(&call).fails(3, &["saturday: 0000.mcap: its bytes are not"]).json();
    assert_eq!(states(&again), ["present", "present"]);
}

#[test]
fn a_session_that_changed_and_a_damaged_result_are_not_taken_for_done() {
    let room = league();
    let call = format!("job {CAPTURES} --step check -o results --json");
    let report = room.run(&call).succeeds().json();
    let [friday, sunday] = [0, 2].map(|number| room.path(report["units"][number]["folder"].as_str().unwrap()));
    fs::write(sunday.join("unit.json"), "{").unwrap();
    let info = room.path(CAPTURES).join("friday/session.json");
    let text = fs::read_to_string(&info).unwrap();
    fs::write(&info, text.replacen('{', "{ ", 1)).unwrap();
    let again = room.run(&call).fails(1, &["sunday: ", "no whole result: remove it, and run the job again"]).json();
    assert_eq!(states(&again), ["done", "present", "failed"]);
    assert!(friday.is_dir());
    fs::remove_dir_all(&sunday).unwrap();
    assert_eq!(states(&room.run(&call).succeeds().json()), ["present", "present", "done"]);
}

#[test]
fn settings_of_a_job_make_results_of_their_own() {
    let room = league();
    room.write("more.toml", "[filter]\nparticles = 300\n");
    let call = format!("job {CAPTURES} --step tag -o results --json");
    let [own, more] = ["", " --config more.toml"].map(|more| room.run(&format!("{call}{more}")).succeeds().json());
    assert_eq!(states(&more), ["done"; 3]);
    assert_ne!(own["units"][0]["folder"], more["units"][0]["folder"]);
    assert_eq!(own["units"][0]["summary"]["tags"], more["units"][0]["summary"]["tags"]);
}

#[test]
fn a_wrong_job_is_refused_before_anything_is_done() {
    let room = league();
    for (arguments, code, said) in [
        ("captures --step tag --shard 5/4 -o results", 2, "3/16"),
        ("captures --step refine --config more.toml -o results", 2, "--config is for --step tag"),
        ("captures --step tag --format yolo -o results", 2, "--format is for --step labels"),
        ("captures --step check -o captures/results", 2, "which is read"),
        ("none --step check -o results", 1, "holds no capture"),
        ("captures --step tag --config none.toml -o results", 2, "none.toml"),
    ] {
        room.run(&format!("job {arguments}")).fails(code, &[said]);
    }
    assert!(!room.path("results").exists());
}

/// A script as it is documented, run by a shell that finds the program.
fn shell(room: &Room, script: &str, arguments: &[&str], variables: &[(&str, &str)]) {
    let program = Path::new(env!("CARGO_BIN_EXE_realitysim")).parent().unwrap().display().to_string();
    let path = format!("{program}:{}", std::env::var("PATH").unwrap_or_default());
    let mut bash = Command::new("bash");
    bash.args(["-c", script, "bash"]).args(arguments).envs(variables.iter().copied()).env("PATH", path);
    let output = bash.current_dir(room.path("")).output().unwrap();
    assert!(output.status.success(), "{script}: {}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn the_slurm_script_does_each_shard_of_its_array() {
    let room = league();
    let script = include_str!("../../docs/howto/league/job.slurm");
    let array = script.lines().find_map(|line| line.strip_prefix("#SBATCH --array=1-")).unwrap();
    assert_eq!(array, "16");
    for task in ["1", "2"] {
        let variables = [("SLURM_ARRAY_TASK_ID", task), ("SLURM_ARRAY_TASK_COUNT", "2"), ("SLURM_CPUS_PER_TASK", "1")];
        shell(&room, script, &[CAPTURES, "results", "check"], &variables);
    }
    assert_eq!(fs::read_dir(room.path("results/check")).unwrap().count(), SESSIONS.len());
}

#[test]
fn the_kubernetes_job_does_each_shard_of_its_indices() {
    let manifest: Value = serde_saphyr::from_str(include_str!("../../docs/howto/league/job.yaml")).unwrap();
    assert_eq!((&manifest["apiVersion"], &manifest["kind"]), (&"batch/v1".into(), &"Job".into()));
    let spec = &manifest["spec"];
    assert_eq!(spec["completionMode"], "Indexed");
    let container = &spec["template"]["spec"]["containers"][0];
    assert_eq!(container["command"], serde_json::json!(["sh", "-c"]));
    let call = container["args"][0].as_str().unwrap();
    assert!(call.contains(&format!("/{} ", spec["completions"])), "{call}");
    let mounts = container["volumeMounts"].as_array().unwrap().iter();
    let paths: BTreeSet<&str> = mounts.map(|mount| mount["mountPath"].as_str().unwrap()).collect();
    assert_eq!(paths, BTreeSet::from(["/captures", "/results"]));
    let room = league();
    let call = call.replace(" /captures", " captures").replace(" /results", " results").replace("refine", "check");
    for index in 0..spec["completions"].as_u64().unwrap() {
        shell(&room, &call, &[], &[("JOB_COMPLETION_INDEX", &index.to_string())]);
    }
    assert_eq!(fs::read_dir(room.path("results/check")).unwrap().count(), SESSIONS.len());
}

/// Ray is large: `pip install ray` into the environment of `REALITYSIM_PYTHON` first.
#[test]
#[ignore = "needs ray, which the tests' environment lacks"]
fn a_cluster_of_ray_that_loses_a_node_gives_the_same_results() {
    let python = std::env::var_os("REALITYSIM_PYTHON").expect("REALITYSIM_PYTHON names an interpreter with ray");
    let room = league();
    for number in 0..20 {
        copy(&room.path(CAPTURES).join(SESSIONS[0]), &room.path(CAPTURES).join(format!("more-{number}")));
    }
    room.run(&format!("job {CAPTURES} --step tag -o expected")).succeeds();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let programs = Path::new(env!("CARGO_BIN_EXE_realitysim")).parent().unwrap();
    let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap_or_default());
    let mut script = Command::new(python);
    script.arg("-B").arg(root.join("tests/replay/check_ray.py")).args([CAPTURES, "expected", "results"]);
    script.env("PYTHONPATH", root.join("clients/python")).env("PATH", path).current_dir(room.path(""));
    let output = script.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stdout).contains("23 sessions"));
}
