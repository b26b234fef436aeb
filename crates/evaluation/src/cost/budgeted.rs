//! Rows of the Pareto front tried again with a time budget for each frame. With one, the search over the whole field is
//! spread over several frames.

use super::pareto_front::front;
use super::row::Row;
use super::sweep_point::SweepPoint;

/// Returns whether no row that counts keeps the budget.
pub fn is_exceeded(rows: &[Row], budget_ms: f64) -> bool {
    !rows.iter().map(Row::point).any(|point| point.counts() && point.time_ms <= budget_ms)
}

/// Returns the settings on the Pareto front with `budget_ms` as their budget.
pub fn capped(rows: &[Row], budget_ms: f64) -> Vec<SweepPoint> {
    let on_front = front(&rows.iter().map(Row::point).collect::<Vec<_>>());
    let bargains = rows.iter().zip(on_front).filter(|(_, on_front)| *on_front);
    bargains.map(|(row, _)| SweepPoint { budget_ms, ..row.sweep_point }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use realitysim_config::Settings;

    #[test]
    fn rows_of_the_front_get_the_budget_that_no_row_keeps() {
        let row = |particles: usize, p99_ms: f64, mean_cm: f64| {
            let sweep_point = SweepPoint { particles, ..SweepPoint::of(&Settings::default()) };
            let mut row = Row { p99_ms, judged: 9, ..Row::of(sweep_point, &[], &[]) };
            row.position_cm.mean = mean_cm;
            row
        };
        let mut rows = vec![row(1, 9.0, 3.0), row(2, 12.0, 1.0), row(3, 15.0, 2.0)];
        assert!(is_exceeded(&rows, 8.0) && !is_exceeded(&rows, 9.0));
        let tried: Vec<_> =
            capped(&rows, 8.0).iter().map(|sweep_point| (sweep_point.particles, sweep_point.budget_ms)).collect();
        assert_eq!(tried, [(1, 8.0), (2, 8.0)]);
        rows[0].evasive = true;
        assert!(is_exceeded(&rows, 9.0), "an evasive row does not count");
    }
}
