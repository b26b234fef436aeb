use proptest::prelude::*;

use super::*;
use crate::cdr::{Sample, SampleSource};

/// Checks that encoding, decoding and encoding again gives the same bytes, and that no message cut short decodes.
fn round_trip<M: Message + Sample>(numbers: Vec<u64>) {
    let bytes = M::sample(&mut SampleSource::new(numbers)).encode();
    let decoded = M::decode(&bytes).unwrap();
    assert_eq!(decoded.encode(), bytes, "{}", M::TYPE);
    for cut in 0..bytes.len() {
        assert!(M::decode(&bytes[..cut]).is_err(), "{} cut to {cut} of {} bytes", M::TYPE, bytes.len());
    }
}

/// Checks that decoding arbitrary bytes neither panics nor makes a message much larger than they are.
fn decode_arbitrary_bytes<M: Message>(bytes: &[u8]) {
    if let Ok(message) = M::decode(bytes) {
        assert!(message.encode().len() <= bytes.len() * 8 + 64);
    }
}

macro_rules! for_each_message {
    ($function:ident($argument:expr)) => {
        $function::<CompressedImage>($argument);
        $function::<Image>($argument);
        $function::<CameraInfo>($argument);
        $function::<Imu>($argument);
        $function::<JointState>($argument);
        $function::<Odometry>($argument);
        $function::<PoseStamped>($argument);
        $function::<PoseWithCovarianceStamped>($argument);
        $function::<TwistStamped>($argument);
        $function::<TwistWithCovarianceStamped>($argument);
        $function::<Odometer>($argument);
        $function::<LowState>($argument);
        $function::<TransformStamped>($argument);
        $function::<TFMessage>($argument);
        $function::<DiagnosticArray>($argument);
        $function::<MarkerArray>($argument);
        $function::<ImageAnnotations>($argument);
        $function::<FrameTag>($argument);
    };
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn every_message_survives_the_round_trip(numbers in prop::collection::vec(any::<u64>(), 0..400)) {
        for_each_message!(round_trip(numbers.clone()));
    }

    #[test]
    fn no_bytes_make_a_decoder_panic(mut bytes in prop::collection::vec(any::<u8>(), 4..600), order in 0u8..2) {
        bytes[..4].copy_from_slice(&[0, order, 0, 0]);
        for_each_message!(decode_arbitrary_bytes(&bytes));
    }
}

#[test]
fn golden_header_of_a_compressed_image() {
    let image = CompressedImage {
        header: Header { stamp: Stamp { sec: 1, nanosec: 2 }, frame_id: "cam".into() },
        format: "jpeg".into(),
        data: vec![0xff, 0xd8],
    };
    let expected = [
        &[0, 1, 0, 0][..],
        &[1, 0, 0, 0, 2, 0, 0, 0],
        &[4, 0, 0, 0, b'c', b'a', b'm', 0],
        &[5, 0, 0, 0, b'j', b'p', b'e', b'g', 0, 0, 0, 0],
        &[2, 0, 0, 0, 0xff, 0xd8],
    ]
    .concat();
    assert_eq!(image.encode(), expected);
    let view = CompressedImageView::decode(&expected).unwrap();
    assert_eq!(view.to_message(), image);
    let mut buffer = vec![9];
    view.encode_into(&mut buffer);
    assert_eq!(buffer, expected);
}

#[test]
fn views_of_images_hold_what_the_messages_hold() {
    let image = Image {
        header: Header { stamp: Stamp { sec: -1, nanosec: 5 }, frame_id: "c".into() },
        height: 2,
        width: 3,
        encoding: "mono8".into(),
        is_bigendian: 0,
        step: 3,
        data: vec![1, 2, 3, 4, 5, 6],
    };
    let bytes = image.encode();
    let view = ImageView::decode(&bytes).unwrap();
    assert_eq!(view.to_message(), image);
    let mut buffer = Vec::new();
    view.encode_into(&mut buffer);
    assert_eq!(buffer, bytes);
}

#[test]
fn big_endian_messages() {
    let message = [
        &[0, 0, 0, 0][..],
        &[0, 0, 0, 1, 0, 0, 0, 2],
        &[0, 0, 0, 2, b'b', 0, 0, 0],
        &[0, 0, 0, 1, 0, 0, 0, 2, b'j', 0, 0, 0],
        &[0, 0, 0, 1, 0x40, 0, 0, 0, 0, 0, 0, 0],
        &[0; 8],
    ]
    .concat();
    let joints = JointState::decode(&message).unwrap();
    assert_eq!(joints.header.stamp, Stamp { sec: 1, nanosec: 2 });
    assert_eq!(joints.name, ["j"]);
    assert_eq!(joints.position, [2.0]);
}

#[test]
fn a_sequence_of_structs_cannot_claim_more_than_is_there() {
    let message = [0, 1, 0, 0, 0xff, 0xff, 0xff, 0x0f, 0, 0, 0, 0];
    assert!(matches!(TFMessage::decode(&message), Err(CdrError::SequenceTooLong { most: 0, .. })));
}

#[test]
fn definitions_name_every_nested_type() {
    fn check<M: Message>(_: ()) {
        let sections: Vec<&str> = M::DEFINITION
            .split("================================================================================\nMSG: ")
            .collect();
        let names: Vec<&str> = sections[1..].iter().filter_map(|section| section.lines().next()).collect();
        for line in sections.iter().enumerate().flat_map(|(i, section)| section.lines().skip(usize::from(i > 0))) {
            let field_type = line.split([' ', '[']).next().unwrap_or_default();
            if field_type.contains('/') {
                assert!(names.contains(&field_type), "{} lacks {field_type}", M::TYPE);
            }
        }
        assert!(M::TYPE.contains("/msg/"));
    }
    for_each_message!(check(()));
}
