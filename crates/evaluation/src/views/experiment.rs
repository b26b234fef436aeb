//! Views against rendered truth, at given distances from their sources, with true poses and images without noise.

use core::f64::consts::TAU;

use glam::DVec3;
use serde::Serialize;

use super::truth_renderer::TruthRenderer;
use realitysim_geometry::{Euler, Field, Isometry, Lens, LensModel, LensParameters};
use realitysim_views::paper::{Correspondences, Posed, correspondences};
use realitysim_views::quadratic::Quadratic;
use realitysim_views::{
    Camera, Candidate, Method, Pyramid, Request, SURE, Similarity, Surface, TagError, Target, ViewError, ViewSettings,
    Vignetting, Warp, World, similarity, view,
};

/// Offset between a view and its sources.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Displacement {
    /// Distance on the ground, metres.
    pub metres: f64,
    /// Difference in yaw, degrees.
    pub yaw_deg: f64,
}

/// Extent of the experiment.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The displacements that are measured.
    pub displacements: Vec<Displacement>,
    /// Number of poses for each displacement.
    pub poses: usize,
}

impl Plan {
    /// Returns all displacements, with eight poses each.
    pub fn full() -> Self {
        let rows = [(0.0, 10.0), (0.1, 0.0), (0.1, 10.0), (0.25, 0.0), (0.25, 10.0), (0.25, 30.0), (0.5, 10.0)];
        let displacements = rows.into_iter().map(|(metres, yaw_deg)| Displacement { metres, yaw_deg }).collect();
        Self { displacements, poses: 8 }
    }

    /// Returns the three displacements that the map of the paper is judged by, and the farthest, with two poses each.
    pub fn quick() -> Self {
        let rows = [(0.0, 10.0), (0.1, 10.0), (0.25, 10.0), (0.5, 10.0)];
        let displacements = rows.into_iter().map(|(metres, yaw_deg)| Displacement { metres, yaw_deg }).collect();
        Self { displacements, poses: 2 }
    }
}

/// Means over the poses of one displacement.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// The displacement.
    pub displacement: Displacement,
    /// Scores of the first source unchanged, over the ground that it shows.
    pub nearest: Scores,
    /// Scores of the quadratic map of the paper with the first source, over the same ground.
    pub paper: Scores,
    /// Scores of the exact map with the first source, over the same ground.
    pub exact: Scores,
    /// Scores of the exact map with four sources around the view, over the same ground. `covered` is over all ground.
    pub four: Scores,
    /// Root mean square residual of the quadratic map, pixels, fitted to the ground under every eighth pixel.
    pub residual_px: f64,
    /// The same residual, pixels, fitted to a grid of 25 cm on the ground.
    pub residual_25cm_px: f64,
    /// 99 % quantile of the distance between the interpolated and the exact map, pixels.
    pub map_p99_px: f64,
}

/// Similarity of a view to the truth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Scores {
    /// Peak signal-to-noise ratio, dB.
    pub psnr_db: f64,
    /// Mean structural similarity, at most 1.
    pub ssim: f64,
    /// Share of the ground in the view that is shown.
    pub covered: f64,
}

/// Returns the lens of the experiment: an equidistant fisheye with 180 degrees over 640 pixels, as in the design brief
/// of the project.
pub fn lens() -> LensParameters {
    let model = LensModel::KannalaBrandt { k: [0.0; 4] };
    LensParameters { width: 640, height: 480, fx: 203.7, fy: 203.7, cx: 319.5, cy: 239.5, model, fov_deg: Some(180.0) }
}

/// Height of the camera, metres.
const HEIGHT_M: f64 = 0.55;
/// Pitch of the camera, 30 degrees down, radians.
const PITCH_RAD: f64 = 30.0 / 180.0 * core::f64::consts::PI;

/// Runs the experiment. `progress` is called with the number of poses that are done and that of all poses.
pub fn displacements(field: &Field, plan: &Plan, progress: &mut dyn FnMut(u64, u64)) -> Result<Vec<Row>, ViewError> {
    let Ok(lens) = Lens::new(lens()) else { return Ok(Vec::new()) };
    let bench = Bench {
        camera: Camera::new(&lens),
        world: World::without_goals(field),
        lawn: TruthRenderer::new(field, &lens, false),
    };
    let total = (plan.displacements.len() * plan.poses) as u64;
    let mut done = 0;
    let mut rows = Vec::new();
    for displacement in &plan.displacements {
        let mut all = Vec::new();
        for index in 0..plan.poses {
            all.push(bench.row(*displacement, index)?);
            done += 1;
            progress(done, total);
        }
        rows.push(mean(&all));
    }
    Ok(rows)
}

/// Camera, world and renderer of the experiment.
struct Bench {
    camera: Camera,
    world: World,
    lawn: TruthRenderer,
}

