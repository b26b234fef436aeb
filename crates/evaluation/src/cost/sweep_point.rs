//! The filter settings that a sweep varies, and the list of those that are tried.

use core::fmt;

use serde::Serialize;

use realitysim_config::Settings;
use realitysim_localization::Model;

/// The settings of the filter that decide about time and accuracy.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SweepPoint {
    /// Observation model.
    pub model: Model,
    /// Number of particles.
    pub particles: usize,
    /// Number of iterations of the filter per frame.
    pub iterations: usize,
    /// Whether `particles` and `iterations` are upper limits, of which the filter uses what it needs.
    pub adaptive: bool,
    /// Number of points on the lines of the field.
    pub line_points: usize,
    /// Factor by which images are reduced, as `[filter] image_reduction`: 0 is automatic.
    pub image_reduction: usize,
    /// Whether poses are refined by least squares.
    pub refinement: bool,
    /// Time budget of a frame in milliseconds, as `[filter] budget_ms`: 0 is none.
    pub budget_ms: f64,
}

impl SweepPoint {
    /// Takes the setting out of a configuration, without its budget.
    pub fn of(settings: &Settings) -> Self {
        let f = &settings.filter;
        Self {
            model: f.model,
            particles: f.particles,
            iterations: f.iterations,
            adaptive: f.adaptive,
            line_points: f.line_points,
            image_reduction: f.image_reduction,
            refinement: f.refinement,
            // A sweep measures the full cost of a setting, which a budget would cut.
            budget_ms: 0.0,
        }
    }

    /// Returns `settings` with this setting and `seed`.
    pub fn set(&self, settings: &Settings, seed: u64) -> Settings {
        let mut settings = settings.clone();
        let f = &mut settings.filter;
        f.model = self.model;
        f.particles = self.particles;
        f.iterations = self.iterations;
        f.adaptive = self.adaptive;
        f.line_points = self.line_points;
        f.image_reduction = self.image_reduction;
        f.refinement = self.refinement;
        f.budget_ms = self.budget_ms;
        f.seed = seed;
        settings
    }
}

impl fmt::Display for SweepPoint {
    fn fmt(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        let model = match self.model {
            Model::Gauss => "gauss",
            Model::Distance => "distance",
        };
        let up_to = if self.adaptive { "up to " } else { "" };
        write!(
            formatter,
            "{model}, {up_to}{} particles x {}, {} points",
            self.particles, self.iterations, self.line_points
        )?;
        if self.image_reduction > 0 {
            write!(formatter, ", image 1/{}", self.image_reduction)?;
        }
        write!(formatter, ", {}", if self.refinement { "refined" } else { "best particle" })?;
        if self.budget_ms > 0.0 { write!(formatter, ", no frame longer than {} ms", self.budget_ms) } else { Ok(()) }
    }
}

/// Largest value that `[filter] image_reduction` allows.
const REDUCTION_LIMIT: usize = 8;

/// Lists the settings of a sweep: the configured one first, then about forty others.
///
/// The number of particles goes through its whole range, every other setting takes a few values, and some rows are
/// cheap in everything. `automatic` is the image reduction that the lens gets by default.
pub fn plan(configured: SweepPoint, automatic: usize) -> Vec<SweepPoint> {
    let base = SweepPoint {
        model: Model::Gauss,
        particles: 200,
        iterations: 5,
        adaptive: false,
        line_points: 350,
        ..configured
    };
    let refined = SweepPoint { refinement: true, ..base };
    let plain = SweepPoint { refinement: false, particles: 800, ..base };
    let distance = |sweep_point: SweepPoint| SweepPoint { model: Model::Distance, ..sweep_point };
    let usual = if configured.image_reduction == 0 { automatic } else { configured.image_reduction };
    let coarser =
        |sweep_point: SweepPoint| SweepPoint { image_reduction: (2 * usual).min(REDUCTION_LIMIT), ..sweep_point };

    let mut rows = vec![configured];
    rows.extend([25, 50, 100, 200, 400, 800, 1600].map(|particles| SweepPoint { particles, ..refined }));
    let adaptive = SweepPoint { particles: 800, adaptive: true, ..refined };
    rows.extend([adaptive, SweepPoint { line_points: 200, ..adaptive }, SweepPoint { refinement: false, ..adaptive }]);
    rows.extend([50, 100, 200, 400, 800, 1600, 3200].map(|particles| SweepPoint { particles, ..plain }));
    rows.extend([100, 400, 800].map(|particles| distance(SweepPoint { particles, ..refined })));
    rows.extend([200, 800].map(|particles| distance(SweepPoint { particles, ..plain })));
    rows.extend([1, 2, 3, 10].map(|iterations| SweepPoint { iterations, ..refined }));
    rows.extend([2, 10].map(|iterations| SweepPoint { iterations, ..plain }));
    rows.extend([100, 200, 700].map(|line_points| SweepPoint { line_points, ..refined }));
    rows.extend([100, 700].map(|line_points| SweepPoint { line_points, ..plain }));
    rows.extend([refined, plain, SweepPoint { particles: 800, ..refined }].map(coarser));
    if usual > 1 {
        rows.extend([refined, plain].map(|sweep_point| SweepPoint { image_reduction: usual / 2, ..sweep_point }));
    }
    let cheap = SweepPoint { particles: 50, iterations: 2, line_points: 150, ..refined };
    rows.extend([cheap, coarser(cheap), SweepPoint { particles: 25, iterations: 1, line_points: 100, ..refined }]);

    let mut unique: Vec<SweepPoint> = Vec::new();
    for row in rows {
        if !unique.contains(&row) {
            unique.push(row);
        }
    }
    unique
}

/// Returns the setting whose tags replace a truth that is not known: far more particles, iterations and points than
/// other rows.
pub fn reference(configured: SweepPoint) -> SweepPoint {
    SweepPoint {
        model: Model::Gauss,
        particles: 4000,
        iterations: 10,
        adaptive: false,
        line_points: 700,
        image_reduction: configured.image_reduction,
        refinement: true,
        budget_ms: 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_is_an_allowed_setting_and_occurs_once() {
        for automatic in [1, 2, 8] {
            for reduction in [0, 1, 8] {
                let mut settings = Settings::default();
                settings.filter.image_reduction = reduction;
                let configured = SweepPoint::of(&settings);
                let rows = plan(configured, automatic);
                assert_eq!(rows[0], configured);
                assert!((32..=48).contains(&rows.len()), "{}", rows.len());
                for (index, row) in rows.iter().enumerate() {
                    assert!(!rows[..index].contains(row), "{row}");
                    let set = row.set(&settings, 3);
                    assert_eq!(set.check(), Ok(()), "{row}");
                    assert_eq!((SweepPoint::of(&set), set.filter.seed), (*row, 3));
                }
            }
        }
    }
}
