//! The best bargains once more, with a budget that each frame keeps: the few that search the field do so bit by bit.

use super::pareto_front::front;
use super::row::Row;
use super::sweep_point::SweepPoint;

/// No row that counts keeps the budget.
pub fn is_exceeded(rows: &[Row], budget_ms: f64) -> bool {
    !rows.iter().map(Row::point).any(|point| point.counts() && point.time_ms <= budget_ms)
}

/// The settings on the front, capped.
pub fn capped(rows: &[Row], budget_ms: f64) -> Vec<SweepPoint> {
    let on_front = front(&rows.iter().map(Row::point).collect::<Vec<_>>());
    let bargains = rows.iter().zip(on_front).filter(|(_, on_front)| *on_front);
    bargains.map(|(row, _)| SweepPoint { budget_ms, ..row.knobs }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use realitysim_config::Settings;

    #[test]
    fn what_is_on_the_front_is_tried_with_a_budget_if_nothing_else_keeps_it() {
        let row = |particles: usize, p99_ms: f64, mean_cm: f64| {
            let knobs = SweepPoint { particles, ..SweepPoint::of(&Settings::default()) };
            let mut row = Row { p99_ms, judged: 9, ..Row::of(knobs, &[], &[]) };
            row.position_cm.mean = mean_cm;
            row
        };
        let mut rows = vec![row(1, 9.0, 3.0), row(2, 12.0, 1.0), row(3, 15.0, 2.0)];
        assert!(is_exceeded(&rows, 8.0) && !is_exceeded(&rows, 9.0));
        let tried: Vec<_> = capped(&rows, 8.0).iter().map(|knobs| (knobs.particles, knobs.budget_ms)).collect();
        assert_eq!(tried, [(1, 8.0), (2, 8.0)]);
        rows[0].evasive = true;
        assert!(is_exceeded(&rows, 9.0), "it does not count");
    }
}
