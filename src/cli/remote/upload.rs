//! `realitysim sync CAPTURES --to ADDRESS`: uploads captures to an object store.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use super::super::output::{self, Transfer};
use super::super::{Outcome, settings::UsageError};
use crate::recording::sync::Selection;
use crate::remote::{Address, ObjectStores, UploadEvent, UploadReport};

/// Uploads the captures in a folder, and prints what became of them.
pub fn run(captures: &Path, to: &str, selection: &Selection, stop: &AtomicBool, json: bool) -> anyhow::Result<Outcome> {
    if !captures.is_dir() {
        return Err(UsageError(format!(
            "{}: --to uploads from a folder of captures, and there is none",
            captures.display()
        ))
        .into());
    }
    let to = Address::parse(to).map_err(|error| UsageError(error.to_string()))?;
    if to.is_of_this_machine() {
        return Err(
            UsageError(format!("{to}: a folder of this machine: `sync SOURCE -o FOLDER` copies into it")).into()
        );
    }
    let mut progress = Transfer::new();
    let report =
        crate::remote::upload(&ObjectStores::new()?, captures, &to, selection, stop, &mut |event| match event {
            UploadEvent::Session(name) => progress.say(&format!("{name}: looked at")),
            UploadEvent::Sent(done, total) => progress.set(done, total),
        });
    progress.finish();
    let report = report?;
    if report.sessions == 0 && !report.stopped {
        let what = "holds no session that was asked for: name a folder of captures, and beginnings of the names of sessions in it";
        return Err(UsageError(format!("{}: {what}", captures.display())).into());
    }
    report.losses.iter().for_each(|loss| output::say(&loss.to_string()));
    print(&report, json)?;
    Ok(match report.stopped {
        true => Outcome::NotReached,
        false => Outcome::of(&report.losses),
    })
}

fn print(report: &UploadReport, json: bool) -> anyhow::Result<()> {
    if json {
        return output::json(report);
    }
    let UploadReport { to, receiver, sessions, uploaded, uploaded_bytes, already, withdrawn, stopped, .. } = report;
    let mut text = format!(
        "{to}: {uploaded} segments uploaded ({}), {already} were there, of {sessions} sessions; acknowledged as {receiver}",
        output::size(*uploaded_bytes)
    );
    if *withdrawn > 0 {
        text += &format!("\n{withdrawn} segments that it had acknowledged are gone there: taken back");
    }
    if *stopped {
        text += "\nstopped before the end: the same call goes on";
    }
    output::lines(&text)
}
