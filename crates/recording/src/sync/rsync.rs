//! The program rsync: how it is called, what it prints, how it ends.

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

/// Command for a remote shell that gives up on a host that does not answer, and notices when one has gone.
pub const SSH: &str = "ssh -o ConnectTimeout=10 -o ServerAliveInterval=5 -o ServerAliveCountMax=4";
/// Command on the robot; its other work has priority.
const ON_THE_ROBOT: &str = "nice -n 19 rsync";
/// Option for the time without a byte after which the link counts as broken, s.
const SILENCE_S: &str = "--timeout=60";
/// Option for the largest small file that is fetched along with its session.
const MAX_SMALL_FILE: &str = "--max-size=64m";
/// Most bytes of rsync's complaints that are kept.
const MAX_STDERR_BYTES: u64 = 64 << 10;
/// Most lines of rsync's output that wait.
const MAX_LINES: usize = 1024;
/// Time between two calls of `tick` while rsync prints nothing.
const TICK: Duration = Duration::from_millis(200);

/// Calls of rsync for one source.
pub struct Rsync<'a> {
    /// The source.
    pub source: &'a Source,
    /// The command that opens a shell on the robot.
    pub ssh: &'a str,
    /// Set to end rsync.
    pub stop: &'a AtomicBool,
}

/// How a call of rsync ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ended {
    /// Everything was transferred.
    Whole,
    /// Some files could not be transferred, since they are gone or may not be read; with what rsync said of them.
    Partly(String),
    /// The call was stopped.
    Stopped,
}

