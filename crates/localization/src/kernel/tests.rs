use super::*;
use glam::DVec2;
use proptest::prelude::*;

/// All paths. One that this processor lacks falls back to the plain path.
const PATHS: [SimdPath; 4] = [SimdPath::Scalar, SimdPath::Sse2, SimdPath::Avx2, SimdPath::Neon];

fn random_table(seed: u32) -> GroundTable {
    let mut state = seed | 1;
    let levels: Vec<u8> = (0..SIDE * SIDE)
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            (state >> 24) as u8
        })
        .collect();
    GroundTable::from_levels(&levels, 0.02)
}

/// The same sum in f64, computed from the levels themselves.
fn oracle(table: &GroundTable, points: &[DVec2], pose: &Pose2) -> f64 {
    let (scale, offset) = table.to_cells();
    let zero = f64::from(table.readings().zero);
    let level = |u: i64, v: i64| {
        let inside = (0..SIDE as i64).contains(&u) && (0..SIDE as i64).contains(&v);
        if inside { f64::from(table.level(u as usize, v as usize)) } else { zero }
    };
    let robot_from_map = pose.inverse();
    points
        .iter()
        .map(|point| {
            let at = robot_from_map.compose(&Pose2::new(point.x, point.y, 0.0));
            let (u, v) = (at.x * scale + offset, at.y * scale + offset);
            let (fu, fv) = (u - u.floor(), v - v.floor());
            let (iu, iv) = (u.floor() as i64, v.floor() as i64);
            let upper = level(iu, iv) * (1.0 - fu) + level(iu + 1, iv) * fu;
            let lower = level(iu, iv + 1) * (1.0 - fu) + level(iu + 1, iv + 1) * fu;
            upper * (1.0 - fv) + lower * fv - zero
        })
        .sum()
}

proptest! {
    #[test]
    fn every_path_gives_the_same_bits_and_agrees_with_f64(
        seed in any::<u32>(),
        x in -7.0..7.0f64, y in -5.0..5.0f64, yaw in -3.2..3.2f64,
        points in proptest::collection::vec((-7.0..7.0f64, -4.5..4.5f64), 0..70),
    ) {
        let table = random_table(seed);
        let positions: Vec<DVec2> = points.into_iter().map(DVec2::from).collect();
        let points = Points::new(positions.iter().copied());
        let pose = Pose2::new(x, y, yaw);
        let plain = sum_levels(SimdPath::Scalar, &table, &points, &pose);
        for path in PATHS.into_iter().chain([available(SimdPath::Auto)]) {
            prop_assert_eq!(sum_levels(path, &table, &points, &pose).to_bits(), plain.to_bits());
        }
        #[cfg(target_arch = "x86_64")]
        if available(SimdPath::Auto) == SimdPath::Avx2 && let Some(placement) = Placement::new(&table, &points, &pose) {
            let groups = points.places.as_chunks::<LANES>().0;
            let expected = plain::sum(table.quads(), groups, placement);
            for look_up in [avx2::LookUp::Gather, avx2::LookUp::Loads] {
                // SAFETY: the processor has AVX2, and a table holds SIDE x SIDE words.
                let found = unsafe { avx2::sum(look_up, table.quads(), groups, placement) };
                prop_assert_eq!(found, expected, "{:?}", look_up);
            }
        }
        // A point lies within a 64th of a cell of its place; neighbouring random levels differ by up to 255.
        let exact = oracle(&table, &positions, &pose);
        prop_assert!((plain - exact).abs() <= 2.0 * 255.0 / 63.0 * positions.len() as f64, "{} {}", plain, exact);
    }
}

/// A point lies within a 64th of a cell of its place, and here neighbours differ by up to 255 levels; in a picture they
/// differ by a tenth of that. The log likelihood is this times points over some 570.
#[test]
fn the_kernel_in_whole_numbers_agrees_with_f64() {
    let mut largest = 0.0f64;
    for seed in 1..300u32 {
        let part = |k: u32| f64::from(seed.wrapping_mul(k) % 2001) / 1000.0 - 1.0;
        let table = random_table(seed);
        let positions: Vec<DVec2> =
            (1..=70).map(|i| DVec2::new(4.5 * part(7919 * i), 3.0 * part(104_729 * i))).collect();
        let pose = Pose2::new(3.0 * part(31), 2.0 * part(37), 3.1 * part(41));
        let found = sum_levels(available(SimdPath::Auto), &table, &Points::new(positions.iter().copied()), &pose);
        largest = largest.max((found - oracle(&table, &positions, &pose)).abs() / positions.len() as f64);
    }
    realitysim_test_support::measured::largest_error(largest, 0.3, "levels a point");
}

#[test]
fn a_pose_that_is_not_finite_reads_neutral() {
    let table = random_table(5);
    let points = Points::new([DVec2::ZERO, DVec2::ONE]);
    for pose in [Pose2::new(f64::NAN, 0.0, 0.0), Pose2::new(0.0, f64::INFINITY, 1.0), Pose2::new(0.0, 0.0, f64::NAN)] {
        for path in PATHS {
            assert_eq!(sum_levels(path, &table, &points, &pose), 0.0);
        }
    }
}

/// Covers the largest sums, more points than one 32-bit sum takes, and a rest that fills no group.
#[test]
fn many_points_on_the_brightest_table_do_not_overflow() {
    let table = GroundTable::from_levels(&[255; SIDE * SIDE], 0.02);
    for count in [1, LANES - 1, LANES + 3, POINTS_PER_SUM, 3 * POINTS_PER_SUM + 5] {
        let points = Points::new((0..count).map(|i| DVec2::new((i % 100) as f64 * 0.01, (i / 100) as f64 * 0.001)));
        for path in PATHS {
            let sum = sum_levels(path, &table, &points, &Pose2::default());
            assert_eq!(sum, count as f64 * (255.0 - f64::from(table.readings().zero)), "{path:?}, {count} points");
        }
    }
}

/// The coordinates of a far-away pose must not wrap around 32 bits back onto the table.
#[test]
fn far_away_nothing_is_read() {
    let table = GroundTable::from_levels(&[255; SIDE * SIDE], 0.02);
    let points = Points::new([DVec2::new(-4.5, -3.0), DVec2::new(4.5, 3.0), DVec2::ZERO]);
    for step in 1..4000 {
        let far = 12.0 + f64::from(step) * 0.37;
        for (x, y) in [(far, 0.0), (-far, 0.0), (0.0, far), (0.0, -far), (far, far), (far * 1e7, -far)] {
            let pose = Pose2::new(x, y, f64::from(step));
            assert_eq!(sum_levels(SimdPath::Scalar, &table, &points, &pose), 0.0, "{pose:?}");
        }
    }
}
