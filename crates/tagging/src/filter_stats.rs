//! Times, particles and spread of localization, for diagnostics and reports.

use super::durations::Durations;
use realitysim_ros2::messages::{DiagnosticStatus, FrameTag, KeyValue};
use realitysim_ros2::topics::DIAGNOSTICS_PREFIX;

/// Statistics of all frames, and of those since the last diagnostics.
#[derive(Clone, Debug, Default)]
pub struct FilterStats {
    /// Times from the decoded image to the tag.
    pub durations: Durations,
    /// Number of frames with fewer particles or iterations than wanted because time was up.
    pub capped: u64,
    /// Number of frames that took longer than the budget.
    pub over_budget: u64,
    recent: RecentFilterStats,
}

#[derive(Clone, Copy, Debug, Default)]
struct RecentFilterStats {
    frames: u64,
    capped: u64,
    over_budget: u64,
    particles: u64,
    spread_m: f64,
}

impl FilterStats {
    /// Counts a frame by its tag. `budget_ms` is 0 if there is no budget.
    pub fn note(&mut self, tag: &FrameTag, budget_ms: f64) {
        self.durations.note(tag.elapsed_ms);
        self.capped += u64::from(tag.capped);
        let over_budget = budget_ms > 0.0 && tag.elapsed_ms > budget_ms;
        self.over_budget += u64::from(over_budget);
        let recent = &mut self.recent;
        recent.frames += 1;
        recent.capped += u64::from(tag.capped);
        recent.over_budget += u64::from(over_budget);
        recent.particles += u64::from(tag.particles);
        recent.spread_m = tag.spread_m;
    }

    /// The diagnostics of localization since the last call.
    pub fn diagnostics(&mut self, robot: &str, budget_ms: f64) -> DiagnosticStatus {
        let RecentFilterStats { frames, capped, over_budget, particles, spread_m } = core::mem::take(&mut self.recent);
        let share = |count: u64| count as f64 / frames.max(1) as f64;
        let quantiles = self.durations.quantiles();
        let late = share(over_budget) > 0.5;
        let message = match (budget_ms > 0.0, late, capped) {
            (false, ..) => "no budget".to_owned(),
            (_, true, _) => {
                format!("the budget of {budget_ms} ms cannot be kept: seeing and refining alone take longer")
            }
            (_, _, 0) => "within the budget".to_owned(),
            (_, _, _) => "within the budget, with fewer particles".to_owned(),
        };
        let value = |key: &str, value: String| KeyValue { key: key.to_owned(), value };
        DiagnosticStatus {
            level: if late { DiagnosticStatus::WARN } else { DiagnosticStatus::OK },
            name: format!("{DIAGNOSTICS_PREFIX}localization"),
            message,
            hardware_id: robot.to_owned(),
            values: vec![
                value("budget_ms", budget_ms.to_string()),
                value("p50_ms", format!("{:.2}", quantiles.p50)),
                value("p99_ms", format!("{:.2}", quantiles.p99)),
                value("particles", format!("{:.0}", particles as f64 / frames.max(1) as f64)),
                value("capped_share", format!("{:.3}", share(capped))),
                value("over_budget_share", format!("{:.3}", share(over_budget))),
                value("spread_cm", format!("{:.1}", 100.0 * spread_m)),
            ],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tag(elapsed_ms: f64, capped: bool) -> FrameTag {
        FrameTag { elapsed_ms, capped, particles: 64, spread_m: 0.021, ..FrameTag::default() }
    }

    #[test]
    fn a_budget_that_cannot_be_kept_is_told_with_what_was_reached() {
        let mut stats = FilterStats::default();
        (0..10).for_each(|_| stats.note(&tag(3.0, true), 1.0));
        let status = stats.diagnostics("r", 1.0);
        assert_eq!(status.level, DiagnosticStatus::WARN);
        assert!(status.message.contains("budget of 1 ms cannot be kept"), "{}", status.message);
        let of = |key: &str| status.values.iter().find(|pair| pair.key == key).map(|pair| pair.value.clone());
        assert_eq!(of("capped_share").as_deref(), Some("1.000"));
        assert_eq!(of("particles").as_deref(), Some("64"));
        assert_eq!(of("spread_cm").as_deref(), Some("2.1"));
        let p99: f64 = of("p99_ms").expect("there").parse().expect("a number");
        assert!((p99 - 3.0).abs() < 0.05);
    }

    #[test]
    fn each_report_is_of_the_time_since_the_last() {
        let mut stats = FilterStats::default();
        (0..10).for_each(|_| stats.note(&tag(3.0, true), 1.0));
        stats.diagnostics("r", 1.0);
        (0..10).for_each(|_| stats.note(&tag(0.9, false), 1.0));
        let status = stats.diagnostics("r", 1.0);
        assert_eq!((status.level, status.message.as_str()), (DiagnosticStatus::OK, "within the budget"));
        assert_eq!(stats.diagnostics("r", 0.0).message, "no budget");
    }
}
