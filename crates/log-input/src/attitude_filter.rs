//! Makes the torso's attitude of raw turn rates and accelerations, for sensors that state none.
//!
//! A complementary filter: turn rates are integrated, and where the accelerometer feels about one g, its direction pulls the
//! integrated vertical towards itself. Rates know fast motion and drift; gravity does not drift, and is hidden by every step of a
//! walk (Mahony, Hamel and Pflimlin, "Nonlinear complementary filters on the special orthogonal group", 2008).

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use realitysim_geometry::Physical;

/// Standard gravity, metres per second squared.
const GRAVITY_M_PER_S2: f64 = 9.80665;
/// Time after which a difference between the integrated vertical and gravity has faded to 1/e, seconds.
///
/// A longer one takes more of a gyro's drift, a shorter one more of what a step accelerates: by
/// `the_time_constant_is_the_best_of_its_neighbours`, with a gyro that has warmed by three kelvins since it was at rest.
const TIME_CONSTANT_S: f64 = 4.0;
/// Share of g by which the length of the acceleration may differ from g so that it counts as gravity.
const NEAR_GRAVITY_SHARE: f64 = 0.2;
/// Share of g by which it may differ while the robot stands quietly.
const QUIET_SHARE: f64 = 0.05;
/// Turn rate below which a robot stands quietly, radians per second. A gyro's bias is below it, and a gait's sway above.
const QUIET_RAD_PER_S: f64 = 0.1;
/// Time for which a robot must stand quietly before the attitude starts, nanoseconds.
const QUIET_NS: i64 = 1_000_000_000;
/// Smallest number of samples in that time, so that their mean is one.
const MIN_QUIET_SAMPLES: u32 = 20;
/// Longest time between two samples that is integrated over, nanoseconds. After a longer one the attitude starts anew.
const GAP_NS: i64 = 500_000_000;
/// Largest turn rate of any robot, radians per second: gyros measure up to 2000 degrees per second.
const MAX_RATE_RAD_PER_S: f64 = 35.0;
/// Standard deviation of roll and pitch that are made here, radians: 1 degree.
///
/// That is three times the error on a rendered walk (`the_time_constant_is_the_best_of_its_neighbours`), since feet that land hit
/// harder than a rendered gait.
pub const MADE_TILT_SIGMA_RAD: f64 = 0.0175;

/// The filter, with what it knows so far. It begins with a second in which the robot stands quietly.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AttitudeFilter {
    /// The quiet time so far, before there is an attitude.
    quiet: QuietTime,
    /// Attitude of the sensor against gravity, once there was a quiet second. Its yaw starts at zero and drifts.
    attitude: Option<DQuat>,
    /// Mean rate of the quiet second, which is the gyro's bias, radians per second.
    bias: DVec3,
    /// Stamp (ns) and rate (rad/s) of the last sample.
    last: Option<(i64, DVec3)>,
}

/// Sums over a time in which the robot stood.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct QuietTime {
    began_ns: i64,
    samples: u32,
    rates: DVec3,
    accelerations: DVec3,
}

impl AttitudeFilter {
    /// Takes a sample of both sensors along the axes of their housing, radians per second and metres per second squared.
    ///
    /// Returns the attitude at the sample's time: `None` before the first quiet second, and for a sample that is out of order or
    /// impossible.
    pub fn push(&mut self, stamp_ns: i64, rate: DVec3, acceleration: DVec3) -> Option<DQuat> {
        self.push_with(stamp_ns, rate, acceleration, TIME_CONSTANT_S)
    }

