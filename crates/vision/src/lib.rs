//! From a picture to the ground table: which places around the robot look like a painted line.
//!
//! Pure, and ignorant of where the robot is: everything here is in image or robot (`base_footprint`)
//! coordinates. The chain for one frame is [`Vision::look`].

mod bilinear;
pub mod border;
pub mod carpet;
pub mod contrast;
pub mod distance;
pub mod ground;
pub mod ground_map;
mod ground_table_fill;
mod image_summary;
pub mod line_image;
pub mod mask;
pub mod picture;
mod ridges;
mod rotation;

use glam::{DVec2, DVec3};

pub use border::CarpetBorder;
use carpet::Carpet;
pub use contrast::LineContrast;
pub use ground::{GroundTable, Readings};
pub use ground_map::GroundMap;
pub use image_summary::{ImageDefect, ImageSummary};
pub use line_image::LineImage;
pub use mask::BodyMask;
pub use picture::{Chroma, Picture, Reduction};
use realitysim_geometry::{Isometry, Lens, Projector};
pub use ridges::Ridge;
pub use rotation::{Small, Turning};

/// What the ground table is to hold; one per observation model and formula.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TableQuantity {
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

/// What one frame shows. Its buffers, and those that it was made with, can be used again for another frame.
#[derive(Clone, Debug, Default)]
pub struct Observations {
    /// What the observation model asked for.
    pub table: GroundTable,
    /// Line contrast, if that is something else: tells how much of what a pose predicts is there.
    pub lines: Option<GroundTable>,
    /// What refinement measures in.
    pub image: LineImage,
    pub summary: ImageSummary,
    contrast: LineContrast,
    /// Of the working image, and the columns of its rows.
    chroma: Chroma,
    chroma_stride: usize,
    making: ground::Making,
    /// NaN where no floor is.
    floor: Vec<DVec2>,
    on_carpet: Vec<bool>,
    reduction: Reduction,
    learning: carpet::Learning,
    border: CarpetBorder,
}

impl Observations {
    pub fn lines(&self) -> &GroundTable {
        self.lines.as_ref().unwrap_or(&self.table)
    }

    /// Where lines `line_width_m` wide are seen on the carpet, as far as there is a picture of them, by a camera at `footprint_from_optical` with
    /// this focal length.
    pub fn ridges(&self, footprint_from_optical: &Isometry, pixels_per_radian: f64, line_width_m: f64) -> Vec<Ridge> {
        let found = ridges::Ridges {
            contrast: &self.contrast,
            chroma: &self.chroma,
            chroma_stride: self.chroma_stride,
            floor: &self.floor,
            on_carpet: &self.on_carpet,
            scale: self.image.scale(),
            full_contrast: self.image.full_contrast(),
            line_width_m,
            foot: footprint_from_optical.translation.truncate(),
            height_m: footprint_from_optical.translation.z,
            pixels_per_radian: pixels_per_radian * self.image.scale().factor(),
        };
        found.find()
    }

    /// Corners of the carpet as far as it is seen, on the ground of `base_footprint`; none if no edge can be told.
    pub fn border(&self) -> &[DVec2] {
        self.border.corners()
    }
}

