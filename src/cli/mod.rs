//! Command line: turns arguments into plain data, errors into exit codes, and results into text for people or JSON for
//! programs.
//!
//! Exit codes are 0 when done, 1 when something failed, 2 for wrong usage or config, 3 when done but data was lost.

mod accuracy;
mod calibrate;
#[cfg(feature = "catalogue")]
mod catalogue;
mod catalogue_beside;
mod check;
mod db;
mod demo;
mod depth_picture;
mod detector;
mod doc_section;
mod doctor;
mod eval;
mod explain;
mod export;
mod host_info;
mod html;
mod import;
mod input_files;
mod install;
mod job;
mod junit;
mod labels;
mod live;
mod log;
mod marks;
mod measure;
mod opened_database;
mod output;
mod paths;
mod photo;
mod pose_covariances;
mod postgame;
mod record;
mod reference_check;
mod refine;
mod remote;
mod replay;
mod scene;
mod serve;
mod sessions;
mod sessions_where;
mod settings;
mod status_text;
mod sync;
mod tag;
mod values;
mod view;
mod view_depth;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::config::ConfigError;
use crate::evaluation::reference::ReferenceError;
use crate::evaluation::suite::SuiteError;
use crate::live::RecordError;
use crate::recording::Loss;
use crate::recording::sync::SyncError;
use crate::scene::SceneError;
use crate::service::ServeError;
use crate::tagging::{ReplayError, SetupError};

/// Tags every camera frame of a soccer robot with the pose of its camera.
#[derive(Parser)]
#[command(name = "realitysim", version, max_term_width = 100)]
#[command(after_long_help = concat!(
    "Examples:",
    "\n  realitysim replay my_bag/ -o captures/ --field kid-2020",
    "\n  realitysim db add captures/2026-11-21T10-00-00Z-robot --db images/",
    "\n  realitysim view --db images/ --x 0.3 --y -0.5 --z 0.5 --yaw 30 --pitch 18 -o view.png",
))]
struct Arguments {
    /// One line of JSON on standard output; everything else goes to standard error.
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    // On the robot.
    Record(Box<record::RecordArguments>),
    Recorder(record::RecorderArguments),
    Doctor(Box<doctor::DoctorArguments>),
    Install(install::InstallArguments),
    // From logs to tags.
    Replay(Box<replay::ReplayArguments>),
    Tag(tag::TagArguments),
    Explain(Box<explain::ExplainArguments>),
    Refine(refine::RefineArguments),
    Calibrate(Box<calibrate::CalibrateArguments>),
    Log(log::LogArguments),
    Import(Box<import::ImportArguments>),
    Export(export::ExportArguments),
    Labels(labels::LabelsArguments),
    // Captures at home.
    Sync(Box<sync::SyncArguments>),
    Sessions(sessions::SessionsArguments),
    Job(job::JobArguments),
    #[cfg(feature = "catalogue")]
    Catalogue(catalogue::CatalogueArguments),
    // Images of any pose.
    Db(db::DbArguments),
    View(view::ViewArguments),
    Serve(serve::ServeArguments),
    Live(live::LiveArguments),
    // Rendered walks, and how good it all is.
    Scene(scene::SceneArguments),
    Accuracy(accuracy::AccuracyArguments),
    Eval(eval::EvalArguments),
    Postgame(postgame::PostgameArguments),
    Check(check::CheckArguments),
    Measure(Box<measure::MeasureArguments>),
    Demo(demo::DemoArguments),
}

/// How a command ended without an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    /// All of it is done.
    Whole,
    /// Done, but data was lost.
    DataLost,
    /// Done, but the result is not what was asked for.
    NotReached,
}

impl Outcome {
    fn of(losses: &[Loss]) -> Self {
        if losses.is_empty() { Self::Whole } else { Self::DataLost }
    }
}

