//! Files that a sweep writes: cost.csv, cost.svg and cost.toml.

use anyhow::Context;

use super::report::{Report, model_name};
use crate::cli::paths;
use crate::config::Settings;
use crate::evaluation::cost::Row;

pub fn write(report: &Report, configured: &Settings) -> anyhow::Result<()> {
    for (name, content) in
        [("cost.csv", csv(report)), ("cost.svg", report.chart()), ("cost.toml", fragment(report, configured)?)]
    {
        paths::write(&report.output.join(name), &content)?;
    }
    Ok(())
}

const COLUMNS: &str = "model,particles,iterations,adaptive,line_points,image_reduction,refinement,budget_ms,p50_ms,p99_ms,mean_cm,median_cm,\
                       p95_cm,max_cm,scatter_cm,yaw_mean_deg,valid_share,tags_judged,evasive,on_front,recommended,configured\n";

/// Writes one line for each row; errors are empty where no tag could be judged.
fn csv(report: &Report) -> String {
    let mut text = COLUMNS.to_owned();
    for line in report.lines() {
        let Row { sweep_point, p50_ms, p99_ms, position_cm: p, scatter_cm, yaw_deg, valid_share, judged, evasive } =
            line.row;
        let errors = if *judged > 0 {
            format!("{:.4},{:.4},{:.4},{:.4},{scatter_cm:.4},{:.4}", p.mean, p.median, p.p95, p.max, yaw_deg.mean)
        } else {
            ",,,,,".to_owned()
        };
        text.push_str(&format!(
            "{},{},{},{},{},{},{},{},{p50_ms:.4},{p99_ms:.4},{errors},{valid_share:.4},{judged},{evasive},{},{},{}\n",
            model_name(sweep_point.model),
            sweep_point.particles,
            sweep_point.iterations,
            sweep_point.adaptive,
            sweep_point.line_points,
            sweep_point.image_reduction,
            sweep_point.refinement,
            sweep_point.budget_ms,
            line.on_front,
            line.recommended,
            line.configured,
        ));
    }
    text
}

/// The recommended settings, and those of the config that differ from the defaults, as a config file.
fn fragment(report: &Report, configured: &Settings) -> anyhow::Result<String> {
    let row = report.recommended();
    let mut settings = row.sweep_point.set(configured, configured.filter.seed);
    // A row measured without a budget leaves the robot's budget as it is.
    if row.sweep_point.budget_ms == 0.0 {
        settings.filter.budget_ms = configured.filter.budget_ms;
    }
    let mut table = toml::Table::try_from(&settings).context("the settings cannot be written as TOML")?;
    let defaults = toml::Table::try_from(Settings::default()).context("the defaults cannot be written as TOML")?;
    remove_defaults(&mut table, &defaults, "");
    Ok(format!(
        "# {}\n# On {}, {} frames: p50 {:.2} ms, p99 {:.2} ms, mean error {:.2} cm, p95 {:.2} cm\n# on a {}.\n\
         # A config by itself (--config), or keys to copy into the robot's.\n\n{table}",
        report.command,
        report.source,
        report.frames,
        row.p50_ms,
        row.p99_ms,
        row.position_cm.mean,
        row.position_cm.p95,
        report.machine
    ))
}

/// Keys that are written even when they have their default value, since they are the recommendation.
const SWEPT_KEYS: [&str; 7] = [
    "filter.model",
    "filter.particles",
    "filter.iterations",
    "filter.adaptive",
    "filter.line_points",
    "filter.image_reduction",
    "filter.refinement",
];

fn remove_defaults(table: &mut toml::Table, defaults: &toml::Table, path: &str) {
    let mut empty = Vec::new();
    for (key, value) in table.iter_mut() {
        let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
        match (value, defaults.get(key)) {
            (toml::Value::Table(inner), Some(toml::Value::Table(defaults))) => {
                remove_defaults(inner, defaults, &path);
                if inner.is_empty() {
                    empty.push(key.clone());
                }
            }
            (value, default) if default == Some(value) && !SWEPT_KEYS.contains(&path.as_str()) => {
                empty.push(key.clone())
            }
            _ => {}
        }
    }
    table.retain(|key, _| !empty.iter().any(|gone| gone == key));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_answer_and_what_differs_is_stated() {
        let mut settings = Settings { robot: "tom".to_owned(), ..Settings::default() };
        settings.filter.valid_share = 0.4;
        settings.camera.lens = Some("wide-640".to_owned());
        let mut table = toml::Table::try_from(&settings).expect("a table");
        remove_defaults(&mut table, &toml::Table::try_from(Settings::default()).expect("a table"), "");
        let text = table.to_string();
        assert_eq!(Settings::parse(&text, "cost.toml").expect("a config"), settings);
        for key in ["robot", "lens", "valid_share", "particles", "refinement"] {
            assert!(text.contains(&format!("{key} = ")), "{key}: {text}");
        }
        assert!(!text.contains("topics") && !text.contains("valid_points"), "{text}");
    }
}
