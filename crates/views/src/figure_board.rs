//! A figure of a source drawn into a view, as an upright board at the place where the figure stands.

use glam::{DMat3, DVec2, DVec3};

use super::Candidate;
use super::camera::{AREA, CELL};
use super::compose::Composed;
use super::figures::{Figures, fill_gaps};
use super::optical;
use super::photometry::{Gain, Vignetting};
use super::raster::{NOTHING, Raster, UNSURE};
use super::sample::read_cell;
use super::target_rays::{Target, cells, corners, interpolate_cell};
use super::world::Surface;

/// One figure of a source, as it is drawn into a view.
pub(super) struct FigureBoard<'a> {
    target: &'a Target<'a>,
    source: &'a Candidate<'a>,
    figures: &'a Figures,
    figure: usize,
    /// Position of the source's camera in `map`, metres.
    place: DVec3,
    map_from_source: DMat3,
    /// Point on the ground and horizontal unit normal of the board, in `map`.
    foot: DVec2,
    normal: DVec2,
    /// Factors for red, green and blue that make the source as bright as the view.
    factors: [f32; 3],
}

/// A block whose mean colour differs by more than this in one channel from what is behind it shows the figure: more than the
/// noise and texture of carpet and walls in the mean of a block.
const DIFFERENCE: i32 = 20;
/// Gaps of up to this many blocks belong to the body around them.
const GAP_BLOCKS: usize = 6;
/// What is behind is read over this many pixels to each side.
const READ_PX: usize = 1;

impl<'a> FigureBoard<'a> {
    /// A figure of `source`, for the view of `target` with this vignetting.
    pub(super) fn new(
        target: &'a Target<'a>,
        source: &'a Candidate<'a>,
        figure: usize,
        gain: &Gain,
        wanted: &Vignetting,
    ) -> Self {
        let pose = optical(&source.map_from_link);
        let figures = source.image.figures();
        let foot = figures.foot(figure);
        let normal = (foot - pose.translation.truncate()).normalize_or(DVec2::X);
        let mut board = Self {
            target,
            source,
            figures,
            figure,
            place: pose.translation,
            map_from_source: DMat3::from_quat(pose.rotation),
            foot,
            normal,
            factors: [1.0; 3],
        };
        let light = board.light_at_foot(wanted);
        board.factors = gain.rgb.map(|gain| (gain * light) as f32);
        board
    }

    /// Distance between the wanted camera and the figure's foot, metres.
    pub(super) fn distance_m(&self) -> f64 {
        self.foot.distance(self.target.place.truncate())
    }

    /// Where the figure stands in `map`, metres.
    pub(super) fn foot(&self) -> DVec2 {
        self.foot
    }

    /// Relative illumination of the view by that of the source, where both show the foot.
    fn light_at_foot(&self, wanted: &Vignetting) -> f64 {
        let camera = self.target.camera();
        let foot = self.foot.extend(0.0);
        let here = camera.projector().project(self.target.optical_from_map(foot - self.target.place));
        let there = self.source.camera.projector().project(self.map_from_source.transpose() * (foot - self.place));
        let (Some(here), Some(there)) = (here, there) else { return 1.0 };
        wanted.at(camera.lens(), here.x, here.y)
            / self.source.vignetting.at(self.source.camera.lens(), there.x, there.y)
    }

    /// Draws the figure, where it differs from `behind`, the view without figures. Pixels that show it become unsure.
    ///
    /// Returns the number of pixels drawn.
    pub(super) fn draw(&self, behind: &Raster, composed: &mut Composed) -> usize {
        let body = self.body(behind);
        let Some([low, high]) = self.bounds(&body) else { return 0 };
        let camera = self.target.camera();
        let (columns, rows) = camera.cells();
        let inside = |(column, row): &(usize, usize)| {
            (low[0] / CELL..=high[0] / CELL).contains(column) && (low[1] / CELL..=high[1] / CELL).contains(row)
        };
        let mut drawn = 0;
        for cell in cells(columns, rows).filter(inside) {
            let [us, vs] = self.map(cell);
            let pixels = read_cell(self.source.image.full(), &us, &vs);
            for i in 0..AREA {
                let (u, v) = (cell.0 * CELL + i % CELL, cell.1 * CELL + i / CELL);
                if u >= camera.width() || v >= camera.height() || us[i].is_nan() || pixels[i][3] == NOTHING {
                    continue;
                }
                let shows = body.is_body((us[i] + 0.5) as usize, (vs[i] + 0.5) as usize);
                let at = v * camera.width() + u;
                if shows && camera.shows()[at] && !self.is_behind_goal(u, v) {
                    composed.image.pixels[at] = self.lit(pixels[i]);
                    drawn += 1;
                }
            }
        }
        drawn
    }

