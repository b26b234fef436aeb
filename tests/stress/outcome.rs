//! One case from message to capture, and what must hold of it.

use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};

use realitysim::config::Settings;
use realitysim::log_input::scene_source::{SceneSource, parse};
use realitysim::ros2::LogMessage;
use realitysim::ros2::messages::FrameTag;
use realitysim::tagging::{ReplayOptions, replay};

use super::case::Case;
use crate::numerics::support::unsound;
use crate::replay::support::{POSE, TAG, decode_all, on, own_log, read_capture};

pub enum Outcome {
    /// So many frames have a tag.
    Replayed(u64),
    /// The scene, the log or the settings are impossible, and a message says so.
    Refused,
}

/// An error is what broke.
pub fn outcome(case: &Case) -> Result<Outcome, String> {
    catch_unwind(AssertUnwindSafe(|| replayed(case))).unwrap_or_else(|panic| {
        let said = panic.downcast_ref::<String>().cloned();
        let said = said.or_else(|| panic.downcast_ref::<&str>().map(|said| (*said).to_owned()));
        Err(format!("panicked: {}", said.unwrap_or_default()))
    })
}

fn refused(why: &impl ToString) -> Result<Outcome, String> {
    if why.to_string().len() > 10 {
        Ok(Outcome::Refused)
    } else {
        Err(format!("refused without a reason: {}", why.to_string()))
    }
}

fn replayed(case: &Case) -> Result<Outcome, String> {
    let folder = tempfile::tempdir().map_err(|error| error.to_string())?;
    let path = |name: &str| folder.path().join(name);
    let lens = path("lens.toml");
    fs::write(&lens, case.lens).map_err(|error| error.to_string())?;
    let scene = match parse(&case.scene(&lens.to_string_lossy()), "scene.toml") {
        Ok(scene) => scene,
        Err(refusal) => return refused(&refusal),
    };
    let messages: Result<Vec<LogMessage>, _> = SceneSource::new(&scene).collect();
    let messages = messages.map_err(|error| format!("the scene does not render: {error}"))?;
    let messages = case.faults.iter().fold(messages, |messages, fault| fault.apply(messages));
    fs::write(path("log.mcap"), own_log(&messages)).map_err(|error| error.to_string())?;
    let settings = Settings::parse(&case.config(), "robot.toml").map_err(|error| format!("settings: {error}"))?;
    let options = ReplayOptions {
        source: path("log.mcap"),
        captures: path("captures"),
        settings,
        initial: None,
        threads: case.threads,
        realtime: false,
        warm_start: false,
    };
    let report = match replay(&options, &mut |_, _| ()) {
        Ok(report) => report,
        Err(refusal) => return refused(&refusal),
    };
    let session = [report.session.clone(), path("captures").join(&report.session)];
    let session = session.iter().find(|path| path.is_dir()).ok_or("the capture is not where the report says")?;
    let capture = read_capture(session);
    let tags: Vec<FrameTag> = decode_all(&capture, TAG);
    for tag in &tags {
        unsound(tag).map_or(Ok(()), |fault| Err(format!("frame {}: {fault}", tag.sequence)))?;
    }
    let untagged: u64 = report.untagged.values().sum();
    let counted = |what: &str, found: u64, expected: u64| {
        if found == expected { Ok(()) } else { Err(format!("{what}: {found}, not {expected}: {report:?}")) }
    };
    counted("frames tagged and untagged", report.tagged + untagged, report.frames)?;
    counted("tags in the capture", tags.len() as u64, report.tagged)?;
    counted("valid tags", tags.iter().filter(|tag| tag.valid).count() as u64, report.valid)?;
    counted("poses of valid tags", on(&capture, POSE).count() as u64, report.valid)?;
    Ok(Outcome::Replayed(report.tagged))
}
