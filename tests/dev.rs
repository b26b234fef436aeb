//! `./dev` asks for packages by names that the distribution has.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;

/// What a distribution's apt says: the packages that `libclang1` and `libclang-dev` depend on, the version of its
/// python3, and all packages that it offers.
struct Distribution {
    name: &'static str,
    libclang1: &'static str,
    libclang_dev: &'static str,
    python3: &'static str,
    offered: &'static str,
    expected: &'static str,
}

const DISTRIBUTIONS: [Distribution; 6] = [
    Distribution {
        name: "Ubuntu 22.04",
        libclang1: "libclang1-14",
        libclang_dev: "libclang-14-dev",
        python3: "3.10.6-1~22.04.1",
        offered: "libclang1-13 libclang1-14 libclang1-15 libclang-common-13-dev libclang-common-14-dev \
                  libclang-common-15-dev python3.10-venv python3.11-venv",
        expected: "libclang1-14 libclang-common-14-dev python3.11-venv",
    },
    Distribution {
        name: "Ubuntu 24.04",
        libclang1: "libclang1-18",
        libclang_dev: "libclang-18-dev",
        python3: "3.12.3-0ubuntu2",
        offered: "libclang1-17t64 libclang1-18 libclang1-19 libclang-common-17-dev libclang-common-18-dev \
                  libclang-common-19-dev python3.12-venv",
        expected: "libclang1-18 libclang-common-18-dev python3-venv",
    },
    Distribution {
        name: "Debian 13",
        libclang1: "libclang1-19",
        libclang_dev: "libclang-19-dev",
        python3: "3.13.5-1",
        offered: "libclang1-17t64 libclang1-19 libclang-common-17-dev libclang-common-19-dev python3.13-venv",
        expected: "libclang1-19 libclang-common-19-dev python3-venv",
    },
    Distribution {
        name: "one without libclang1, such as Ubuntu 26.04",
        libclang1: "",
        libclang_dev: "libclang-21-dev",
        python3: "3.14.3-0ubuntu1",
        offered: "libclang1-9 libclang1-21 libclang1-22 libclang-common-21-dev libclang-common-22-dev python3.14-venv",
        expected: "libclang1-21 libclang-common-21-dev python3-venv",
    },
    Distribution {
        name: "one that has chosen no version",
        libclang1: "",
        libclang_dev: "",
        python3: "3.9.2-3",
        offered: "libclang1-9 libclang1-17t64 libclang-common-9-dev libclang-common-17-dev python3.9-venv",
        expected: "libclang1-17 libclang-common-17-dev",
    },
    Distribution {
        name: "one that knows nothing",
        libclang1: "",
        libclang_dev: "",
        python3: "",
        offered: "",
        expected: "libclang-dev",
    },
];

/// As the real one: patterns are extended regular expressions, and what is not known is a failure.
const APT_CACHE: &str = r#"#!/usr/bin/env bash
case "$1 $2" in
    "depends libclang1") [ -z "$LIBCLANG1" ] && exit 100; printf '%s\n  Depends: %s\n' "$2" "$LIBCLANG1" ;;
    "depends libclang-dev") [ -z "$LIBCLANG_DEV" ] && exit 100; printf '%s\n  Depends: %s\n' "$2" "$LIBCLANG_DEV" ;;
    "policy python3") [ -z "$PYTHON3" ] || printf 'python3:\n  Installed: (none)\n  Candidate: %s\n' "$PYTHON3" ;;
    "search --names-only") printf '%s - a description\n' $OFFERED | grep -E "${3%$} " ;;
    "show --no-all-versions") printf '%s\n' $OFFERED | grep -qx "$3" && printf 'Package: %s\n' "$3" ;;
    *) echo "apt-cache is not called like that: $*" >&2; exit 99 ;;
esac
"#;

fn write_program(path: &Path, text: &str) {
    fs::write(path, text).unwrap();
    fs::set_permissions(path, fs::Permissions::from_mode(0o755)).unwrap();
}

/// What a command prints that knows the functions of `./dev`, its words in one line. `folder` comes first in PATH.
fn said(folder: &Path, command: &str, environment: &[(&str, &str)]) -> String {
    let script = format!("source ./dev; PATH=\"$1:$PATH\"; {command}");
    let output = Command::new("bash")
        .args(["-c", &script, "bash"])
        .arg(folder)
        .envs(environment.iter().copied())
        .output()
        .unwrap();
    let errors = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && errors.is_empty(), "{command}: {:?}: {errors}", output.status);
    String::from_utf8(output.stdout).unwrap().split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn packages_have_the_names_of_the_distribution() {
    let folder = tempfile::tempdir().unwrap();
    write_program(&folder.path().join("apt-cache"), APT_CACHE);
    for Distribution { name, libclang1, libclang_dev, python3, offered, expected } in DISTRIBUTIONS {
        let environment =
            [("LIBCLANG1", libclang1), ("LIBCLANG_DEV", libclang_dev), ("PYTHON3", python3), ("OFFERED", offered)];
        assert_eq!(said(folder.path(), "libclang_packages; python_venv_package", &environment), expected, "{name}");
    }
}

#[test]
fn a_python_that_is_too_old_is_passed_over() {
    let folder = tempfile::tempdir().unwrap();
    for (name, version) in [("python3", "3.10"), ("python3.12", "3.12"), ("python3.11", "3.11")] {
        // Does what the script given with -c does.
        let good = i32::from(version == "3.10");
        write_program(&folder.path().join(name), &format!("#!/bin/sh\nexit {good}\n"));
    }
    // None of the machine's own is in the way.
    let command = "has() { [ -x \"$1\" ] || [ -x \"${PATH%%:*}/$1\" ]; }; find_python";
    assert_eq!(said(folder.path(), command, &[]), "python3.12");
    fs::remove_file(folder.path().join("python3.12")).unwrap();
    fs::remove_file(folder.path().join("python3.11")).unwrap();
    assert_eq!(said(folder.path(), &format!("{command} || echo none"), &[]), "none");
}
