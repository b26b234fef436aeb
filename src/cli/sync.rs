//! Command `realitysim sync`: fetches recordings from a robot.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use clap::Args;
use jiff::{ToSpan, Zoned};

use super::catalogue_beside::update_catalogue;
use super::settings::{UsageError, numbers};
use super::values::whole;
use super::{Outcome, output};
use crate::live::stop_flag;
use crate::recording::sync::{Event, Options, Report, SSH, Selection, Source, Store, SyncError, Within, round};
use crate::recording::{METADATA_FILE, SESSION_FILE};

/// Fetch recordings from a robot, or from a stick
///
/// Finished segments only; each is verified by its hash, forced onto the disk and only then acknowledged: what is
/// acknowledged may be deleted on the robot. A sync that broke goes on where it broke; one that is run twice copies
/// nothing. Needs rsync on both sides. docs/howto/sync.md says what holds whatever goes wrong.
#[derive(Args)]
#[command(after_long_help = concat!(
    "Examples:",
    "\n  realitysim sync robot: -o captures/",
    "\n  realitysim sync nao@10.0.0.5:captures -o captures/ --since 2026-11-21",
))]
pub struct SyncArguments {
    /// robot: (the service's captures), user@host:dir, or a folder of captures
    source: String,
    /// Sessions, by the beginnings of their names; none: all
    sessions: Vec<String>,
    /// Where captures are kept here
    #[arg(short, long, value_name = "CAPTURES_DIR", required = true)]
    #[cfg_attr(feature = "remote", arg(required = false, required_unless_present = "to"))]
    output: Option<PathBuf>,
    /// Upload the folder of captures SOURCE to an object store instead: s3://bucket/captures, gs://, az:// or https://. A segment is acknowledged once
    /// it was read back
    #[cfg(feature = "remote")]
    #[arg(long, value_name = "ADDRESS", conflicts_with_all = ["output", "watch", "no_acknowledge"])]
    to: Option<String>,
    /// Only segments recorded since then, by the robot's clock: 2026-11-21 or 2026-11-21T10:00:00Z
    #[arg(long, value_name = "TIME", value_parser = begin_ns)]
    since: Option<i64>,
    /// Only segments that begin until then; a day counts as a whole
    #[arg(long, value_name = "TIME", value_parser = end_ns)]
    until: Option<i64>,
    /// Only segments whose valid poses (the box around them) come this near a place on the field, metres
    #[arg(long, value_name = "X,Y,R", value_parser = within, allow_hyphen_values = true)]
    within: Option<Within>,
    /// Only segments of whose frames at least this share has a valid tag, 0 to 1
    #[arg(long, value_name = "SHARE", value_parser = share)]
    valid: Option<f64>,
    /// Keep following a robot that records, until stopped
    #[arg(long)]
    watch: bool,
    /// Between two looks
    #[arg(long, value_name = "SECONDS", default_value_t = 5, value_parser = whole(1..=3600u64))]
    every: u64,
    /// The command that opens a shell on the robot, options included
    #[arg(long, value_name = "COMMAND", default_value = SSH)]
    ssh: String,
    /// Do not tell the source what is here: it will delete nothing on our word
    #[arg(long)]
    no_acknowledge: bool,
}

/// Longest wait between two attempts to reach a robot that is away.
const MAX_PAUSE: Duration = Duration::from_secs(60);
const TICK: Duration = Duration::from_millis(100);

pub fn run(arguments: &SyncArguments, json: bool) -> anyhow::Result<Outcome> {
    if arguments.since.zip(arguments.until).is_some_and(|(since, until)| until < since) {
        return Err(UsageError("--until is before --since: no segment is asked for".to_owned()).into());
    }
    let selection = Selection {
        sessions: arguments.sessions.clone(),
        since_ns: arguments.since,
        until_ns: arguments.until,
        within: arguments.within,
        valid_share: arguments.valid,
    };
    #[cfg(feature = "remote")]
    if let Some(to) = &arguments.to {
        let stop = stop_flag()?;
        return super::remote::upload(arguments.source.as_ref(), to, &selection, &stop, json);
    }
    let missing = || UsageError("--output CAPTURES_DIR is missing".to_owned());
    let output = arguments.output.as_deref().ok_or_else(missing)?;
    let source = Source::parse(&arguments.source)?;
    let options = Options { source, selection, ssh: arguments.ssh.clone(), acknowledge: !arguments.no_acknowledge };
    check_places(&options.source, output)?;
    let store = Store::open(output)?;
    let stop = stop_flag()?;
    if arguments.watch {
        return watch(&options, &store, Duration::from_secs(arguments.every), &stop, json);
    }
    let report = sync_once(&options, &store, &stop)?;
    print_report(&report, &store, json)?;
    Ok(outcome(&report, stop.load(Ordering::Relaxed)))
}