    /// The blocks of the figure that show it, and not what is behind it.
    fn body(&self, behind: &Raster) -> Body {
        let side = self.figures.side();
        let (width, height) = (self.source.camera.width(), self.source.camera.height());
        let mut body = Body::new(side, width.div_ceil(side), height.div_ceil(side));
        for (column, row) in self.figures.blocks(self.figure) {
            body.own[row * body.columns + column] = true;
            if self.shows_figure((column * side, row * side), behind) {
                body.shown[row * body.columns + column] = true;
            }
        }
        body.widen();
        body
    }

    /// Whether a block, given by its first pixel, differs from what the view shows behind it, or that is unknown.
    fn shows_figure(&self, (left, top): (usize, usize), behind: &Raster) -> bool {
        let side = self.figures.side();
        let Some(ray) = self.source.camera.ray(left + side / 2, top + side / 2) else { return false };
        let ray = self.map_from_source * ray;
        let hit = self.target.world.background_from(self.place).hit(ray);
        let seen = ray + hit.inverse_distance * (self.place - self.target.place);
        let Some(at) = self.target.camera().projector().project(self.target.optical_from_map(seen)) else {
            return true;
        };
        let Some(there) = mean(behind, (at.x + 0.5) as usize, (at.y + 0.5) as usize, READ_PX) else { return true };
        let image = self.source.image.full();
        let Some(own) = mean(image, left + side / 2, top + side / 2, side / 2) else { return true };
        (0..3).any(|c| ((own[c] * self.factors[c] - there[c]) as i32).abs() > DIFFERENCE)
    }

    /// The rectangle of the view that shows the body, pixels; `None` if it shows none of it.
    fn bounds(&self, body: &Body) -> Option<[[usize; 2]; 2]> {
        let camera = self.target.camera();
        let (side, margin) = (body.side, 2.0 * body.side as f64);
        let [mut low, mut high] = [DVec2::INFINITY, DVec2::NEG_INFINITY];
        for index in (0..body.shown.len()).filter(|index| body.shown[*index]) {
            let (u, v) = (index % body.columns * side + side / 2, index / body.columns * side + side / 2);
            let Some(ray) =
                self.source.camera.ray(u.min(self.source.camera.width() - 1), v.min(self.source.camera.height() - 1))
            else {
                continue;
            };
            let Some(point) = self.meet(self.place, self.map_from_source * ray) else { continue };
            let seen = self.target.optical_from_map(point - self.target.place);
            if let Some(at) = camera.projector().project(seen) {
                (low, high) = (low.min(at - margin), high.max(at + margin));
            }
        }
        let last = DVec2::new(camera.width() as f64 - 1.0, camera.height() as f64 - 1.0);
        let (low, high) = (low.max(DVec2::ZERO), high.min(last));
        low.cmple(high).all().then(|| [low, high].map(|at| [at.x as usize, at.y as usize]))
    }

    /// Where a ray from a camera meets the board, in `map`.
    fn meet(&self, camera: DVec3, ray: DVec3) -> Option<DVec3> {
        let distance = self.normal.dot(self.foot - camera.truncate()) / self.normal.dot(ray.truncate());
        (distance > 0.0 && distance.is_finite()).then(|| camera + ray * distance)
    }

    /// Where the source shows the point of the board that a ray of the view meets.
    fn source_pixel(&self, ray: DVec3) -> Option<DVec2> {
        let point = self.meet(self.target.place, ray)?;
        self.source.camera.projector().project(self.map_from_source.transpose() * (point - self.place))
    }

