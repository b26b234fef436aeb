//! The true trajectory and what the sensors make of it.

use glam::DVec3;
use proptest::prelude::*;
use realitysim::geometry::{Euler, Isometry, Pose2, wrap_angle};
use realitysim::scene::{Imu, Odometry, START_STAMP_NS, Scene, SceneEventKind};

use super::common::{DEMO, LOOP, STRAIGHT, plain, scene, with_effects};

fn odometry(scene: &Scene) -> Vec<(f64, Odometry)> {
    let pick = |event: realitysim::scene::SceneEvent| match event.kind {
        SceneEventKind::Odometry(odometry) => Some((seconds(event.stamp_ns), odometry)),
        _ => None,
    };
    scene.events().filter_map(pick).collect()
}

fn imu(scene: &Scene) -> Vec<(f64, Imu)> {
    let pick = |event: realitysim::scene::SceneEvent| match event.kind {
        SceneEventKind::Imu(imu) => Some((seconds(event.stamp_ns), imu)),
        _ => None,
    };
    scene.events().filter_map(pick).collect()
}

fn seconds(stamp_ns: i64) -> f64 {
    (stamp_ns - START_STAMP_NS) as f64 / 1e9
}

#[test]
fn the_straight_walk_is_the_paper_s() {
    let scene = scene(STRAIGHT);
    assert!((scene.duration_s() - 5.8 / 0.25).abs() < 1e-9);
    assert_eq!(scene.frame_count(), 233);
    let [start, end] = [0.0, 100.0].map(|time| scene.truth(time).map_from_base_footprint);
    assert!(start.distance(&Pose2::new(-2.9, 0.1, 0.0)) < 1e-12);
    assert!(end.distance(&Pose2::new(2.9, 0.1, 0.0)) < 1e-9 && end.yaw == 0.0);
    // It starts and ends upright.
    let upright = scene.mount().base_footprint_from_base_link;
    assert!((scene.truth(0.0).map_from_base_link.translation.z - upright.translation.z).abs() < 1e-12);
}

#[test]
fn the_route_turns_no_faster_than_stated_and_never_jumps() {
    for (toml, turn_deg_s, speed) in [(LOOP, 35.0, 0.25), (DEMO, 20.0, 0.28)] {
        let scene = scene(toml);
        let step = 0.01;
        let mut before = scene.truth(0.0).map_from_base_footprint;
        for index in 1..(scene.duration_s() / step) as usize {
            let now = scene.truth(index as f64 * step).map_from_base_footprint;
            assert!(before.distance(&now) < speed * step * (1.0 + 1e-9));
            assert!(wrap_angle(now.yaw - before.yaw).abs() < f64::to_radians(turn_deg_s) * step * (1.0 + 1e-9));
            before = now;
        }
    }
}

#[test]
fn rates_and_accelerations_are_those_of_the_trajectory() {
    let scene = scene(LOOP);
    let h = 1e-3;
    for index in 20..400 {
        let time = f64::from(index) * 0.1137;
        let [before, now, after] = [-h, 0.0, h].map(|step| scene.truth(time + step));
        // Where a straight piece ends, a difference sees half of the bend.
        if before.twist != after.twist || time > scene.duration_s() - 0.1 {
            continue;
        }
        let turned = before.map_from_base_link.rotation.conjugate() * after.map_from_base_link.rotation;
        let rate = turned.xyz() * 2.0 / (2.0 * h);
        assert!((rate - now.angular_velocity).length() < 1e-4, "{time} {rate} {}", now.angular_velocity);
        let [p0, p1, p2] = [before, now, after].map(|truth| truth.map_from_base_link.translation);
        let in_map = (p2 - 2.0 * p1 + p0) / (h * h) + DVec3::new(0.0, 0.0, 9.80665);
        let felt = now.map_from_base_link.inverse().transform_vector(in_map);
        assert!((felt - now.linear_acceleration).length() < 1e-3, "{time} {felt} {}", now.linear_acceleration);
    }
}

