//! Settings from the config file and from the same keys on the command line.

use std::path::{Path, PathBuf};

use clap::Args;
use glam::DVec2;
use thiserror::Error;

use super::input_files;
use super::values::{any_number, any_whole};
use crate::config::wording::plain;
use crate::config::{MotionSource, Settings, check_field_size};
use crate::geometry::{Field, Physical, Pose2};
use crate::localization::{Formula, Model, SimdPath};
use crate::log_input::InputSource;

#[derive(Debug, Error)]
#[error("{0}")]
pub struct UsageError(pub String);

#[derive(Args)]
pub struct SettingsArguments {
    /// Robot config (TOML); config/robot.toml shows every key.
    #[arg(long, value_name = "FILE")]
    config: Option<String>,
    /// Any key of the config, for example --set filter.valid_share=0.4; can be given several times.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// A shipped field (config/fields) or the path of a field file.
    #[arg(long, value_name = "NAME")]
    field: Option<String>,
    /// Length and width of the field between the centres of its lines, metres, if they differ from those of --field:
    /// areas, circle and marks stay as they are, relative to their goal line.
    #[arg(long, value_name = "LxW", value_parser = field_size)]
    field_size: Option<[f64; 2]>,
    /// Seed of all random numbers: the same seed gives the same tags, bit for bit.
    #[arg(long, value_name = "S", value_parser = any_whole::<u64>)]
    seed: Option<u64>,
    /// Observation model: gauss (Eq. 2 of the paper) or distance (Eq. 1).
    #[arg(long, value_name = "gauss|distance", value_parser = word::<Model>)]
    model: Option<Model>,
    /// corrected, or paper: as printed (docs/explanation/paper.md says what that does).
    #[arg(long, value_name = "corrected|paper", value_parser = word::<Formula>)]
    formula: Option<Formula>,
    /// Number of particles (N of the paper).
    #[arg(long, value_name = "N", value_parser = any_whole::<usize>)]
    particles: Option<usize>,
    /// Weighting and resampling rounds per frame (T of the paper).
    #[arg(long, value_name = "T", value_parser = any_whole::<usize>)]
    iterations: Option<usize>,
    /// About how many points stand for all field lines.
    #[arg(long, value_name = "N", value_parser = any_whole::<usize>)]
    line_points: Option<usize>,
    /// Scale of the exponent in Eq. 1 and 2.
    #[arg(long, value_name = "ALPHA", allow_negative_numbers = true, value_parser = any_number)]
    alpha: Option<f64>,
    /// Where the step between frames comes from: odometry or random_walk.
    #[arg(long, value_name = "odometry|random_walk", value_parser = word::<MotionSource>)]
    motion: Option<MotionSource>,
    /// Kernel: auto, avx2, sse2 or scalar; the tags are the same on each.
    #[arg(long, value_name = "PATH", value_parser = word::<SimdPath>)]
    simd: Option<SimdPath>,
    /// A lens file, or a field of view as equidistant:180deg, in place of the log's camera_info.
    #[arg(long, value_name = "FILE")]
    lens: Option<String>,
}

impl SettingsArguments {
    /// All files that the arguments name, the config itself among them.
    pub fn files(&self) -> Vec<PathBuf> {
        let config = self.config.iter().map(PathBuf::from);
        // If the arguments are wrong, no file but the config is read.
        let named = self.resolve().map_or_else(|_| Vec::new(), |settings| input_files::files_named_in(&settings));
        config.chain(named).collect()
    }

    /// Like [`Self::resolve`], for a log or scene. A scene names its own field, so one on the command line is refused.
    pub fn resolve_for(&self, source: &Path) -> anyhow::Result<Settings> {
        let given = [
            ("--field", self.field.is_some() || self.sets("field")),
            ("--field-size", self.field_size.is_some() || self.sets("field_size_m")),
        ];
        let given = given.into_iter().find(|(_, is_given)| *is_given);
        if let Some((option, _)) = given.filter(|_| InputSource::is_scene(source)) {
            let scene = source.display();
            return Err(UsageError(format!(
                "{option} is of a log, and {scene} is a scene, which names its field itself: `field` in its [scene]; `realitysim scene render` \
                 makes a log of it"
            ))
            .into());
        }
        self.resolve()
    }

    /// Whether the command line or the config names a field, so that it is not the default by oversight.
    pub fn names_field(&self) -> bool {
        let text = self.config.as_deref().and_then(|path| input_files::small_text(Path::new(path)));
        self.field.is_some() || self.sets("field") || text.is_some_and(|text| Settings::names_field(&text))
    }

    /// Whether a `--set` is of this key.
    fn sets(&self, key: &str) -> bool {
        self.set.iter().any(|assignment| assignment.split('=').next().is_some_and(|set| set.trim() == key))
    }

