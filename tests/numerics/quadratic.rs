//! The paper's quadratic map between two images: points that leave it open, and the fit against 256 bits.

use glam::DVec2;
use realitysim::views::quadratic::{FitError, Quadratic};

use realitysim_test_support::exact::{Exact, exact, rounded};
use realitysim_test_support::measured::largest_error;

type Pair = (DVec2, DVec2);

/// What two views of a field look like, at 640 x 480: bent a little, and no quadratic.
fn bent(p: DVec2) -> DVec2 {
    DVec2::new(
        1.1 * p.x + 0.2 * p.y + 20.0 * libm::sin(p.y / 90.0),
        0.9 * p.y - 0.1 * p.x + 1e-4 * p.x * p.x + 15.0 * libm::cos(p.x / 70.0),
    )
}

fn pairs(count: usize, offset: DVec2, map: impl Fn(DVec2) -> DVec2) -> Vec<Pair> {
    let place = |i: usize| DVec2::new((i * 277 % 640) as f64, (i * 181 % 480) as f64);
    (0..count).map(|i| (place(i) + offset, map(place(i)) + offset)).collect()
}

fn terms(p: &[Exact; 2]) -> [Exact; 6] {
    let [x, y] = p;
    [exact(1.0), x.clone(), y.clone(), x * x, x * y, y * y]
}

/// Where the least squares map, by normal equations in 256 bits, takes each point of `at`.
fn oracle(pairs: &[Pair], at: &[DVec2]) -> Vec<[Exact; 2]> {
    // Any centre and scale give the same map.
    let centre = pairs[0].0;
    let place =
        |p: DVec2| [(exact(p.x) - exact(centre.x)) / exact(256.0), (exact(p.y) - exact(centre.y)) / exact(256.0)];
    let mut rows: Vec<Vec<Exact>> = vec![vec![exact(0.0); 8]; 6];
    for (from, to) in pairs {
        let terms = terms(&place(*from));
        for (row, term) in rows.iter_mut().zip(&terms) {
            for (sum, other) in row.iter_mut().zip(terms.iter().chain([&exact(to.x), &exact(to.y)])) {
                *sum = &*sum + term * other;
            }
        }
    }
    let solved = eliminated(rows);
    let value = |p: &DVec2, which: usize| {
        terms(&place(*p)).iter().zip(&solved).fold(exact(0.0), |sum, (term, row)| sum + term * &row[which])
    };
    at.iter().map(|p| [value(p, 0), value(p, 1)]).collect()
}

/// Gauss and Jordan: what is right of the sixth column is the solution.
fn eliminated(mut rows: Vec<Vec<Exact>>) -> Vec<[Exact; 2]> {
    for pivot in 0..6 {
        let head = rows[pivot].clone();
        for (_, row) in rows.iter_mut().enumerate().filter(|(index, _)| *index != pivot) {
            let factor = &row[pivot] / &head[pivot];
            row.iter_mut().zip(&head).for_each(|(value, of_head)| *value = &*value - &factor * of_head);
        }
    }
    (0..6).map(|i| [&rows[i][6] / &rows[i][i], &rows[i][7] / &rows[i][i]]).collect()
}

fn largest(pairs: &[Pair]) -> f64 {
    let map = Quadratic::fit(pairs).expect("a fit");
    let at: Vec<DVec2> = pairs.iter().map(|pair| pair.0).collect();
    let errors = at.iter().zip(oracle(pairs, &at)).flat_map(|(p, truth)| {
        let found = map.apply(*p);
        [(found.x, truth[0].clone()), (found.y, truth[1].clone())]
    });
    errors.map(|(found, truth)| rounded(&(exact(found) - truth)).abs()).fold(0.0, f64::max)
}

#[test]
fn the_quadratic_map_agrees_with_256_bits() {
    let found = [6, 7, 30, 400].map(|count| largest(&pairs(count, DVec2::ZERO, bent)));
    largest_error(found.into_iter().fold(0.0, f64::max), 1e-12, "px");
}

/// In raw pixels the normal equations would square 1e12, and have no digit left.
#[test]
fn a_quadratic_map_a_million_pixels_away_is_fitted_as_well_as_one_here() {
    let far = DVec2::new(1e6, -1e6);
    let there = Quadratic::fit(&pairs(100, far, bent)).expect("a fit");
    let here = Quadratic::fit(&pairs(100, DVec2::ZERO, bent)).expect("a fit");
    assert!((there.condition() / here.condition() - 1.0).abs() < 1e-9);
    assert!((there.residual().rms_px / here.residual().rms_px - 1.0).abs() < 1e-6);
    largest_error(largest(&pairs(100, far, bent)), 2e-10, "px at 1e6 px");
}

#[test]
fn collinear_few_and_doubled_points_are_refused_with_their_condition() {
    let fit = |points: &[DVec2]| Quadratic::fit(&points.iter().map(|p| (*p, bent(*p))).collect::<Vec<_>>());
    for count in 0..6 {
        let points: Vec<DVec2> = pairs(count, DVec2::ZERO, bent).iter().map(|pair| pair.0).collect();
        assert_eq!(fit(&points), Err(FitError::FewPoints { found: count }));
    }
    let line: Vec<DVec2> = (0..60).map(|i| DVec2::new(f64::from(i), 3.0 * f64::from(i) + 5.0)).collect();
    let two_lines: Vec<DVec2> = line.iter().flat_map(|p| [*p, *p + DVec2::new(100.0, 0.0)]).collect();
    let five: Vec<DVec2> = pairs(5, DVec2::ZERO, bent).iter().map(|pair| pair.0).cycle().take(50).collect();
    let far_line: Vec<DVec2> = line.iter().map(|p| *p + DVec2::splat(1e6)).collect();
    for (name, points) in [("a line", line), ("two lines", two_lines), ("five places", five), ("far", far_line)] {
        match fit(&points) {
            Err(FitError::Degenerate { condition }) => {
                assert!(condition > 1e3 && format!("{}", fit(&points).unwrap_err()).contains("condition"), "{name}");
            }
            other => panic!("{name}: {other:?}"),
        }
    }
    // Nearly on a line: refused before the map is worth nothing.
    let nearly = |off: f64| -> Vec<DVec2> {
        (0..60).map(|i| DVec2::new(10.0 * f64::from(i), off * f64::from(i * 37 % 11))).collect()
    };
    assert!(matches!(fit(&nearly(1e-3)), Err(FitError::Degenerate { .. })));
    assert!(fit(&nearly(40.0)).is_ok_and(|map| (1.0..1e3).contains(&map.condition())));
}
