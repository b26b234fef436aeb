//! A page of some images with their labels drawn over them.

use image::{Rgb, RgbImage};

use super::super::marks::{UPRIGHT, cross, frame_box};
use crate::evaluation::drawing::{panels, scaled};
use crate::labels::{Class, Labeller, PosedImage, Visibility};
use crate::views::Raster;

/// Number of images on the page.
pub(super) const PREVIEWS: usize = 12;
/// Columns of the page.
const COLUMNS: u32 = 3;
/// Width of an image on the page, pixels.
const WIDTH_PX: u32 = 480;
/// Share of a class's colour in a pixel.
const TINT: f32 = 0.45;
/// Half the length of a cross at a landmark, pixels.
const CROSS_PX: i64 = 5;

/// An image, tinted by the classes of its pixels, with boxes, and crosses at the landmarks: yellow if visible, gray if hidden.
pub(super) fn preview(labeller: &Labeller, posed: &PosedImage, image: &Raster, classes: &[Class]) -> RgbImage {
    let mut picture = RgbImage::new(image.width as u32, image.height as u32);
    for ((pixel, [red, green, blue, _]), class) in picture.pixels_mut().zip(&image.pixels).zip(classes) {
        let own = [*red, *green, *blue];
        let tint = colour(*class);
        *pixel = Rgb(core::array::from_fn(|i| match tint {
            Some(tint) => (f32::from(own[i]) * (1.0 - TINT) + f32::from(tint[i]) * TINT) as u8,
            None => own[i],
        }));
    }
    for found in labeller.boxes(posed) {
        frame_box(&mut picture, found.from, found.to, Rgb([0, 255, 255]));
    }
    for keypoint in labeller.keypoints(posed) {
        let tint = match keypoint.visibility {
            Visibility::Outside => continue,
            Visibility::Hidden => [128; 3],
            Visibility::Visible => [255, 255, 0],
        };
        cross(&mut picture, keypoint.at, UPRIGHT, CROSS_PX, Rgb(tint));
    }
    let height = (WIDTH_PX * picture.height()).div_ceil(picture.width().max(1));
    scaled(&picture, WIDTH_PX, height.max(1))
}

/// The page of all previews.
pub(super) fn sheet(pictures: &[(RgbImage, String)]) -> RgbImage {
    panels(pictures, COLUMNS)
}

/// The tint of a class; carpet and hall keep their colours.
fn colour(class: Class) -> Option<[u8; 3]> {
    match class {
        Class::Beyond | Class::Carpet => None,
        Class::Line => Some([255, 0, 0]),
        Class::GoalFrame => Some([0, 0, 255]),
        Class::Net => Some([0, 160, 255]),
        Class::Body => Some([255, 0, 255]),
        Class::Ignore => Some([0, 0, 0]),
    }
}
