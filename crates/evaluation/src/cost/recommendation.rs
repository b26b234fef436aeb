//! The recommended row of a sweep, and the reason for it.

use serde::Serialize;

use super::pareto_front::Point;
use super::row::Row;

/// Requirements of the user on time and accuracy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Requirements {
    /// Largest time for a frame, milliseconds; compared with the 99 % quantile.
    pub budget_ms: Option<f64>,
    /// Largest mean position error, centimetres.
    pub accuracy_cm: Option<f64>,
}

/// A recommended row.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Advice {
    /// Index of the row.
    pub row: usize,
    /// Explanation for people.
    pub why: String,
    /// Whether the row keeps the budget; `None` if none was asked for.
    pub keeps_budget: Option<bool>,
    /// Whether the row reaches the accuracy; `None` if none was asked for.
    pub reaches_accuracy: Option<bool>,
}

impl Advice {
    /// Returns whether something was asked for and the row meets none of it.
    pub fn fails(&self) -> bool {
        let asked = [self.keeps_budget, self.reaches_accuracy];
        asked.iter().any(Option::is_some) && !asked.contains(&Some(true))
    }
}

/// Smallest noise that is assumed, centimetres: smaller differences in error are not worth a millisecond.
const MIN_NOISE_CM: f64 = 0.05;

/// Returns the difference in mean error, centimetres, from which on two rows count as different.
///
/// Two standard errors of the difference. The scatter over the seeds is the larger of that of the best row and the
/// median over the rows.
pub fn noise_cm(rows: &[Row], seeds: usize) -> f64 {
    let mut counting: Vec<&Row> = rows.iter().filter(|row| row.point().counts()).collect();
    counting.sort_by(|a, b| a.position_cm.mean.total_cmp(&b.position_cm.mean));
    let best = counting.first().map_or(0.0, |row| row.scatter_cm);
    let mut scatters: Vec<f64> = counting.iter().map(|row| row.scatter_cm).collect();
    scatters.sort_by(f64::total_cmp);
    let middle = scatters.get(scatters.len() / 2).copied().unwrap_or(0.0);
    (2.0 * libm::sqrt(2.0 / seeds.max(1) as f64) * best.max(middle)).max(MIN_NOISE_CM)
}

/// Recommends a row; `None` if no row counts.
pub fn advise(rows: &[Row], noise_cm: f64, requirements: &Requirements) -> Option<Advice> {
    let points: Vec<Point> = rows.iter().map(Row::point).collect();
    let (row, reason) = choose(&points, noise_cm, requirements)?;
    let point = points[row];
    let keeps_budget = requirements.budget_ms.map(|budget_ms| point.time_ms <= budget_ms);
    let reaches_accuracy = requirements.accuracy_cm.map(|accuracy_cm| point.error_cm <= accuracy_cm);
    let mut why = format!("{}: {}.", rows[row].sweep_point, explain(&points, row, reason, noise_cm, requirements));
    if rows[row].sweep_point.budget_ms > 0.0 {
        let [capped, most] = [rows[row].valid_share, rows.iter().map(|row| row.valid_share).fold(0.0, f64::max)]
            .map(|share| 100.0 * share);
        why.push_str(&format!(
            " A search takes it several frames: it tags {capped:.0} % of all, {most:.0} % are possible."
        ));
    }
    Some(Advice { row, why, keeps_budget, reaches_accuracy })
}

/// The reason why a row was chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Reason {
    /// The cheapest allowed row that is within noise of the best allowed row, whose index this is.
    AsGoodAs(usize),
    /// The cheapest row that reaches the accuracy.
    Reaches,
    /// The cheapest row that reaches the accuracy, over the budget, which no row keeps.
    ReachesLate,
    /// The fastest row, as none keeps the budget.
    Fastest,
}

/// Chooses a point; `None` if none counts.
///
/// It lies on the Pareto front: each set of which it is the cheapest also contains whatever dominates one of its
/// points.
fn choose(points: &[Point], noise_cm: f64, requirements: &Requirements) -> Option<(usize, Reason)> {
    let all: Vec<usize> = (0..points.len()).filter(|index| points[*index].counts()).collect();
    let within = |of: &[usize], time_ms: f64, error_cm: f64| -> Vec<usize> {
        let holds = |index: &&usize| points[**index].time_ms <= time_ms && points[**index].error_cm <= error_cm;
        of.iter().filter(holds).copied().collect()
    };
    let affordable = within(&all, requirements.budget_ms.unwrap_or(f64::INFINITY), f64::INFINITY);
    if let Some(accuracy_cm) = requirements.accuracy_cm {
        let reaching = within(&affordable, f64::INFINITY, accuracy_cm);
        if let Some(row) = cheapest(points, &reaching) {
            return Some((row, Reason::Reaches));
        }
        if affordable.is_empty()
            && let Some(row) = cheapest(points, &within(&all, f64::INFINITY, accuracy_cm))
        {
            return Some((row, Reason::ReachesLate));
        }
    }
    let Some(best) = most_accurate(points, &affordable) else {
        return cheapest(points, &all).map(|row| (row, Reason::Fastest));
    };
    let as_good = within(&affordable, f64::INFINITY, points[best].error_cm + noise_cm);
    cheapest(points, &as_good).map(|row| (row, Reason::AsGoodAs(best)))
}

fn cheapest(points: &[Point], of: &[usize]) -> Option<usize> {
    let key = |index: &usize| (points[*index].time_ms, points[*index].error_cm);
    of.iter().copied().min_by(|a, b| order(key(a), key(b)))
}

