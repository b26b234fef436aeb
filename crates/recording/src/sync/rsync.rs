//! The program `rsync`: how it is called, what it says, how it ends.

use std::ffi::OsStr;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crossbeam_channel::{RecvTimeoutError, bounded};

use super::error::SyncError;
use super::listing::{Entry, parse_line};
use super::source::Source;
use crate::{
    ACK_ENDING, ACK_FOLDER, COVERAGE_FILE, EVICTED_FILE, MANIFEST_FILE, METADATA_FILE, RECEIVED_FILE, SESSION_FILE,
};

/// Gives up on a host that does not answer, and notices one that has gone.
pub const SSH: &str = "ssh -o ConnectTimeout=10 -o ServerAliveInterval=5 -o ServerAliveCountMax=4";
/// The robot's other work goes first.
const ON_THE_ROBOT: &str = "nice -n 19 rsync";
/// Without a byte for so long the link is dead, s.
const SILENCE_S: &str = "--timeout=60";
/// Small files that are fetched without being asked for one by one.
const MAX_SMALL_FILE: &str = "--max-size=64m";
/// Of what rsync complains.
const MAX_SAID_BYTES: u64 = 64 << 10;
/// Lines under way between rsync and us.
const MAX_LINES: usize = 1024;
const TICK: Duration = Duration::from_millis(200);

pub struct Rsync<'a> {
    pub source: &'a Source,
    /// The command that opens a shell on the robot.
    pub ssh: &'a str,
    pub stop: &'a AtomicBool,
}

/// How it ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ended {
    Whole,
    /// Some files could not be had: gone, or not to be read. What it said of them.
    Partly(String),
    Stopped,
}

