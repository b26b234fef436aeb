//! Command `realitysim catalogue`: keeps a table of all frames as Parquet files.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};

use super::paths::check_output;
use super::settings::UsageError;
use super::{Outcome, output};
use crate::catalogue::{self, Entry, EntryState, Report};
use crate::recording::Loss;

/// Keep a catalogue: one table of all frames of many captures, as Parquet files that DuckDB, Polars and pandas query
///
/// A row is a frame: where its image lies, its stamp, its pose and how well that is known. Captures are only read; a catalogue can
/// be made anew from them at any time.
#[derive(Args)]
#[command(after_long_help = concat!(
    "Examples:",
    "\n  realitysim catalogue rebuild captures/ -o catalogue/",
    "\n  realitysim catalogue show catalogue/",
))]
pub struct CatalogueArguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Rebuild(RebuildArguments),
    Add(AddArguments),
    Show(ShowArguments),
    Query(QueryArguments),
}

/// Make a catalogue of all captures in a folder
///
/// The same captures give the same files. Rows of sessions that are not in the folder any more are removed.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim catalogue rebuild captures/ -o catalogue/")]
struct RebuildArguments {
    /// Folder with captures
    captures: PathBuf,
    /// The catalogue's folder
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
}

/// Add captures to a catalogue; rows that it has of these sessions are replaced
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim catalogue add captures/2026-11-21T10-00-00Z-robot -o catalogue/")]
struct AddArguments {
    /// Captures' folders
    #[arg(required = true)]
    captures: Vec<PathBuf>,
    /// The catalogue's folder
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
}

/// What a catalogue holds, and which captures changed since; exit code 3 if one did, or if a file is not whole
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim catalogue show catalogue/")]
struct ShowArguments {
    /// The catalogue's folder
    catalogue: PathBuf,
}

/// Answer a question in SQL; the table is `frames`
///
/// DataFusion answers it in this process, if the program is built with the feature `query`. Nothing but questions is done. With --json each row is
/// a line, and what is null is left out of it.
#[derive(Args)]
#[command(
    after_long_help = "Example:\n  realitysim catalogue query catalogue/ \"select robot, count(*) from frames group by robot\""
)]
struct QueryArguments {
    /// The catalogue's folder
    catalogue: PathBuf,
    /// The question
    sql: String,
}

pub fn run(arguments: &CatalogueArguments, json: bool) -> anyhow::Result<Outcome> {
    match &arguments.command {
        Command::Rebuild(RebuildArguments { captures, output }) => {
            check_output(output, &[captures])?;
            change(output, json, |progress| catalogue::rebuild(output, captures, progress))
        }
        Command::Add(AddArguments { captures, output }) => {
            let inputs: Vec<&Path> = captures.iter().map(PathBuf::as_path).collect();
            check_output(output, &inputs)?;
            change(output, json, |progress| catalogue::add(output, captures, progress))
        }
        Command::Show(arguments) => show(&catalogue::show(&arguments.catalogue)?, json),
        Command::Query(QueryArguments { catalogue, sql }) => query(catalogue, sql, json),
    }
}

fn change(
    folder: &Path,
    json: bool,
    make: impl FnOnce(&mut dyn FnMut(u64)) -> Result<Report, catalogue::CatalogueError>,
) -> anyhow::Result<Outcome> {
    let mut progress = output::Progress::new("reading");
    let report = make(&mut |done| progress.set(done, None))?;
    progress.finish();
    output::losses(&report.losses);
    report.warnings.iter().for_each(|warning| output::say(warning));
    if json {
        output::json(&report)?;
    } else {
        let removed = match report.removed.len() {
            0 => String::new(),
            count => format!(", {count} files removed"),
        };
        output::lines(&format!(
            "{} sessions, {} rows ({} valid), {} in {}{removed}",
            report.sessions,
            report.rows,
            report.valid,
            output::size(report.bytes),
            folder.display()
        ))?;
    }
    Ok(if report.sessions == 0 { Outcome::NotReached } else { Outcome::of(&report.losses) })
}