/// Runs the command that the process was called with, and returns its exit code.
pub fn run() -> ExitCode {
    let arguments = match remote::with_local_copies(std::env::args_os().collect()) {
        Ok(arguments) => Arguments::parse_from(arguments),
        Err(error) => return failed(&error),
    };
    let json = arguments.json;
    let outcome = match arguments.command {
        Command::Record(arguments) => record::run(&arguments, json),
        Command::Recorder(arguments) => record::send_command(&arguments.command, json),
        Command::Doctor(arguments) => doctor::run(&arguments, json),
        Command::Install(arguments) => install::run(&arguments),
        Command::Replay(arguments) => replay::run(&arguments, json),
        Command::Tag(arguments) => tag::run(&arguments, json),
        Command::Explain(arguments) => explain::run(&arguments, json),
        Command::Refine(arguments) => refine::run(&arguments, json),
        Command::Calibrate(arguments) => calibrate::run(&arguments, json),
        Command::Log(arguments) => log::run(&arguments, json),
        Command::Import(arguments) => import::run(&arguments, json),
        Command::Export(arguments) => export::run(&arguments, json),
        Command::Labels(arguments) => labels::run(&arguments, json),
        Command::Sync(arguments) => sync::run(&arguments, json),
        Command::Sessions(arguments) => sessions::run(&arguments, json),
        Command::Job(arguments) => job::run(&arguments, json),
        #[cfg(feature = "catalogue")]
        Command::Catalogue(arguments) => catalogue::run(&arguments, json),
        Command::Db(arguments) => db::run(&arguments, json),
        Command::View(arguments) => view::run(&arguments, json),
        Command::Serve(arguments) => serve::run(&arguments, json),
        Command::Live(arguments) => live::run(&arguments, json),
        Command::Scene(arguments) => scene::run(&arguments, json),
        Command::Accuracy(arguments) => accuracy::run(&arguments, json),
        Command::Eval(arguments) => eval::run(&arguments, json),
        Command::Postgame(arguments) => postgame::run(&arguments, json),
        Command::Check(arguments) => check::run(&arguments, json),
        Command::Measure(arguments) => measure::run(&arguments, json),
        Command::Demo(arguments) => demo::run(&arguments, json),
    };
    match outcome {
        Ok(Outcome::Whole) => ExitCode::SUCCESS,
        Ok(Outcome::DataLost) => ExitCode::from(3),
        Ok(Outcome::NotReached) => ExitCode::from(1),
        Err(error) if output::is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => failed(&error),
    }
}

/// Tells an error, and gives its exit code.
fn failed(error: &anyhow::Error) -> ExitCode {
    output::say(&error_text(error));
    ExitCode::from(if is_usage(error) { 2 } else { 1 })
}

/// Joins an error and its causes; a cause that is quoted already is not repeated.
fn error_text(error: &anyhow::Error) -> String {
    let mut text = String::new();
    for cause in error.chain().map(|cause| output::reword_system_errors(cause.to_string().trim_end())) {
        if text.is_empty() {
            text = cause;
        } else if !text.contains(&cause) {
            text = format!("{text}: {cause}");
        }
    }
    text
}

/// Whether a config or an argument is wrong, as opposed to the input or the machine.
fn is_usage(error: &anyhow::Error) -> bool {
    #[cfg(feature = "query")]
    if matches!(error.downcast_ref(), Some(crate::catalogue_query::QueryError::Sql(_))) {
        return true;
    }
    error.chain().any(|cause| {
        cause.is::<ConfigError>()
            || cause.is::<SceneError>()
            || cause.is::<SuiteError>()
            || matches!(cause.downcast_ref(), Some(ReferenceError::Tolerance { .. }))
            || cause.is::<settings::UsageError>()
            || matches!(cause.downcast_ref(), Some(ServeError::NoToken(_) | ServeError::ShortToken(_)))
            || matches!(
                cause.downcast_ref(),
                Some(SyncError::Source(_) | SyncError::IntoCapture { .. } | SyncError::NoSuchSession { .. })
            )
            || matches!(
                cause.downcast_ref::<RecordError>(),
                Some(
                    RecordError::NoMount
                        | RecordError::NoLens
                        | RecordError::IntoCapture { .. }
                        | RecordError::Fov(_)
                        | RecordError::Setup(_)
                )
            )
            || matches!(
                cause.downcast_ref::<ReplayError>(),
                Some(
                    ReplayError::IntoCapture { .. }
                        | ReplayError::Setup(SetupError::Config(_) | SetupError::BodyMask { .. } | SetupError::Fov(_))
                )
            )
    })
}

