//! Command `realitysim install`: installs the recorder as a service of this machine.
//!
//! The Debian package is made of what this command writes (`./dev package`), so that there is one list of files.

mod shell_files;

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, bail};
use clap::Args;

use super::settings::UsageError;
use super::{Outcome, output, paths};
use crate::config::plain_file;

/// Put the recorder in place as a service of this machine (as root)
///
/// For a system without Debian's packages; where there is dpkg, `apt install ./realitysim_VERSION_ARCHITECTURE.deb` does this and can be undone.
///
/// Copies the program to /usr/bin, the unit, udev rules, user, manual pages and completions of shells to their places, and a config to
/// /etc/realitysim if there is none. Starts nothing: edit the config, then `systemctl enable --now realitysim`. A second run replaces all
/// but the config.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim install")]
pub struct InstallArguments {
    /// Only write the files, below this folder: for an image or a package
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
}

const FILES: [(&str, &str); 4] = [
    ("usr/lib/systemd/system/realitysim.service", include_str!("../../../systemd/realitysim.service")),
    ("usr/lib/udev/rules.d/99-realitysim.rules", include_str!("../../../systemd/99-realitysim.rules")),
    ("usr/lib/sysusers.d/realitysim.conf", include_str!("../../../systemd/realitysim.sysusers")),
    ("usr/lib/tmpfiles.d/realitysim.conf", include_str!("../../../systemd/realitysim.tmpfiles")),
];
const CONFIG: (&str, &str) = ("etc/realitysim/robot.toml", include_str!("../../../config/robot.toml"));
const PROGRAM: &str = "usr/bin/realitysim";
/// Where dpkg lists the files of the Debian package while it is installed.
const OF_PACKAGE: &str = "var/lib/dpkg/info/realitysim.list";

/// Commands that make the system read the files, in this order.
const COMMANDS: [&[&str]; 5] = [
    &["systemd-sysusers", "/usr/lib/sysusers.d/realitysim.conf"],
    &["systemd-tmpfiles", "--create", "/usr/lib/tmpfiles.d/realitysim.conf"],
    &["systemctl", "daemon-reload"],
    &["udevadm", "control", "--reload"],
    &["udevadm", "trigger", "--subsystem-match=video4linux", "--subsystem-match=tty"],
];

/// Largest program file, with all of its debugging information.
const MAX_PROGRAM_BYTES: u64 = 1 << 30;

pub fn run(arguments: &InstallArguments) -> anyhow::Result<Outcome> {
    let root = arguments.root.as_deref().unwrap_or(Path::new("/"));
    if root.join(OF_PACKAGE).exists() {
        let what = "is installed from a Debian package, whose files dpkg keeps: install a newer package, or remove that one first";
        return Err(UsageError(format!("{}: realitysim {what}", root.display())).into());
    }
    for (name, content) in FILES {
        write(&root.join(name), content.as_bytes(), 0o644)?;
    }
    for (name, content) in shell_files::shell_files()? {
        write(&root.join(name), &content, 0o644)?;
    }
    if !root.join(CONFIG.0).exists() {
        write(&root.join(CONFIG.0), CONFIG.1.as_bytes(), 0o644)?;
    }
    let program = std::env::current_exe().context("this program's own file")?;
    let content = plain_file::read(&program, MAX_PROGRAM_BYTES).map_err(|error| paths::cannot_read(&program, error))?;
    write(&root.join(PROGRAM), &content, 0o755)?;
    if arguments.root.is_some() {
        output::lines(&format!("written into {}", root.display()))?;
    } else {
        for command in COMMANDS {
            run_command(command)?;
        }
        output::lines("installed; edit /etc/realitysim/robot.toml, then: systemctl enable --now realitysim")?;
    }
    Ok(Outcome::Whole)
}

/// Writes beside the file, then renames: a running program cannot be written over.
fn write(path: &Path, content: &[u8], mode: u32) -> anyhow::Result<()> {
    let failed = |error| paths::cannot_write(path, error);
    if let Some(folder) = path.parent() {
        create_folders(folder).map_err(failed)?;
    }
    let beside = path.with_extension("new");
    std::fs::write(&beside, content).map_err(failed)?;
    std::fs::set_permissions(&beside, std::fs::Permissions::from_mode(mode)).map_err(failed)?;
    std::fs::rename(&beside, path).map_err(failed)
}

/// Makes the folders, accessible to all users whatever the umask.
fn create_folders(folder: &Path) -> std::io::Result<()> {
    let new: Vec<&Path> =
        folder.ancestors().take_while(|folder| !folder.as_os_str().is_empty() && !folder.exists()).collect();
    std::fs::create_dir_all(folder)?;
    new.into_iter().try_for_each(|folder| std::fs::set_permissions(folder, std::fs::Permissions::from_mode(0o755)))
}

fn run_command(command: &[&str]) -> anyhow::Result<()> {
    let said = command.join(" ");
    let status = Command::new(command[0]).args(&command[1..]).status().with_context(|| said.clone())?;
    if !status.success() {
        bail!("{said} ended with {status}; the files are in place");
    }
    Ok(())
}
