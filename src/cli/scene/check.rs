//! Command `realitysim scene check`: checks a scene file and measures what its effects cost.

use std::collections::BTreeMap;

use anyhow::Context;
use clap::Args;
use serde::Serialize;

use crate::cli::{Outcome, host_info, output};
use crate::evaluation::cpu_calibration::REFERENCE_MS;
use crate::evaluation::effect_cost::{self, SceneCost};
use crate::localization::SimdPath;
use crate::log_input::scene_source;
use crate::scene::{Role, Scene};

/// Check a scene file; print its effects, all numbers as drawn, and what each costs per frame
///
/// Whatever is wrong with the file is told with its line and what would be right (exit code 2). Milliseconds are measured
/// now, on this machine, of one thread's processor: the best of five times on six frames, with and without each effect.
///
/// A limit must hold on every machine, so --max-ms is not held against these, but against what they would be on the machine
/// of docs/reference/scenes.md, by how fast a fixed loop runs here meanwhile.
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim scene check replay/scenes/crowded.toml")]
pub struct CheckArguments {
    /// A scene file
    #[arg(value_name = "SCENE")]
    scene: String,
    /// Exit code 1 if a frame takes longer to render, in milliseconds of the reference machine
    #[arg(long, value_name = "MS", value_parser = milliseconds)]
    max_ms: Option<f64>,
}

#[derive(Serialize)]
struct Report<'a> {
    scene: &'a str,
    title: &'a str,
    field: &'a str,
    lens: &'a str,
    frames: u64,
    duration_s: f64,
    effects: Vec<EffectReport>,
    bare_ms: f64,
    total_ms: f64,
    /// Time of the calibration loop, milliseconds.
    loop_ms: f64,
    reference_ms: f64,
    max_ms: Option<f64>,
    machine: String,
}

#[derive(Serialize)]
struct EffectReport {
    kind: &'static str,
    role: Option<&'static str>,
    /// Values as drawn; a value that is drawn for each frame is shown as its range.
    values: BTreeMap<String, toml::Value>,
    /// `None` if the effect changes no pixel.
    ms: Option<f64>,
}

/// Measurements that must exceed a limit of time until it counts as broken.
const ATTEMPTS: usize = 3;

pub fn run(arguments: &CheckArguments, json: bool) -> anyhow::Result<Outcome> {
    let scene = scene_source::load(&arguments.scene)?;
    let cost = measure_repeatedly(&scene, arguments.max_ms)?;
    let reference_ms = cost.reference_ms();
    let SceneCost { bare_ms, effects, total_ms, loop_ms } = cost;
    let values = values(&scene)?;
    let file = scene.file();
    let effects = file.effects.iter().zip(effects).zip(values).map(|((effect, cost), values)| {
        let role = effect.role().map(|role| match role {
            Role::Base => "base",
            Role::Filler => "filler",
        });
        EffectReport { kind: cost.kind, role, values, ms: cost.ms }
    });
    let report = Report {
        scene: &arguments.scene,
        title: &file.scene.title,
        field: &file.scene.field,
        lens: &file.camera.lens,
        frames: scene.frame_count(),
        duration_s: scene.duration_s(),
        effects: effects.collect(),
        bare_ms,
        total_ms,
        loop_ms,
        reference_ms,
        max_ms: arguments.max_ms,
        machine: host_info::describe(SimdPath::Auto),
    };
    if json {
        output::json(&report)?
    } else {
        output::lines(&for_people(&report))?
    }
    match arguments.max_ms {
        Some(max_ms) if reference_ms > max_ms => {
            eprintln!(
                "realitysim: {}: a frame takes {reference_ms:.2} ms of the reference machine ({total_ms:.2} here), \
                 allowed are {max_ms}",
                arguments.scene
            );
            Ok(Outcome::NotReached)
        }
        _ => Ok(Outcome::Whole),
    }
}

/// Measures the cost of a scene. Disturbances only add time, so the best of several measurements counts.
fn measure_repeatedly(scene: &Scene, max_ms: Option<f64>) -> anyhow::Result<SceneCost> {
    let mut best = effect_cost::measure(scene)?;
    for _ in 1..ATTEMPTS {
        if max_ms.is_none_or(|max_ms| best.reference_ms() <= max_ms) {
            break;
        }
        let again = effect_cost::measure(scene)?;
        if again.reference_ms() < best.reference_ms() {
            best = again;
        }
    }
    Ok(best)
}

fn milliseconds(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number: &f64| number.is_finite() && *number > 0.0);
    number.ok_or_else(|| "it must be a number of milliseconds above 0".to_owned())
}

/// Values of each effect's entry, without its kind and role.
fn values(scene: &Scene) -> anyhow::Result<Vec<BTreeMap<String, toml::Value>>> {
    let text = scene.file().resolved().unwrap_or_default();
    let table: toml::Table = toml::from_str(&text).context("the scene cannot be read again")?;
    let effects = table.get("effect").and_then(toml::Value::as_array).cloned().unwrap_or_default();
    let of_entry = |entry: toml::Value| match entry {
        toml::Value::Table(table) => table.into_iter().filter(|(key, _)| key != "kind" && key != "role").collect(),
        _ => BTreeMap::new(),
    };
    Ok(effects.into_iter().map(of_entry).collect())
}

fn for_people(report: &Report) -> String {
    let mut text = format!(
        "{}: {} frames, {:.1} s, field {}, lens {}\n\n  {:<20} {:<7} {:>8}\n  {:<20} {:<7} {:>8.2}\n",
        report.title,
        report.frames,
        report.duration_s,
        report.field,
        report.lens,
        "effect",
        "role",
        "ms",
        "(none)",
        "",
        report.bare_ms
    );
    for EffectReport { kind, role, values, ms } in &report.effects {
        let ms = ms.map_or_else(|| "-".to_owned(), |ms| format!("+{ms:.2}"));
        let values: Vec<String> = values.iter().map(|(key, value)| format!("{key} = {}", shortened(value))).collect();
        text.push_str(&format!("  {kind:<20} {:<7} {ms:>8}  {}\n", role.unwrap_or("-"), values.join(", ")));
    }
    text.push_str(&format!(
        "  {:<20} {:<7} {:>8.2}\n  {:<20} {:<7} {:>8.2}\n\n{}; its loop takes {:.2} ms, that of the reference {REFERENCE_MS}",
        "all", "", report.total_ms, "on the reference", "", report.reference_ms, report.machine, report.loop_ms
    ));
    text
}

/// Shortens a value for the screen: a list of tables to its length, a range to its ends.
fn shortened(value: &toml::Value) -> String {
    match value {
        toml::Value::Table(range) if range.contains_key("uniform") => {
            let ends = range["uniform"].as_array().map(Vec::as_slice).unwrap_or_default();
            let ends: Vec<String> = ends.iter().map(shortened).collect();
            format!("{} each frame", ends.join(" to "))
        }
        toml::Value::Array(list) if list.iter().any(|value| value.get("uniform").is_some()) => {
            format!("[{}]", list.iter().map(shortened).collect::<Vec<_>>().join(", "))
        }
        toml::Value::Array(list) if list.iter().any(toml::Value::is_table) => format!("[{} of them]", list.len()),
        value => value.to_string(),
    }
}
