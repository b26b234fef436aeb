//! Converts the pixels of a `sensor_msgs/Image` into a picture.

use realitysim_geometry::lens::is_image_size;
use realitysim_ros2::messages::ImageView;
use realitysim_vision::{Chroma, Picture};

use super::DecodeError;
use super::bayer::{Mosaic, demosaic};

/// How the pixels of an encoding lie in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PixelLayout {
    /// One gray level of 8 bits for each pixel.
    Gray,
    /// One gray level of 16 bits for each pixel.
    Gray16,
    /// Colours of 8 bits side by side.
    Colour {
        /// Bytes of a pixel; a fourth one is transparency, which is left out.
        bytes: usize,
        /// Offset of red, green and blue in the pixel, bytes.
        rgb: [usize; 3],
    },
    /// Y'CbCr with one pair of chroma values for two neighbours in a row (4:2:2), in four bytes.
    SharedByTwo {
        /// Offset of the first luma value; the second stands two bytes further.
        luma: usize,
        /// Offset of Cb; Cr stands two bytes further.
        blue: usize,
    },
    /// A plane of luma, then one of chroma pairs with half the columns and rows (4:2:0).
    TwoPlanes {
        /// Whether Cb comes before Cr.
        blue_first: bool,
    },
    /// A Bayer mosaic with 8 bits for each pixel.
    Bayer(Mosaic),
    /// A Bayer mosaic with 16 bits for each pixel.
    Bayer16(Mosaic),
}

use PixelLayout::{Bayer, Bayer16, Colour, Gray, Gray16, SharedByTwo, TwoPlanes};

const UYVY: PixelLayout = SharedByTwo { luma: 1, blue: 0 };
const YUYV: PixelLayout = SharedByTwo { luma: 0, blue: 1 };

/// Every encoding that is read, by its name in `sensor_msgs/image_encodings.hpp` (ros2/common_interfaces). `nv12` is that of
/// Foxglove's `RawImage`, which describes its two planes (foxglove/foxglove-sdk, schemas/proto/foxglove/RawImage.proto).
const ENCODINGS: [(&str, PixelLayout); 22] = [
    ("mono8", Gray),
    ("8UC1", Gray),
    ("mono16", Gray16),
    ("16UC1", Gray16),
    ("rgb8", Colour { bytes: 3, rgb: [0, 1, 2] }),
    ("bgr8", Colour { bytes: 3, rgb: [2, 1, 0] }),
    ("rgba8", Colour { bytes: 4, rgb: [0, 1, 2] }),
    ("bgra8", Colour { bytes: 4, rgb: [2, 1, 0] }),
    ("yuv422_yuy2", YUYV),
    ("yuyv", YUYV),
    ("yuv422", UYVY),
    ("uyvy", UYVY),
    ("nv12", TwoPlanes { blue_first: true }),
    ("nv21", TwoPlanes { blue_first: false }),
    ("bayer_rggb8", Bayer(Mosaic::RGGB)),
    ("bayer_bggr8", Bayer(Mosaic::BGGR)),
    ("bayer_gbrg8", Bayer(Mosaic::GBRG)),
    ("bayer_grbg8", Bayer(Mosaic::GRBG)),
    ("bayer_rggb16", Bayer16(Mosaic::RGGB)),
    ("bayer_bggr16", Bayer16(Mosaic::BGGR)),
    ("bayer_gbrg16", Bayer16(Mosaic::GBRG)),
    ("bayer_grbg16", Bayer16(Mosaic::GRBG)),
];

/// Returns the names of the encodings of `sensor_msgs/Image` that are read.
pub fn encodings() -> impl ExactSizeIterator<Item = &'static str> {
    ENCODINGS.iter().map(|(name, _)| *name)
}

/// Lists the names of all encodings that are read, for an error.
pub(super) fn encoding_names() -> String {
    encodings().collect::<Vec<_>>().join(", ")
}

impl PixelLayout {
    /// Returns the layout of an encoding, by its name.
    fn of(encoding: &str) -> Result<Self, DecodeError> {
        let found = ENCODINGS.iter().find(|(name, _)| *name == encoding);
        found.map(|(_, layout)| *layout).ok_or_else(|| DecodeError::Encoding(encoding.to_owned()))
    }

    /// Returns the number of bytes of a row's pixel, that of the luma plane if there are two planes.
    fn bytes_per_pixel(self) -> usize {
        match self {
            Gray | Bayer(_) | TwoPlanes { .. } => 1,
            Gray16 | Bayer16(_) | SharedByTwo { .. } => 2,
            Colour { bytes, .. } => bytes,
        }
    }