#[test]
fn camera_is_mounted_as_stated() {
    let scene = scene(&plain(STRAIGHT));
    let mount = scene.mount();
    let truth = scene.truth(3.0);
    let chain = truth.map_from_base_footprint.to_isometry()
        * mount.base_footprint_from_base_link
        * mount.base_link_from_camera_link;
    assert!((chain.translation - truth.map_from_camera_link.translation).length() < 1e-12);
    assert!((chain.translation.z - 0.49).abs() < 1e-12);
    let Euler { yaw, pitch, roll } = truth.map_from_camera_link.euler();
    assert!(yaw.abs() < 1e-12 && roll.abs() < 1e-12 && (pitch - 17f64.to_radians()).abs() < 1e-12);
    assert_eq!(mount.camera_link_from_camera_optical_frame, Isometry::link_from_optical());
}

#[test]
fn events_come_in_order_and_at_their_rates() {
    let scene = scene(STRAIGHT);
    let (mut last, mut counts) = (START_STAMP_NS, [0; 5]);
    for (position, event) in scene.events().enumerate() {
        assert!(event.stamp_ns >= last);
        last = event.stamp_ns;
        let which = match event.kind {
            SceneEventKind::InitialPose(estimate) => {
                let error = Pose2::new(-0.06, 0.053, 2f64.to_radians());
                let expected = Pose2::new(-2.9 + error.x, 0.1 + error.y, error.yaw);
                assert!(estimate.map_from_base_footprint.distance(&expected) < 1e-12);
                assert_eq!(position, 0);
                0
            }
            SceneEventKind::Odometry(_) => 1,
            SceneEventKind::Imu(_) => 2,
            SceneEventKind::Frame { index, map_from_camera_link } => {
                assert_eq!(event.stamp_ns, START_STAMP_NS + 100_000_000 * index as i64);
                let truth = scene.truth(scene.frame_time_s(index));
                assert_eq!(map_from_camera_link, truth.map_from_camera_link);
                3
            }
            SceneEventKind::Joints(_) => 4,
        };
        counts[which] += 1;
    }
    assert_eq!(counts, [1, 1161, 2321, 233, 0]);
}

#[test]
fn without_errors_the_sensors_tell_the_truth() {
    let scene = scene(&plain(LOOP));
    let start = scene.truth(0.0).map_from_base_footprint;
    for (time, odometry) in odometry(&scene) {
        let truth = scene.truth(time);
        let told = start.compose(&odometry.odom_from_base_footprint);
        assert!(told.distance(&truth.map_from_base_footprint) < 1e-9);
        assert!(wrap_angle(told.yaw - truth.map_from_base_footprint.yaw).abs() < 1e-9);
        assert_eq!(odometry.twist, truth.twist);
    }
    for (time, imu) in imu(&scene) {
        let truth = scene.truth(time);
        let told = Isometry::new(imu.orientation, DVec3::ZERO).euler();
        assert!(told.roll.abs() < 1e-12 && told.pitch.abs() < 1e-12);
        assert!(wrap_angle(told.yaw + start.yaw - truth.map_from_base_footprint.yaw).abs() < 1e-9);
        assert_eq!(imu.angular_velocity, truth.angular_velocity);
    }
}

#[test]
fn sensor_errors_have_their_stated_size() {
    let scene = scene(&STRAIGHT.replace("yaw_drift_deg_per_m = 0.0", "yaw_drift_deg_per_m = 1.0"));
    let odometry = odometry(&scene);
    let (_, last) = odometry.last().expect("some");
    assert!((last.odom_from_base_footprint.yaw - f64::to_radians(5.8)).abs() < 0.01);
    let way = last.odom_from_base_footprint;
    assert!((libm::hypot(way.x, way.y) / (5.8 * 1.06) - 1.0).abs() < 0.01, "{way:?}");
    let imu = imu(&scene);
    let n = imu.len() as f64;
    let errors: Vec<f64> = imu
        .iter()
        .map(|(time, imu)| {
            let told = Isometry::new(imu.orientation, DVec3::ZERO).euler();
            (told.roll - scene.truth(*time).map_from_base_link.euler().roll).to_degrees()
        })
        .collect();
    let mean = errors.iter().sum::<f64>() / n;
    let deviation = (errors.iter().map(|e| (e - mean) * (e - mean)).sum::<f64>() / n).sqrt();
    assert!((mean - 0.5).abs() < 0.03 && (deviation - 0.25).abs() < 0.02, "{mean} {deviation}");
}

