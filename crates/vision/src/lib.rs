//! From a camera image to what it shows of painted field lines.
//!
//! [`Vision::look`] is the whole chain for one frame. It learns the carpet's colour ([`carpet`]) and finds the carpet's border
//! ([`border`]), measures how far each pixel stands out from the carpet around it ([`contrast`]), and reads that contrast at each
//! cell of a square of ground around the robot: the ground table ([`ground`]). [`Observations`] also finds [`Ridge`]s, pixels that look
//! like paint, and has the image in which lines are located to a fraction of a pixel ([`LineImage`]). [`Turning`] estimates how a camera
//! turned between two pictures. The crate is pure and does not know where the robot is: coordinates are those of the image or of
//! `base_footprint`.
//!
//! ```rust
//! use glam::DVec3;
//! use realitysim_geometry::{Euler, Isometry};
//! use realitysim_vision::{Picture, TableQuantity, Vision, VisionSettings};
//!
//! let lens = realitysim_config::load_lens("fisheye-640").expect("a built-in lens").lens;
//! let (reading, line_width_m, tilt_sigma_rad) = (TableQuantity::Contrast, 0.05, 0.012);
//! let settings = VisionSettings { reading, line_width_m, tilt_sigma_rad, reduction: 0 };
//! // A green carpet with a white line that runs straight away from the camera.
//! let is_line = |pixel: i32| (pixel % 640 - 322).abs() < 5;
//! let colour = |pixel: i32| if is_line(pixel) { [225u8, 230, 222] } else { [45, 120, 50] };
//! let picture = Picture::from_rgb(640, 480, &(0..640 * 480).flat_map(colour).collect::<Vec<u8>>()).expect("640 x 480 pixels");
//! // The camera is half a metre above the ground and looks down by 0.3 rad.
//! let footprint_from_camera = Isometry::from_euler(Euler { pitch: 0.3, ..Euler::default() }, DVec3::new(0.0, 0.0, 0.5));
//! let footprint_from_optical = footprint_from_camera * Isometry::link_from_optical();
//! let seen = Vision::new(&lens, settings).look(&picture, &footprint_from_optical, None);
//! assert!(seen.lines().clear_lines().any(|(ground, _)| ground.x > 0.5 && ground.y.abs() < 0.1));
//! ```

mod bilinear;
pub mod board;
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

/// The quantity that the ground table holds: one for each observation model and formula (docs/explanation/paper.md).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TableQuantity {
    /// Line contrast, 0 on plain carpet (corrected Eq. 2).
    Contrast,
    /// Distance to the nearest white cell, in metres on the ground (corrected Eq. 1).
    Nearest,
    /// Blurred gray level (Eq. 2 as printed).
    Gray,
    /// Distance to the nearest white pixel, in pixels of the image (Eq. 1 as printed).
    NearestPixel,
}

/// Half the side of the ground table, in heights of the camera.
///
/// At a distance of seven heights a line of 5 cm is a third of a pixel wide for 200 pixels a radian.
const RANGE_OF_HEIGHT: f64 = 7.3;
/// Smallest and largest half side of the ground table, metres.
const RANGES_M: [f64; 2] = [3.0, 8.0];

/// What one frame shows of the ground. Its buffers can be used again for another frame ([`Vision::look_again`]).
#[derive(Clone, Debug, Default)]
pub struct Observations {
    /// Ground table of the quantity that the observation model weighs particles by ([`VisionSettings::reading`]).
    pub table: GroundTable,
    /// Ground table of line contrast, if `table` holds another quantity. It tells how many of a pose's expected lines are seen.
    pub lines: Option<GroundTable>,
    /// The image in which refinement locates lines.
    pub image: LineImage,
    /// Brightness and fingerprint of the picture.
    pub summary: ImageSummary,
    contrast: LineContrast,
    /// Chroma of the working image.
    chroma: Chroma,
    /// Columns of each row of `chroma`.
    chroma_stride: usize,
    buffers: ground::TableBuffers,
    /// Point of the ground (`base_footprint`, metres) that each coarse cell shows; NaN where it shows none.
    floor: Vec<DVec2>,
    /// Whether the ground point of each coarse cell lies within the carpet's border.
    on_carpet: Vec<bool>,
    reduction: Reduction,
    learning: carpet::Learning,
    border: CarpetBorder,
}

impl Observations {
    /// The ground table of line contrast, whatever the observation model asked for.
    pub fn lines(&self) -> &GroundTable {
        self.lines.as_ref().unwrap_or(&self.table)
    }

    /// Finds the pixels that look like paint of lines `line_width_m` wide on the carpet.
    ///
    /// `footprint_from_optical` is the pose of the camera in `base_footprint`, `pixels_per_radian` its focal length in the full-size image.
    pub fn ridges(&self, footprint_from_optical: &Isometry, pixels_per_radian: f64, line_width_m: f64) -> Vec<Ridge> {
        let detector = ridges::RidgeDetector {
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
        detector.find()
    }

    /// Corners of the visible carpet's convex outline on the ground of `base_footprint`, metres; empty if the border is unknown.
    pub fn border(&self) -> &[DVec2] {
        self.border.corners()
    }
}

/// Image processing for one lens: what does not change from frame to frame.
#[derive(Clone, Debug)]
pub struct Vision {
    projector: Projector,
    settings: VisionSettings,
    reduction: usize,
    /// Rays through the coarse cells of the wide blur, row by row, in `camera_optical_frame`; `None` where the lens draws nothing.
    coarse_rays: Vec<Option<DVec3>>,
    border_rays: border::Rays,
}

/// Settings of the image processing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisionSettings {
    /// Quantity that the ground table holds.
    pub reading: TableQuantity,
    /// Width of the field's painted lines, metres.
    pub line_width_m: f64,
    /// Standard deviation of the camera's roll and pitch, radians. Points on the ground that such an error moves far count less.
    pub tilt_sigma_rad: f64,
    /// Side of the blocks of pixels that are averaged into one pixel of the working image; 0: [`automatic_reduction`].
    pub reduction: usize,
}

