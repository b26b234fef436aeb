//! The ways to locate that are compared.

use super::{PAPER_DISTANCE, PAPER_GAUSS, Reported};
use realitysim_config::Settings;
use realitysim_localization::{Formula, Model};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Method {
    pub name: &'static str,
    pub model: Model,
    pub formula: Formula,
    /// Where it is not the formula's own.
    pub alpha: Option<f64>,
    pub refinement: bool,
    /// Drawn over the number of particles; others only stand in the table.
    pub in_fig9: bool,
    /// What the paper has for it.
    pub reported: Option<Reported>,
}

/// The paper's two, as printed and corrected, and what this program does by default.
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
            // The paper has no rules of validity; with them a filter that is lost would be set back onto its way.
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
    fn every_method_is_a_possible_setting() {
        for method in METHODS {
            assert_eq!(method.settings(&Settings::default(), 50).check(), Ok(()), "{}", method.name);
        }
    }
}
