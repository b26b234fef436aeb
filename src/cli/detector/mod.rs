//! Runs a detector of the user's own: a command that gets names of pictures and prints what it finds in each.

use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use crossbeam_channel::{Receiver, RecvTimeoutError, bounded};
use rustix::process::{Pid, Signal, kill_process_group};

/// A command that is started once, since a network takes seconds to load, and is then asked about one picture after the other.
///
/// It gets the name of each picture as a line on standard input, and ends each answer with an empty line.
pub struct Detector {
    command: String,
    limits: Limits,
    process: Option<Process>,
}

/// Limits of a detector's answer.
#[derive(Clone, Copy, Debug)]
struct Limits {
    time: Duration,
    bytes: usize,
}

/// A detector that runs.
struct Process {
    child: Child,
    stdin: Option<ChildStdin>,
    lines: Receiver<std::io::Result<Vec<u8>>>,
    /// Whether it has answered for every picture so far, at least one.
    is_ready: bool,
}

/// Time within which the command must answer for one picture.
const MAX_TIME: Duration = Duration::from_secs(60);
/// Longest output for one picture, bytes: some thousand detections.
const MAX_ANSWER_BYTES: usize = 256 << 10;
/// Lines that wait to be looked at.
const MAX_LINES: usize = 64;
/// Time between two looks at whether the command has ended.
const WAIT: Duration = Duration::from_millis(2);
/// Time for the command to end by itself when there are no more pictures.
const TIME_TO_END: Duration = Duration::from_secs(1);
/// What a command must do that does not answer.
const PROTOCOL: &str = "it must read the names of pictures from standard input, a line each, and end each answer with an empty line, flushed";

impl Detector {
    /// A detector that is started with its first picture, by a shell.
    pub fn new(command: &str) -> Self {
        let limits = Limits { time: MAX_TIME, bytes: MAX_ANSWER_BYTES };
        Self { command: command.to_owned(), limits, process: None }
    }

    /// Asks about a picture. Returns the lines of the answer.
    ///
    /// # Errors
    ///
    /// Fails if the command cannot be run, prints too much, takes too long, or ends. Then it has been ended with all processes that it
    /// has started, and the next picture starts it anew.
    pub fn ask(&mut self, picture: &Path) -> anyhow::Result<String> {
        let asked = self.process.take().map_or_else(|| Process::start(&self.command, self.limits), Ok);
        let answered = asked.and_then(|mut process| Ok((process.ask(picture, self.limits)?, process)));
        let (answer, process) = answered.with_context(|| format!("--detector {:?}", self.command))?;
        self.process = Some(process);
        Ok(answer)
    }
}

impl Process {
    fn start(command: &str, limits: Limits) -> anyhow::Result<Self> {
        let mut child = Command::new("sh")
            .args(["-c", command])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .process_group(0)
            .spawn()
            .context("cannot be run")?;
        let stdin = child.stdin.take();
        let lines = read_aside(child.stdout.take().context("has no output")?, limits.bytes);
        Ok(Self { child, stdin, lines, is_ready: false })
    }

    fn ask(&mut self, picture: &Path, limits: Limits) -> anyhow::Result<String> {
        let start = Instant::now();
        self.is_ready = false;
        if let Some(stdin) = &mut self.stdin {
            // A command that reads nothing more has ended, or will not answer: that is told below.
            let _ = stdin.write_all(format!("{}\n", picture.display()).as_bytes()).and_then(|()| stdin.flush());
        }
        let mut answer = Vec::new();
        loop {
            match self.lines.recv_deadline(start + limits.time) {
                Ok(line) => {
                    let line = line?;
                    if line.trim_ascii().is_empty() {
                        break;
                    }
                    answer.extend(line);
                    anyhow::ensure!(answer.len() <= limits.bytes, "prints more than {} bytes", limits.bytes);
                }
                Err(RecvTimeoutError::Timeout) => {
                    bail!("did not answer within {} s: {PROTOCOL}", limits.time.as_secs_f64())
                }
                Err(RecvTimeoutError::Disconnected) => {
                    let printed = shortened(&String::from_utf8_lossy(&answer));
                    match self.status(start + limits.time) {
                        Some(status) => bail!("ended with {status} and printed {printed:?}: {PROTOCOL}"),
                        None => bail!("closed its output: {PROTOCOL}"),
                    }
                }
            }
        }
        self.is_ready = true;
        Ok(String::from_utf8_lossy(&answer).into_owned())
    }