/// The reduction, 1 to 8, that leaves about 210 pixels a radian.
///
/// Line contrast is made for lines that are a few pixels wide, so a camera with more pixels is looked at in a smaller copy.
pub fn automatic_reduction(lens: &Lens) -> usize {
    (libm::round(lens.focal() / 210.0) as usize).clamp(1, 8)
}

/// The carpet's colour is learnt from the ground within this distance of the robot, metres.
const LEARN_WITHIN_M: f64 = 2.5;

impl Vision {
    /// Prepares the image processing for a lens.
    pub fn new(lens: &Lens, settings: VisionSettings) -> Self {
        let reduction = if settings.reduction == 0 { automatic_reduction(lens) } else { settings.reduction };
        let (width, height) = (lens.width() as usize / reduction, lens.height() as usize / reduction);
        let scale = WorkingScale::new(reduction);
        let coarse_rays =
            contrast::coarse_centres(width, height).map(|centre| lens.unproject(scale.undo(centre))).collect();
        Self { projector: Projector::new(lens), settings, reduction, coarse_rays, border_rays: border::Rays::default() }
    }

    /// The lens that this was prepared for.
    pub fn lens(&self) -> &Lens {
        self.projector.lens()
    }

    /// The settings that this was prepared with.
    pub fn settings(&self) -> &VisionSettings {
        &self.settings
    }

    /// Finds what one picture shows of the ground.
    ///
    /// `footprint_from_optical` is the pose of the camera in `base_footprint`; `body` masks the pixels that show the robot itself.
    /// A camera that sees no ground gives tables without information.
    pub fn look(&self, picture: &Picture, footprint_from_optical: &Isometry, body: Option<&BodyMask>) -> Observations {
        let mut seen = Observations::default();
        self.look_again(picture, footprint_from_optical, body, &mut seen);
        seen
    }

    /// Does the same as [`Self::look`], with the buffers of an earlier frame, whose content is replaced.
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
            buffers,
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
        border.clear();
        if carpet.is_some() {
            let rays = &self.border_rays;
            border.find(rays, surfaces, contrast.width, &self.projector, footprint_from_optical, scale);
        }
        border.find_inside(floor, on_carpet);
        contrast.finish(surfaces, on_carpet);
        let range_m = table_range_m(footprint_from_optical);
        buffers.map().fill(&self.projector, footprint_from_optical, range_m, border);
        let scales = ground::Scale {
            to_working: scale,
            pixels_per_radian: self.lens().focal(),
            line_width_m: self.settings.line_width_m,
        };
        let full_contrast = buffers.tables(contrast, scales, &self.settings, table, lines);
        image.fill(working, scale, full_contrast, on_carpet);
    }

    /// Intersects the ray of each coarse cell with the ground; NaN where there is no intersection.
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

    /// Learns the carpet's colour near the robot; `None` for a gray picture, or if there is too little green.
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
            // NaN fails this comparison.
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

/// Half the side of the ground table for a camera, metres.
fn table_range_m(footprint_from_optical: &Isometry) -> f64 {
    (RANGE_OF_HEIGHT * footprint_from_optical.translation.z).clamp(RANGES_M[0], RANGES_M[1])
}

/// Marks the half-resolution pixels that show the robot's own body.
fn hide_body(body: &BodyMask, surfaces: &mut [carpet::Surface], half_width: usize, scale: WorkingScale) {
    for (index, surface) in surfaces.iter_mut().enumerate() {
        let (u, v) = (index % half_width, index / half_width);
        if body.hides(scale.undo(DVec2::new(2.0 * u as f64 + 0.5, 2.0 * v as f64 + 0.5))) {
            *surface = carpet::Surface::Other;
        }
    }
}

/// The transformation from pixel coordinates of the full-size image to those of the working image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WorkingScale {
    factor: f64,
    offset: f64,
}

impl WorkingScale {
    /// Makes the transformation for a working image whose pixels are means of `reduction` x `reduction` pixels.
    pub fn new(reduction: usize) -> Self {
        let factor = 1.0 / reduction as f64;
        // The centre of the first reduced pixel lies between the full-size pixels that it averages.
        Self { factor, offset: 0.5 * factor - 0.5 }
    }

    /// Working pixels per full-size pixel.
    pub fn factor(&self) -> f64 {
        self.factor
    }

    /// Turns coordinates of the working image into those of the full-size image.
    pub fn undo(&self, pixel: DVec2) -> DVec2 {
        (pixel - DVec2::splat(self.offset)) / self.factor
    }

    /// Turns coordinates of the full-size image into those of the working image.
    pub fn apply(&self, pixel: DVec2) -> DVec2 {
        pixel * self.factor + DVec2::splat(self.offset)
    }
}

#[cfg(test)]
mod tests;
