//! Tests of the decoder's laws, and of the axes against rotations of plain vectors.

use ::mavlink::dialects::common::*;
use ::mavlink::{MAVLinkV2MessageRaw, MavHeader};
use glam::{DQuat, DVec3};
use proptest::prelude::*;

use super::framing::Framer;
use super::*;

/// A device that sends a stream of messages.
#[derive(Default)]
struct Device {
    sequence: u8,
}

impl Device {
    fn frame(&mut self, message: &MavMessage) -> Vec<u8> {
        let header = MavHeader { system_id: 1, component_id: 1, sequence: self.sequence };
        self.sequence = self.sequence.wrapping_add(1);
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.serialize_message(header, message);
        raw.raw_bytes().to_vec()
    }
}

fn imu(index: u32) -> MavMessage {
    MavMessage::HIGHRES_IMU(HIGHRES_IMU_DATA {
        time_usec: 1_000_000 + u64::from(index) * 10_000,
        xacc: index as f32,
        zacc: -9.81,
        fields_updated: HighresImuUpdatedFlags::from_bits_truncate(63),
        ..HIGHRES_IMU_DATA::DEFAULT
    })
}

fn odometry(frame_id: MavFrame, child_frame_id: MavFrame) -> ODOMETRY_DATA {
    let mut odometry = ODOMETRY_DATA { time_usec: 1_000_000, frame_id, child_frame_id, ..ODOMETRY_DATA::DEFAULT };
    odometry.q = [1.0, 0.0, 0.0, 0.0];
    odometry
}

fn decoded(bytes: &[u8]) -> (Vec<Received>, PortCounts) {
    let (mut decoder, mut all) = (Decoder::default(), Vec::new());
    decoder.push(bytes, |received| all.push(received));
    (all, decoder.counts().clone())
}

fn one(message: &MavMessage) -> Result<Content, PortCounts> {
    let (mut all, counts) = decoded(&Device::default().frame(message));
    all.pop().map(|received| received.content).ok_or(counts)
}

/// Noise by SplitMix64, the same in every run.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
}

fn acceleration_x(received: &Received) -> usize {
    match &received.content {
        Content::Inertial(inertial) => inertial.acceleration.expect("sent").x as usize,
        other => panic!("nobody sent {other:?}"),
    }
}

#[test]
fn every_frame_that_was_not_hit_is_read_and_every_other_is_counted() {
    const FRAMES: usize = 4_000;
    for percent in 0..=10 {
        let (mut device, mut noise) = (Device::default(), Noise(7 + percent));
        let (mut stream, mut whole) = (Vec::new(), Vec::new());
        for index in 0..FRAMES {
            let mut frame = device.frame(&imu(index as u32));
            let mut hit = false;
            for byte in &mut frame {
                if noise.next() % 100 < percent {
                    // The new byte always differs from the old one.
                    *byte ^= 1 + (noise.next() % 255) as u8;
                    hit = true;
                }
            }
            if !hit {
                whole.push(index);
            }
            stream.extend(frame);
        }
        let (all, counts) = decoded(&stream);
        let read: Vec<usize> = all.iter().map(acceleration_x).collect();
        assert!(whole.iter().all(|index| read.contains(index)), "{percent} %");
        // One in 65 536 wrong frames has a right checksum.
        assert!(read.len() <= whole.len() + 2, "{percent} %: {} of {}", read.len(), whole.len());
        let (first, last) = (whole[0], whole[whole.len() - 1]);
        // If more than 255 messages in a row are lost, their number cannot be known. A frame whose type was hit may look like
        // one of an unknown type.
        if percent <= 3 {
            let (lost, missing) = (counts.lost as usize, last - first + 1 - whole.len());
            assert!(
                (lost..=lost + counts.frames.unknown as usize).contains(&missing),
                "{percent} %: {lost}, {missing}"
            );
        }
        assert_eq!(counts.frames.crc_failures > 0, percent > 0);
        assert_eq!(counts.frames.bytes_skipped > 0, percent > 0);
    }
}