/// Syncs again and again, and waits for a robot that goes away.
fn watch(options: &Options, store: &Store, every: Duration, stop: &AtomicBool, json: bool) -> anyhow::Result<Outcome> {
    let (mut pause, mut away, mut lost) = (every, None, false);
    while !stop.load(Ordering::Relaxed) {
        let failed = match sync_once(options, store, stop) {
            Ok(report) => {
                lost |= !report.lost.is_empty();
                if report.fetched + report.verified > 0 {
                    print_report(&report, store, json)?;
                }
                report.failed
            }
            // All of these can end: the session may begin, the stick be put in again, the other sync end.
            Err(
                error @ (SyncError::NoSuchSession { .. }
                | SyncError::Link { .. }
                | SyncError::Absent { .. }
                | SyncError::Busy(_)),
            ) => Some(error.to_string()),
            Err(error) => return Err(error.into()),
        };
        match &failed {
            Some(_) if away == failed => {}
            Some(said) => eprintln!("realitysim: {said}; it is tried again"),
            None if away.is_some() => eprintln!("realitysim: {} answers again", options.source.shown()),
            None => {}
        }
        pause = if failed.is_some() { (2 * pause).min(MAX_PAUSE.max(every)) } else { every };
        away = failed;
        let began = Instant::now();
        while began.elapsed() < pause && !stop.load(Ordering::Relaxed) {
            std::thread::sleep(TICK);
        }
    }
    Ok(if lost { Outcome::DataLost } else { Outcome::Whole })
}

fn sync_once(options: &Options, store: &Store, stop: &AtomicBool) -> Result<Report, SyncError> {
    let mut progress = output::Transfer::new();
    let result = round(options, store, stop, &mut |event| match event {
        Event::Planned { sessions, plan } => {
            if plan.bytes() > 0 {
                progress.say(&format!(
                    "sessions there: {sessions}; segments to come: {}, {}",
                    plan.items.len(),
                    output::size(plan.bytes())
                ));
            }
        }
        Event::Progress { done, total } => progress.set(done, total),
        Event::Again { said } => progress.say(&format!("{said}; it is tried again")),
    });
    progress.finish();
    if let Ok(report) = &result {
        update_catalogue(&ended_sessions(report, store));
    }
    result
}

/// The sessions of a report that have ended: one that is still being recorded would be read again at each look.
fn ended_sessions(report: &Report, store: &Store) -> Vec<PathBuf> {
    let folders = report.sessions.iter().map(|session| store.captures().join(&session.session));
    folders.filter(|folder| folder.join(METADATA_FILE).is_file()).collect()
}

fn check_places(source: &Source, output: &Path) -> Result<(), UsageError> {
    if source.is_remote() {
        return Ok(());
    }
    let folder = Path::new(&source.folder);
    if !folder.is_dir() {
        let name = &source.folder;
        return Err(UsageError(format!("{name}: there is no such folder ({name}: with a colon would be a robot)")));
    }
    if let (true, Some(captures), Some(session)) =
        (folder.join(SESSION_FILE).exists(), folder.parent(), folder.file_name())
    {
        let (folder, captures, session) = (folder.display(), captures.display(), session.display());
        return Err(UsageError(format!("{folder}: a session, not a folder of captures: sync {captures} {session}")));
    }
    super::paths::check_output(output, &[folder])
}