/// Everything about seeing that does not change from frame to frame.
#[derive(Clone, Debug)]
pub struct Vision {
    projector: Projector,
    settings: VisionSettings,
    reduction: usize,
    /// Rays through the coarse cells of the wide blur, row by row; `None` where the lens draws nothing.
    coarse_rays: Vec<Option<DVec3>>,
    border_rays: border::Rays,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisionSettings {
    pub reading: TableQuantity,
    /// Of the field's painted lines.
    pub line_width_m: f64,
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

/// Samples whose colour is learnt from lie within this range of the robot.
const LEARN_WITHIN_M: f64 = 2.5;

impl Vision {
    pub fn new(lens: &Lens, settings: VisionSettings) -> Self {
        let reduction = if settings.reduction == 0 { automatic_reduction(lens) } else { settings.reduction };
        let (width, height) = (lens.width() as usize / reduction, lens.height() as usize / reduction);
        let scale = WorkingScale::new(reduction);
        let coarse_rays =
            contrast::coarse_centres(width, height).map(|centre| lens.unproject(scale.undo(centre))).collect();
        Self { projector: Projector::new(lens), settings, reduction, coarse_rays, border_rays: border::Rays::default() }
    }

    pub fn lens(&self) -> &Lens {
        self.projector.lens()
    }

    pub fn settings(&self) -> &VisionSettings {
        &self.settings
    }

    /// What one frame shows of the ground, `footprint_from_optical` being the camera's place above the robot's
    /// footprint; `body` hides the robot itself. A camera that sees no ground gives tables without information.
    pub fn look(&self, picture: &Picture, footprint_from_optical: &Isometry, body: Option<&BodyMask>) -> Observations {
        let mut seen = Observations::default();
        self.look_again(picture, footprint_from_optical, body, &mut seen);
        seen
    }

    /// As [`Self::look`], into the buffers of a frame that is done with.
    pub fn look_again(
        &self,
        picture: &Picture,
        footprint_from_optical: &Isometry,
        body: Option<&BodyMask>,
        seen: &mut Observations,
    ) {
        seen.summary = ImageSummary::of(picture);
        let Observations {
            table,
            lines,
            image,
            contrast,
            chroma,
            chroma_stride,
            making,
            floor,
            on_carpet,
            reduction,
            learning,
            border,
            ..
        } = seen;
        let working = picture.reduced(self.reduction, reduction);
        let scale = WorkingScale::new(self.reduction);
        contrast.start(working);
        chroma.clone_from(&working.chroma);
        *chroma_stride = working.width.div_ceil(2);
        self.find_floor(footprint_from_optical, floor);
        let carpet = self.learn_carpet(working, contrast, floor, learning);
        let surfaces = &mut image.surfaces;
        match &carpet {
            Some(carpet) => carpet.surfaces(&contrast.half, working, surfaces),
            None => carpet::lit_surfaces(&contrast.half, surfaces),
        }
        if let Some(body) = body {
            hide_body(body, surfaces, contrast.width, scale);
        }
        border.forget();
        if carpet.is_some() {
            let rays = &self.border_rays;
            border.find(rays, surfaces, contrast.width, &self.projector, footprint_from_optical, scale);
        }
        border.holds(floor, on_carpet);
        contrast.finish(surfaces, on_carpet);
        let range_m = self.range_m(footprint_from_optical);
        making.map().fill(&self.projector, footprint_from_optical, range_m, border);
        let scales = ground::Scale {
            to_working: scale,
            pixels_per_radian: self.lens().focal(),
            line_width_m: self.settings.line_width_m,
        };
        let full_contrast = making.tables(contrast, scales, &self.settings, table, lines);
        image.fill(working, scale, full_contrast, on_carpet);
    }

    fn range_m(&self, footprint_from_optical: &Isometry) -> f64 {
        match self.settings.range_m {
            0.0 => (RANGE_OF_HEIGHT * footprint_from_optical.translation.z).clamp(3.0, 8.0),
            range => range,
        }
    }

    /// Where the ray of each coarse cell meets the floor.
    fn find_floor(&self, footprint_from_optical: &Isometry, floor: &mut Vec<DVec2>) {
        let camera = footprint_from_optical.translation;
        let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| footprint_from_optical.transform_vector(axis));
        floor.clear();
        floor.extend(self.coarse_rays.iter().map(|ray| {
            let Some(ray) = *ray else { return DVec2::NAN };
            let ray = x * ray.x + y * ray.y + z * ray.z;
            let reach = -camera.z / ray.z;
            if reach > 0.0 && reach.is_finite() { (camera + ray * reach).truncate() } else { DVec2::NAN }
        }));
    }

    fn learn_carpet(
        &self,
        working: &Picture,
        contrast: &LineContrast,
        floor: &[DVec2],
        learning: &mut carpet::Learning,
    ) -> Option<Carpet> {
        if working.chroma.is_empty() || contrast.width == 0 {
            return None;
        }
        let stride = working.width.div_ceil(2);
        let (columns, rows) = contrast::coarse_size(working.width, working.height);
        let sample = |row: usize, column: usize| {
            // NaN fails.
            let near = floor[row * columns + column].length_squared() < LEARN_WITHIN_M * LEARN_WITHIN_M;
            let (u, v) = (contrast::coarse_middle(column), contrast::coarse_middle(row));
            near.then(|| {
                let chroma = [&working.chroma.blue, &working.chroma.red].map(|c| f32::from(c[v * stride + u]) - 128.0);
                carpet::Sample::new(f32::from(contrast.half[v * contrast.width + u]) * 0.25, chroma)
            })
        };
        learning.learn((0..rows).flat_map(|row| (0..columns).step_by(2).filter_map(move |column| sample(row, column))))
    }
}

/// The robot's own body stands before the floor.
fn hide_body(body: &BodyMask, surfaces: &mut [carpet::Surface], half_width: usize, scale: WorkingScale) {
    for (index, surface) in surfaces.iter_mut().enumerate() {
        let (u, v) = (index % half_width, index / half_width);
        if body.hides(scale.undo(DVec2::new(2.0 * u as f64 + 0.5, 2.0 * v as f64 + 0.5))) {
            *surface = carpet::Surface::Other;
        }
    }
}

/// From full-size pixels to pixels of the reduced picture.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
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

#[cfg(test)]
mod tests;
