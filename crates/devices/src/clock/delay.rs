//! Estimates the constant by which a camera's stamps are later than its exposures.
//!
//! Pictures tell how far the camera turned between two frames; the attitude of the body tells how far the body turned between
//! the same two times less the delay. The delay at which both agree best is the estimate. Only the size of the turns is
//! compared, so it does not matter how the camera is mounted.

use thiserror::Error;

/// The turn of the camera between two successive frames, as their pictures show it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turn {
    /// Stamp of the first frame, nanoseconds.
    pub from_ns: i64,
    /// Stamp of the second frame, nanoseconds.
    pub to_ns: i64,
    /// Size of the turn, radians.
    pub angle: f64,
}

/// An estimated delay.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Delay {
    /// Time by which stamps are later than exposures, nanoseconds.
    pub delay_ns: i64,
    /// Two standard deviations of the delay, and one step of the search, nanoseconds.
    pub uncertainty_ns: i64,
    /// Correlation of the two measurements of the turns, at this delay.
    pub correlation: f64,
    /// Number of turns that were compared.
    pub turns: usize,
}

/// Why no delay can be estimated.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum DelayError {
    /// There are too few turns that both measured; their number.
    #[error("only {0} pairs of frames with both pictures and attitude: at least {MIN_TURNS} are needed")]
    Few(usize),
    /// The body turns too little; its turn rate, degrees per second, root mean square.
    #[error(
        "the body hardly turns ({0:.1} deg/s): turn head or body left and right, at 20 deg/s or more, for ten seconds"
    )]
    Still(f64),
    /// The two measurements do not agree at any delay; the best correlation.
    #[error(
        "pictures and attitude do not agree at any delay (correlation {0:.2}): stand still and turn only; is the lens right?"
    )]
    Disagree(f64),
    /// The best delay lies at an end of the range that is searched; milliseconds.
    #[error("the best delay lies at the end of what is tried ({0} ms): are both on one clock?")]
    AtTheEnd(i64),
}

/// Largest delay that is searched, on both sides of zero, nanoseconds.
const MAX_DELAY_NS: i64 = 250_000_000;
/// Step of the search, nanoseconds.
const STEP_NS: i64 = 1_000_000;
/// Smallest number of turns that give a delay.
const MIN_TURNS: usize = 60;
/// Smallest turn rate of the body, degrees per second, root mean square.
const MIN_TURN_RATE_DEG_S: f64 = 5.0;
/// Smallest correlation that is believed. While the robot walks, near things move in the picture without a turn: on a simulated
/// walk the correlation is 0.88 and the delay wrong by 18 ms.
const MIN_CORRELATION: f64 = 0.95;

/// Estimates the delay. `turned` returns the angle by which the body turned between two times, radians, if it was measured.
pub fn estimate(turns: &[Turn], turned: impl Fn(i64, i64) -> Option<f64>) -> Result<Delay, DelayError> {
    let mut best: Option<(i64, Fit)> = None;
    let mut fits = Vec::new();
    for delay_ns in (-MAX_DELAY_NS..=MAX_DELAY_NS).step_by(STEP_NS as usize) {
        let fit = Fit::at(turns, delay_ns, &turned);
        if best.as_ref().is_none_or(|(_, best)| fit.correlation > best.correlation) {
            best = Some((delay_ns, fit));
        }
        fits.push(fit);
    }
    let (delay_ns, fit) = best.ok_or(DelayError::Few(0))?;
    if fit.turns < MIN_TURNS {
        return Err(DelayError::Few(fit.turns));
    }
    if fit.degrees_a_second < MIN_TURN_RATE_DEG_S {
        return Err(DelayError::Still(fit.degrees_a_second));
    }
    if fit.correlation < MIN_CORRELATION {
        return Err(DelayError::Disagree(fit.correlation));
    }
    let index = ((delay_ns + MAX_DELAY_NS) / STEP_NS) as usize;
    // The minimum of a parabola through three points some steps apart, because single steps are noisy.
    let reach = 5;
    let (Some(before), Some(after)) = (index.checked_sub(reach).map(|i| &fits[i]), fits.get(index + reach)) else {
        return Err(DelayError::AtTheEnd(delay_ns / 1_000_000));
    };
    let width = (reach as i64 * STEP_NS) as f64;
    let curvature = (before.residual - 2.0 * fit.residual + after.residual) / (width * width);
    let slope = (after.residual - before.residual) / (2.0 * width);
    let shift = if curvature > 0.0 { (-slope / curvature).clamp(-width, width) } else { 0.0 };
    let variance = fit.residual / (fit.turns - 2) as f64;
    let sigma = if curvature > 0.0 { libm::sqrt(2.0 * variance / curvature) } else { MAX_DELAY_NS as f64 };
    Ok(Delay {
        delay_ns: delay_ns + shift as i64,
        uncertainty_ns: (2.0 * sigma) as i64 + STEP_NS,
        correlation: fit.correlation,
        turns: fit.turns,
    })
}