#[test]
fn bytes_between_frames_are_skipped_and_counted() {
    let mut device = Device::default();
    let mut stream = b"boot: MCU v1.2\r\n".to_vec();
    stream.extend(device.frame(&imu(0)));
    stream.extend([0xfd, 0x00, 0x00]);
    stream.extend(device.frame(&imu(1)));
    let (all, counts) = decoded(&stream);
    assert_eq!(all.len(), 2);
    assert_eq!((counts.frames.bytes_skipped, counts.lost), (16 + 3, 0));
}

#[test]
fn messages_of_unknown_types_are_passed_over_without_a_loss() {
    let mut device = Device::default();
    let mut stream = device.frame(&imu(0));
    let mut private = device.frame(&imu(1));
    // The type becomes unknown; the checksum does not matter then.
    private[7..10].copy_from_slice(&[0x39, 0xa0, 0x00]);
    stream.extend(private);
    stream.extend(device.frame(&imu(2)));
    let (all, counts) = decoded(&stream);
    assert_eq!(all.len(), 2);
    assert_eq!((counts.frames.unknown, counts.lost, counts.frames.bytes_skipped), (1, 0, 0));
}

#[test]
fn losses_are_counted_per_sender() {
    let mut stream = Vec::new();
    for (component, sequences) in [(1, [0, 1, 4]), (2, [250, 0, 1])] {
        for sequence in sequences {
            let mut raw = MAVLinkV2MessageRaw::new();
            raw.serialize_message(MavHeader { system_id: 1, component_id: component, sequence }, &imu(0));
            stream.extend(raw.raw_bytes());
        }
    }
    let (all, counts) = decoded(&stream);
    assert_eq!((all.len(), counts.lost), (6, 2 + 5));
}

#[test]
fn what_cannot_be_used_says_why() {
    let said = |message: MavMessage| {
        let counts = one(&message).expect_err("unusable");
        let (reason, count) = counts.unusable.into_iter().next().expect("a reason");
        assert_eq!(count, 1);
        reason
    };
    let mut wrong = odometry(MavFrame::MAV_FRAME_GLOBAL, MavFrame::MAV_FRAME_BODY_FRD);
    assert!(said(MavMessage::ODOMETRY(wrong.clone())).contains("frame_id"));
    wrong.frame_id = MavFrame::MAV_FRAME_LOCAL_FLU;
    wrong.q = [0.0; 4];
    assert!(said(MavMessage::ODOMETRY(wrong.clone())).contains("length 1"));
    wrong.q = [1.0, f32::NAN, 0.0, 0.0];
    assert!(said(MavMessage::ODOMETRY(wrong.clone())).contains("finite"));
    wrong.time_usec = 0;
    assert!(said(MavMessage::ODOMETRY(wrong)).contains("time_usec"));
    for (flags, word) in [
        (GimbalDeviceFlags::GIMBAL_DEVICE_FLAGS_PITCH_LOCK, "PITCH_LOCK"),
        (GimbalDeviceFlags::GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME, "YAW_IN_EARTH_FRAME"),
        (GimbalDeviceFlags::GIMBAL_DEVICE_FLAGS_YAW_LOCK, "YAW_LOCK"),
    ] {
        let q = [1.0, 0.0, 0.0, 0.0];
        let gimbal = GIMBAL_DEVICE_ATTITUDE_STATUS_DATA { q, flags, ..GIMBAL_DEVICE_ATTITUDE_STATUS_DATA::DEFAULT };
        assert!(said(MavMessage::GIMBAL_DEVICE_ATTITUDE_STATUS(gimbal)).contains(word));
    }
}

#[test]
fn at_rest_gravity_points_up() {
    let Ok(Content::Inertial(inertial)) = one(&imu(0)) else { panic!("an IMU") };
    assert!((inertial.acceleration.expect("sent") - DVec3::new(0.0, 0.0, 9.81)).length() < 1e-6);
}

