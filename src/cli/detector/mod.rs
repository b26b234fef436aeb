//! Runs a detector of the user's own: a command that gets a picture's file name and prints what it finds.

use std::io::{ErrorKind, Read};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use anyhow::Context;
use rustix::process::{Pid, Signal, kill_process_group};

/// Limits of a detector's answer.
#[derive(Clone, Copy, Debug)]
struct Limits {
    time: Duration,
    bytes: usize,
}

/// Time within which the command must answer for one picture.
const MAX_TIME: Duration = Duration::from_secs(60);
/// Longest output for one picture, bytes: some thousand detections.
const MAX_ANSWER_BYTES: usize = 256 << 10;
/// Time between two looks at whether the command has ended.
const WAIT: Duration = Duration::from_millis(2);

/// Runs `command` in a shell with the picture's name as its last argument. Returns what it prints.
///
/// # Errors
///
/// Fails if the command cannot be run, prints too much, takes too long, or ends with another exit code than 0. Then it has been ended with
/// all processes that it has started.
pub fn run_detector(command: &str, picture: &Path) -> anyhow::Result<String> {
    run_within(command, picture, Limits { time: MAX_TIME, bytes: MAX_ANSWER_BYTES })
        .with_context(|| format!("--detector {command:?}"))
}

fn run_within(command: &str, picture: &Path, limits: Limits) -> anyhow::Result<String> {
    let deadline = Instant::now() + limits.time;
    let mut process = Command::new("sh")
        .args(["-c", &format!("{command} \"$1\""), "sh"])
        .arg(picture)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .process_group(0)
        .spawn()
        .context("cannot be run")?;
    let group = Pid::from_child(&process);
    let answered = match process.stdout.take().map(|stdout| read_aside(stdout, limits.bytes)) {
        Some(answer) => collect(&answer, &mut process, limits, deadline),
        None => Err(anyhow::anyhow!("has no output")),
    };
    if answered.is_err() {
        // Ends the command with all processes that it has started.
        let _ = kill_process_group(group, Signal::KILL);
        let _ = process.wait();
    }
    let (answer, status) = answered?;
    let text = String::from_utf8_lossy(&answer).into_owned();
    anyhow::ensure!(status.success(), "ended with {status} and printed {:?}", shortened(&text));
    Ok(text)
}

/// The start of a detector's answer, as an error quotes it.
pub fn shortened(text: &str) -> String {
    const QUOTED_CHARACTERS: usize = 200;
    let text = text.trim();
    let start: String = text.chars().take(QUOTED_CHARACTERS).collect();
    if start.len() < text.len() { format!("{start} ...") } else { start }
}

/// Reads an output in a thread of its own, so that a command that says nothing can be waited for with a limit of time.
fn read_aside(stdout: ChildStdout, max_bytes: usize) -> Receiver<std::io::Result<Vec<u8>>> {
    let (send, receive) = channel();
    std::thread::spawn(move || {
        let mut answer = Vec::new();
        let read = stdout.take(max_bytes as u64 + 1).read_to_end(&mut answer).map(|_| answer);
        let _ = send.send(read);
    });
    receive
}

/// The whole output of a command, and how it ended.
fn collect(
    answer: &Receiver<std::io::Result<Vec<u8>>>,
    process: &mut Child,
    limits: Limits,
    deadline: Instant,
) -> anyhow::Result<(Vec<u8>, ExitStatus)> {
    let late = || format!("did not answer within {} s", limits.time.as_secs_f64());
    let answer = answer.recv_timeout(limits.time).ok().with_context(late)??;
    anyhow::ensure!(answer.len() <= limits.bytes, "prints more than {} bytes", limits.bytes);
    // A command may close its output and go on.
    loop {
        match process.try_wait() {
            Ok(Some(status)) => return Ok((answer, status)),
            Ok(None) => {}
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(error.into()),
        }
        anyhow::ensure!(Instant::now() < deadline, late());
        std::thread::sleep(WAIT);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { time: Duration::from_secs(60), bytes: 4096 };

    fn ask(command: &str, limits: Limits) -> Result<String, String> {
        run_within(command, Path::new("/a picture.png"), limits).map_err(|error| error.to_string())
    }

    #[test]
    fn the_answer_is_what_a_command_that_succeeds_prints() {
        assert_eq!(ask("echo", LIMITS), Ok("/a picture.png\n".to_owned()));
        for (command, said) in [
            ("echo 1; false", "exit status: 1 and printed \"1\""),
            ("/no/such/program", "exit status: 127"),
            ("yes", "prints more than 4096 bytes"),
            ("kill -9 $$; true", "signal: 9"),
        ] {
            let error = ask(command, LIMITS).expect_err(command);
            assert!(error.contains(said), "{command}: {error}");
        }
    }

    #[test]
    fn a_command_that_hangs_is_ended_with_all_that_it_has_started() {
        let limits = Limits { time: Duration::from_millis(100), ..LIMITS };
        for command in ["sleep 1000; true", "sleep 1000 & wait; true", "exec >&-; sleep 1000; true"] {
            let error = ask(command, limits).expect_err(command);
            assert!(error.contains("did not answer within 0.1 s"), "{command}: {error}");
        }
    }
}