    /// Source coordinates of the pixels of a cell; NaN where the source does not show the board.
    fn map(&self, cell: (usize, usize)) -> [[f32; AREA]; 2] {
        let camera = self.target.camera();
        let at = corners(camera.cells().0, cell);
        let pixel = |ray: Option<DVec3>| ray.and_then(|ray| self.source_pixel(ray)).unwrap_or(DVec2::NAN).as_vec2();
        let [a, b, c, d] = at.map(|corner| pixel(self.target.nodes[corner].map(|(ray, _)| ray)));
        if !(a + b + c + d).is_nan() {
            return [interpolate_cell([a.x, b.x, c.x, d.x]), interpolate_cell([a.y, b.y, c.y, d.y])];
        }
        let own = |i: usize| {
            let (u, v) = (cell.0 * CELL + i % CELL, cell.1 * CELL + i / CELL);
            let is_inside = u < camera.width() && v < camera.height();
            pixel(is_inside.then(|| self.target.ray_hit(u, v, false)).flatten().map(|(ray, _)| ray))
        };
        let pixels: [_; AREA] = core::array::from_fn(own);
        [pixels.map(|at| at.x), pixels.map(|at| at.y)]
    }

    /// Whether a bar of a goal stands before the board in this pixel of the view.
    fn is_behind_goal(&self, u: usize, v: usize) -> bool {
        if self.target.world.bars().is_empty() {
            return false;
        }
        let Some((ray, hit)) = self.target.ray_hit(u, v, true) else { return false };
        let distance = self.meet(self.target.place, ray).map_or(f64::INFINITY, |at| at.distance(self.target.place));
        hit.surface == Surface::Goal && hit.inverse_distance * distance > 1.0
    }

    /// A pixel of the source as bright as the view.
    fn lit(&self, [red, green, blue, _]: [u8; 4]) -> [u8; 4] {
        let [r, g, b] = self.factors;
        let lit = |value: u8, factor: f32| (f32::from(value) * factor + 0.5).min(255.0) as u8;
        [lit(red, r), lit(green, g), lit(blue, b), UNSURE]
    }
}

/// The blocks of a source that show one figure.
struct Body {
    side: usize,
    columns: usize,
    /// The blocks that are marked as the figure's.
    own: Vec<bool>,
    /// Those of them that differ from what is behind.
    shown: Vec<bool>,
}

impl Body {
    fn new(side: usize, columns: usize, rows: usize) -> Self {
        Self { side, columns, own: vec![false; columns * rows], shown: vec![false; columns * rows] }
    }

    /// Adds the neighbours of shown blocks that are marked as well: a body has soft edges, and parts of the colour of what is behind.
    fn widen(&mut self) {
        fill_gaps(&mut self.shown, self.columns, GAP_BLOCKS);
        let (columns, rows) = (self.columns, self.own.len() / self.columns);
        let near = |at: usize, end: usize| at.saturating_sub(1)..(at + 2).min(end);
        let is_near = |index: usize| {
            near(index / columns, rows)
                .any(|row| self.shown[row * columns..][near(index % columns, columns)].contains(&true))
        };
        self.shown = (0..self.own.len()).map(|index| self.own[index] && is_near(index)).collect();
    }

    fn is_body(&self, u: usize, v: usize) -> bool {
        let (column, row) = (u / self.side, v / self.side);
        column < self.columns && self.shown.get(row * self.columns + column) == Some(&true)
    }
}

/// The mean colour of the pixels within `reach` of one; `None` if one of them shows nothing or lies outside.
fn mean(image: &Raster, u: usize, v: usize, reach: usize) -> Option<[f32; 3]> {
    let (left, top) = (u.checked_sub(reach)?, v.checked_sub(reach)?);
    let side = 2 * reach + 1;
    if left + side > image.width || top + side > image.height {
        return None;
    }
    let mut sum = [0u32; 3];
    for row in image.pixels[top * image.width..].chunks(image.width).take(side) {
        for pixel in &row[left..left + side] {
            if pixel[3] == NOTHING {
                return None;
            }
            (0..3).for_each(|c| sum[c] += u32::from(pixel[c]));
        }
    }
    Some(sum.map(|sum| sum as f32 / (side * side) as f32))
}