#[cfg(test)]
mod tests {
    use clap::{Command, CommandFactory};

    use super::*;

    /// Visits the program and all its commands, each with its full name.
    fn each(command: &Command, before: &str, look: &mut dyn FnMut(&str, &Command)) {
        let name = format!("{before} {}", command.get_name());
        look(name.trim(), command);
        command.get_subcommands().for_each(|inner| each(inner, &name, look));
    }

    /// The words of a command line; a quoted text is one.
    fn words(line: &str) -> Vec<String> {
        let parts = line.split('"').enumerate().flat_map(|(index, part)| match index % 2 {
            0 => part.split_whitespace().map(str::to_owned).collect(),
            _ => vec![part.to_owned()],
        });
        parts.collect()
    }

    #[test]
    fn every_help_has_an_example_that_the_program_takes() {
        let mut count = 0;
        each(&Arguments::command(), "", &mut |name, command| {
            let help = command.clone().render_long_help().to_string();
            let examples: Vec<&str> =
                help.lines().map(str::trim).skip_while(|line| !line.starts_with("Example")).skip(1).collect();
            assert!(!examples.is_empty(), "{name} --help has no example:\n{help}");
            for example in examples {
                assert!(example.starts_with(name), "{name}: {example}");
                let parsed = Arguments::try_parse_from(words(example));
                assert!(
                    parsed.is_ok(),
                    "{name}: {example}: {}",
                    parsed.err().map(|e| e.to_string()).unwrap_or_default()
                );
                count += 1;
            }
        });
        assert!(count > 40, "{count}");
    }

    #[test]
    fn every_command_and_argument_says_what_it_is() {
        each(&Arguments::command(), "", &mut |name, command| {
            assert!(command.get_about().is_some(), "{name}");
            for argument in command.get_arguments() {
                assert!(argument.get_help().is_some(), "{name}: {}", argument.get_id());
            }
        });
    }

    /// Command lines of the program in a document: lines of its blocks of code, up to a pipe, a redirection or a remark.
    fn command_lines(document: &str) -> Vec<String> {
        let joined = document.replace("\\\n", " ");
        let lines = joined.lines().filter_map(|line| line.strip_prefix("    ")).map(str::trim);
        // A picture of crates has the program's name in it, too.
        let is_command = |line: &&str| {
            line.strip_prefix("realitysim ").is_some_and(|rest| rest.starts_with(|c: char| c.is_ascii_lowercase()))
        };
        let lines = lines.filter(is_command);
        lines.map(|line| line.split(['|', '>', '#', '&', ';']).next().unwrap_or_default().trim().to_owned()).collect()
    }

    /// Values may be placeholders (`LOG`, `S`), so that only commands and the names of arguments are checked.
    #[test]
    fn every_command_line_of_the_documents_names_what_there_is() {
        let mut folders = vec![std::path::PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("docs")];
        let (mut wrong, mut count) = (Vec::new(), 0);
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(&folder).expect("a folder") {
                let path = entry.expect("an entry").path();
                if path.is_dir() {
                    folders.push(path);
                    continue;
                }
                if path.extension().is_none_or(|ending| ending != "md") {
                    continue;
                }
                for line in command_lines(&std::fs::read_to_string(&path).expect("a document")) {
                    count += 1;
                    // Options of the features `live` and `remote`.
                    let is_live = line.contains(" --foxglove ");
                    let is_remote = line.starts_with("realitysim sync ") && line.contains(" --to ");
                    if (is_live && !cfg!(feature = "live")) || (is_remote && !cfg!(feature = "remote")) {
                        continue;
                    }
                    use clap::error::ErrorKind;
                    let Err(error) = Arguments::try_parse_from(words(&line)) else { continue };
                    if matches!(error.kind(), ErrorKind::UnknownArgument | ErrorKind::InvalidSubcommand) {
                        wrong.push(format!("{}: {line}: {error}", path.display()));
                    }
                }
            }
        }
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
        assert!(count > 40, "{count}");
    }

    #[test]
    fn the_system_s_words_are_translated() {
        let missing = std::fs::read("there/is/none").expect_err("not there");
        let error = anyhow::Error::new(missing).context("there/is/none");
        assert_eq!(error_text(&error), "there/is/none: there is no such file or folder");
    }
}
