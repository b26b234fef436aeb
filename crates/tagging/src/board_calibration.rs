//! Calibrates a lens from pictures of a calibration board.
//!
//! Corners are found in each picture without a lens. A first fit of all pictures tells where the other corners lie, those at the rim
//! above all; they are located there, and everything is fitted again (Duisterhof et al. 2022, TartanCalib).

use glam::DVec2;
use thiserror::Error;

use super::calibrated_lens::{CalibratedLens, NEEDED};
use super::walk_calibration::CalibratedConstant;
use realitysim_geometry::{Board, Isometry, Lens, LensError, LensModel, LensParameters};
use realitysim_localization::smoothing::NAMES;
use realitysim_localization::smoothing::board::{BoardFit, BoardFitError, BoardView, MIN_CORNERS, fit_board};
use realitysim_localization::smoothing::projection::ImageGrid;
use realitysim_vision::Picture;
use realitysim_vision::board::{BoardCorner, find_corners, refine_corner, window};

/// Pictures in which the board was found, each from another place.
pub struct BoardPictures {
    board: Board,
    believed: LensParameters,
    views: Vec<(Picture, Vec<BoardCorner>)>,
    /// Number of all pictures, and of those in which the board was found.
    counts: [usize; 2],
}

/// What pictures of a board tell of a lens.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardCalibration {
    /// The lens as found, and maps over its image.
    pub image: CalibratedLens,
    /// Each constant of the lens.
    pub constants: Vec<CalibratedConstant>,
    /// Number of all pictures, of those in which the board was found, and of those that took part.
    pub pictures: [usize; 3],
    /// Number of corners, and of those that do not fit.
    pub corners: [usize; 2],
    /// Largest angle off the axis at which corners were seen, radians.
    pub farthest_rad: f64,
}

