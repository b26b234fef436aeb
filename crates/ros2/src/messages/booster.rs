//! Messages of `booster_interface`, which robots of Booster Robotics send: `/odometer_state` and `/low_state`.
//!
//! None of them has a stamp. The definitions are those of `booster_ros2_interface/msg` in the repository
//! BoosterRobotics/booster_robotics_sdk_ros2, and the same in `src/interface` of BoosterRobotics/robocup_demo.

use serde::Serialize;

use super::message;
use crate::cdr::wire_struct;

wire_struct! {
    /// `booster_interface/Odometer`: pose of the robot on the ground as it counts its steps, since it was switched on.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
    pub struct Odometer {
        /// Forwards, metres.
        pub x: f32,
        /// To the left, metres.
        pub y: f32,
        /// Heading, radians.
        pub theta: f32,
    }
}

wire_struct! {
    /// `booster_interface/ImuState`: what the inertial sensor of the torso measures, and the attitude made of it.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
    pub struct ImuState {
        /// Roll, pitch and yaw of the torso, radians.
        pub rpy: [f32; 3],
        /// Angular velocity about the torso's axes, radians per second.
        pub gyro: [f32; 3],
        /// Acceleration with gravity along the torso's axes, metres per second squared.
        pub acc: [f32; 3],
    }
}

wire_struct! {
    /// `booster_interface/MotorState`: the state of one joint.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
    pub struct MotorState {
        /// Mode of control.
        pub mode: i8,
        /// Angle, radians.
        pub q: f32,
        /// Angular velocity, radians per second.
        pub dq: f32,
        /// Angular acceleration, radians per second squared.
        pub ddq: f32,
        /// Estimated torque, newton metres.
        pub tau_est: f32,
        /// Temperature, degrees Celsius.
        pub temperature: i8,
        /// Number of packets lost.
        pub lost: u32,
        /// Flags of errors, and rate of communication in hertz.
        pub reserve: [u32; 2],
    }
}

wire_struct! {
    /// `booster_interface/LowState`: the state of sensors and joints.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct LowState {
        /// The inertial sensor of the torso.
        pub imu_state: ImuState,
        /// Motors of joints with parallel drives, one a motor.
        pub motor_state_parallel: Vec<MotorState>,
        /// Joints, one a joint: the first turns the head about the vertical, the second tilts it.
        pub motor_state_serial: Vec<MotorState>,
    }
}

message!(Odometer is "booster_interface" / "Odometer");
message!(LowState is "booster_interface" / "LowState",
    needs "booster_interface/ImuState", needs "booster_interface/MotorState");
