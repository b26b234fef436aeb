//! Messages for 3D viewers: the tagged camera, the lines of its tag over the image, and the field. A log (`export --to foxglove`) and a live
//! connection (`live --foxglove`) show the same.

use core::f64::consts::{FRAC_PI_2, TAU};

use glam::DVec2;

use crate::evaluation::drawing::projected_lines;
use crate::geometry::field::Stroke;
use crate::geometry::{Field, Isometry, Lens};
use crate::recording::camera_transforms;
use crate::ros2::messages::{
    CameraInfo, Color, ColorRGBA, FrameTag, Header, ImageAnnotations, Marker, MarkerArray, Message, Point, Point2,
    PointsAnnotation, PoseWithCovarianceStamped, TextAnnotation, Vector3,
};
use crate::ros2::topics;

/// Topic of the field's lines as markers.
pub const FIELD_LINES: &str = "/field/lines";
/// Topic of the lines over the images.
pub const IMAGE_LINES: &str = "/camera/lines";
/// Topic of the lens as the exported images have it.
pub const CAMERA_INFO: &str = "/camera/tagged_info";
/// Pieces of a circle: each of them is off by less than a thousandth of the radius.
const PIECES: u32 = 72;
const VALID: Color = Color { r: 0.9, g: 0.12, b: 0.24, a: 0.9 };
const INVALID: Color = Color { r: 1.0, g: 0.67, b: 0.0, a: 0.9 };
const NO_COLOR: Color = Color { r: 0.0, g: 0.0, b: 0.0, a: 0.0 };
/// Size of the words over an image, pixels.
const FONT_PX: f64 = 16.0;

/// What takes messages for viewers: a log, or a live connection.
pub trait MessageSink {
    /// Takes a message of a topic; its log time is in nanoseconds.
    fn put<M: Message>(&mut self, topic: &str, time_ns: i64, message: &M) -> anyhow::Result<()>;
}

/// Puts all that a tag says about its image: lens, lines, and, if it is valid, transforms and pose.
///
/// The image itself is left to the caller, since it is not always the same message.
pub fn put_tag(
    sink: &mut impl MessageSink,
    time_ns: i64,
    tag: &FrameTag,
    lens: &Lens,
    field: &Field,
) -> anyhow::Result<()> {
    let header = tag.header.clone();
    sink.put(CAMERA_INFO, time_ns, &CameraInfo::of_lens(lens.parameters(), at_tagged_camera(&header)))?;
    sink.put(IMAGE_LINES, time_ns, &annotations(tag, lens, field))?;
    if tag.valid {
        sink.put(topics::CAMERA_TF, time_ns, &camera_transforms(&header, tag))?;
        sink.put(topics::POSE, time_ns, &PoseWithCovarianceStamped { header, pose: tag.pose })?;
    }
    sink.put(topics::FRAME_TAG, time_ns, tag)
}

/// The header of an image or lens, with the tagged camera as its coordinate frame.
pub fn at_tagged_camera(header: &Header) -> Header {
    Header { frame_id: topics::TAGGED_OPTICAL.to_owned(), ..header.clone() }
}

/// The lines of a tag over its image, orange if it is invalid, and then why.
fn annotations(tag: &FrameTag, lens: &Lens, field: &Field) -> ImageAnnotations {
    let timestamp = tag.header.stamp;
    let color = if tag.valid { VALID } else { INVALID };
    let point = |at: DVec2| Point2 { x: at.x, y: at.y };
    let strip = |line: Vec<DVec2>| PointsAnnotation {
        timestamp,
        kind: PointsAnnotation::LINE_STRIP,
        points: line.into_iter().map(point).collect(),
        outline_color: color,
        thickness: 1.0,
        ..PointsAnnotation::default()
    };
    let words = TextAnnotation {
        timestamp,
        position: Point2 { x: 4.0, y: FONT_PX + 4.0 },
        text: if tag.valid { format!("sigma {:.1} cm", 100.0 * tag.pose.sigma_xy_m()) } else { tag.reason.clone() },
        font_size: FONT_PX,
        text_color: color,
        background_color: NO_COLOR,
    };
    let points = projected_lines(lens, &Isometry::from(tag.pose.pose), field).into_iter().map(strip).collect();
    ImageAnnotations { circles: Vec::new(), points, texts: vec![words] }
}

/// The painted lines of the field as one marker: a list of lines as wide as the paint.
pub fn field_markers(field: &Field, header: Header) -> MarkerArray {
    let point = |at: DVec2| Point { x: at.x, y: at.y, z: 0.0 };
    let lines = field.painted_strokes();
    let points = lines.iter().flat_map(pieces).flatten().map(point).collect();
    let marker = Marker {
        header,
        ns: "field".to_owned(),
        kind: Marker::LINE_LIST,
        scale: Vector3 { x: field.line_width(), ..Vector3::default() },
        color: ColorRGBA { r: 1.0, g: 1.0, b: 1.0, a: 1.0 },
        points,
        ..Marker::default()
    };
    MarkerArray { markers: vec![marker] }
}

/// Straight pieces of a painted line, metres.
fn pieces(stroke: &Stroke) -> Vec<[DVec2; 2]> {
    let round = |centre: DVec2, radius: f64, side: DVec2, turn: f64| {
        let at = |piece: u32| {
            let angle = turn * f64::from(piece) / f64::from(PIECES);
            centre + radius * side * DVec2::new(libm::cos(angle), libm::sin(angle))
        };
        (0..PIECES).map(|piece| [at(piece), at(piece + 1)]).collect()
    };
    match *stroke {
        Stroke::Segment { from, to } => vec![[from, to]],
        Stroke::Circle { centre, radius } => round(centre, radius, DVec2::ONE, TAU),
        Stroke::Quarter { centre, radius, side } => round(centre, radius, side, FRAC_PI_2),
    }
}