impl Bench {
    /// Measures one pose at one displacement.
    fn row(&self, displacement: Displacement, index: usize) -> Result<Row, ViewError> {
        let Displacement { metres, yaw_deg } = displacement;
        // Poses are evenly spread, and the same on every machine.
        let part = |step: f64| ((index as f64 + 0.5) * step).fract();
        let (x, y, yaw) = (4.0 * (part(0.618_034) - 0.5), 2.4 * (part(0.754_878) - 0.5), TAU * part(0.569_840));
        let wanted = pose(x, y, yaw);
        let (truth, ground) = self.lawn.render(&wanted);
        let around = TAU * part(0.430_159);
        let sources: Vec<(Isometry, Pyramid)> = (0..4)
            .map(|which| {
                let (sin, cos) = libm::sincos(around + f64::from(which) * core::f64::consts::FRAC_PI_2);
                let turn = if which % 2 == 0 { yaw_deg } else { -yaw_deg };
                let pose = pose(x + metres * cos, y + metres * sin, yaw + turn.to_radians());
                (pose, Pyramid::new(self.lawn.render(&pose).0))
            })
            .collect();
        let candidates: Vec<Candidate> = sources
            .iter()
            .enumerate()
            .map(|(id, (map_from_link, image))| Candidate {
                id: id as u64,
                camera: &self.camera,
                map_from_link: *map_from_link,
                image,
                tag: TagError::default(),
                vignetting: Vignetting::default(),
            })
            .collect();
        let target = Target::new(&self.camera, &wanted, &self.world);
        let warp = Warp::new(&target, &candidates[0]);
        let width = self.camera.width();
        let places: Vec<_> = (0..ground.len()).map(|i| (warp.pixel(i % width, i / width), i)).collect();
        let seen: Vec<bool> =
            places.iter().map(|(at, _)| at.is_some_and(|(at, _)| self.camera.lens().contains(at))).collect();
        let score = |method: Method, count: usize| -> Result<Scores, ViewError> {
            let settings = ViewSettings { stored_within_m: -1.0, ..ViewSettings::default() };
            let (camera, world) = (&self.camera, &self.world);
            let vignetting = Vignetting::default();
            let request = Request { camera, map_from_link: wanted, method, world, vignetting, settings };
            let answer = view(&request, &candidates[..count])?;
            let shown: Vec<bool> = answer.image.pixels.iter().map(|pixel| pixel[3] == SURE).collect();
            let both: Vec<bool> = shown.iter().zip(&seen).map(|(shown, seen)| *shown && *seen).collect();
            let of = |mask: &[bool]| similarity(&truth.pixels, &answer.image.pixels, width, &ground, mask);
            let Similarity { psnr_db, ssim, .. } = of(&both);
            Ok(Scores { psnr_db, ssim, covered: of(&shown).compared })
        };
        let [from, to] = [sources[0].0, wanted].map(|map_from_link| Posed { camera: &self.camera, map_from_link });
        let residual = |how| -> Result<f64, ViewError> {
            Ok(Quadratic::fit(&correspondences(&from, &to, &self.world, how))?.residual().rms_px)
        };
        let mut off: Vec<f64> = places
            .iter()
            .filter(|(_, i)| seen[*i])
            .filter_map(|(exact, i)| Some((exact.as_ref()?, warp.interpolated(i % width, i / width)?)))
            .filter(|((_, surface), _)| *surface == Surface::Ground)
            .map(|((exact, _), (found, _))| exact.distance(found))
            .collect();
        off.sort_by(f64::total_cmp);
        Ok(Row {
            displacement,
            nearest: score(Method::Nearest, 1)?,
            paper: score(Method::Paper, 1)?,
            exact: score(Method::Exact, 1)?,
            four: score(Method::Exact, 4)?,
            residual_px: residual(Correspondences::InImage { spacing_px: 8 })?,
            residual_25cm_px: residual(Correspondences::OnGround { spacing_m: 0.25 })?,
            map_p99_px: off.get(off.len() * 99 / 100).copied().unwrap_or(0.0),
        })
    }
}

fn pose(x: f64, y: f64, yaw: f64) -> Isometry {
    Isometry::from_euler(Euler { yaw, pitch: PITCH_RAD, roll: 0.0 }, DVec3::new(x, y, HEIGHT_M))
}

/// Averages the rows of one displacement.
fn mean(rows: &[Row]) -> Row {
    let count = rows.len().max(1) as f64;
    let of = |value: &dyn Fn(&Row) -> f64| rows.iter().map(value).sum::<f64>() / count;
    let scores = |which: &dyn Fn(&Row) -> Scores| Scores {
        psnr_db: of(&|row| which(row).psnr_db),
        ssim: of(&|row| which(row).ssim),
        covered: of(&|row| which(row).covered),
    };
    Row {
        displacement: rows[0].displacement,
        nearest: scores(&|row| row.nearest),
        paper: scores(&|row| row.paper),
        exact: scores(&|row| row.exact),
        four: scores(&|row| row.four),
        residual_px: of(&|row| row.residual_px),
        residual_25cm_px: of(&|row| row.residual_25cm_px),
        map_p99_px: of(&|row| row.map_p99_px),
    }
}