    /// [`Self::push`] with a time constant, seconds.
    fn push_with(&mut self, stamp_ns: i64, rate: DVec3, acceleration: DVec3, time_constant_s: f64) -> Option<DQuat> {
        let is_sensible = rate.is_possible() && acceleration.is_possible() && rate.length() <= MAX_RATE_RAD_PER_S;
        if !is_sensible {
            return None;
        }
        let Some((last_ns, last_rate)) = self.last else {
            self.last = Some((stamp_ns, rate));
            return self.wait_for_quiet(stamp_ns, rate, acceleration);
        };
        let step_ns = stamp_ns.saturating_sub(last_ns);
        if (-GAP_NS..=0).contains(&step_ns) {
            return None;
        }
        if !(0..=GAP_NS).contains(&step_ns) {
            *self = Self::default();
        }
        self.last = Some((stamp_ns, rate));
        let Some(before) = self.attitude else { return self.wait_for_quiet(stamp_ns, rate, acceleration) };
        let seconds = step_ns as f64 * 1e-9;
        let turned = before * DQuat::from_scaled_axis(((last_rate + rate) * 0.5 - self.bias) * seconds);
        let attitude = pulled_upright(turned, acceleration, seconds / time_constant_s).normalize();
        self.attitude = Some(attitude);
        Some(attitude)
    }

    /// Adds up samples of a robot that stands, and starts the attitude after a second of them.
    fn wait_for_quiet(&mut self, stamp_ns: i64, rate: DVec3, acceleration: DVec3) -> Option<DQuat> {
        let is_quiet = is_about_gravity(acceleration, QUIET_SHARE) && rate.length() <= QUIET_RAD_PER_S;
        if !is_quiet {
            self.quiet = QuietTime::default();
            return None;
        }
        let quiet = &mut self.quiet;
        if quiet.samples == 0 {
            quiet.began_ns = stamp_ns;
        }
        quiet.samples = quiet.samples.saturating_add(1);
        quiet.rates += rate;
        quiet.accelerations += acceleration;
        if stamp_ns.saturating_sub(quiet.began_ns) < QUIET_NS || quiet.samples < MIN_QUIET_SAMPLES {
            return None;
        }
        self.bias = quiet.rates / f64::from(quiet.samples);
        // At rest the acceleration points up: its direction in the housing is that of the world's z axis.
        self.attitude = Some(DQuat::from_rotation_arc(quiet.accelerations.normalize(), DVec3::Z));
        self.attitude
    }
}

/// Turns an attitude so that the acceleration points upwards, by the share of the difference that fades in so many time constants.
fn pulled_upright(attitude: DQuat, acceleration: DVec3, time_constants: f64) -> DQuat {
    if !is_about_gravity(acceleration, NEAR_GRAVITY_SHARE) {
        return attitude;
    }
    let towards_up = DQuat::from_rotation_arc((attitude * acceleration).normalize(), DVec3::Z);
    let share = 1.0 - libm::exp(-time_constants);
    DQuat::from_scaled_axis(towards_up.to_scaled_axis() * share) * attitude
}

/// Whether an acceleration is as long as gravity, but for a share of it.
fn is_about_gravity(acceleration: DVec3, share: f64) -> bool {
    (acceleration.length() - GRAVITY_M_PER_S2).abs() <= share * GRAVITY_M_PER_S2
}