/// The fit of the pictures' turns, at one delay, by a linear function of the body's turns.
#[derive(Clone, Copy)]
struct Fit {
    turns: usize,
    correlation: f64,
    /// Sum of the squared residuals, rad².
    residual: f64,
    /// Turn rate of the body, root mean square.
    degrees_a_second: f64,
}

impl Fit {
    /// Fits the turns at one delay.
    fn at(turns: &[Turn], delay_ns: i64, turned: &impl Fn(i64, i64) -> Option<f64>) -> Self {
        let (mut n, mut a, mut b, mut aa, mut bb, mut ab, mut rate) = (0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for turn in turns {
            let Some(body) = turned(turn.from_ns - delay_ns, turn.to_ns - delay_ns) else { continue };
            n += 1;
            a += body;
            b += turn.angle;
            aa += body * body;
            bb += turn.angle * turn.angle;
            ab += body * turn.angle;
            let seconds = (turn.to_ns - turn.from_ns) as f64 * 1e-9;
            rate += (body / seconds) * (body / seconds);
        }
        let count = f64::from(n.max(1));
        let (saa, sbb, sab) = (aa - a * a / count, bb - b * b / count, ab - a * b / count);
        let correlation = if saa * sbb > 0.0 { sab / libm::sqrt(saa * sbb) } else { 0.0 };
        let residual = if saa > 0.0 { sbb - sab * sab / saa } else { sbb };
        Self { turns: n as usize, correlation, residual, degrees_a_second: libm::sqrt(rate / count).to_degrees() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the angle of a head that looks left and right, at a time.
    fn heading(ns: i64) -> f64 {
        let t = ns as f64 * 1e-9;
        0.5 * libm::sin(2.1 * t) + 0.2 * libm::sin(5.3 * t + 1.0)
    }

    fn turns(delay_ns: i64, noise: f64, seconds: i64) -> Vec<Turn> {
        let mut state = 7u64;
        let mut draw = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64 / f64::from(1 << 24) - 0.5
        };
        (0..30 * seconds)
            .map(|frame| {
                let (from, to) = (frame * 33_333_333, (frame + 1) * 33_333_333);
                let angle = (heading(to) - heading(from)).abs() * 0.97 + noise * draw();
                Turn { from_ns: from + delay_ns, to_ns: to + delay_ns, angle }
            })
            .collect()
    }

    fn body(from_ns: i64, to_ns: i64) -> Option<f64> {
        Some((heading(to_ns) - heading(from_ns)).abs())
    }

    #[test]
    fn the_delay_is_found_and_its_uncertainty_holds() {
        for delay_ms in [-120, -33, 0, 7, 45, 180] {
            let truth_ns = delay_ms * 1_000_000 + 400_000;
            let found = estimate(&turns(truth_ns, 0.004, 12), body).expect("turns enough");
            let error_ns = found.delay_ns - truth_ns;
            assert!(error_ns.abs() < 3_000_000, "{delay_ms} ms: {found:?}");
            assert!(
                error_ns.abs() <= found.uncertainty_ns && found.uncertainty_ns < 8_000_000,
                "{delay_ms} ms: {found:?}"
            );
        }
    }

    #[test]
    fn what_cannot_be_told_is_not_told() {
        assert_eq!(estimate(&turns(0, 0.0, 1), body), Err(DelayError::Few(30)));
        assert!(matches!(estimate(&turns(0, 0.0, 12), |_, _| Some(0.0001)), Err(DelayError::Still(_))));
        let other = |from: i64, to: i64| body(from * 3, to * 3);
        assert!(matches!(estimate(&turns(0, 0.0, 12), other), Err(DelayError::Disagree(_) | DelayError::AtTheEnd(_))));
    }
}
