use super::*;
use proptest::prelude::*;

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

/// The same sum in f64, straight from the levels.
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
        for path in [SimdPath::Sse2, SimdPath::Avx2, available(SimdPath::Auto)] {
            prop_assert_eq!(sum_levels(path, &table, &points, &pose).to_bits(), plain.to_bits());
        }
        // f32 places a point to about 1e-4 cells; neighbouring random levels differ by up to 255.
        let exact = oracle(&table, &positions, &pose);
        prop_assert!((plain - exact).abs() < 0.1 * (1.0 + positions.len() as f64), "{} {}", plain, exact);
    }
}

/// f32 places a point to about 1e-4 cells, where neighbours may differ by all 255 levels. The log likelihood is this times
/// points over some 570.
#[test]
fn the_f32_kernel_agrees_with_f64() {
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
    crate::measured::largest_error(largest, 6e-4, "levels a point");
}

#[test]
fn a_pose_that_is_no_number_reads_neutral() {
    let table = random_table(5);
    let points = Points::new([DVec2::ZERO, DVec2::ONE]);
    for pose in [Pose2::new(f64::NAN, 0.0, 0.0), Pose2::new(0.0, f64::INFINITY, 1.0), Pose2::new(0.0, 0.0, f64::NAN)] {
        for path in [SimdPath::Scalar, SimdPath::Sse2, SimdPath::Avx2] {
            assert_eq!(sum_levels(path, &table, &points, &pose), 0.0);
        }
    }
}