impl Physical for AttitudeFilter {
    fn is_possible(&self) -> bool {
        let Self { quiet, attitude, bias, last } = self;
        [quiet.rates, quiet.accelerations, *bias].iter().all(Physical::is_possible)
            && attitude.is_possible()
            && last.is_none_or(|(_, rate)| rate.is_possible())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::scene_source::parse;
    use realitysim_geometry::Euler;
    use realitysim_scene::{START_STAMP_NS, SceneEventKind};

    const STEP_NS: i64 = 10_000_000;

    /// The angle between the vertical and where the attitude has it, radians.
    fn tilt_error(found: DQuat, truth: DQuat) -> f64 {
        let up = |attitude: DQuat| attitude.conjugate() * DVec3::Z;
        up(found).angle_between(up(truth))
    }

    /// Samples of a sensor that is tilted like this and stands still, with this bias.
    fn stand(filter: &mut AttitudeFilter, from_ns: i64, seconds: i64, truth: DQuat, bias: DVec3) -> Option<DQuat> {
        let gravity = truth.conjugate() * DVec3::Z * GRAVITY_M_PER_S2;
        (0..=seconds * 100).map(|i| filter.push(from_ns + i * STEP_NS, bias, gravity)).last().flatten()
    }

    #[test]
    fn a_quiet_second_gives_the_tilt_of_a_sensor_however_it_is_mounted() {
        for euler in [(0.0, 0.0), (0.1, -0.2), (3.1, 0.0), (1.5, 0.3), (0.0, -1.5)] {
            let truth = Euler { roll: euler.0, pitch: euler.1, yaw: 0.7 }.rotation();
            let found = stand(&mut AttitudeFilter::default(), 0, 1, truth, DVec3::splat(0.02)).expect("started");
            assert!(tilt_error(found, truth) < 1e-9, "{euler:?}");
        }
    }

    #[test]
    fn without_a_quiet_second_there_is_no_attitude() {
        let mut filter = AttitudeFilter::default();
        let gravity = DVec3::Z * GRAVITY_M_PER_S2;
        for i in 0..1000 {
            let rate = if i % 50 == 49 { DVec3::X * 0.3 } else { DVec3::ZERO };
            assert_eq!(filter.push(i * STEP_NS, rate, gravity), None);
        }
        let fell = (0..1000).map(|i| filter.push((1000 + i) * STEP_NS, DVec3::ZERO, DVec3::ZERO));
        assert!(fell.into_iter().all(|attitude| attitude.is_none()), "a sensor that measures no acceleration");
    }

    #[test]
    fn a_gyro_carries_the_tilt_through_accelerations_that_hide_gravity() {
        let mut filter = AttitudeFilter::default();
        let bias = DVec3::new(0.01, -0.02, 0.03);
        stand(&mut filter, 0, 1, DQuat::IDENTITY, bias).expect("started");
        // It rolls by half a radian in a second while something pushes at two g.
        let mut last = None;
        for i in 1..=100 {
            last = filter.push(1_000_000_000 + i * STEP_NS, DVec3::X * 0.5 + bias, DVec3::Y * 20.0);
        }
        let truth = DQuat::from_rotation_x(0.5);
        // The first interval is that in which the rate begins: half of it by the trapezoidal rule.
        assert!(tilt_error(last.expect("known"), truth) < 0.004);
    }

    #[test]
    fn a_wrong_tilt_fades_with_the_time_constant() {
        let mut filter = AttitudeFilter::default();
        stand(&mut filter, 0, 1, DQuat::IDENTITY, DVec3::ZERO).expect("started");
        let truth = DQuat::from_rotation_y(0.1);
        let gravity = truth.conjugate() * DVec3::Z * GRAVITY_M_PER_S2;
        let steps = (TIME_CONSTANT_S * 100.0) as i64;
        let found =
            (1..=steps).map(|i| filter.push(1_000_000_000 + i * STEP_NS, DVec3::ZERO, gravity)).last().flatten();
        let left = tilt_error(found.expect("known"), truth) / 0.1;
        assert!((left - libm::exp(-1.0)).abs() < 1e-3, "{left}");
    }

    #[test]
    fn after_a_gap_the_attitude_starts_anew() {
        let mut filter = AttitudeFilter::default();
        stand(&mut filter, 0, 1, DQuat::IDENTITY, DVec3::ZERO).expect("started");
        let gravity = DVec3::Z * GRAVITY_M_PER_S2;
        assert_eq!(filter.push(990_000_000, DVec3::ZERO, gravity), None, "out of order");
        assert!(filter.push(1_500_000_000, DVec3::ZERO, gravity).is_some(), "as long as can be");
        assert_eq!(filter.push(2_100_000_000, DVec3::ZERO, gravity), None, "a gap");
        let tilted = DQuat::from_rotation_x(0.3);
        let found = stand(&mut filter, 2_200_000_000, 1, tilted, DVec3::ZERO).expect("started again");
        assert!(tilt_error(found, tilted) < 0.01, "all of the quiet second but its first sample");
    }

    /// A walk of the rendered scenes with its gait, accelerations, and noise of the gyro; the IMU ticks at 100 Hz.
    const WALK: &str = r#"
        [scene]
        title = "Walk"
        task = "Measure an attitude that is made."
        seed = 7
        field = "kid-2009"
        initial_pose = "exact"
        [camera]
        lens = "fisheye-640"
        rate_hz = 1.0
        jpeg_quality = 90
        torso_height_m = 0.38
        mount_xyz_m = [0.04, 0.0, 0.11]
        mount_pitch_deg = 17.0
        [route]
        kind = "walk"
        waypoints = [[-3.0, 0.1], [2.0, 0.3], [2.0, -1.5], [-2.0, -1.5]]
        speed_m_s = 0.25
        turn_deg_s = 30.0
        [imu]
        rate_hz = 100.0
        [[effect]]
        kind = "gait_sway"
        role = "base"
        roll_deg = 2.0
        pitch_deg = 1.3
        lateral_m = 0.018
        vertical_m = 0.006
        step_hz = 2.4
        [[effect]]
        kind = "imu_error"
        role = "base"
        roll_bias_deg = 0.0
        pitch_bias_deg = 0.0
        noise_deg = 0.25
        gyro_noise_deg_s = 0.3
    "#;

    /// Root mean square of roll's and pitch's error together, radians, of a walk after a second in which the robot stands.
    fn tilt_error_of_a_walk(time_constant_s: f64) -> f64 {
        let scene = parse(WALK, "walk.toml").expect("a scene");
        let mut filter = AttitudeFilter::default();
        let (mut squares, mut count) = (0.0, 0.0);
        for event in scene.events() {
            let SceneEventKind::Imu(imu) = event.kind else { continue };
            let since_ns = event.stamp_ns - START_STAMP_NS;
            let truth = scene.truth(since_ns as f64 * 1e-9).map_from_base_link.rotation;
            if since_ns == 0 {
                stand(&mut filter, event.stamp_ns - 1_000_000_000 - STEP_NS, 1, truth, DVec3::splat(0.01));
            }
            // 0.015 degrees per second and kelvin (data sheet of the BMI088), warmed by three.
            let drift = DVec3::splat(0.045f64.to_radians());
            let rate = imu.angular_velocity + DVec3::splat(0.01) + drift;
            if let Some(made) = filter.push_with(event.stamp_ns, rate, imu.linear_acceleration, time_constant_s) {
                squares += tilt_error(made, truth) * tilt_error(made, truth);
                count += 1.0;
            }
        }
        assert!(count > 3000.0, "a walk of half a minute: {count}");
        libm::sqrt(squares / count)
    }

    #[test]
    fn the_time_constant_is_the_best_of_its_neighbours() {
        let error =
            [0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0].map(|seconds| (seconds, tilt_error_of_a_walk(seconds).to_degrees()));
        println!("time constant (s) and tilt error (degrees): {error:.2?}");
        let own = tilt_error_of_a_walk(TIME_CONSTANT_S);
        assert!(error.iter().all(|(_, error)| own.to_degrees() <= error * 1.2), "{own}");
        assert!(own * 3.0 < MADE_TILT_SIGMA_RAD, "{own}");
    }

    proptest! {
        #[test]
        fn no_samples_make_an_attitude_that_is_not_finite(
            samples in prop::collection::vec((any::<i64>(), prop::array::uniform6(any::<f64>())), 0..60),
            start in any::<i64>(),
        ) {
            let mut filter = AttitudeFilter::default();
            stand(&mut filter, start.clamp(i64::MIN / 2, i64::MAX / 2), 1, DQuat::IDENTITY, DVec3::ZERO);
            for (stamp_ns, [a, b, c, d, e, f]) in samples {
                let attitude = filter.push(stamp_ns, DVec3::new(a, b, c), DVec3::new(d, e, f));
                prop_assert!(attitude.is_none_or(|attitude| (attitude.length() - 1.0).abs() < 1e-9));
                prop_assert!(filter.is_possible());
            }
        }

        #[test]
        fn fast_and_slow_motion_alike_keep_the_attitude_of_length_one(
            samples in prop::collection::vec((1i64..500_000_000, prop::array::uniform6(-40.0f64..40.0)), 1..200),
        ) {
            let mut filter = AttitudeFilter::default();
            stand(&mut filter, 0, 1, DQuat::IDENTITY, DVec3::ZERO);
            let mut now_ns = 1_000_000_000;
            for (step_ns, [a, b, c, d, e, f]) in samples {
                now_ns += step_ns;
                if let Some(attitude) = filter.push(now_ns, DVec3::new(a, b, c), DVec3::new(d, e, f)) {
                    prop_assert!((attitude.length() - 1.0).abs() < 1e-9);
                }
            }
        }
    }
}
