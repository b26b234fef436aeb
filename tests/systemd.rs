//! The files in systemd/: judged by systemd's own tools where they are.

use std::process::Command;

use tempfile::TempDir;

/// Its program is there, so that only the unit is judged.
fn unit() -> (TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let unit = std::fs::read_to_string("systemd/realitysim.service").unwrap();
    assert_eq!(unit.matches("/usr/bin/realitysim ").count(), 1);
    let unit = unit.replace("/usr/bin/realitysim ", &format!("{} ", env!("CARGO_BIN_EXE_realitysim")));
    let path = folder.path().join("realitysim.service");
    std::fs::write(&path, unit).unwrap();
    (folder, path)
}

/// None where there is no systemd.
fn analyze(arguments: &[&str], unit: &std::path::Path) -> Option<std::process::Output> {
    match Command::new("systemd-analyze").args(arguments).arg(unit).output() {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            eprintln!("skipped: there is no systemd-analyze");
            None
        }
        output => Some(output.unwrap()),
    }
}

#[test]
fn systemd_has_nothing_to_say_about_the_unit() {
    let (_folder, unit) = unit();
    let Some(output) = analyze(&["verify", "--man=no"], &unit) else { return };
    let said = String::from_utf8_lossy(&output.stderr).into_owned() + &String::from_utf8_lossy(&output.stdout);
    // Unknown keys are only lines of text, with exit code 0. Units of the machine itself are not ours.
    let ours: Vec<&str> = said.lines().filter(|line| line.contains("realitysim.service")).collect();
    assert!(output.status.success() && ours.is_empty(), "{said}");
}

#[test]
fn the_unit_is_hardened() {
    let (_folder, unit) = unit();
    let Some(output) = analyze(&["security", "--offline=yes", "--threshold=15", "--no-pager"], &unit) else { return };
    // The threshold is in tenths: exposure 1.5.
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
}

/// `udevadm verify` is too new to rely on: every rule is a comma-separated list of KEY OPERATOR "value".
#[test]
fn the_udev_rules_are_well_formed() {
    let rules = std::fs::read_to_string("systemd/99-realitysim.rules").unwrap();
    let mut count = 0;
    for rule in rules.lines().filter(|line| !line.is_empty() && !line.starts_with('#')) {
        count += 1;
        let mut assigns = false;
        for part in rule.split(", ") {
            let (key, rest) = part.split_once(['=', '!', '+']).unwrap_or_else(|| panic!("{part}"));
            let known = ["ACTION", "SUBSYSTEM", "KERNEL", "DRIVER", "SYMLINK"].contains(&key)
                || (key.ends_with('}') && (key.starts_with("ENV{") || key.starts_with("ATTR{")));
            assert!(known, "{part}");
            let value = rest.trim_start_matches('=');
            assert!(value.starts_with('"') && value.ends_with('"') && value.len() > 2, "{part}");
            assigns |= !part.contains("==");
        }
        assert!(assigns, "does nothing: {rule}");
    }
    assert!(count >= 4);
}

#[test]
fn installing_puts_all_of_it_in_place_and_keeps_the_config() {
    let root = tempfile::tempdir().unwrap();
    let install = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_realitysim"));
        let output = command.arg("install").arg("--root").arg(root.path()).output().unwrap();
        assert!(output.status.success(), "{output:?}");
    };
    let read = |name: &str| std::fs::read(root.path().join(name)).unwrap();
    install();
    assert_eq!(read("etc/realitysim/robot.toml"), std::fs::read("config/robot.toml").unwrap());
    std::fs::write(root.path().join("etc/realitysim/robot.toml"), "robot = \"ours\"").unwrap();
    install();
    assert_eq!(read("etc/realitysim/robot.toml"), b"robot = \"ours\"");
    assert_eq!(read("usr/lib/systemd/system/realitysim.service"), std::fs::read("systemd/realitysim.service").unwrap());
    let version = Command::new(root.path().join("usr/bin/realitysim")).arg("--version").output().unwrap();
    assert!(version.status.success(), "{version:?}");
}

#[test]
fn the_files_of_a_debian_package_are_not_written_over() {
    let root = tempfile::tempdir().unwrap();
    let list = root.path().join("var/lib/dpkg/info/realitysim.list");
    std::fs::create_dir_all(list.parent().unwrap()).unwrap();
    std::fs::write(&list, "/usr/bin/realitysim\n").unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_realitysim"));
    let output = command.arg("install").arg("--root").arg(root.path()).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && said.contains("Debian package"), "{output:?}");
    assert!(!root.path().join("usr").exists() && !root.path().join("etc").exists());
}
