//! The workflow of docs/howto/ci.md, step by step, on a sample repository.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::TempDir;

use super::support::walk;

const GUIDE: &str = include_str!("../../docs/howto/ci.md");

/// A team's repository with its log, as checked out by a server.
struct Repository {
    folder: TempDir,
}

impl Repository {
    fn new() -> Self {
        let repository = Self { folder: tempfile::tempdir().unwrap() };
        let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/ci-sample");
        fs::create_dir(repository.path("ci")).unwrap();
        fs::create_dir(repository.path("logs")).unwrap();
        for file in ["robot.toml", "vision", "ci/suite.toml"] {
            fs::copy(sample.join(file), repository.path(file)).unwrap();
        }
        fs::write(repository.path("recorded.mcap"), &walk().log).unwrap();
        repository.run(&line_of("realitysim log cut")).unwrap();
        fs::remove_file(repository.path("recorded.mcap")).unwrap();
        repository
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// As a server runs a step: bash that stops at the first error.
    fn run(&self, script: &str) -> Result<(), String> {
        let program = Path::new(env!("CARGO_BIN_EXE_realitysim")).parent().unwrap();
        let path = std::env::join_paths(
            [program.to_owned()].into_iter().chain(std::env::split_paths(&std::env::var_os("PATH").unwrap())),
        );
        let output = Command::new("bash")
            .args(["--noprofile", "--norc", "-eo", "pipefail", "-c", script])
            .env("PATH", path.unwrap())
            .current_dir(&self.folder)
            .output()
            .unwrap();
        let told = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
        if output.status.success() { Ok(()) } else { Err(told) }
    }

    /// Every step but the installation, as far as they go.
    fn workflow(&self) -> Result<(), String> {
        steps().iter().filter(|(name, _)| name != "Install").try_for_each(|(_, script)| self.run(script))
    }
}

/// Name and script of each `run:` in the guide's workflow.
fn steps() -> Vec<(String, String)> {
    let yaml = GUIDE.split("```yaml\n").nth(1).unwrap().split("```").next().unwrap();
    let indent = |line: &str| line.len() - line.trim_start().len();
    let mut lines = yaml.lines().peekable();
    let (mut steps, mut name) = (Vec::new(), String::new());
    while let Some(line) = lines.next() {
        if let Some(found) = line.trim().strip_prefix("- name: ") {
            name = found.to_owned();
        }
        let Some(script) = line.trim().strip_prefix("run: ") else { continue };
        let mut script = script.to_owned();
        if script == "|" {
            script.clear();
            while let Some(more) = lines.next_if(|more| indent(more) > indent(line)) {
                script += &format!("{more}\n");
            }
        }
        steps.push((name.clone(), script));
    }
    steps
}

/// The guide's own line that begins so.
fn line_of(command: &str) -> String {
    GUIDE.split('`').find(|code| code.starts_with(command)).unwrap().to_owned()
}

fn bless() -> String {
    let line = line_of("realitysim replay");
    assert!(line.ends_with("--bless"), "{line}");
    line
}

#[test]
fn the_workflow_passes_as_it_is_and_stops_a_change_for_the_worse() {
    assert_eq!(steps().len(), 4);
    let repository = Repository::new();
    repository.run(&bless()).unwrap();
    repository.workflow().unwrap();
    for name in ["out/limits.xml", "out/reference.xml"] {
        assert!(fs::read_to_string(repository.path(name)).unwrap().contains("failures=\"0\""), "{name}");
    }

    // Somebody tries to save time.
    let hasty =
        "robot = \"sample\"\nfield = \"kid-2009\"\n[filter]\nparticles = 60\niterations = 1\nrefinement = false\n";
    fs::write(repository.path("robot.toml"), hasty).unwrap();
    let told = repository.workflow().unwrap_err();
    assert!(told.contains("kickoff: mean_cm is") && told.contains("allowed is at most 1"), "{told}");
    assert!(fs::read_to_string(repository.path("out/limits.xml")).unwrap().contains("failures=\"1\""));
}

#[test]
fn a_change_that_is_meant_to_be_is_blessed() {
    let repository = Repository::new();
    repository.run(&bless()).unwrap();
    let config = fs::read_to_string(repository.path("robot.toml")).unwrap();
    fs::write(repository.path("robot.toml"), config + "line_points = 300\n").unwrap();
    let told = repository.workflow().unwrap_err();
    for word in ["filter.line_points is 300, was 350", "frames differ", "--bless"] {
        assert!(told.contains(word), "{word}: {told}");
    }
    repository.run(&bless()).unwrap();
    repository.workflow().unwrap();
}
