//! What moves the camera beside the route: the head, and somebody who carries the robot off.

use glam::DVec3;
use realitysim::geometry::{Euler, Isometry, Pose2, wrap_angle};
use realitysim::scene::{Joints, Odometry, START_STAMP_NS, Scene, SceneEventKind};

use super::common::{LOOP, plain, scene, straight_with as build, with_effects};

const HEAD: &str = "kind = \"head_motion\"\npan_amplitude_deg = 60\npan_period_s = 4\ntilt_amplitude_deg = 10\n\
                    tilt_period_s = 3";
const CARRIED: &str = "kind = \"kidnapping\"\nat_s = 10.0\nduration_s = 2.0\nto_m = [1.0, -1.0]\nto_yaw_deg = 90.0\n\
                       lift_m = 0.3";
const SWAY: &str = "kind = \"gait_sway\"\nroll_deg = 2.0\npitch_deg = 1.3\nlateral_m = 0.018\nvertical_m = 0.006\n\
                    step_hz = 2.4";

fn seconds(stamp_ns: i64) -> f64 {
    (stamp_ns - START_STAMP_NS) as f64 / 1e9
}

fn joints(scene: &Scene) -> Vec<(f64, Joints)> {
    let pick = |event: realitysim::scene::SceneEvent| match event.kind {
        SceneEventKind::Joints(joints) => Some((seconds(event.stamp_ns), joints)),
        _ => None,
    };
    scene.events().filter_map(pick).collect()
}

fn odometry(scene: &Scene) -> Vec<(f64, Odometry)> {
    let pick = |event: realitysim::scene::SceneEvent| match event.kind {
        SceneEventKind::Odometry(odometry) => Some((seconds(event.stamp_ns), odometry)),
        _ => None,
    };
    scene.events().filter_map(pick).collect()
}

#[test]
fn joints_and_mount_give_the_camera_s_true_place() {
    let scene = build(&[SWAY, HEAD]);
    let mount = scene.mount().base_link_from_camera_link;
    let told = joints(&scene);
    assert_eq!(told.len(), 2321, "at the IMU's rate");
    let (mut left, mut low) = (0f64, 0f64);
    for (time, Joints { pan, tilt }) in told {
        let truth = scene.truth(time);
        let [about_z, about_y] = [Euler { yaw: pan, ..Euler::default() }, Euler { pitch: tilt, ..Euler::default() }]
            .map(|euler| Isometry::from_euler(euler, DVec3::ZERO));
        let camera = about_z * Isometry::new(mount.rotation, DVec3::ZERO) * about_y;
        let expected = truth.map_from_base_link * Isometry::new(camera.rotation, mount.translation);
        assert!((expected.translation - truth.map_from_camera_link.translation).length() < 1e-12);
        assert!(expected.rotation.angle_between(truth.map_from_camera_link.rotation) < 1e-7);
        (left, low) = (left.max(pan), low.max(tilt));
    }
    assert!((left - 60f64.to_radians()).abs() < 1e-3 && (low - 10f64.to_radians()).abs() < 1e-3, "{left} {low}");
}

#[test]
fn a_head_that_moves_moves_nothing_else() {
    let (still, moving) = (build(&[SWAY]), build(&[SWAY, HEAD]));
    assert_eq!(still.mount(), moving.mount());
    for index in 0..100 {
        let [a, b] = [&still, &moving].map(|scene| scene.truth(f64::from(index) * 0.231));
        assert_eq!(a.map_from_base_link, b.map_from_base_link);
        assert_eq!(a.map_from_camera_link.translation, b.map_from_camera_link.translation);
    }
    let without = |scene: &Scene| {
        let body = |kind: &SceneEventKind| !matches!(kind, SceneEventKind::Joints(_) | SceneEventKind::Frame { .. });
        scene.events().filter(|event| body(&event.kind)).collect::<Vec<_>>()
    };
    assert_eq!(without(&still), without(&moving));
}

#[test]
fn encoders_are_as_noisy_as_stated() {
    let (exact, noisy) = (build(&[HEAD]), build(&[&format!("{HEAD}\nencoder_noise_deg = 0.3")]));
    let errors: Vec<f64> = joints(&exact)
        .into_iter()
        .zip(joints(&noisy))
        .flat_map(|((_, a), (_, b))| [(b.pan - a.pan).to_degrees(), (b.tilt - a.tilt).to_degrees()])
        .collect();
    let n = errors.len() as f64;
    let (mean, deviation) = (errors.iter().sum::<f64>() / n, (errors.iter().map(|e| e * e).sum::<f64>() / n).sqrt());
    assert!(mean.abs() < 0.02 && (deviation - 0.3).abs() < 0.015, "{mean} {deviation}");
    assert_eq!(exact.truth(7.0), noisy.truth(7.0));
}

#[test]
fn a_kidnapped_robot_goes_on_elsewhere_and_does_not_know() {
    let (free, taken) = (build(&[]), build(&[CARRIED]));
    assert!((taken.duration_s() - free.duration_s() - 2.0).abs() < 1e-12);
    let place = |scene: &Scene, time: f64| scene.truth(time).map_from_base_footprint;
    for time in [0.0, 3.0, 9.99] {
        assert_eq!(free.truth(time), taken.truth(time));
    }
    let target = Pose2::new(1.0, -1.0, f64::to_radians(90.0));
    for after in [0.0, 1.0, 5.0] {
        let walked = place(&free, 10.0).inverse().compose(&place(&free, 10.0 + after));
        let expected = target.compose(&walked);
        let found = place(&taken, 12.0 + after);
        assert!(found.distance(&expected) < 1e-9 && wrap_angle(found.yaw - expected.yaw).abs() < 1e-9, "{found:?}");
    }
    let high = taken.truth(11.0).map_from_base_link.translation.z - free.truth(0.0).map_from_base_link.translation.z;
    assert!((high - 0.3).abs() < 1e-9, "{high}");
    // What odometry tells stands still meanwhile, and then goes on.
    for (time, told) in odometry(&taken) {
        let on_route = if time < 10.0 { time } else { (time - 2.0).max(10.0) };
        let walked = place(&free, 0.0).inverse().compose(&place(&free, on_route));
        assert!(told.odom_from_base_footprint.distance(&walked) < 1e-9, "{time}");
    }
}

#[test]
fn the_gyro_feels_being_carried() {
    let scene = scene(&with_effects(&plain(LOOP), &[SWAY, CARRIED]));
    let h = 1e-3;
    for index in 0..60 {
        let time = 9.0 + f64::from(index) * 0.0713;
        let [before, now, after] = [-h, 0.0, h].map(|step| scene.truth(time + step));
        if [10.0, 12.0].iter().any(|border| (time - border).abs() < 0.01)
            || before.twist.x != after.twist.x && !(10.0..12.0).contains(&time)
        {
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
fn at_once_is_possible_too() {
    let taken = build(&["kind = \"kidnapping\"\nat_s = 10.0\nto_m = [-1.0, 1.0]\nto_yaw_deg = 0.0"]);
    let [before, after] = [9.999, 10.0].map(|time| taken.truth(time).map_from_base_footprint);
    assert!(before.distance(&Pose2::new(-0.4, 0.1, 0.0)) < 1e-3);
    assert!(after.distance(&Pose2::new(-1.0, 1.0, 0.0)) < 1e-9);
    assert_eq!(taken.duration_s(), build(&[]).duration_s());
}
