//! The suite file: TOML, checked completely before anything runs.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use thiserror::Error;

use super::limits::Limits;
use realitysim_config::plain_file;
use realitysim_config::wording::in_words;

/// Reason why a suite file is refused.
#[derive(Debug, Error)]
#[error("{file}: {message}")]
pub struct SuiteError {
    /// Path of the suite file.
    pub file: String,
    /// Description of the problem, and of what would be right.
    pub message: String,
}

/// A suite: cases, and settings that they share.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Suite {
    /// Robot configuration of all cases that name none.
    pub config: Option<PathBuf>,
    /// Limits of every case that does not set its own.
    #[serde(default)]
    pub limits: Limits,
    /// The cases, 1 to 1000.
    #[serde(rename = "case")]
    pub cases: Vec<Case>,
}

/// One log or scene with its limits. Paths in the file are relative to the file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Case {
    /// Name of the case; by default the file name of the source without its extension.
    #[serde(default)]
    pub name: String,
    /// Log or scene that is replayed, or whose poses are judged.
    pub source: PathBuf,
    /// Robot configuration.
    pub config: Option<PathBuf>,
    /// Log with the true poses, if they are not in the source itself.
    pub truth: Option<PathBuf>,
    /// Topic of the source with poses of `camera_link` in `map`. If given, these are judged and nothing is replayed.
    pub poses: Option<String>,
    /// File with the tags of an earlier replay (`replay --check FILE --bless`), which the tags must equal bit for bit.
    pub reference: Option<PathBuf>,
    /// Whether of an ambiguous tag the nearer of its pose and its mirrored pose is judged.
    #[serde(default)]
    pub up_to_mirror: bool,
    /// Start of the judged part, seconds after the first frame.
    #[serde(default)]
    pub from_s: f64,
    /// Intervals that are not judged, seconds after the first frame.
    #[serde(default)]
    pub except_s: Vec<[f64; 2]>,
    /// Times from which on the pose can be found again, seconds after the first frame.
    #[serde(default)]
    pub recovery_from_s: Vec<f64>,
    /// Limits of this case.
    #[serde(default)]
    pub limits: Limits,
}

/// Largest number of cases: what fits into a table that somebody reads.
const MAX_CASES: usize = 1000;
/// Largest size of a suite file, bytes. A thousand cases take some hundred KiB.
const MAX_SUITE_BYTES: u64 = 4 << 20;

impl Suite {
    /// Reads and checks a suite file.
    pub fn load(path: &Path) -> Result<Self, SuiteError> {
        let text = plain_file::read_text(path, MAX_SUITE_BYTES).map_err(|error| refuse(path, error))?;
        Self::parse(&text, path)
    }

    /// Parses and checks the text of a suite file. `path` is the path of the file, which other paths are relative to.
    pub fn parse(text: &str, path: &Path) -> Result<Self, SuiteError> {
        let mut suite: Self = toml::from_str(text).map_err(|error| refuse(path, in_words(&error)))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        suite.fill_in(folder);
        suite.resolve_limits().and_then(|()| suite.check()).map_err(|message| refuse(path, message))?;
        Ok(suite)
    }

    /// Returns all files that a run reads.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.cases.iter().flat_map(Case::files)
    }

    /// Fills in names and configurations, and makes paths relative to the working directory.
    fn fill_in(&mut self, folder: &Path) {
        let near = |path: &mut Option<PathBuf>| *path = path.take().map(|path| folder.join(path));
        near(&mut self.config);
        for case in &mut self.cases {
            if case.name.is_empty() {
                case.name = case.source.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            }
            case.source = folder.join(&case.source);
            near(&mut case.config);
            near(&mut case.truth);
            near(&mut case.reference);
            case.config = case.config.take().or(self.config.clone());
        }
    }

    /// Gives each case the limits of the suite that it can break, and refuses limits that no case could break.
    fn resolve_limits(&mut self) -> Result<(), String> {
        let suite = self.limits;
        suite.check()?;
        if let Some(message) = suite.unbreakable(&Limits::default()) {
            return Err(message);
        }
        if suite.recovered_within_s.is_some() && self.cases.iter().all(|case| case.recovery_from_s.is_empty()) {
            return Err(format!("limits.{RECOVERY_LIMIT_WITHOUT_TIMES}"));
        }
        if suite.p99_ratio.is_some() && self.cases.iter().all(|case| case.poses.is_some()) {
            return Err(format!("limits.{TIME_LIMIT_WITHOUT_REPLAY}"));
        }
        for case in &mut self.cases {
            case.resolve_limits(&suite).map_err(|message| format!("case {:?}: {message}", case.name))?;
        }
        Ok(())
    }

    fn check(&self) -> Result<(), String> {
        if !(1..=MAX_CASES).contains(&self.cases.len()) {
            return Err(format!("{} cases: a suite has 1 to {MAX_CASES}", self.cases.len()));
        }
        let mut names = BTreeSet::new();
        for case in &self.cases {
            if !names.insert(&case.name) {
                return Err(format!("two cases are called {:?}: give one a name of its own", case.name));
            }
            case.check().map_err(|message| format!("case {:?}: {message}", case.name))?;
        }
        Ok(())
    }
}

