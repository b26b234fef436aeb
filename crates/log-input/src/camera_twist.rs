//! Computes how fast the camera moves while an image is taken, from gyro, feet and neck.

use glam::DVec3;

use super::transforms::CameraPlace;
use realitysim_geometry::{Isometry, Pose2, Twist};

/// The motions that move the camera.
#[derive(Clone, Copy, Debug)]
pub(super) struct RateSources {
    /// Turn rate of the torso about its own axes, radians per second.
    pub(super) torso_rate: DVec3,
    /// An earlier `base_from_optical`, and how many seconds ago it was.
    pub(super) neck: (Isometry, f64),
    /// The present pose of the feet in their earlier coordinate frame, and how many seconds ago that was.
    pub(super) feet: (Pose2, f64),
}

/// Largest speed of the feet, metres per second. Odometry that is faster has jumped, and counts as standing.
const FEET_SPEED_LIMIT_M_PER_S: f64 = 3.0;
/// Largest turn rate of a camera, radians per second. In a faster turn no image shows lines.
const TURN_RATE_LIMIT_RAD_PER_S: f64 = 15.0;

/// Computes the velocity of `camera_optical_frame` along its own axes; `None` if it is not finite or turns too fast.
pub(super) fn camera_twist(now: &CameraPlace, sources: &RateSources) -> Option<Twist> {
    let RateSources { torso_rate, neck: (neck, neck_s), feet: (feet, feet_s) } = *sources;
    let optical_from_base = now.base_from_optical.rotation.conjugate();
    let optical_from_footprint = now.footprint_from_optical.rotation.conjugate();
    let neck_moved = neck.inverse() * now.base_from_optical;
    let walking = DVec3::new(feet.x, feet.y, 0.0) / feet_s;
    let walking = if walking.length() <= FEET_SPEED_LIMIT_M_PER_S { walking } else { DVec3::ZERO };
    let twist = Twist {
        linear: optical_from_footprint * walking
            + optical_from_base * torso_rate.cross(now.base_from_optical.translation)
            + neck_moved.translation / neck_s,
        angular: optical_from_base * torso_rate + neck_moved.rotation.to_scaled_axis() / neck_s,
    };
    (twist.angular.length() <= TURN_RATE_LIMIT_RAD_PER_S && twist.linear.is_finite()).then_some(twist)
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec2};
    use proptest::prelude::*;

    use super::*;
    use realitysim_geometry::Euler;

    /// A robot that walks, sways, turns and looks around, each at a constant speed.
    #[derive(Clone, Copy, Debug)]
    struct Robot {
        walks: DVec2,
        rolls: DVec3,
        looks: [f64; 2],
        leans: Euler,
        pan_tilt: [f64; 2],
    }

    impl Robot {
        fn feet(&self, seconds: f64) -> Pose2 {
            Pose2::new(self.walks.x * seconds, self.walks.y * seconds, 0.0)
        }

        fn base_from_optical(&self, seconds: f64) -> Isometry {
            let [pan, tilt] = [0, 1].map(|joint| self.pan_tilt[joint] + self.looks[joint] * seconds);
            let head = Isometry::from_euler(Euler { yaw: pan, pitch: tilt, roll: 0.0 }, DVec3::new(0.05, 0.0, 0.15));
            let camera = Isometry::from_euler(Euler { yaw: 0.0, pitch: 0.3, roll: 0.05 }, DVec3::new(0.06, 0.01, 0.04));
            head * camera * Isometry::link_from_optical()
        }

        /// The torso turns about its own axes, and stands on the feet.
        fn footprint_from_base(&self, seconds: f64) -> Isometry {
            let turned = self.leans.rotation() * DQuat::from_scaled_axis(self.rolls * seconds);
            Isometry::new(turned, DVec3::new(0.0, 0.0, 0.38))
        }

        fn odom_from_optical(&self, seconds: f64) -> Isometry {
            self.feet(seconds).to_isometry() * self.footprint_from_base(seconds) * self.base_from_optical(seconds)
        }

        fn place(&self) -> CameraPlace {
            let footprint_from_optical = self.footprint_from_base(0.0) * self.base_from_optical(0.0);
            CameraPlace {
                footprint_from_link: footprint_from_optical * Isometry::link_from_optical().inverse(),
                footprint_from_optical,
                base_from_optical: self.base_from_optical(0.0),
                age_ns: 0,
                tilt_is_measured: true,
                lean_rad: None,
            }
        }

        fn twist(&self) -> Option<Twist> {
            let (neck_s, feet_s) = (1e-5, 0.1);
            let sources = RateSources {
                torso_rate: self.rolls,
                neck: (self.base_from_optical(-neck_s), neck_s),
                feet: (self.feet(-feet_s).inverse().compose(&self.feet(0.0)), feet_s),
            };
            camera_twist(&self.place(), &sources)
        }
    }

    fn robots() -> impl Strategy<Value = Robot> {
        let rate = || -1.5..1.5f64;
        let vector = || (rate(), rate(), rate());
        ((rate(), rate()), vector(), (rate(), rate()), (-0.3..0.3, -0.3..0.3), (-1.0..1.0, -0.5..0.5f64)).prop_map(
            |(walks, rolls, looks, (roll, pitch), pan_tilt)| Robot {
                walks: walks.into(),
                rolls: rolls.into(),
                looks: looks.into(),
                leans: Euler { yaw: 0.0, pitch, roll },
                pan_tilt: pan_tilt.into(),
            },
        )
    }

    proptest! {
        /// A resting point passes the camera as fast as differences of the kinematics say.
        #[test]
        fn places_pass_as_they_do_before_the_moving_camera(robot in robots(), at in (-2.0..2.0, -1.0..1.0, 0.3..3.0)) {
            let seconds = 1e-5;
            let place = DVec3::from(at);
            let in_odom = robot.odom_from_optical(0.0).transform_point(place);
            let then = |seconds| robot.odom_from_optical(seconds).inverse().transform_point(in_odom);
            let wanted = (then(seconds) - then(-seconds)) / (2.0 * seconds);
            let twist = robot.twist().expect("possible");
            let off = (twist.passing(place) - wanted).length();
            prop_assert!(off < 1e-4 * (1.0 + wanted.length()), "{off}: {twist:?}, {wanted}");
            let carried = twist.carries(&robot.odom_from_optical(0.0), seconds).translation;
            prop_assert!(carried.distance(robot.odom_from_optical(seconds).translation) < 1e-8);
        }
    }

    #[test]
    fn what_cannot_be_is_no_movement() {
        let robot = Robot {
            walks: DVec2::new(0.2, 0.0),
            rolls: DVec3::new(0.1, 0.0, 0.0),
            looks: [0.0; 2],
            leans: Euler { yaw: 0.0, pitch: 0.0, roll: 0.0 },
            pan_tilt: [0.0; 2],
        };
        let still = Robot { walks: DVec2::ZERO, ..robot }.twist();
        assert_eq!(Robot { walks: DVec2::X * 400.0, ..robot }.twist(), still, "odometry that jumped is no walk");
        for wrong in [DVec3::NAN, DVec3::INFINITY, DVec3::X * 40.0] {
            assert_eq!(Robot { rolls: wrong, ..robot }.twist(), None, "{wrong}");
        }
        assert_eq!(Robot { looks: [40.0, 0.0], ..robot }.twist(), None, "an encoder that jumped");
    }
}