    /// Takes defaults, then the file, then the command line, and checks the result once.
    pub fn resolve(&self) -> anyhow::Result<Settings> {
        let mut settings = match &self.config {
            Some(path) => Settings::load(path)?,
            None => Settings::default(),
        };
        for assignment in &self.set {
            settings = with_key(settings, assignment)?;
        }
        let filter = &mut settings.filter;
        replace(&mut settings.field, &self.field);
        settings.field_size_m = self.field_size.or(settings.field_size_m);
        replace(&mut filter.seed, &self.seed);
        replace(&mut filter.model, &self.model);
        replace(&mut filter.formula, &self.formula);
        replace(&mut filter.particles, &self.particles);
        replace(&mut filter.iterations, &self.iterations);
        replace(&mut filter.line_points, &self.line_points);
        replace(&mut filter.motion, &self.motion);
        replace(&mut filter.simd, &self.simd);
        filter.alpha = self.alpha.or(filter.alpha);
        settings.camera.lens = self.lens.clone().or(settings.camera.lens);
        settings.check().map_err(UsageError)?;
        Ok(settings)
    }
}

fn replace<T: Clone>(value: &mut T, given: &Option<T>) {
    if let Some(given) = given {
        *value = given.clone();
    }
}

/// Sets the key of `a.b=value`. The value is written as in TOML; a bare word is a string.
fn with_key(settings: Settings, assignment: &str) -> anyhow::Result<Settings> {
    let (key, value) = assignment
        .split_once('=')
        .ok_or_else(|| UsageError(format!("--set {assignment}: expected KEY=VALUE, as in filter.particles=400")))?;
    let value: toml::Value = toml::from_str::<toml::Table>(&format!("value = {value}"))
        .ok()
        .and_then(|mut table| table.remove("value"))
        .unwrap_or_else(|| toml::Value::String(value.to_owned()));
    let mut root = toml::Value::try_from(&settings)?;
    let mut place = &mut root;
    for part in key.trim().split('.') {
        let table = place.as_table_mut().ok_or_else(|| UsageError(format!("--set {key}: there is no such key")))?;
        place = table.entry(part).or_insert_with(|| toml::Value::Table(toml::Table::new()));
    }
    *place = value;
    root.try_into()
        .map_err(|error: toml::de::Error| UsageError(format!("--set {assignment}: {}", plain(error.message()))).into())
}

fn word<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, String> {
    let value = serde::de::value::StrDeserializer::<serde::de::value::Error>::new(text);
    T::deserialize(value).map_err(|error| plain(&error.to_string()))
}

/// Distance beyond the carpet's edge at which a robot may start, metres.
const START_OFF_CARPET_M: f64 = 1.0;

/// Checks that a robot or camera can stand there; the error states the extent of the field.
pub fn check_initial(initial: &Pose2, name: &str, field: &Field) -> Result<(), UsageError> {
    let half = field.carpet_half_extent();
    let reach = half + DVec2::splat(START_OFF_CARPET_M);
    if initial.x.abs() <= reach.x && initial.y.abs() <= reach.y {
        return Ok(());
    }
    Err(UsageError(format!(
        "--initial is {},{}: the carpet of {name} reaches from -{:.2} to {:.2} m in x and from -{:.2} to {:.2} m in y, and \
         a start may be {START_OFF_CARPET_M} m outside of it",
        initial.x, initial.y, half.x, half.x, half.y, half.y
    )))
}

/// Parses `x,y,yaw_deg` in metres and degrees.
pub fn planar_pose(text: &str) -> Result<Pose2, String> {
    let [x, y, yaw_deg] = numbers::<3>(text, "x,y,yaw_deg")?;
    Ok(Pose2::new(x, y, yaw_deg.to_radians()))
}

/// Parses length x width of a field in metres, as in `5.90x4.02`.
pub fn field_size(text: &str) -> Result<[f64; 2], String> {
    let form = "expected LENGTHxWIDTH in metres, as in 5.90x4.02";
    let (length_m, width_m) = text.split_once('x').ok_or(form)?;
    let metres = |text: &str| text.trim().parse::<f64>().map_err(|_| form.to_owned());
    let size_m = [metres(length_m)?, metres(width_m)?];
    check_field_size(size_m)?;
    Ok(size_m)
}

/// Parses `N` numbers with commas between them.
pub fn numbers<const N: usize>(text: &str, form: &str) -> Result<[f64; N], String> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(|part| part.trim().parse::<f64>().ok().filter(Physical::is_possible))
        .collect::<Option<_>>()
        .ok_or_else(|| format!("expected {form}, numbers with commas between them"))?;
    let found = numbers.len();
    numbers.try_into().map_err(|_| format!("expected {form}, {N} numbers, and there are {found}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_set_as_in_the_file() {
        let set = |text: &str| with_key(Settings::default(), text);
        assert_eq!(set("filter.particles=42").expect("a number").filter.particles, 42);
        assert_eq!(set("topics.image=/cam").expect("a bare word").topics.image, "/cam");
        assert_eq!(set("filter.model=distance").expect("a name").filter.model, Model::Distance);
        for wrong in ["filter.particels=4", "filter.model=x", "filter.particles=many", "robot.x=1", "nonsense"] {
            assert!(set(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn poses_are_three_numbers() {
        assert_eq!(planar_pose("1, -2,90").expect("a pose").yaw, core::f64::consts::FRAC_PI_2);
        for wrong in ["1,2", "1,2,x", "1,2,nan", "1,2,3,4", ""] {
            assert!(planar_pose(wrong).is_err(), "{wrong}");
        }
    }
}
