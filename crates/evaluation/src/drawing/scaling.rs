//! Pictures in another size.

use fast_image_resize::images::{Image, ImageRef};
use fast_image_resize::{FilterType, PixelType, ResizeAlg, ResizeOptions, Resizer};
use image::RgbImage;

/// Returns the picture in another size, filtered by Catmull and Rom's cubic.
///
/// A picture without pixels, or one that is asked to have none, becomes black.
pub fn scaled(picture: &RgbImage, width: u32, height: u32) -> RgbImage {
    let mut page = RgbImage::new(width, height);
    let Ok(from) = ImageRef::new(picture.width(), picture.height(), picture.as_raw(), PixelType::U8x3) else {
        return page;
    };
    let Ok(mut to) = Image::from_slice_u8(width, height, &mut page, PixelType::U8x3) else { return page };
    let options = ResizeOptions::new().resize_alg(ResizeAlg::Convolution(FilterType::CatmullRom));
    // It fails for sizes of zero alone, which leave the page as it is.
    _ = Resizer::new().resize(&from, &mut to, &options);
    page
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slope(width: u32, height: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| image::Rgb([(2 * x) as u8, (3 * y) as u8, 77]))
    }

    #[test]
    fn a_slope_stays_a_slope() {
        let large = scaled(&slope(40, 30), 160, 120);
        for (x, y) in [(20, 20), (81, 60), (139, 99)] {
            // The centre of pixel x of the large picture lies at (x + 0.5) / 4 - 0.5 of the small one.
            let [across, down] = [x, y].map(|place| (f64::from(place) + 0.5) / 4.0 - 0.5);
            let [red, green, blue] = large.get_pixel(x, y).0.map(f64::from);
            assert!((red - 2.0 * across).abs() <= 1.0 && (green - 3.0 * down).abs() <= 1.0, "{red} {green}");
            assert_eq!(blue, 77.0);
        }
        let small = scaled(&large, 20, 15);
        assert!((f64::from(small.get_pixel(10, 7).0[0]) - 41.0).abs() <= 2.0);
    }

    #[test]
    fn a_picture_without_pixels_is_black() {
        assert_eq!(scaled(&RgbImage::new(0, 7), 3, 2), RgbImage::new(3, 2));
        assert_eq!(scaled(&slope(4, 3), 0, 5).width(), 0);
    }
}