#[test]
fn a_robot_that_is_carried_measures_no_way() {
    let toml = STRAIGHT.replace(
        "kind = \"walk\"\nwaypoints = [[-2.9, 0.1], [2.9, 0.1]]\nspeed_m_s = 0.25\nturn_deg_s = 30.0",
        "kind = \"still\"\nposes = [[0.0, 0.0, 0.0], [1.0, 0.5, 90.0], [-1.0, 0.5, 180.0]]\nhold_s = 2.0",
    );
    let scene = scene(&with_effects(&plain(&toml), &[]));
    assert_eq!(scene.duration_s(), 6.0);
    assert!(scene.truth(2.5).map_from_base_footprint.distance(&Pose2::new(1.0, 0.5, 0.0)) < 1e-12);
    assert!(odometry(&scene).iter().all(|(_, odometry)| odometry.odom_from_base_footprint == Pose2::default()));
}

#[test]
fn a_walk_that_stands_arrives_at_each_waypoint_and_does_not_sway_there() {
    let toml = STRAIGHT.replace("turn_deg_s = 30.0", "turn_deg_s = 30.0\nstand_s = 2.0");
    let toml = toml.replace("[[-2.9, 0.1], [2.9, 0.1]]", "[[-2.9, 0.1], [0.0, 0.1], [0.0, 1.0]]");
    let scene = scene(&toml);
    let stands = scene.stands();
    assert_eq!(stands.len(), 2);
    for ((from_s, until_s, pose), (at, yaw_deg)) in stands.iter().zip([([0.0, 0.1], 0.0), ([0.0, 1.0], 90.0f64)]) {
        assert!(pose.distance(&Pose2::new(at[0], at[1], 0.0)) < 1e-9 && (pose.yaw.to_degrees() - yaw_deg).abs() < 1e-9);
        assert!((until_s - from_s - 2.0).abs() < 1e-9);
        let [begin, end] = [from_s, until_s].map(|time| scene.truth(*time).map_from_base_link);
        assert_eq!(begin.translation.distance(end.translation), 0.0, "{begin:?} {end:?}");
    }
}

proptest! {
    #[test]
    fn any_route_ends_at_its_last_waypoint(
        points in proptest::collection::vec([-3.0..3.0f64, -2.0..2.0f64], 2..7),
        speed in 0.1..1.0f64,
        turn in 10.0..200.0f64,
        yaw in -180.0..180.0f64,
    ) {
        let apart = |pair: &[[f64; 2]]| (pair[0][0] - pair[1][0]).abs() + (pair[0][1] - pair[1][1]).abs() > 0.05;
        prop_assume!(points.windows(2).all(apart));
        let route = format!("waypoints = {points:?}\nspeed_m_s = {speed}\nturn_deg_s = {turn}\nstart_yaw_deg = {yaw}");
        let toml = plain(STRAIGHT)
            .replace("waypoints = [[-2.9, 0.1], [2.9, 0.1]]\nspeed_m_s = 0.25\nturn_deg_s = 30.0", &route);
        let scene = scene(&toml);
        let [start, end] = [0.0, scene.duration_s()].map(|time| scene.truth(time).map_from_base_footprint);
        let (first, last) = (points[0], points[points.len() - 1]);
        prop_assert!(libm::hypot(start.x - first[0], start.y - first[1]) < 1e-9);
        prop_assert!(libm::hypot(end.x - last[0], end.y - last[1]) < 1e-6);
        prop_assert!(wrap_angle(start.yaw - yaw.to_radians()).abs() < 1e-9);
    }
}