fn most_accurate(points: &[Point], of: &[usize]) -> Option<usize> {
    let key = |index: &usize| (points[*index].error_cm, points[*index].time_ms);
    of.iter().copied().min_by(|a, b| order(key(a), key(b)))
}

fn order(a: (f64, f64), b: (f64, f64)) -> core::cmp::Ordering {
    a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1))
}

/// Explains the choice in a sentence.
fn explain(points: &[Point], row: usize, reason: Reason, noise_cm: f64, requirements: &Requirements) -> String {
    let Point { time_ms, error_cm } = points[row];
    let (budget, accuracy) = (requirements.budget_ms.unwrap_or(0.0), requirements.accuracy_cm.unwrap_or(0.0));
    let has = format!("{error_cm:.2} cm at {time_ms:.1} ms (p99)");
    match reason {
        Reason::Reaches => format!("the cheapest row that reaches {accuracy} cm, with {has}"),
        Reason::ReachesLate => {
            let fastest = points.iter().filter(|point| point.counts()).map(|point| point.time_ms);
            let fastest = fastest.fold(f64::INFINITY, f64::min);
            format!(
                "no row keeps {budget} ms, the fastest takes {fastest:.1} ms (p99); this is the cheapest that reaches \
                 {accuracy} cm, with {has}"
            )
        }
        Reason::Fastest => {
            let missed = if requirements.accuracy_cm.is_some() {
                format!(" and none reaches {accuracy} cm")
            } else {
                String::new()
            };
            format!("no row keeps {budget} ms{missed}; this is the fastest, with {has}")
        }
        Reason::AsGoodAs(best) => {
            let limit = requirements.budget_ms.map_or(String::new(), |budget| format!(" under {budget} ms"));
            let mut text = if best == row {
                format!("the most accurate row{limit}, with {has}, and none cheaper is within noise ({noise_cm:.2} cm)")
            } else {
                let Point { time_ms, error_cm } = points[best];
                format!(
                    "with {has} the cheapest row within noise ({noise_cm:.2} cm) of the best{limit}, which has \
                     {error_cm:.2} cm at {time_ms:.1} ms"
                )
            };
            if requirements.accuracy_cm.is_some() {
                let reaching = points.iter().filter(|point| point.counts() && point.error_cm <= accuracy);
                let late = reaching.map(|point| point.time_ms).fold(f64::INFINITY, f64::min);
                text = match late.is_finite() {
                    true => format!("{accuracy} cm cost {late:.1} ms; {text}"),
                    false => format!("no row reaches {accuracy} cm; {text}"),
                };
            }
            text
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::pareto_front::front;
    use super::*;
    use proptest::prelude::*;

    fn point(time_ms: f64, error_cm: f64) -> Point {
        Point { time_ms, error_cm }
    }

    const CURVE: [(f64, f64); 5] = [(1.0, 9.0), (2.0, 3.0), (4.0, 1.04), (6.0, 1.0), (12.0, 0.6)];

    fn chosen(budget_ms: Option<f64>, accuracy_cm: Option<f64>) -> (usize, Reason) {
        let points: Vec<Point> = CURVE.map(|(time, error)| point(time, error)).to_vec();
        choose(&points, 0.05, &Requirements { budget_ms, accuracy_cm }).expect("points that count")
    }

    #[test]
    fn the_rules_apply_in_their_order() {
        assert_eq!(chosen(Some(8.0), None), (2, Reason::AsGoodAs(3)));
        assert_eq!(chosen(Some(2.5), None), (1, Reason::AsGoodAs(1)));
        assert_eq!(chosen(Some(0.5), None), (0, Reason::Fastest));
        assert_eq!(chosen(None, Some(3.0)), (1, Reason::Reaches));
        assert_eq!(chosen(None, Some(0.1)), (4, Reason::AsGoodAs(4)));
        assert_eq!(chosen(Some(8.0), Some(3.0)), (1, Reason::Reaches));
        assert_eq!(chosen(Some(8.0), Some(0.7)), (2, Reason::AsGoodAs(3)));
        assert_eq!(chosen(Some(0.5), Some(0.7)), (4, Reason::ReachesLate));
        assert_eq!(chosen(Some(0.5), Some(0.1)), (0, Reason::Fastest));
        assert_eq!(choose(&[point(1.0, f64::INFINITY)], 0.05, &Requirements::default()), None);
    }

    proptest! {
        #[test]
        fn the_recommendation_lies_on_the_front(
            pairs in proptest::collection::vec((0.5..20.0f64, 0.1..30.0f64, any::<bool>()), 0..40),
            noise in 0.0..3.0f64,
            budget in proptest::option::of(0.1..25.0f64),
            accuracy in proptest::option::of(0.05..40.0f64),
        ) {
            let points: Vec<Point> = pairs
                .into_iter()
                .map(|(time, error, counts)| point(time.round(), if counts { error.round() } else { f64::INFINITY }))
                .collect();
            let requirements = Requirements { budget_ms: budget, accuracy_cm: accuracy };
            match choose(&points, noise, &requirements) {
                Some((row, reason)) => {
                    prop_assert!(front(&points)[row]);
                    // The explanation holds finite numbers only.
                    let text = explain(&points, row, reason, noise, &requirements);
                    prop_assert!(!text.contains("inf") && !text.contains("NaN"), "{}", text);
                    let affordable = |p: &&Point| p.counts() && p.time_ms <= budget.unwrap_or(f64::INFINITY);
                    if points.iter().filter(affordable).count() > 0 {
                        prop_assert!(points[row].time_ms <= budget.unwrap_or(f64::INFINITY), "the budget is kept if it can be");
                    }
                }
                None => prop_assert!(!points.iter().any(Point::counts)),
            }
        }
    }
}