#[test]
fn the_head_pans_to_the_left_and_tilts_down() {
    // In FRD axes yaw is positive to the right and pitch is positive upwards.
    let q = DQuat::from_rotation_z(-0.5) * DQuat::from_rotation_y(-0.3);
    let gimbal = GIMBAL_DEVICE_ATTITUDE_STATUS_DATA {
        q: [q.w, q.x, q.y, q.z].map(|part| part as f32),
        flags: GimbalDeviceFlags::GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME,
        ..GIMBAL_DEVICE_ATTITUDE_STATUS_DATA::DEFAULT
    };
    let Ok(Content::Head(head)) = one(&MavMessage::GIMBAL_DEVICE_ATTITUDE_STATUS(gimbal)) else { panic!("a head") };
    assert!((head.pan - 0.5).abs() < 1e-6 && (head.tilt - 0.3).abs() < 1e-6, "{head:?}");
}

#[test]
fn a_reset_of_the_estimate_does_not_move_the_robot() {
    let mut device = Device::default();
    let mut stream = Vec::new();
    // The robot walks forward at 1 m/s. At the third message the estimate jumps and looks the other way.
    for (index, (x, y, q, resets)) in
        [(0.0, 0.0, 1.0, 0), (0.1, 0.0, 1.0, 0), (7.0, 5.0, 0.0, 1), (6.9, 5.0, 0.0, 1)].into_iter().enumerate()
    {
        let mut odometry = odometry(MavFrame::MAV_FRAME_LOCAL_FLU, MavFrame::MAV_FRAME_LOCAL_FLU);
        odometry.time_usec += index as u64 * 100_000;
        (odometry.x, odometry.y, odometry.vx, odometry.reset_counter) = (x, y, 1.0, resets);
        odometry.q = [q, 0.0, 0.0, 1.0 - q];
        stream.extend(device.frame(&MavMessage::ODOMETRY(odometry)));
    }
    let (all, counts) = decoded(&stream);
    assert_eq!(counts.resets, 1);
    for (index, received) in all.iter().enumerate() {
        let Content::Odometry(step) = &received.content else { panic!("odometry") };
        let expected = DVec3::new(0.1 * index as f64, 0.0, 0.0);
        assert!((step.odom_from_body.translation - expected).length() < 1e-6, "{index}: {step:?}");
        assert!(step.odom_from_body.euler().yaw.abs() < 1e-6, "{index}");
    }
}

/// The counter of resets does not tell a restart: it is 0 at every start.
#[test]
fn a_device_that_starts_anew_does_not_move_the_robot() {
    let mut device = Device::default();
    let mut stream = Vec::new();
    for (time_usec, x) in [(60_000_000, 3.0), (60_100_000, 3.1), (2_000_000, 0.0), (2_100_000, 0.1), (2_050_000, 0.05)]
    {
        let mut odometry = odometry(MavFrame::MAV_FRAME_LOCAL_FLU, MavFrame::MAV_FRAME_LOCAL_FLU);
        (odometry.time_usec, odometry.x) = (time_usec, x);
        stream.extend(device.frame(&MavMessage::ODOMETRY(odometry)));
    }
    let (all, counts) = decoded(&stream);
    assert_eq!(counts.resets, 1, "what comes a little out of order is no start");
    for (received, expected) in all.iter().zip([3.0, 3.1, 3.1, 3.2, 3.15]) {
        let Content::Odometry(step) = &received.content else { panic!("odometry") };
        assert!((step.odom_from_body.translation.x - expected).abs() < 1e-6, "{expected}: {step:?}");
    }
}

