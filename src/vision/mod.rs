//! From a picture to the ground table: which places around the robot look like a painted line.
//!
//! Pure, and ignorant of where the robot is: everything here is in image or robot (`base_footprint`)
//! coordinates. The chain for one frame is [`Vision::look`].

pub mod border;
pub mod carpet;
mod cells;
pub mod contrast;
pub mod distance;
pub mod ground;
pub mod ground_map;
pub mod line_image;
pub mod mask;
pub mod picture;

use glam::{DVec2, DVec3};

use crate::geometry::{Isometry, Lens};
pub use border::CarpetBorder;
pub use contrast::LineContrast;
pub use ground::{GroundTable, Readings};
pub use ground_map::GroundMap;
pub use line_image::LineImage;
pub use mask::BodyMask;
pub use picture::Picture;

/// What the ground table is to hold; one per observation model and formula.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reading {
    /// Line contrast, 0 where the carpet is plain (corrected Eq. 2).
    Contrast,
    /// Distance to the nearest white place, in metres on the ground (corrected Eq. 1).
    Nearest,
    /// Blurred gray (Eq. 2 as printed).
    Gray,
    /// Distance to the nearest white pixel, in pixels (Eq. 1 as printed).
    NearestPixel,
}

/// At a distance of seven heights a line of 5 cm is a third of a pixel wide for 200 pixels a radian.
const RANGE_OF_HEIGHT: f64 = 7.3;

/// What one frame shows.
#[derive(Clone, Debug)]
pub struct Seen {
    /// What the observation model asked for.
    pub table: GroundTable,
    /// Line contrast, if that is something else: tells how much of what a pose predicts is there.
    pub lines: Option<GroundTable>,
    /// What refinement measures in.
    pub image: LineImage,
}

impl Seen {
    pub fn lines(&self) -> &GroundTable {
        self.lines.as_ref().unwrap_or(&self.table)
    }
}

/// Everything about seeing that does not change from frame to frame.
#[derive(Clone, Debug)]
pub struct Vision {
    lens: Lens,
    settings: VisionSettings,
    reduction: usize,
    /// Rays through the coarse cells of the wide blur, row by row; `None` where the lens draws nothing.
    coarse_rays: Vec<Option<DVec3>>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisionSettings {
    pub reading: Reading,
    /// Half the side of the ground table; 0: by the camera's height.
    pub range_m: f64,
    /// Expected error of the camera's roll and pitch: places that it moves far count less.
    pub tilt_sigma_rad: f64,
    /// How far on the ground the nearest white place is looked for.
    pub nearest_reach_m: f64,
    /// Blocks of this many pixels by as many are averaged before looking; 0: [`automatic_reduction`].
    pub reduction: usize,
}

/// Cameras with more than about 200 pixels a radian are looked at in a smaller copy: lines a few pixels wide are what
/// the contrast is made for.
pub fn automatic_reduction(lens: &Lens) -> usize {
    (libm::round(lens.focal() / 210.0) as usize).clamp(1, 8)
}

impl Vision {
    pub fn new(lens: Lens, settings: VisionSettings) -> Self {
        let reduction = if settings.reduction == 0 { automatic_reduction(&lens) } else { settings.reduction };
        let (width, height) = (lens.width() as usize / reduction, lens.height() as usize / reduction);
        let scale = WorkingScale::new(reduction);
        let coarse_rays =
            contrast::coarse_centres(width, height).map(|centre| lens.unproject(scale.undo(centre))).collect();
        Self { lens, settings, reduction, coarse_rays }
    }

    pub fn lens(&self) -> &Lens {
        &self.lens
    }

    pub fn settings(&self) -> &VisionSettings {
        &self.settings
    }

    /// What one frame shows of the ground, `footprint_from_optical` being the camera's place above the robot's
    /// footprint; `body` hides the robot itself. A camera that sees no ground gives tables without information.
    pub fn look(&self, picture: &Picture, footprint_from_optical: &Isometry, body: Option<&BodyMask>) -> Seen {
        let working = picture.reduced(self.reduction);
        let scale = WorkingScale::new(self.reduction);
        let (border, carpet) = CarpetBorder::find(&working, &self.lens, footprint_from_optical, scale, body).unzip();
        let on_carpet = self.coarse_on_carpet(border.as_ref(), footprint_from_optical);
        let contrast = LineContrast::of(&working, &on_carpet, carpet.as_ref());
        let mut map = GroundMap::new(&self.lens, footprint_from_optical, self.range_m(footprint_from_optical));
        map.hide(border.as_ref(), body);
        let (table, lines, full_contrast) = ground::tables(&contrast, &map, scale, self.lens.focal(), &self.settings);
        let image = LineImage::new(&working, &contrast, scale, body, full_contrast);
        Seen { table, lines, image }
    }

    fn range_m(&self, footprint_from_optical: &Isometry) -> f64 {
        match self.settings.range_m {
            0.0 => (RANGE_OF_HEIGHT * footprint_from_optical.translation.z).clamp(3.0, 8.0),
            range => range,
        }
    }

    fn coarse_on_carpet(&self, border: Option<&CarpetBorder>, footprint_from_optical: &Isometry) -> Vec<bool> {
        let camera = footprint_from_optical.translation;
        let on_carpet = |ray: DVec3| {
            let ray = footprint_from_optical.transform_vector(ray);
            let reach = -camera.z / ray.z;
            reach > 0.0 && border.is_none_or(|border| border.holds((camera + ray * reach).truncate()))
        };
        self.coarse_rays.iter().map(|ray| ray.is_some_and(on_carpet)).collect()
    }
}

/// From full-size pixels to pixels of the reduced picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorkingScale {
    factor: f64,
    offset: f64,
}

impl WorkingScale {
    pub fn new(reduction: usize) -> Self {
        let factor = 1.0 / reduction as f64;
        // The centre of the first reduced pixel lies between the full-size pixels that it averages.
        Self { factor, offset: 0.5 * factor - 0.5 }
    }

    /// Working pixels per full-size pixel.
    pub fn factor(&self) -> f64 {
        self.factor
    }

    pub fn undo(&self, pixel: DVec2) -> DVec2 {
        (pixel - DVec2::splat(self.offset)) / self.factor
    }

    pub fn apply(&self, pixel: DVec2) -> DVec2 {
        pixel * self.factor + DVec2::splat(self.offset)
    }
}
