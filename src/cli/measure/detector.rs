//! Runs a detector of the user's own: a command that gets a picture's file name and prints what it finds.

use std::io::Read;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::mpsc::channel;
use std::time::Duration;

use anyhow::Context;

/// Time within which the command must answer for one picture.
const MAX_TIME: Duration = Duration::from_secs(60);
/// Longest output for one picture, bytes: some thousand detections.
const MAX_ANSWER_BYTES: u64 = 256 << 10;

/// Runs `command` in a shell with the picture's name as its last argument. Returns what it prints.
pub fn run_detector(command: &str, picture: &Path) -> anyhow::Result<String> {
    let failed = |what: String| anyhow::anyhow!("--detector {command:?}: {what}");
    let mut process = Command::new("sh")
        .args(["-c", &format!("{command} \"$1\""), "sh"])
        .arg(picture)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .process_group(0)
        .spawn()
        .with_context(|| format!("--detector {command:?}: cannot be run"))?;
    let group = rustix::process::Pid::from_child(&process);
    let stdout = process.stdout.take().context("a pipe was asked for")?;
    let (send, receive) = channel();
    std::thread::spawn(move || {
        let mut answer = Vec::new();
        let read = stdout.take(MAX_ANSWER_BYTES + 1).read_to_end(&mut answer).map(|_| answer);
        let _ = send.send(read);
    });
    let answer = receive.recv_timeout(MAX_TIME);
    let whole = matches!(&answer, Ok(Ok(answer)) if answer.len() as u64 <= MAX_ANSWER_BYTES);
    if !whole {
        // Ends the command with all processes that it has started.
        let _ = rustix::process::kill_process_group(group, rustix::process::Signal::KILL);
    }
    let status = process.wait().map_err(|error| failed(error.to_string()))?;
    let answer = answer.map_err(|_| failed(format!("did not answer within {} s", MAX_TIME.as_secs())))?;
    let answer = answer.map_err(|error| failed(error.to_string()))?;
    if !whole {
        return Err(failed(format!("prints more than {MAX_ANSWER_BYTES} bytes")));
    }
    let text = String::from_utf8_lossy(&answer).into_owned();
    let start: String = text.trim().chars().take(200).collect();
    if status.success() { Ok(text) } else { Err(failed(format!("ended with {status} and printed {start:?}"))) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_output_is_an_answer_unless_the_command_fails() {
        let ask = |command: &str| run_detector(command, Path::new("/a picture.png")).map_err(|error| error.to_string());
        assert_eq!(ask("echo found in"), Ok("found in /a picture.png\n".to_owned()));
        assert_eq!(ask("true"), Ok(String::new()));
        for (command, said) in [
            ("echo 1; false", "exit status: 1"),
            ("/no/such/program", "exit status: 127"),
            ("yes", "prints more than 262144 bytes"),
        ] {
            let error = ask(command).expect_err(command);
            assert!(error.contains(said), "{command}: {error}");
        }
    }
}