fn outcome(report: &Report, stopped: bool) -> Outcome {
    if report.failed.is_some() || report.no_room_bytes > 0 || stopped {
        Outcome::NotReached
    } else if !report.lost.is_empty() {
        Outcome::DataLost
    } else if report.left_there > 0 {
        Outcome::NotReached
    } else {
        Outcome::Whole
    }
}

fn print_report(report: &Report, store: &Store, json: bool) -> anyhow::Result<()> {
    for it in &report.set_aside {
        output::say(&format!("set aside: {it}"));
    }
    for (path, who) in &report.elsewhere {
        eprintln!("realitysim: {}: gone there; {} has it", path.display(), who.join(", "));
    }
    for it in &report.lost {
        output::say(&format!("lost: {it}"));
    }
    for (robot, machines) in &report.shared_names {
        let robot = output::without_control_characters(robot);
        eprintln!(
            "realitysim: {} robots call themselves {robot}: {} (give each its own `robot = ` in its config)",
            machines.len(),
            machines.join(", ")
        );
    }
    if report.left_there > 0 {
        eprintln!(
            "realitysim: {} finished segments stay there, since their manifest is not believed, or their session.json (`sessions repair` there, \
             or here)",
            report.left_there
        );
    }
    if report.no_room_bytes > 0 {
        eprintln!("realitysim: no room here for {} more", output::size(report.no_room_bytes));
    }
    if let Some(said) = &report.failed {
        eprintln!("realitysim: {said}");
    }
    if json {
        return output::json(report);
    }
    let mut lines = Vec::new();
    for session in &report.sessions {
        let path = store.captures().join(&session.session);
        lines.push(format!("{:>5} of {:<5} segments  {}", session.segments, session.of, path.display()));
    }
    if let [first, ..] = report.withheld.as_slice() {
        lines.push(format!(
            "not acknowledged: {first}{}: what is here did not come from there, so it may not be deleted there for it",
            if report.withheld.len() > 1 { format!(" and {} more", report.withheld.len() - 1) } else { String::new() }
        ));
    }
    let told = match (report.acknowledged, &report.failed) {
        (true, _) => format!("acknowledged as {}", report.receiver),
        (false, Some(_)) => "not all acknowledged: run it again".to_owned(),
        (false, None) => "not acknowledged".to_owned(),
    };
    lines.push(format!(
        "{} segments fetched ({} in {:.1} s), {} verified here, {} were here; {told}",
        report.fetched,
        output::size(report.fetched_bytes),
        report.wall_s,
        report.verified,
        report.already
    ));
    output::lines(&lines.join("\n"))
}

/// Parses the beginning of a time range: a day (UTC) or a moment.
fn begin_ns(text: &str) -> Result<i64, String> {
    time_ns(text, Ok)
}

/// Parses the end of a time range; a day counts as a whole.
fn end_ns(text: &str) -> Result<i64, String> {
    time_ns(text, |day| day.tomorrow().and_then(|next| next.checked_sub(1.nanoseconds())))
}

/// Parses a moment, or a day (UTC) for which `of_day` gives the moment.
fn time_ns(text: &str, of_day: impl Fn(Zoned) -> Result<Zoned, jiff::Error>) -> Result<i64, String> {
    let moment = text.parse::<jiff::Timestamp>().or_else(|_| {
        let day: jiff::civil::Date = text.parse()?;
        Ok(of_day(day.to_zoned(jiff::tz::TimeZone::UTC)?)?.timestamp())
    });
    let moment = moment.map_err(|_: jiff::Error| "expected 2026-11-21 or 2026-11-21T10:00:00Z".to_owned())?;
    i64::try_from(moment.as_nanosecond()).map_err(|_| "beyond what a recording can say".to_owned())
}

fn within(text: &str) -> Result<Within, String> {
    let [x, y, radius] = numbers::<3>(text, "x,y,radius")?;
    if radius < 0.0 {
        return Err("the radius must not be negative".to_owned());
    }
    Ok(Within { x, y, radius })
}

fn share(text: &str) -> Result<f64, String> {
    let share: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    if (0.0..=1.0).contains(&share) { Ok(share) } else { Err("0 to 1".to_owned()) }
}