    /// Returns what would be right if pixels that share their chroma do not make up an image of this size.
    fn needs(self, width: usize, height: usize) -> Option<&'static str> {
        match self {
            SharedByTwo { .. } if !width.is_multiple_of(2) => {
                Some("the width must be even, since two neighbours in a row share their chroma")
            }
            TwoPlanes { .. } if !(width | height).is_multiple_of(2) => {
                Some("width and height must be even, since 2 x 2 pixels share their chroma")
            }
            _ => None,
        }
    }

    /// Returns the number of rows in memory, those of a chroma plane included.
    fn rows(self, height: usize) -> usize {
        if matches!(self, TwoPlanes { .. }) { height + height / 2 } else { height }
    }
}

/// Converts an uncompressed image into a picture. The error names an encoding or size that is not possible.
///
/// The bytes of Y'CbCr count as full range with the matrix of JFIF, as in a JPEG. Of 16 bits the higher 8 count.
pub fn raw(image: &ImageView) -> Result<Picture, DecodeError> {
    let size = || DecodeError::Size {
        width: image.width,
        height: image.height,
        encoding: image.encoding.to_owned(),
        step: image.step,
        bytes: image.data.len(),
    };
    let (width, height, step) = (image.width as usize, image.height as usize, image.step as usize);
    let layout = PixelLayout::of(image.encoding)?;
    let line = width.checked_mul(layout.bytes_per_pixel()).ok_or_else(size)?;
    if !is_image_size(width as u64, height as u64) || step < line {
        return Err(size());
    }
    if let Some(needed) = layout.needs(width, height) {
        let (width, height, encoding) = (image.width, image.height, image.encoding.to_owned());
        return Err(DecodeError::OddSize { width, height, encoding, needed });
    }
    // The last row may lack the padding that `step` adds.
    let needed = step.checked_mul(layout.rows(height) - 1).and_then(|rows| rows.checked_add(line)).ok_or_else(size)?;
    if image.data.len() < needed {
        return Err(size());
    }
    let rows: Vec<&[u8]> = image.data.chunks(step).take(layout.rows(height)).map(|row| &row[..line]).collect();
    let high = if image.is_bigendian != 0 { 0 } else { 1 };
    let picture = match layout {
        Gray => Picture::from_gray(width, height, rows.concat()),
        Gray16 => Picture::from_gray(width, height, high_bytes(&rows, high).concat()),
        Colour { bytes: 3, rgb: [0, 1, 2] } => Picture::from_rgb(width, height, &rows.concat()),
        Colour { bytes, rgb } => {
            let pixels = rows.iter().flat_map(|row| row.chunks_exact(bytes));
            Picture::from_rgb(width, height, &pixels.flat_map(|pixel| rgb.map(|at| pixel[at])).collect::<Vec<u8>>())
        }
        SharedByTwo { luma, blue } => {
            let quads = rows.iter().flat_map(|row| row.as_chunks::<4>().0);
            let pixels = quads.flat_map(|quad| {
                let [u, v] = [quad[blue], quad[blue + 2]];
                [quad[luma], u, v, quad[luma + 2], u, v]
            });
            Picture::from_ycbcr(width, height, &pixels.collect::<Vec<u8>>())
        }
        TwoPlanes { blue_first } => Some(two_planes(width, height, &rows, blue_first)),
        Bayer(mosaic) => Picture::from_rgb(width, height, &demosaic(width, height, &rows, mosaic)),
        Bayer16(mosaic) => {
            let levels = high_bytes(&rows, high);
            let rows: Vec<&[u8]> = levels.iter().map(Vec::as_slice).collect();
            Picture::from_rgb(width, height, &demosaic(width, height, &rows, mosaic))
        }
    };
    picture.ok_or_else(size)
}

/// Takes the byte at offset `high` of each pair: the higher one of a number of 16 bits.
fn high_bytes(rows: &[&[u8]], high: usize) -> Vec<Vec<u8>> {
    rows.iter().map(|row| row.as_chunks::<2>().0.iter().map(|pair| pair[high]).collect()).collect()
}

/// Makes a picture of `height` rows of luma and half as many of chroma pairs, which is how a [`Picture`] has its chroma, too.
fn two_planes(width: usize, height: usize, rows: &[&[u8]], blue_first: bool) -> Picture {
    let (luma, pairs) = rows.split_at(height);
    let plane = |at: usize| pairs.iter().flat_map(|row| row.as_chunks::<2>().0).map(|pair| pair[at]).collect();
    let (blue, red) = if blue_first { (plane(0), plane(1)) } else { (plane(1), plane(0)) };
    Picture { width, height, luma: luma.concat(), chroma: Chroma { blue, red } }
}
