//! The localization methods that the experiments compare.

use super::{PAPER_DISTANCE, PAPER_GAUSS, Reported};
use realitysim_config::Settings;
use realitysim_localization::{Formula, Model};

/// A localization method.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Method {
    /// Name for tables and legends.
    pub name: &'static str,
    /// Observation model.
    pub model: Model,
    /// Formula of the observation model, as printed or corrected.
    pub formula: Formula,
    /// Parameter alpha of the formula, where it differs from the default of the formula.
    pub alpha: Option<f64>,
    /// Whether poses are refined by least squares.
    pub refinement: bool,
    /// Whether the method is drawn over the number of particles. Others stand in the table only.
    pub in_fig9: bool,
    /// Result that the paper reports for it.
    pub reported: Option<Reported>,
}

/// The two methods of the paper, as printed and corrected, and the default of this program.
pub const METHODS: [Method; 6] = [
    Method {
        name: "Gauss, as printed",
        model: Model::Gauss,
        formula: Formula::Paper,
        alpha: None,
        refinement: false,
        in_fig9: true,
        reported: Some(PAPER_GAUSS),
    },
    Method {
        name: "Gauss, printed with the sign of alpha turned",
        model: Model::Gauss,
        formula: Formula::Paper,
        alpha: Some(1000.0),
        refinement: false,
        in_fig9: false,
        reported: None,
    },
    Method {
        name: "distance, as printed",
        model: Model::Distance,
        formula: Formula::Paper,
        alpha: None,
        refinement: false,
        in_fig9: true,
        reported: Some(PAPER_DISTANCE),
    },
    Method {
        name: "Gauss, corrected",
        model: Model::Gauss,
        formula: Formula::Corrected,
        alpha: None,
        refinement: false,
        in_fig9: true,
        reported: None,
    },
    Method {
        name: "distance, corrected",
        model: Model::Distance,
        formula: Formula::Corrected,
        alpha: None,
        refinement: false,
        in_fig9: true,
        reported: None,
    },
    Method {
        name: "Gauss, corrected and refined",
        model: Model::Gauss,
        formula: Formula::Corrected,
        alpha: None,
        refinement: true,
        in_fig9: true,
        reported: None,
    },
];

impl Method {
    /// Returns `base` with the settings of this method and the given number of particles.
    pub fn settings(&self, base: &Settings, particles: usize) -> Settings {
        let mut settings = base.clone();
        let f = &mut settings.filter;
        f.model = self.model;
        f.formula = self.formula;
        f.alpha = self.alpha;
        f.refinement = self.refinement;
        f.particles = particles;
        f.adaptive = false;
        if self.formula == Formula::Paper {
            // The paper has no rules of validity: with them, a lost filter would be put back onto its way.
            f.valid_share = 0.0;
            f.valid_points = 0.0;
            f.valid_spread_m = 100.0;
        }
        settings
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_method_has_allowed_settings() {
        for method in METHODS {
            assert_eq!(method.settings(&Settings::default(), 50).check(), Ok(()), "{}", method.name);
        }
    }
}