#[test]
fn a_covariance_turns_with_its_axes() {
    // First a variance of x only, then of yaw only. The x of NED is the y of ENU.
    let mut odometry = odometry(MavFrame::MAV_FRAME_LOCAL_NED, MavFrame::MAV_FRAME_BODY_FRD);
    (odometry.pose_covariance[0], odometry.pose_covariance[1], odometry.pose_covariance[20]) = (4.0, 1.0, 9.0);
    let Ok(Content::Odometry(step)) = one(&MavMessage::ODOMETRY(odometry.clone())) else { panic!("odometry") };
    let at = |row: usize, column: usize| step.pose_covariance[6 * row + column];
    assert_eq!((at(1, 1), at(0, 0), at(0, 1), at(1, 0), at(5, 5)), (4.0, 0.0, 1.0, 1.0, 9.0));
    odometry.pose_covariance[0] = f32::NAN;
    let Ok(Content::Odometry(step)) = one(&MavMessage::ODOMETRY(odometry)) else { panic!("odometry") };
    assert_eq!(step.pose_covariance, [0.0; 36]);
}

#[test]
fn what_is_sent_can_be_read_again() {
    let mut outgoing = Outgoing::new(1);
    let pose = realitysim_geometry::Isometry::new(DQuat::from_rotation_z(0.4), DVec3::new(1.5, -2.0, 0.5));
    let mut covariance = [0.0; 36];
    (covariance[0], covariance[7], covariance[35], covariance[1], covariance[6]) = (0.5, 0.25, 0.125, 0.0625, 0.0625);
    let stream = [
        outgoing.heartbeat(),
        outgoing.time_request(5),
        outgoing.time_reply(9, 7),
        outgoing.pose(3_000, &pose, &covariance),
    ];
    let (all, counts) = decoded(&stream.concat());
    assert_eq!((all.len(), counts.lost), (4, 0));
    assert_eq!(all[1].content, Content::TimeRequest { its_ns: 5 });
    assert_eq!(all[2].content, Content::TimeReply { base: TimeBase::Boot, device_ns: 9, sent_ns: 7 });
    let Content::Odometry(step) = &all[3].content else { panic!("odometry") };
    assert!((step.odom_from_body.translation - pose.translation).length() < 1e-6);
    assert_eq!(step.pose_covariance, covariance);
}

fn unit() -> impl Strategy<Value = DQuat> {
    prop::array::uniform4(-1.0..1.0f64)
        .prop_filter("not nothing", |q| q.iter().map(|x| x * x).sum::<f64>() > 0.01)
        .prop_map(|q| DQuat::from_array(q).normalize())
}

fn point() -> impl Strategy<Value = DVec3> {
    prop::array::uniform3(-5.0..5.0f64).prop_map(DVec3::from_array)
}