impl Rsync<'_> {
    /// Lists the source's folder and the folders in it.
    pub fn list(&self) -> Result<(Vec<Entry>, Ended), SyncError> {
        let mut command = self.command();
        // With -8 names are printed as they are, not in octal numbers.
        command.args(["-r", "-8", "--links", "--no-h", "--list-only", "--exclude=/.*", "--exclude=/*/*/*"]);
        command.arg(self.source.argument(""));
        let mut entries = Vec::new();
        let ended = self.run(command, &[], &mut |line| entries.extend(parse_line(line)), &mut || ())?;
        Ok((entries, ended))
    }

    /// Fetches the small files that describe each session; files that are no longer at the source are deleted here.
    pub fn heads(&self, into: &Path) -> Result<Ended, SyncError> {
        let mut command = self.command();
        // With -I files are compared by content, since sizes and times prove nothing.
        command.args(["-r", "-I", "--no-links", "--delete", "--delete-excluded", "--prune-empty-dirs"]);
        command.args(["--chmod=u+rwX", MAX_SMALL_FILE, "--exclude=/.*", "--include=/*/"]);
        for name in [SESSION_FILE, MANIFEST_FILE, METADATA_FILE, COVERAGE_FILE, EVICTED_FILE, RECEIVED_FILE] {
            command.arg(format!("--include=/*/{name}"));
        }
        command.arg(format!("--include=/*/{ACK_FOLDER}/")).arg(format!("--include=/*/{ACK_FOLDER}/*{ACK_ENDING}"));
        command.args(["--exclude=*"]).arg(self.source.argument("")).arg(with_slash(into));
        self.run(command, &[], &mut |_| (), &mut || ())
    }

    /// Fetches files by their paths under the source, into the same paths under `into`.
    ///
    /// Parts that are there already are compared block by block and kept where they are right, so that a broken
    /// transfer is continued. `arrived` is called with each file that rsync reports as complete, `tick` a few times a
    /// second.
    pub fn segments(
        &self,
        paths: &[String],
        into: &Path,
        arrived: &mut dyn FnMut(&str),
        tick: &mut dyn FnMut(),
    ) -> Result<Ended, SyncError> {
        let mut command = self.command();
        // The files are written in place, since only this program reads that folder: after a kill, the part that has
        // come is there under its name. --append would trust what is there.
        command.args(["-I", "--inplace", "--no-whole-file", "--chmod=u+rwX", "--files-from=-", "--from0"]);
        command.args(["--outbuf=L", "--out-format=%b %n"]).arg(self.source.argument("")).arg(with_slash(into));
        // In such a list rsync takes a line that begins with ; or # for a comment; it removes a leading ./ again.
        let asked = paths.iter().map(|path| format!("./{path}")).collect::<Vec<_>>().join("\0");
        let mut each = |line: &str| arrived(line.split_once(' ').map_or(line, |(_, name)| name));
        self.run(command, asked.as_bytes(), &mut each, tick)
    }

    /// Copies a file of this machine into the `ack` folder of a session at the source; the session's folder must
    /// exist.
    pub fn acknowledge(&self, file: &Path, session: &str) -> Result<Ended, SyncError> {
        let mut command = self.command();
        command.args(["-I", "--chmod=ug+rwX"]).arg(file).arg(self.source.argument(&format!("{session}/{ACK_FOLDER}/")));
        self.run(command, &[], &mut |_| (), &mut || ())
    }

    /// Call of rsync with the options that all calls share.
    fn command(&self) -> Command {
        let mut command = Command::new("rsync");
        command.env("LC_ALL", "C").args(["-s", SILENCE_S]);
        if self.source.is_remote() {
            command.args(["-e", self.ssh, "--rsync-path", ON_THE_ROBOT]);
        }
        command
    }

    /// Runs rsync: `input` goes to its standard input, each line of its output to `each`.
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
            // An rsync that has ended does not read it; its exit status says why.
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
            let complaints = scope.spawn(move || stderr.map_or_else(String::new, read_complaints));
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

    /// Interprets the exit status, as rsync(1) describes it under EXIT VALUES, and what rsync said.
    fn judge(&self, code: Option<i32>, complaints: &str) -> Result<Ended, SyncError> {
        let has = |what: &str| complaints.contains(what);
        let refused = |said: String| Err(SyncError::Refused { source_name: self.source.shown(), said });
        match code {
            Some(0) => Ok(Ended::Whole),
            _ if has("No space left on device") => refused("no space left on the disk".to_owned()),
            _ if has("File too large") => refused("a file may not become so large here".to_owned()),
            _ if has("Disk quota exceeded") => refused("the disk quota is used up".to_owned()),
            Some(23) if has("change_dir") => {
                Err(SyncError::Absent { source_name: self.source.shown(), said: first_complaint(complaints) })
            }
            Some(23..=25) => Ok(Ended::Partly(first_complaint(complaints))),
            Some(127) => refused("rsync is not installed there (Debian: apt-get install rsync)".to_owned()),
            Some(255) if has("Permission denied") || has("Host key verification") => {
                refused(format!("{} (ssh-copy-id gives it your key)", first_complaint(complaints)))
            }
            Some(code) if complaints.trim().is_empty() => Err(self.link(format!("rsync ended with {code}"))),
            _ => Err(self.link(first_complaint(complaints))),
        }
    }

    /// Error of a broken link.
    fn link(&self, said: String) -> SyncError {
        SyncError::Link { source_name: self.source.shown(), said }
    }
}

/// First line that says something: the lines after it mostly say that there was an error.
fn first_complaint(complaints: &str) -> String {
    let line =
        complaints.lines().map(str::trim).find(|line| !line.is_empty() && !line.starts_with("Warning: Permanently"));
    line.unwrap_or("rsync was ended").to_owned()
}

/// Reads what rsync says. The beginning is kept; the rest is read and dropped, so that rsync does not block.
fn read_complaints(mut stderr: impl Read) -> String {
    let mut bytes = Vec::new();
    let _ = stderr.by_ref().take(MAX_STDERR_BYTES).read_to_end(&mut bytes);
    let _ = std::io::copy(&mut stderr, &mut std::io::sink());
    String::from_utf8_lossy(&bytes).into_owned()
}

/// Tells rsync to end.
fn end(child: &Child) {
    if let Some(id) = rustix::process::Pid::from_raw(child.id() as i32) {
        let _ = rustix::process::kill_process(id, rustix::process::Signal::TERM);
    }
}

/// Path with a slash behind it, which for rsync means the content of the folder.
fn with_slash(folder: &Path) -> impl AsRef<OsStr> {
    let mut argument = folder.as_os_str().to_owned();
    argument.push("/");
    argument
}
