//! Messages of `visualization_msgs` and `foxglove_msgs`, which viewers draw: lines on the field, and lines over an image.

use serde::Serialize;

use super::geometry::{Point, Pose, Vector3};
use super::image::CompressedImage;
use super::message;
use super::time::{Header, Stamp};
use crate::cdr::wire_struct;

wire_struct! {
    /// `std_msgs/ColorRGBA`: colour and opacity, each 0 to 1.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
    pub struct ColorRGBA {
        /// Red.
        pub r: f32,
        /// Green.
        pub g: f32,
        /// Blue.
        pub b: f32,
        /// Opacity.
        pub a: f32,
    }
}

wire_struct! {
    /// `builtin_interfaces/Duration`: a length of time; zero means for ever.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
    pub struct Duration {
        /// Seconds, rounded down.
        pub sec: i32,
        /// Nanoseconds on top of `sec`, below 10^9.
        pub nanosec: u32,
    }
}

wire_struct! {
    /// `visualization_msgs/UVCoordinate`: a point of a texture.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
    pub struct UVCoordinate {
        /// Place along the texture, 0 to 1.
        pub u: f32,
        /// Place across the texture, 0 to 1.
        pub v: f32,
    }
}

wire_struct! {
    /// `visualization_msgs/MeshFile`: a mesh that a marker brings along.
    #[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
    pub struct MeshFile {
        /// Name of the file.
        pub filename: String,
        /// Content of the file.
        pub data: Vec<u8>,
    }
}

wire_struct! {
    /// `visualization_msgs/Marker`: a shape in space.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct Marker {
        /// Time, and coordinate frame in which the marker stands.
        pub header: Header,
        /// Namespace of `id`.
        pub ns: String,
        /// Number of the marker; one of the same number replaces it.
        pub id: i32,
        /// Kind of the shape: [`Self::LINE_LIST`] or another constant of the type.
        pub kind: i32,
        /// What is done with it: 0 adds it.
        pub action: i32,
        /// Pose of the shape in the coordinate frame.
        pub pose: Pose,
        /// Size, metres; of lines, x is the width.
        pub scale: Vector3,
        /// Colour.
        pub color: ColorRGBA,
        /// How long it is shown.
        pub lifetime: Duration,
        /// Whether it moves with its coordinate frame.
        pub frame_locked: bool,
        /// Points of lines, two for each line of a list, metres.
        pub points: Vec<Point>,
        /// Colours of the points; none if all have that of the marker.
        pub colors: Vec<ColorRGBA>,
        /// Name of a texture.
        pub texture_resource: String,
        /// A texture that the marker brings along.
        pub texture: CompressedImage,
        /// Points of the texture for the points of the shape.
        pub uv_coordinates: Vec<UVCoordinate>,
        /// Text, for markers that show one.
        pub text: String,
        /// Name of a mesh.
        pub mesh_resource: String,
        /// A mesh that the marker brings along.
        pub mesh_file: MeshFile,
        /// Whether the mesh keeps its own materials.
        pub mesh_use_embedded_materials: bool,
    }
}

wire_struct! {
    /// `visualization_msgs/MarkerArray`: several markers.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct MarkerArray {
        /// The markers.
        pub markers: Vec<Marker>,
    }
}

wire_struct! {
    /// `foxglove_msgs/Point2`: a point of an image, pixels from its upper left corner.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
    pub struct Point2 {
        /// Pixels to the right.
        pub x: f64,
        /// Pixels down.
        pub y: f64,
    }
}

wire_struct! {
    /// `foxglove_msgs/Color`: colour and opacity, each 0 to 1.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
    pub struct Color {
        /// Red.
        pub r: f64,
        /// Green.
        pub g: f64,
        /// Blue.
        pub b: f64,
        /// Opacity.
        pub a: f64,
    }
}

wire_struct! {
    /// `foxglove_msgs/CircleAnnotation`: a circle over an image.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
    pub struct CircleAnnotation {
        /// Stamp of the image.
        pub timestamp: Stamp,
        /// Centre.
        pub position: Point2,
        /// Diameter, pixels.
        pub diameter: f64,
        /// Width of the line, pixels.
        pub thickness: f64,
        /// Colour inside.
        pub fill_color: Color,
        /// Colour of the line.
        pub outline_color: Color,
    }
}

wire_struct! {
    /// `foxglove_msgs/PointsAnnotation`: points or lines over an image.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct PointsAnnotation {
        /// Stamp of the image.
        pub timestamp: Stamp,
        /// What the points make: [`Self::LINE_STRIP`] or another constant of the type.
        pub kind: u8,
        /// The points.
        pub points: Vec<Point2>,
        /// Colour of the line.
        pub outline_color: Color,
        /// Colours of the points; none if all have that of the line.
        pub outline_colors: Vec<Color>,
        /// Colour inside.
        pub fill_color: Color,
        /// Width of the line, pixels.
        pub thickness: f64,
    }
}

wire_struct! {
    /// `foxglove_msgs/TextAnnotation`: words over an image.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct TextAnnotation {
        /// Stamp of the image.
        pub timestamp: Stamp,
        /// Lower left corner of the words.
        pub position: Point2,
        /// The words.
        pub text: String,
        /// Size of the letters, pixels.
        pub font_size: f64,
        /// Colour of the letters.
        pub text_color: Color,
        /// Colour behind them.
        pub background_color: Color,
    }
}

wire_struct! {
    /// `foxglove_msgs/ImageAnnotations`: what is drawn over the image of the same stamp.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct ImageAnnotations {
        /// Circles.
        pub circles: Vec<CircleAnnotation>,
        /// Points and lines.
        pub points: Vec<PointsAnnotation>,
        /// Words.
        pub texts: Vec<TextAnnotation>,
    }
}

impl Marker {
    /// Kind of a marker whose points are the ends of lines.
    pub const LINE_LIST: i32 = 5;
}

impl PointsAnnotation {
    /// Kind of an annotation whose points are joined in their order.
    pub const LINE_STRIP: u8 = 3;
}

message!(MarkerArray is "visualization_msgs" / "MarkerArray",
    needs "visualization_msgs/Marker", needs "std_msgs/Header", needs "builtin_interfaces/Time",
    needs "geometry_msgs/Pose", needs "geometry_msgs/Point", needs "geometry_msgs/Quaternion",
    needs "geometry_msgs/Vector3", needs "std_msgs/ColorRGBA", needs "builtin_interfaces/Duration",
    needs "sensor_msgs/CompressedImage", needs "visualization_msgs/UVCoordinate", needs "visualization_msgs/MeshFile");
message!(ImageAnnotations is "foxglove_msgs" / "ImageAnnotations",
    needs "foxglove_msgs/CircleAnnotation", needs "foxglove_msgs/PointsAnnotation", needs "foxglove_msgs/TextAnnotation",
    needs "builtin_interfaces/Time", needs "foxglove_msgs/Point2", needs "foxglove_msgs/Color");