impl Rsync<'_> {
    /// What lies in the source's folder and in the folders there.
    pub fn list(&self) -> Result<(Vec<Entry>, Ended), SyncError> {
        let mut command = self.command();
        // Names as they are, not in octal numbers.
        command.args(["-r", "-8", "--links", "--no-h", "--list-only", "--exclude=/.*", "--exclude=/*/*/*"]);
        command.arg(self.source.argument(""));
        let mut entries = Vec::new();
        let ended = self.run(command, &[], &mut |line| entries.extend(parse_line(line)), &mut || ())?;
        Ok((entries, ended))
    }

    /// What sessions say of themselves; what is no longer there goes.
    pub fn heads(&self, into: &Path) -> Result<Ended, SyncError> {
        let mut command = self.command();
        // Sizes and times prove nothing: they are compared by content.
        command.args(["-r", "-I", "--no-links", "--delete", "--delete-excluded", "--prune-empty-dirs"]);
        command.args(["--chmod=u+rwX", MAX_SMALL_FILE, "--exclude=/.*", "--include=/*/"]);
        for name in [SESSION_FILE, MANIFEST_FILE, METADATA_FILE, COVERAGE_FILE, EVICTED_FILE, RECEIVED_FILE] {
            command.arg(format!("--include=/*/{name}"));
        }
        command.arg(format!("--include=/*/{ACK_FOLDER}/")).arg(format!("--include=/*/{ACK_FOLDER}/*{ACK_ENDING}"));
        command.args(["--exclude=*"]).arg(self.source.argument("")).arg(with_slash(into));
        self.run(command, &[], &mut |_| (), &mut || ())
    }

    /// Files by their paths under the source, into the same paths under `into`. What is there of them already is compared
    /// block by block and kept where it is right: a broken transfer goes on where it broke. `arrived` hears of each
    /// that rsync takes for done, `tick` is called a few times a second.
    pub fn segments(
        &self,
        paths: &[String],
        into: &Path,
        arrived: &mut dyn FnMut(&str),
        tick: &mut dyn FnMut(),
    ) -> Result<Ended, SyncError> {
        let mut command = self.command();
        // In place, since nobody but us looks into that folder: a kill then leaves what has come, under its name. Not
        // --append: it would believe what is there.
        command.args(["-I", "--inplace", "--no-whole-file", "--chmod=u+rwX", "--files-from=-", "--from0"]);
        command.args(["--outbuf=L", "--out-format=%b %n"]).arg(self.source.argument("")).arg(with_slash(into));
        // In such a list rsync takes a line that begins with ; or # for a comment, and leaves a path's ./ away again.
        let asked = paths.iter().map(|path| format!("./{path}")).collect::<Vec<_>>().join("\0");
        let mut each = |line: &str| arrived(line.split_once(' ').map_or(line, |(_, name)| name));
        self.run(command, asked.as_bytes(), &mut each, tick)
    }

    /// A file of ours into a session's folder at the source; that folder must be there.
    pub fn acknowledge(&self, file: &Path, session: &str) -> Result<Ended, SyncError> {
        let mut command = self.command();
        command.args(["-I", "--chmod=ug+rwX"]).arg(file).arg(self.source.argument(&format!("{session}/{ACK_FOLDER}/")));
        self.run(command, &[], &mut |_| (), &mut || ())
    }

    fn command(&self) -> Command {
        let mut command = Command::new("rsync");
        command.env("LC_ALL", "C").args(["-s", SILENCE_S]);
        if self.source.is_remote() {
            command.args(["-e", self.ssh, "--rsync-path", ON_THE_ROBOT]);
        }
        command
    }

    fn run(
        &self,
        mut command: Command,
        input: &[u8],
        each: &mut dyn FnMut(&str),
        tick: &mut dyn FnMut(),
    ) -> Result<Ended, SyncError> {
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().map_err(|error| match error.kind() {
            std::io::ErrorKind::NotFound => SyncError::NoRsync,
            _ => self.link(error.to_string()),
        })?;
        let (stdin, stdout, stderr) = (child.stdin.take(), child.stdout.take(), child.stderr.take());
        let (send, lines) = bounded::<String>(MAX_LINES);
        let complaints = std::thread::scope(|scope| {
            // One that has gone does not read it: how it ended says why.
            scope.spawn(move || stdin.map(|mut stdin| stdin.write_all(input)));
            scope.spawn(move || {
                for line in
                    stdout.into_iter().flat_map(|stdout| BufReader::new(stdout).split(b'\n')).map_while(Result::ok)
                {
                    if send.send(String::from_utf8_lossy(&line).into_owned()).is_err() {
                        break;
                    }
                }
            });
            let complaints = scope.spawn(move || stderr.map_or_else(String::new, said));
            let mut told_to_end = false;
            loop {
                if self.stop.load(Ordering::Relaxed) && !told_to_end {
                    told_to_end = true;
                    end(&child);
                }
                match lines.recv_timeout(TICK) {
                    Ok(line) => each(&line),
                    Err(RecvTimeoutError::Timeout) => tick(),
                    Err(RecvTimeoutError::Disconnected) => break,
                }
            }
            complaints.join().unwrap_or_default()
        });
        let status = child.wait().map_err(|error| self.link(error.to_string()))?;
        if self.stop.load(Ordering::Relaxed) {
            return Ok(Ended::Stopped);
        }
        self.judge(status.code(), &complaints)
    }

    /// rsync(1), EXIT VALUES.
    fn judge(&self, code: Option<i32>, complaints: &str) -> Result<Ended, SyncError> {
        let has = |what: &str| complaints.contains(what);
        let refused = |said: String| Err(SyncError::Refused { source_name: self.source.shown(), said });
        match code {
            Some(0) => Ok(Ended::Whole),
            _ if has("No space left on device") => refused("no space left on the disk".to_owned()),
            _ if has("File too large") => refused("a file may not become so large here".to_owned()),
            _ if has("Disk quota exceeded") => refused("the disk quota is used up".to_owned()),
            Some(23) if has("change_dir") => {
                Err(SyncError::Absent { source_name: self.source.shown(), said: told(complaints) })
            }
            Some(23..=25) => Ok(Ended::Partly(told(complaints))),
            Some(127) => refused("rsync is not installed there (Debian: apt-get install rsync)".to_owned()),
            Some(255) if has("Permission denied") || has("Host key verification") => {
                refused(format!("{} (ssh-copy-id gives it your key)", told(complaints)))
            }
            Some(code) if complaints.trim().is_empty() => Err(self.link(format!("rsync ended with {code}"))),
            _ => Err(self.link(told(complaints))),
        }
    }

    fn link(&self, said: String) -> SyncError {
        SyncError::Link { source_name: self.source.shown(), said }
    }
}

/// The first line that says something; what follows mostly says that something was said.
fn told(complaints: &str) -> String {
    let line =
        complaints.lines().map(str::trim).find(|line| !line.is_empty() && !line.starts_with("Warning: Permanently"));
    line.unwrap_or("rsync was ended").to_owned()
}

/// The beginning of it; the rest is read and forgotten, so that its writer does not wait.
fn said(mut stderr: impl Read) -> String {
    let mut bytes = Vec::new();
    let _ = stderr.by_ref().take(MAX_SAID_BYTES).read_to_end(&mut bytes);
    let _ = std::io::copy(&mut stderr, &mut std::io::sink());
    String::from_utf8_lossy(&bytes).into_owned()
}

fn end(child: &Child) {
    if let Some(id) = rustix::process::Pid::from_raw(child.id() as i32) {
        let _ = rustix::process::kill_process(id, rustix::process::Signal::TERM);
    }
}

/// What lies in it.
fn with_slash(folder: &Path) -> impl AsRef<OsStr> {
    let mut argument = folder.as_os_str().to_owned();
    argument.push("/");
    argument
}