const RECOVERY_LIMIT_WITHOUT_TIMES: &str =
    "recovered_within_s without recovery_from_s: say from when on the pose is there to be found again, or leave it out";
const TIME_LIMIT_WITHOUT_REPLAY: &str =
    "p99_ratio with poses: nothing is replayed whose time could be taken, so leave it out";

impl Case {
    fn files(&self) -> impl Iterator<Item = &Path> {
        let Self { source, config, truth, reference, .. } = self;
        let named = [Some(source), config.as_ref(), truth.as_ref(), reference.as_ref()];
        named.into_iter().flatten().map(PathBuf::as_path)
    }

    /// Merges the limits of the suite into those of the case, and refuses limits that the case could not break.
    fn resolve_limits(&mut self, suite: &Limits) -> Result<(), String> {
        let own = self.limits;
        own.check()?;
        if let Some(message) = own.unbreakable(suite) {
            return Err(message);
        }
        self.limits = own.merged_over(suite);
        if self.recovery_from_s.is_empty() && self.limits.recovered_within_s.take().is_some() {
            own.recovered_within_s.map_or(Ok(()), |_| Err(format!("limits.{RECOVERY_LIMIT_WITHOUT_TIMES}")))?;
        }
        if self.poses.is_some() && self.limits.p99_ratio.take().is_some() {
            own.p99_ratio.map_or(Ok(()), |_| Err(format!("limits.{TIME_LIMIT_WITHOUT_REPLAY}")))?;
        }
        Ok(())
    }

    fn check(&self) -> Result<(), String> {
        let time = |key: &str, value: f64| {
            if (0.0..=1e6).contains(&value) { Ok(()) } else { Err(format!("{key} is {value}: 0 or more seconds")) }
        };
        time("from_s", self.from_s)?;
        for from_s in &self.recovery_from_s {
            time("recovery_from_s", *from_s)?;
        }
        for [from, to] in &self.except_s {
            time("except_s", *from)?;
            time("except_s", *to)?;
            if from >= to {
                return Err(format!("except_s has [{from}, {to}]: the first must be below the second"));
            }
        }
        if !self.limits.ask_for_something() && self.reference.is_none() {
            return Err("no limit at all, and no reference: what would it show?".to_owned());
        }
        if self.reference.is_some() && self.poses.is_some() {
            return Err("a reference is of replayed tags, and with poses nothing is replayed: leave one out".to_owned());
        }
        if !self.recovery_from_s.is_empty() && self.limits.recovered_within_s.is_none() {
            return Err("recovery_from_s without limits.recovered_within_s: say how fast it must be".to_owned());
        }
        Ok(())
    }
}

