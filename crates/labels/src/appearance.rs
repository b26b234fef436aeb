//! What a sphere and its surroundings look like in an image, to be compared with another image.

use glam::{DVec2, DVec3};

use realitysim_views::Raster;

use crate::PosedImage;
use crate::sphere::{Disc, RestingSphere, shown_pixel};

/// Places across the patch.
const SIDE: usize = 24;
/// Half the side of the patch, in radii of the sphere's disc.
const REACH: f64 = 1.6;
/// The surroundings lie between these distances from the middle of the disc, in its radii.
const RING: [f64; 2] = [1.2, 1.6];
/// Places of the surroundings that must be seen to compare with them.
const MIN_RING: usize = 24;
/// Share of the patch that two images must both show.
const MIN_COMMON_SHARE: f64 = 0.4;

/// A sphere's picture turned upright and brought to one size: how much redder, greener and bluer each place is than the surroundings, in
/// shares of their brightness.
///
/// So a change of the light or the exposure changes nothing.
#[derive(Clone, Debug)]
pub struct Appearance {
    /// Row by row; `None` where the picture does not show the place.
    places: Vec<Option<DVec3>>,
}

impl Appearance {
    /// Reads how a sphere looks in an image. `None` if too little of its surroundings is in the picture, or they are black.
    pub fn of(sphere: &RestingSphere, image: &PosedImage, picture: &Raster) -> Option<Self> {
        let disc = Disc::of(sphere, image)?;
        let colour = |at: &DVec2| shown_pixel(image, disc.ray(*at)).map(|pixel| read(picture, pixel));
        let mut places: Vec<Option<DVec3>> =
            grid().map(|at| Some(at).filter(|at| at.length() <= REACH).as_ref().and_then(colour)).collect();
        let ring: Vec<DVec3> = grid()
            .zip(&places)
            .filter_map(|(at, place)| place.filter(|_| (RING[0]..=RING[1]).contains(&at.length())))
            .collect();
        let around = median(&ring).filter(|_| ring.len() >= MIN_RING)?;
        let brightness = (around.x + around.y + around.z) / 3.0;
        if brightness < 1.0 {
            return None;
        }
        places.iter_mut().flatten().for_each(|place| *place = (*place - around) / brightness);
        Some(Self { places })
    }

    /// How alike two pictures are: 1 if they are the same, about 0 if they have nothing in common, -1 if one is the other's negative.
    /// `None` if they show too few places of it in common.
    ///
    /// This is the product of contrast and structure of the structural similarity (Wang et al. 2004), `2 a.b / (a.a + b.b)`.
    pub fn similarity(&self, other: &Self) -> Option<f64> {
        let (mut product, mut squares, mut common) = (0.0, 0.0, 0usize);
        for (own, other) in self.places.iter().zip(&other.places) {
            let (Some(own), Some(other)) = (own, other) else { continue };
            product += 2.0 * own.dot(*other);
            squares += own.length_squared() + other.length_squared();
            common += 1;
        }
        let is_enough = common as f64 >= MIN_COMMON_SHARE * self.places.len() as f64 && squares > 0.0;
        is_enough.then(|| product / squares)
    }
}

/// The places of the patch, row by row, in radii from the middle of the disc: right and up.
fn grid() -> impl Iterator<Item = DVec2> {
    let at = |step: usize| ((step as f64 + 0.5) * 2.0 / SIDE as f64 - 1.0) * REACH;
    (0..SIDE * SIDE).map(move |index| DVec2::new(at(index % SIDE), -at(index / SIDE)))
}

/// The colour at a pixel between four, red, green and blue.
fn read(picture: &Raster, pixel: DVec2) -> DVec3 {
    let (left, top) = (libm::floor(pixel.x), libm::floor(pixel.y));
    let (right_share, lower_share) = (pixel.x - left, pixel.y - top);
    let at = |u: f64, v: f64| {
        let [u, v] = [(u as usize).min(picture.width - 1), (v as usize).min(picture.height - 1)];
        let [red, green, blue, _] = picture.pixels[v * picture.width + u];
        DVec3::new(f64::from(red), f64::from(green), f64::from(blue))
    };
    let row = |v: f64| at(left, v).lerp(at(left + 1.0, v), right_share);
    row(top).lerp(row(top + 1.0), lower_share)
}

/// The median of each colour.
fn median(colours: &[DVec3]) -> Option<DVec3> {
    let middle = |of: fn(&DVec3) -> f64| {
        let mut values: Vec<f64> = colours.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied()
    };
    Some(DVec3::new(middle(|c| c.x)?, middle(|c| c.y)?, middle(|c| c.z)?))
}
