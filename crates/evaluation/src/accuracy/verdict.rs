//! For which use the measured accuracy is good enough.

use serde::Serialize;

use super::Measure;
use super::split_half::SplitHalf;
use super::taped::{MIN_CROSSINGS, Taped};
use super::turned::Turned;

/// Largest errors that each use bears, metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Limits {
    /// Standard deviation that images for labels must have.
    pub labels_m: f64,
    /// Standard deviation that images for training of views must have.
    pub views_m: f64,
    /// Radius of the ball.
    pub ball_m: f64,
}

/// A use of the tags, and whether they are good enough for it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Use {
    /// What the tags are used for.
    pub name: &'static str,
    /// Which figure is compared with the limit, and where the limit comes from.
    pub figure: &'static str,
    /// The limit, centimetres.
    pub limit_cm: f64,
    /// The figure, centimetres, or without taped places the noise alone.
    pub value_cm: Option<f64>,
    /// Whether `value_cm` is the noise alone, which is part of the figure.
    pub noise_alone: bool,
    /// Whether they are good enough.
    pub verdict: Verdict,
    /// Why there is no verdict.
    pub missing: Option<String>,
}

/// Whether tags are good enough.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The figure is within the limit.
    Yes,
    /// It is not.
    No,
    /// The data show neither.
    NotShown,
}

/// Judges each use. Noise alone can refute a use; only taped places can show that it is met, since all else misses what every tag has in
/// common.
pub fn verdicts(
    limits: &Limits,
    taped: &Measure<Taped>,
    turned: &Measure<Turned>,
    halves: &[Measure<SplitHalf>],
) -> Vec<Use> {
    let noises = halves.iter().filter_map(|half| half.known().map(|half| half.noise_cm));
    let noise_cm = noises.fold(None, |most: Option<f64>, noise| Some(most.map_or(noise, |most| most.max(noise))));
    let enough = taped.known().filter(|taped| taped.crossings >= MIN_CROSSINGS);
    let gross = taped.known().is_some_and(|taped| taped.gross > 0);
    let turning_cm = turned.known().map(|turned| turned.forward_left_cm.length());
    let judge = |name, figure, limit_m: f64, shown_cm: Option<f64>| {
        let limit_cm = 100.0 * limit_m;
        let value_cm = shown_cm.or(noise_cm);
        let is_worse = gross || value_cm.is_some_and(|value| value > limit_cm);
        let verdict = match (is_worse, shown_cm) {
            (true, _) => Verdict::No,
            (false, Some(_)) => Verdict::Yes,
            (false, None) => Verdict::NotShown,
        };
        let missing = (verdict == Verdict::NotShown)
            .then(|| format!("it takes marks on {MIN_CROSSINGS} crossings, each with opposite headings"));
        Use { name, figure, limit_cm, value_cm, noise_alone: shown_cm.is_none(), verdict, missing }
    };
    let consistent = enough.and(turning_cm).zip(noise_cm).map(|(turning, noise)| libm::hypot(turning, noise));
    vec![
        judge(
            "labels",
            "absolute error at taped places, rms; limit: `realitysim labels --max-sigma`",
            limits.labels_m,
            enough.map(|taped| taped.rms_cm),
        ),
        judge(
            "views",
            "noise and what turns with the robot, rms; limit: `realitysim export --to nerfstudio --max-sigma`",
            limits.views_m,
            consistent,
        ),
        judge(
            "ball radius",
            "absolute error at taped places, 95 % quantile; limit: radius of a ball of 14 cm, as scenes have it",
            limits.ball_m,
            enough.map(|taped| taped.position_cm.p95),
        ),
    ]
}