fn refuse(path: &Path, message: impl ToString) -> SuiteError {
    SuiteError { file: path.display().to_string(), message: message.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::suite::judge::Judged;

    fn refused(text: &str) -> String {
        Suite::parse(text, Path::new("s/suite.toml")).expect_err("refused").to_string()
    }

    #[test]
    fn a_case_takes_what_it_does_not_say_from_the_suite() {
        let text = "config = \"r.toml\"\nlimits = { mean_cm = 1.0, valid_share = 0.9 }\n\
                    [[case]]\nsource = \"a/b.toml\"\n\
                    [[case]]\nname = \"x\"\nsource = \"/b.mcap\"\nconfig = \"o.toml\"\nlimits = { mean_cm = inf }\n";
        let suite = Suite::parse(text, Path::new("s/suite.toml")).expect("a suite");
        let [a, x] = &suite.cases[..] else { panic!("{suite:?}") };
        assert_eq!((a.name.as_str(), a.source.as_path()), ("b", Path::new("s/a/b.toml")));
        assert_eq!(a.config.as_deref(), Some(Path::new("s/r.toml")));
        assert_eq!((a.limits.mean_cm, a.limits.valid_share), (Some(1.0), Some(0.9)));
        assert_eq!((x.source.as_path(), x.config.as_deref()), (Path::new("/b.mcap"), Some(Path::new("s/o.toml"))));
        assert_eq!((x.limits.mean_cm, x.limits.valid_share), (None, Some(0.9)));
    }

    #[test]
    fn a_case_that_must_be_refused_has_no_limits_but_its_own() {
        let text = "limits = { mean_cm = 1.0, valid_share = 0.9 }\n\
                    [[case]]\nsource = \"b.toml\"\nlimits = { most_valid_share = 0 }\n";
        let suite = Suite::parse(text, Path::new("s/suite.toml")).expect("a suite");
        let own = Limits { most_valid_share: Some(0.0), ..Limits::default() };
        assert_eq!(suite.cases[0].limits, own);
        let mut judged = Judged::default();
        for (valid_share, broken) in [(Some(0.0), 0), (Some(0.01), 1), (None, 1)] {
            judged.valid_share = valid_share;
            assert_eq!(own.broken(&judged).len(), broken, "{valid_share:?}");
        }
    }

    #[test]
    fn a_senseless_suite_is_refused_with_the_reason() {
        let case = |rest: &str| format!("[[case]]\nsource = \"a.mcap\"\n{rest}\n");
        for (text, words) in [
            ("", vec!["s/suite.toml", "case"]),
            ("case = []", vec!["0 cases"]),
            (&case(""), vec!["case \"a\"", "no limit at all"]),
            (&case("reference = \"r.jsonl\"\nposes = \"/p\""), vec!["case \"a\"", "reference", "poses"]),
            (&case("limits = { mean = 3 }"), vec!["line 3", "unknown field `mean`", "mean_cm"]),
            (&case("limits = { mean_cm = 0 }"), vec!["mean_cm is 0", "above 0"]),
            (&case("limits = { valid_share = 1.5 }"), vec!["valid_share is 1.5", "0 to 1"]),
            (&case("limits = { mean_cm = 1 }\nfrom_s = -1"), vec!["from_s is -1"]),
            (&case("limits = { mean_cm = 1 }\nexcept_s = [[3, 2]]"), vec!["except_s has [3, 2]"]),
            (&case("limits = { mean_cm = 1 }\nrecovery_from_s = [3]"), vec!["recovered_within_s"]),
            (&(case("limits = { mean_cm = 1 }") + &case("limits = { mean_cm = 1 }")), vec!["two cases", "\"a\""]),
        ] {
            let message = refused(text);
            assert!(words.iter().all(|word| message.contains(word)), "{text}: {message}");
        }
    }

    #[test]
    fn a_limit_that_nothing_can_break_is_refused_by_name() {
        let case = |rest: &str| format!("[[case]]\nsource = \"a.mcap\"\n{rest}\n");
        let with = |limits: &str, rest: &str| format!("limits = {{ {limits} }}\n{}", case(rest));
        for (text, words) in [
            (case("limits = { mean_cm = inf }"), vec!["case \"a\"", "limits.mean_cm is inf", "nothing can break"]),
            (case("limits = { mean_cm = nan }"), vec!["limits.mean_cm is NaN", "above 0"]),
            (case("limits = { mean_cm = 1, max_cm = inf }"), vec!["limits.max_cm is inf"]),
            (case("limits = { valid_share = 0 }"), vec!["limits.valid_share is 0", "nothing can break"]),
            (case("limits = { valid_share = nan }"), vec!["limits.valid_share is NaN"]),
            (case("limits = { most_valid_share = 1 }"), vec!["limits.most_valid_share is 1", "nothing can break"]),
            (case("limits = { most_valid_share = -0.1 }"), vec!["limits.most_valid_share is -0.1", "0 to 1"]),
            (case("limits = { judged_share = 0.5 }"), vec!["no limit at all"]),
            (with("mean_cm = inf", ""), vec!["limits.mean_cm is inf"]),
            (with("mean_cm = 1", "limits = { mean_cm = inf }"), vec!["no limit at all"]),
            (case("limits = { mean_cm = 1, recovered_within_s = 1 }"), vec!["recovered_within_s", "recovery_from_s"]),
            (with("recovered_within_s = 1, mean_cm = 1", "recovery_from_s = []"), vec!["recovered_within_s"]),
            (
                with(
                    "mean_cm = 1, recovered_within_s = 2",
                    "recovery_from_s = [1]\nlimits = { recovered_within_s = inf }",
                ),
                vec!["say how fast"],
            ),
            (case("poses = \"/p\"\nlimits = { mean_cm = 1, p99_ratio = 3 }"), vec!["p99_ratio", "poses"]),
            (with("mean_cm = 1, p99_ratio = 3", "poses = \"/p\""), vec!["p99_ratio", "poses"]),
        ] {
            let message = refused(&text);
            assert!(words.iter().all(|word| message.contains(word)), "{text}: {message}");
        }
    }
}