#[cfg(feature = "query")]
fn query(catalogue: &Path, sql: &str, json: bool) -> anyhow::Result<Outcome> {
    let answer = crate::catalogue_query::query(catalogue, sql)?;
    output::lines(if json { answer.json_lines()? } else { answer.table()? }.trim_end())?;
    Ok(Outcome::Whole)
}

#[cfg(not(feature = "query"))]
fn query(catalogue: &Path, _sql: &str, _json: bool) -> anyhow::Result<Outcome> {
    Err(cannot_ask(catalogue))
}

#[cfg(not(feature = "query"))]
fn cannot_ask(catalogue: &Path) -> anyhow::Error {
    let what = "questions are answered by a program that is built with `--features query`; any other asks DuckDB, Polars or pandas";
    UsageError(format!("{}: {what}", catalogue.display())).into()
}

/// Whether a condition in SQL holds for any frame of a session, by the session's identity, for all sessions in a catalogue or in
/// the one beside their folder.
pub(super) fn sessions_where(captures: &Path, condition: &str) -> anyhow::Result<BTreeMap<String, bool>> {
    let own = catalogue::is_catalogue(captures).then(|| captures.to_owned());
    let Some(catalogue) = own.or_else(|| catalogue::catalogue_beside(captures)) else {
        let folder = captures.display();
        let what =
            "there is no catalogue beside the folder: `realitysim catalogue rebuild` with `-o catalogue` makes it";
        return Err(UsageError(format!("--where: {folder}: {what}")).into());
    };
    ask_for_sessions(&catalogue, condition)
}

#[cfg(feature = "query")]
fn ask_for_sessions(catalogue: &Path, condition: &str) -> anyhow::Result<BTreeMap<String, bool>> {
    #[derive(serde::Deserialize)]
    struct Line {
        session_id: String,
        holds: bool,
    }
    let sql =
        format!("select session_id, bool_or(coalesce(({condition}), false)) as holds from frames group by session_id");
    let answer = crate::catalogue_query::query(catalogue, &sql)?.json_lines()?;
    let lines = answer.lines().map(serde_json::from_str::<Line>);
    Ok(lines.map(|line| line.map(|line| (line.session_id, line.holds))).collect::<Result<_, _>>()?)
}

#[cfg(not(feature = "query"))]
fn ask_for_sessions(catalogue: &Path, _condition: &str) -> anyhow::Result<BTreeMap<String, bool>> {
    Err(cannot_ask(catalogue))
}

fn show(entries: &[Entry], json: bool) -> anyhow::Result<Outcome> {
    let is_wrong = |entry: &&Entry| entry.state != EntryState::Current;
    let losses: Vec<Loss> =
        entries.iter().filter(is_wrong).map(|entry| Loss::new(&entry.file, entry.what.as_str())).collect();
    output::losses(&losses);
    if json {
        output::json(&entries)?;
    } else {
        let rows: u64 = entries.iter().map(|entry| entry.rows).sum();
        let bytes: u64 = entries.iter().map(|entry| entry.bytes).sum();
        let lines: String = entries.iter().map(line).collect();
        output::lines(&format!("{lines}{} files, {rows} rows, {}", entries.len(), output::size(bytes)))?;
    }
    Ok(Outcome::of(&losses))
}

fn line(entry: &Entry) -> String {
    let valid = entry.head.as_ref().map_or(0, |head| head.valid);
    let state = match entry.state {
        EntryState::Current => "as its capture",
        EntryState::Changed => "capture changed since",
        EntryState::Gone => "capture gone",
        EntryState::Unreadable => "not readable",
    };
    let (rows, size) = (entry.rows, output::size(entry.bytes));
    format!("{rows:>9} rows {valid:>9} valid {size:>10}  {state:<21}  {}\n", entry.file.display())
}