proptest! {
    /// The counts do not depend on how the bytes are cut into reads, whatever the bytes are.
    #[test]
    fn reads_of_any_size_count_the_same(
        parts in prop::collection::vec(prop_oneof![
            (0u32..1000).prop_map(Some),
            Just(None),
        ], 0..20),
        noise in prop::collection::vec(any::<u8>(), 0..300),
        cuts in prop::collection::vec(1usize..40, 1..50),
    ) {
        let mut device = Device::default();
        let mut stream = Vec::new();
        for part in parts {
            match part {
                Some(index) => stream.extend(device.frame(&imu(index))),
                None => stream.extend(&noise[..noise.len().min(37)]),
            }
        }
        stream.extend(&noise);
        let whole = decoded(&stream);
        let (mut decoder, mut all) = (Decoder::default(), Vec::new());
        let (mut rest, mut cuts) = (stream.as_slice(), cuts.iter().cycle());
        while !rest.is_empty() {
            let (now, later) = rest.split_at(rest.len().min(*cuts.next().expect("endless")));
            decoder.push(now, |received| all.push(received));
            rest = later;
        }
        prop_assert_eq!((all, decoder.counts().clone()), whole);
    }

    #[test]
    fn every_byte_is_part_of_a_frame_or_skipped_or_waiting(
        bytes in prop::collection::vec(prop_oneof![Just(0xfdu8), Just(0u8), any::<u8>()], 0..2000)
    ) {
        let (mut framer, mut in_frames) = (Framer::default(), 0);
        framer.push(&bytes, |frame| in_frames += frame.wire_bytes as u64);
        let before = framer.counts();
        framer.drop_unfinished();
        let waiting = framer.counts().bytes_skipped - before.bytes_skipped;
        prop_assert!(waiting < 300);
        prop_assert_eq!(in_frames + framer.counts().bytes_skipped, bytes.len() as u64);
    }

    /// A vector of the body has the same direction in the world before and after the conversion.
    #[test]
    fn attitudes_turn_vectors_as_before(ned_from_frd in unit(), ahead in point()) {
        let q = [ned_from_frd.w, ned_from_frd.x, ned_from_frd.y, ned_from_frd.z].map(|part| part as f32);
        let attitude = ATTITUDE_QUATERNION_DATA { q1: q[0], q2: q[1], q3: q[2], q4: q[3], ..ATTITUDE_QUATERNION_DATA::DEFAULT };
        let Ok(Content::Attitude(read)) = one(&MavMessage::ATTITUDE_QUATERNION(attitude)) else { panic!("an attitude") };
        let ned = ned_from_frd * ahead;
        let enu = read.world_from_body * DVec3::new(ahead.x, -ahead.y, -ahead.z);
        prop_assert!((enu - DVec3::new(ned.y, ned.x, -ned.z)).length() < 1e-5);
    }

    #[test]
    fn odometry_of_every_frame_is_the_same_walk(local_from_body in unit(), at in point(), ahead in point(), v in point()) {
        let q = local_from_body;
        let f32s = |v: DVec3| v.to_array().map(|x| x as f32);
        for (frame_id, child_frame_id) in [
            (MavFrame::MAV_FRAME_LOCAL_NED, MavFrame::MAV_FRAME_BODY_FRD),
            (MavFrame::MAV_FRAME_LOCAL_FRD, MavFrame::MAV_FRAME_BODY_FRD),
            (MavFrame::MAV_FRAME_LOCAL_FLU, MavFrame::MAV_FRAME_BODY_FRD),
            (MavFrame::MAV_FRAME_LOCAL_FLU, MavFrame::MAV_FRAME_LOCAL_FLU),
        ] {
            let mut sent = odometry(frame_id, child_frame_id);
            [sent.x, sent.y, sent.z] = f32s(at);
            [sent.vx, sent.vy, sent.vz] = f32s(v);
            sent.q = [q.w, q.x, q.y, q.z].map(|part| part as f32);
            let Ok(Content::Odometry(step)) = one(&MavMessage::ODOMETRY(sent)) else { panic!("odometry") };
            let to_world = |v: DVec3| match frame_id {
                MavFrame::MAV_FRAME_LOCAL_NED => DVec3::new(v.y, v.x, -v.z),
                MavFrame::MAV_FRAME_LOCAL_FRD => DVec3::new(v.x, -v.y, -v.z),
                _ => v,
            };
            let to_body = |v: DVec3| match child_frame_id {
                MavFrame::MAV_FRAME_BODY_FRD => DVec3::new(v.x, -v.y, -v.z),
                _ => v,
            };
            prop_assert!((step.odom_from_body.transform_point(to_body(ahead)) - to_world(at + q * ahead)).length() < 1e-4);
            prop_assert!((step.velocity - to_body(v)).length() < 1e-5);
        }
    }
}

/// On a line whose TX and RX are joined, an echo must not look like a device.
#[test]
fn what_this_program_sent_itself_is_not_heard() {
    let own = Outgoing::name(1);
    let mut outgoing = Outgoing::new(own.system);
    let bytes = [outgoing.heartbeat(), outgoing.time_request(5), outgoing.time_reply(6, 5)].concat();
    let mut decoder = Decoder::beside(own);
    decoder.push(&bytes, |received| panic!("{received:?}"));
    let counts = decoder.counts();
    assert_eq!((counts.echoes, counts.frames.frames, counts.used.len(), counts.lost), (3, 3, 0, 0));
    let mut other = Decoder::beside(Outgoing::name(2));
    other.push(&bytes, |_| {});
    assert_eq!(other.counts().echoes, 0);
}