    /// How the command ended; `None` if it has not by `deadline`.
    fn status(&mut self, deadline: Instant) -> Option<ExitStatus> {
        loop {
            match self.child.try_wait() {
                Ok(Some(status)) => return Some(status),
                Err(error) if error.kind() != ErrorKind::Interrupted => return None,
                _ if Instant::now() > deadline => return None,
                _ => std::thread::sleep(WAIT),
            }
        }
    }
}

/// Ends the command with all processes that it has started.
impl Drop for Process {
    fn drop(&mut self) {
        // The end of its input tells it that there are no more pictures.
        if self.stdin.take().is_some() && self.is_ready {
            self.status(Instant::now() + TIME_TO_END);
        }
        let _ = kill_process_group(Pid::from_child(&self.child), Signal::KILL);
        let _ = self.child.wait();
    }
}

/// The start of a detector's answer, as an error quotes it.
pub fn shortened(text: &str) -> String {
    const QUOTED_CHARACTERS: usize = 200;
    let text = text.trim();
    let start: String = text.chars().take(QUOTED_CHARACTERS).collect();
    if start.len() < text.len() { format!("{start} ...") } else { start }
}

/// Reads the lines of an output in a thread of its own, so that they can be waited for with a limit of time. A line that is longer than
/// an answer may be comes in pieces.
fn read_aside(stdout: ChildStdout, max_bytes: usize) -> Receiver<std::io::Result<Vec<u8>>> {
    let (send, receive) = bounded(MAX_LINES);
    std::thread::spawn(move || {
        let mut output = BufReader::new(stdout);
        loop {
            let mut line = Vec::new();
            let read = output.by_ref().take(max_bytes as u64 + 1).read_until(b'\n', &mut line);
            if matches!(read, Ok(0)) || send.send(read.map(|_| line)).is_err() {
                break;
            }
        }
    });
    receive
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { time: Duration::from_secs(60), bytes: 4096 };

    fn detector(command: &str, limits: Limits) -> Detector {
        Detector { limits, ..Detector::new(command) }
    }

    fn ask(detector: &mut Detector) -> Result<String, String> {
        detector.ask(Path::new("/a picture.png")).map_err(|error| format!("{error:#}"))
    }

    #[test]
    fn one_process_answers_for_each_picture() {
        let mut detector = detector("while read -r name; do echo \"$name $$\"; echo; done", LIMITS);
        let first = ask(&mut detector).expect("an answer");
        assert!(first.starts_with("/a picture.png "), "{first}");
        assert_eq!(ask(&mut detector), Ok(first), "by the same process");
    }

    #[test]
    fn a_command_that_does_not_answer_is_told_what_it_must_do() {
        for (command, said) in [
            ("echo 1; false", "exit status: 1 and printed \"1\""),
            ("/no/such/program", "exit status: 127"),
            ("yes", "prints more than 4096 bytes"),
            ("tr '\\n' x </dev/zero", "prints more than 4096 bytes"),
            ("kill -9 $$; true", "signal: 9"),
            ("true", "a line each, and end each answer with an empty line"),
        ] {
            let error = ask(&mut detector(command, LIMITS)).expect_err(command);
            assert!(error.contains(said), "{command}: {error}");
        }
    }

    #[test]
    fn a_command_that_hangs_is_ended_with_all_that_it_has_started() {
        let limits = Limits { time: Duration::from_millis(100), ..LIMITS };
        for command in ["sleep 1000; true", "sleep 1000 & wait; true", "exec >&-; sleep 1000; true"] {
            let error = ask(&mut detector(command, limits)).expect_err(command);
            assert!(error.contains("empty line"), "{command}: {error}");
        }
    }

    #[test]
    fn a_command_that_died_is_started_anew() {
        let folder = tempfile::tempdir().expect("a folder");
        let once = folder.path().join("once");
        let command =
            format!("read -r name; [ -e '{0}' ] || {{ touch '{0}'; exit 4; }}; echo found; echo; cat", once.display());
        let mut detector = detector(&command, LIMITS);
        assert!(ask(&mut detector).is_err_and(|error| error.contains("exit status: 4")));
        assert_eq!(ask(&mut detector), Ok("found\n".to_owned()));
    }
}