/// Why pictures of a board give no calibration.
#[derive(Debug, Error)]
pub enum BoardCalibrationError {
    /// A picture has another size than those before it.
    #[error("it has {} x {} pixels, and those before it {} x {}: all pictures of a calibration have one size", found[0], found[1], wanted[0], wanted[1])]
    Size {
        /// Width and height of the picture, pixels.
        found: [usize; 2],
        /// Width and height of the lens's image, pixels.
        wanted: [u32; 2],
    },
    /// The board was found in too few pictures.
    #[error(
        "the board was found in {found} of {pictures} pictures, {used} of them from different places, and {MIN_VIEWS} are needed: \
         check the board file (family, columns, rows), light and focus, and move the board, or the camera, between pictures"
    )]
    FewViews {
        /// Number of all pictures.
        pictures: usize,
        /// Number of pictures with the board.
        found: usize,
        /// Number of those from different places.
        used: usize,
    },
    /// The corners do not lie where any lens draws them.
    #[error(
        "the corners lie {rms_px:.1} px (rms) from where the best lens draws them: check tagSpacing or markerSize of the board file, that the \
         board is flat, and that the angle of view is about right (--lens equidistant:180deg)"
    )]
    NoFit {
        /// Root mean square of the residuals, pixels.
        rms_px: f64,
    },
    /// The corners give no lens.
    #[error(transparent)]
    Fit(#[from] BoardFitError),
    /// A lens is not valid.
    #[error("the lens: {0}")]
    Lens(#[from] LensError),
}

/// Fewest pictures of a calibration: each half of them must determine the lens.
const MIN_VIEWS: usize = 8;
/// Most pictures that take part; they are kept in memory.
const MAX_VIEWS: usize = 150;
/// Mean movement of the corners between two pictures that both take part, as a share of the image's width.
const MIN_MOVE_SHARE: f64 = 0.02;
/// Farthest that a corner lies from where the first fit draws it, pixels.
const OUTLIER_PX: f64 = 1.5;
/// Largest root mean square of the residuals of a fit to the corners as they were first found, pixels.
const REFUSED_RMS_PX: f64 = 2.0;
/// Largest root mean square of the residuals of the last fit, pixels: corners of a board that is as its file says lie within a third.
const LAST_RMS_PX: f64 = 0.6;
/// Rounds in which corners are sought where the fit draws them.
const ROUNDS: usize = 2;

impl BoardPictures {
    /// Begins without any picture. `believed` is the lens to start with; its stated field of view is not used.
    pub fn new(board: Board, believed: LensParameters) -> Self {
        let believed = LensParameters { fov_deg: None, ..believed };
        Self { board, believed, views: Vec::new(), counts: [0; 2] }
    }

    /// Looks for the board in a picture, and keeps the picture if it shows the board from a new place.
    ///
    /// # Errors
    ///
    /// [`BoardCalibrationError::Size`] if the picture is not of the lens's size.
    pub fn add(&mut self, picture: Picture) -> Result<(), BoardCalibrationError> {
        let LensParameters { width, height, .. } = self.believed;
        if [picture.width, picture.height] != [width as usize, height as usize] {
            let (found, wanted) = ([picture.width, picture.height], [width, height]);
            return Err(BoardCalibrationError::Size { found, wanted });
        }
        self.counts[0] += 1;
        let corners = find_corners(&picture, &self.board);
        if corners.len() < MIN_CORNERS {
            return Ok(());
        }
        self.counts[1] += 1;
        let least_px = MIN_MOVE_SHARE * f64::from(width);
        if self.views.len() < MAX_VIEWS && self.views.iter().all(|(_, others)| moved_px(&corners, others) > least_px) {
            self.views.push((picture, corners));
        }
        Ok(())
    }

    /// Fits the lens to the corners of all pictures that were kept.
    ///
    /// # Errors
    ///
    /// A [`BoardCalibrationError`] if there are too few pictures or no lens fits them.
    pub fn calibrate(&self) -> Result<BoardCalibration, BoardCalibrationError> {
        let [pictures, found] = self.counts;
        if self.views.len() < MIN_VIEWS {
            return Err(BoardCalibrationError::FewViews { pictures, found, used: self.views.len() });
        }
        let corner = |corner: &BoardCorner| (self.board.corners_m[corner.number], corner.pixel);
        let first =
            |(_, corners): &(Picture, Vec<BoardCorner>)| BoardView { corners: corners.iter().map(corner).collect() };
        let mut views: Vec<BoardView> = self.views.iter().map(first).collect();
        let mut fit = fit_board(&views, &self.believed)?;
        for _ in 0..ROUNDS {
            if fit.rms_px > REFUSED_RMS_PX {
                return Err(BoardCalibrationError::NoFit { rms_px: fit.rms_px });
            }
            let lens = Lens::new(fit.lens.clone())?;
            let poses = self.views.iter().zip(&fit.optical_from_board);
            views = poses.map(|((picture, _), pose)| self.seek(picture, &lens, pose)).collect();
            views.retain(|view| view.corners.len() >= MIN_CORNERS);
            if views.len() < self.views.len() {
                // A picture without corners where the fit draws them has no part in it, and the others keep their first corners.
                views = self.views.iter().map(first).collect();
                break;
            }
            fit = fit_board(&views, &self.believed)?;
        }
        if fit.rms_px > LAST_RMS_PX {
            return Err(BoardCalibrationError::NoFit { rms_px: fit.rms_px });
        }
        self.assess(&views, fit)
    }

    /// The corners that a picture has where a fit draws them.
    fn seek(&self, picture: &Picture, lens: &Lens, pose: &Isometry) -> BoardView {
        let Self { board, .. } = self;
        let side_m = board.markers.first().map_or(0.0, |marker| {
            let [left, right, ..] = marker.corners;
            board.corners_m[left].distance(board.corners_m[right])
        });
        let draw = |at: DVec2| lens.project(pose.transform_point(at.extend(0.0)));
        let corner = |point: &DVec2| {
            let drawn = draw(*point)?;
            let side = |axis: DVec2| Some(draw(*point + axis * side_m)?.distance(drawn));
            let half_px = window(board, side(DVec2::X)?.min(side(DVec2::Y)?))?;
            let pixel = refine_corner(picture, drawn, half_px)?;
            (pixel.distance(drawn) < OUTLIER_PX).then_some((*point, pixel))
        };
        BoardView { corners: board.corners_m.iter().filter_map(corner).collect() }
    }

    fn assess(&self, views: &[BoardView], fit: BoardFit) -> Result<BoardCalibration, BoardCalibrationError> {
        let half = |first: usize| -> Vec<BoardView> { views.iter().skip(first).step_by(2).cloned().collect() };
        let [one, other] = [fit_board(&half(0), &fit.lens)?, fit_board(&half(1), &fit.lens)?];
        let halves = [(one.lens, &one.covariance), (other.lens, &other.covariance)];
        let maps = |grid: &ImageGrid| grid.bias(&fit.residuals, fit.rms_px);
        let image = CalibratedLens::new((fit.lens.clone(), &fit.covariance), halves, fit.rms_px, maps)?;
        let values = fit.constants.values();
        let sought = (0..NAMES.len()).filter(|at| fit.known[*at] > 0.0);
        let constants = sought.map(|at| CalibratedConstant {
            name: NAMES[at].0,
            unit: NAMES[at].1,
            value: values[at],
            sigma: fit.known[at],
            needed: NEEDED[at],
            determined: fit.known[at] < NEEDED[at],
        });
        let lens = Lens::new(fit.lens)?;
        let angle = |pixel: DVec2| lens.unproject(pixel).map_or(0.0, |ray| libm::acos(ray.z.clamp(-1.0, 1.0)));
        let pixels = fit.residuals.iter().flatten().map(|residual| residual.pixel);
        Ok(BoardCalibration {
            constants: constants.collect(),
            image,
            pictures: [self.counts[0], self.counts[1], views.len()],
            corners: fit.corners,
            farthest_rad: pixels.map(angle).fold(0.0, f64::max),
        })
    }
}

impl BoardCalibration {
    /// Whether the pictures determine how the lens projects.
    pub fn determines_lens(&self) -> bool {
        self.constants.iter().all(|constant| constant.determined)
    }

    /// Whether distortion was fitted: other models than Kannala-Brandt keep theirs.
    pub fn fits_distortion(&self) -> bool {
        matches!(self.image.lens.model, LensModel::KannalaBrandt { .. })
    }
}

/// Mean movement of the corners that both pictures show, pixels; infinite if they share none.
fn moved_px(corners: &[BoardCorner], others: &[BoardCorner]) -> f64 {
    let both = corners.iter().filter_map(|corner| {
        let other = others.binary_search_by_key(&corner.number, |other| other.number).ok()?;
        Some(corner.pixel.distance(others[other].pixel))
    });
    let (sum, count) = both.fold((0.0, 0usize), |(sum, count), moved| (sum + moved, count + 1));
    if count == 0 { f64::INFINITY } else { sum / count as f64 }
}
