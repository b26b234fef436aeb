//! What the robot is told and is not so: odometry that fails, an IMU upside down, a calibration that is off.

use glam::DVec3;
use realitysim::geometry::{LensParameters, wrap_angle};
use realitysim::scene::{Imu, Odometry, Renderer, START_STAMP_NS, Scene, SceneEventKind};

use super::common::straight_with as build;

const ODOMETRY: &str = "kind = \"odometry_error\"\nscale_percent = 10\nyaw_drift_deg_per_m = 1.0\nnoise_m_per_m = 0.1";

fn odometry(extra: &str) -> Vec<(f64, Odometry)> {
    let pick = |event: realitysim::scene::SceneEvent| match event.kind {
        SceneEventKind::Odometry(odometry) => Some(((event.stamp_ns - START_STAMP_NS) as f64 / 1e9, odometry)),
        _ => None,
    };
    build(&[&format!("{ODOMETRY}\n{extra}")]).events().filter_map(pick).collect()
}

fn imu(scene: &Scene) -> Vec<Imu> {
    let pick = |event: realitysim::scene::SceneEvent| match event.kind {
        SceneEventKind::Imu(imu) => Some(imu),
        _ => None,
    };
    scene.events().filter_map(pick).collect()
}

#[test]
fn frozen_odometry_repeats_itself_and_loses_the_way() {
    let (free, frozen) = (odometry(""), odometry("freeze = { from_s = 5.0, for_s = 2.0 }"));
    let at = |list: &[(f64, Odometry)], time: f64| {
        list.iter().find(|(t, _)| (t - time).abs() < 1e-6).expect("a sample").1.odom_from_base_footprint
    };
    for (a, b) in free.iter().zip(&frozen).take_while(|((time, _), _)| *time < 5.0) {
        assert_eq!(a, b);
    }
    assert!(
        frozen
            .iter()
            .filter(|(t, _)| (5.0..7.0).contains(t))
            .all(|(_, odometry)| { odometry.odom_from_base_footprint == at(&frozen, 4.98) && odometry.twist.x == 0.0 })
    );
    // The steps after it are those that came without it.
    let [a, b] = [&free, &frozen].map(|list| at(list, 7.1).inverse().compose(&at(list, 15.0)));
    assert!(a.distance(&b) < 1e-9 && (a.yaw - b.yaw).abs() < 1e-9);
    let lost = at(&free, 15.0).x - at(&frozen, 15.0).x;
    assert!((lost - 2.0 * 0.25 * 1.1).abs() < 0.05, "{lost}");
}

#[test]
fn silent_odometry_counts_on() {
    let (free, silent) = (odometry(""), odometry("missing.from_s = 5.0\nmissing.for_s = 3.0"));
    let heard: Vec<_> = free.into_iter().filter(|(time, _)| !(5.0..8.0).contains(time)).collect();
    assert_eq!(heard, silent);
}

#[test]
fn odometry_jumps_once() {
    let (free, jumping) = (odometry(""), odometry("jump = { at_s = 5.0, x_m = 0.5, y_m = -0.2, yaw_deg = 30.0 }"));
    for (index, ((time, a), (_, b))) in free.iter().zip(&jumping).enumerate() {
        let [a, b] = [a, b].map(|odometry| odometry.odom_from_base_footprint);
        if *time < 5.0 {
            assert_eq!(a, b);
        } else if index % 50 == 0 {
            // The same step, from a place that has moved.
            let [from_a, from_b] = [&free, &jumping].map(|list| list[index - 1].1.odom_from_base_footprint);
            let [a, b] = [from_a.inverse().compose(&a), from_b.inverse().compose(&b)];
            let expected = if *time > 5.01 { 0.0 } else { f64::to_radians(30.0) };
            assert!((wrap_angle(b.yaw - a.yaw) - expected).abs() < 1e-9, "{time}");
        }
    }
}

#[test]
fn an_imu_upside_down_is_consistent_with_itself() {
    let error = "kind = \"imu_error\"\nroll_bias_deg = 0.5\npitch_bias_deg = 0.5\nnoise_deg = 0.25\n\
                 gyro_noise_deg_s = 0.3";
    let (right, wrong) = (build(&[error]), build(&[&format!("{error}\nmount_roll_deg = 180.0")]));
    for (right, wrong) in imu(&right).iter().zip(imu(&wrong)) {
        let up = |imu: &Imu| imu.orientation * imu.linear_acceleration;
        // Both say the same about the world ...
        assert!((up(right) - up(&wrong)).length() < 1e-9);
        assert!(
            (right.orientation * right.angular_velocity - wrong.orientation * wrong.angular_velocity).length() < 1e-9
        );
        // ... from axes of which y and z are turned round.
        let turned = |v: DVec3| DVec3::new(v.x, -v.y, -v.z);
        assert!((turned(right.angular_velocity) - wrong.angular_velocity).length() < 1e-9);
        assert!((wrong.orientation * DVec3::Z).z < -0.99);
    }
}

#[test]
fn a_wrong_calibration_is_only_announced() {
    let error = "kind = \"calibration_error\"\nfocal_percent = 0.6\ncentre_px = [1.5, -1.0]\nmount_pitch_deg = 1.0\n\
                 mount_roll_deg = -0.5\nheight_m = 0.015";
    let (right, wrong) = (build(&[]), build(&[error]));
    assert!(right.events().eq(wrong.events()));
    let image = |scene: &Scene| {
        let mut pixels = Vec::new();
        Renderer::new(scene).render(30, &mut pixels);
        pixels
    };
    assert_eq!(image(&right), image(&wrong));
    assert_eq!(right.announced_lens(), right.lens().parameters());
    assert_eq!(right.announced_mount(), right.mount());
    let (so, told) = (wrong.lens().parameters(), wrong.announced_lens());
    let LensParameters { fx, fy, cx, cy, .. } = so;
    assert_eq!(*told, LensParameters { fx: fx * 1.006, fy: fy * 1.006, cx: cx + 1.5, cy: cy - 1.0, ..so.clone() });
    let (so, told) = (wrong.mount(), wrong.announced_mount());
    let [a, b] = [&so, &told].map(|mount| mount.base_link_from_camera_link.euler());
    assert!((b.pitch - a.pitch - 1f64.to_radians()).abs() < 1e-9 && (b.roll + 0.5f64.to_radians()).abs() < 1e-9);
    let height = |mount: &realitysim::scene::Mount| mount.base_footprint_from_base_link.translation.z;
    assert!((height(&told) - height(&so) - 0.015).abs() < 1e-12);
}
