//! Coverage of a database, for the questions that people have: where are images, where would views be good, where to walk next?

use core::f64::consts::TAU;

use glam::DVec2;
use image::{Rgb, RgbImage};
use serde::Serialize;

use super::beside;
use super::canvas::{Canvas, Ink};
use super::plot::{Plot, TEXT};
use super::text;
use realitysim_geometry::{Field, PoseGrid};
use realitysim_views::FAR_M;

/// Width of each of the two maps, pixels.
const WIDTH_PX: u32 = 860;
const PAGE: [u8; 3] = [255, 255, 255];
const LINE: [u8; 3] = [120, 150, 120];
/// Colour of headings without an image.
const MISSING: [u8; 3] = [226, 229, 226];
const CARPET: [u8; 3] = [246, 248, 246];
/// Colours of headings with one image and with the most images; those between are mixed on a logarithmic scale.
const ONE: [f64; 3] = [150.0, 205.0, 150.0];
const MANY: [f64; 3] = [10.0, 95.0, 45.0];
/// Side of a cell of the guide, metres.
const GUIDE_CELL_M: f64 = 0.25;
/// Headings that the guide tells apart.
const GUIDE_HEADINGS: usize = 12;
/// Shares of the headings, up to which the guide has a colour each, and these colours.
const GUIDE_STEPS: [(f64, [u8; 3]); 5] = [
    (0.0, [236, 160, 140]),
    (0.25, [246, 226, 180]),
    (0.5, [215, 234, 190]),
    (0.75, [120, 188, 112]),
    (1.0, [26, 122, 62]),
];
/// Distance to the nearest image, metres, from which a heading is a gap: half of that at which the service refuses a view.
const GAP_M: f64 = FAR_M / 2.0;
/// Radius around a proposed place whose gaps it closes, metres.
const REACH_M: f64 = 0.75;
/// Number of places that are proposed.
const PLACES: usize = 3;
/// Smallest share of headings missing around a place that is worth a walk.
const WORTH_SHARE: f64 = 0.1;
const PLACE: [u8; 3] = [30, 60, 200];

/// Distance from each cell and heading of the carpet to the nearest image that looks the same way.
#[derive(Clone, Debug, PartialEq)]
pub struct WalkGuide {
    columns: usize,
    rows: usize,
    half: DVec2,
    /// Distances, metres, by row, column, heading; [`f64::INFINITY`] if no image is within reach.
    distances_m: Vec<f64>,
}

/// A place where more images would help most.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WalkPlace {
    /// Position in `map`, metres.
    pub x: f64,
    /// Position in `map`, metres.
    pub y: f64,
    /// Share of the headings around it, 0 to 1, without an image within half a metre.
    pub missing: f64,
}

impl WalkGuide {
    /// Measures the distances from the images that a grid of any step counts. An image is taken to stand in the middle of its cell.
    ///
    /// It counts for its own heading and both neighbours, 15 to 45 degrees away: a view of it shows most of what is asked for.
    pub fn new(grid: &PoseGrid) -> Self {
        let half = grid.half_extent();
        let [columns, rows] = [half.x, half.y].map(|half| (libm::ceil(2.0 * half / GUIDE_CELL_M) as usize).max(1));
        let distances_m = vec![f64::INFINITY; columns * rows * GUIDE_HEADINGS];
        let mut guide = Self { columns, rows, half, distances_m };
        let mut is_filled = vec![false; columns * rows * GUIDE_HEADINGS];
        for (index, _) in grid.counts().iter().enumerate().filter(|(_, count)| **count > 0) {
            let (cell, heading) = (index / grid.sectors, (index % grid.sectors) as f64 + 0.5);
            let centre =
                DVec2::new((cell % grid.columns) as f64 + 0.5, (cell / grid.columns) as f64 + 0.5) * grid.cell_m;
            let heading = (heading / grid.sectors as f64 * GUIDE_HEADINGS as f64) as usize;
            is_filled[guide.cell_at(centre - half) * GUIDE_HEADINGS + heading.min(GUIDE_HEADINGS - 1)] = true;
        }
        let reach = libm::ceil(FAR_M / GUIDE_CELL_M) as isize;
        for (index, _) in is_filled.iter().enumerate().filter(|(_, filled)| **filled) {
            let (cell, heading) = (index / GUIDE_HEADINGS, index % GUIDE_HEADINGS);
            guide.spread((cell % columns) as isize, (cell / columns) as isize, heading, reach);
        }
        guide
    }

    fn cell_at(&self, place: DVec2) -> usize {
        let cell = (place + self.half) / GUIDE_CELL_M;
        let (column, row) = (cell.x as usize, cell.y as usize);
        row.min(self.rows - 1) * self.columns + column.min(self.columns - 1)
    }

    /// Lowers the distances around a cell with an image.
    fn spread(&mut self, column: isize, row: isize, heading: usize, reach: isize) {
        for (dx, dy) in (-reach..=reach).flat_map(|dx| (-reach..=reach).map(move |dy| (dx, dy))) {
            let (x, y) = (column + dx, row + dy);
            if x < 0 || y < 0 || x >= self.columns as isize || y >= self.rows as isize {
                continue;
            }
            let distance_m = GUIDE_CELL_M * libm::hypot(dx as f64, dy as f64);
            for turn in [GUIDE_HEADINGS - 1, 0, 1] {
                let at = (y as usize * self.columns + x as usize) * GUIDE_HEADINGS + (heading + turn) % GUIDE_HEADINGS;
                self.distances_m[at] = self.distances_m[at].min(distance_m);
            }
        }
    }

    fn of_cell(&self, cell: usize) -> &[f64] {
        &self.distances_m[cell * GUIDE_HEADINGS..(cell + 1) * GUIDE_HEADINGS]
    }

    fn centre(&self, cell: usize) -> DVec2 {
        let (column, row) = (cell % self.columns, cell / self.columns);
        DVec2::new(column as f64 + 0.5, row as f64 + 0.5) * GUIDE_CELL_M - self.half
    }

    /// Returns the places where a turn on the spot closes the most gaps, the best first; at most three.
    pub fn places(&self) -> Vec<WalkPlace> {
        let count = self.columns * self.rows;
        let is_gap = |distance: &&f64| **distance > GAP_M;
        let mut gaps: Vec<usize> = (0..count).map(|cell| self.of_cell(cell).iter().filter(is_gap).count()).collect();
        let reach = libm::floor(REACH_M / GUIDE_CELL_M) as isize;
        let mut places = Vec::new();
        while places.len() < PLACES {
            let best = (0..count).map(|cell| (self.near(cell, reach).map(|near| gaps[near]).sum::<usize>(), cell));
            // Of equally good places the one nearest to the centre of the field is taken.
            let Some((sum, cell)) = best.max_by(|a, b| {
                let off = |cell| self.centre(cell).length_squared();
                a.0.cmp(&b.0).then(off(b.1).total_cmp(&off(a.1)))
            }) else {
                break;
            };
            let near: Vec<usize> = self.near(cell, reach).collect();
            let missing = sum as f64 / (near.len() * GUIDE_HEADINGS).max(1) as f64;
            if missing < WORTH_SHARE {
                break;
            }
            let DVec2 { x, y } = self.centre(cell);
            places.push(WalkPlace { x, y, missing });
            // A second place within reach of the first would close the same gaps.
            self.near(cell, 2 * reach).for_each(|near| gaps[near] = 0);
        }
        places
    }

    /// Returns the cells within a circle of `reach` cells around a cell.
    fn near(&self, cell: usize, reach: isize) -> impl Iterator<Item = usize> + use<> {
        let (columns, rows) = (self.columns as isize, self.rows as isize);
        let (column, row) = (cell as isize % columns, cell as isize / columns);
        let offsets = (-reach..=reach).flat_map(move |dx| (-reach..=reach).map(move |dy| (dx, dy)));
        let inside = move |(dx, dy): &(isize, isize)| dx * dx + dy * dy <= reach * reach;
        offsets.filter(inside).filter_map(move |(dx, dy)| {
            let (x, y) = (column + dx, row + dy);
            ((0..columns).contains(&x) && (0..rows).contains(&y)).then_some((y * columns + x) as usize)
        })
    }

    /// Colour of a place: that of the share of headings in which an image is near.
    fn colour(&self, cell: usize) -> [u8; 3] {
        let near = self.of_cell(cell).iter().filter(|distance| **distance <= GAP_M).count();
        let share = near as f64 / GUIDE_HEADINGS as f64;
        GUIDE_STEPS.iter().find(|(most, _)| share <= *most).map_or(CARPET, |(_, colour)| *colour)
    }
}

/// Draws where images are, beside where views would be good and where to walk next, with axes, title and legend.
///
/// On the left each cell of `grid` is a disc whose sectors are headings, darker the more images there are. On the right a place is
/// coloured by the share of headings in which an image was taken near it, and numbers mark the [places](WalkGuide::places).
pub fn coverage_map(grid: &PoseGrid, field: &Field) -> RgbImage {
    let guide = WalkGuide::new(grid);
    let images: u64 = grid.counts().iter().map(|count| u64::from(*count)).sum();
    let left = Sheet::new(field).draw(
        &format!("Where are images? {images} by position and heading"),
        &|place, half_pixel| disc_colour(grid, place, half_pixel),
        &disc_legend(grid),
        &[],
    );
    let places = guide.places();
    let mut words = vec![format!(
        "colour: how far away an image was taken that looks the same way (half of all headings); above {FAR_M} m no view is made"
    )];
    words.extend(places.iter().enumerate().map(|(rank, place)| {
        let WalkPlace { x, y, missing } = place;
        format!(
            "{}: walk to x {x:.1}, y {y:.1} m and turn around: {:.0} % of the headings are missing",
            rank + 1,
            100.0 * missing
        )
    }));
    if places.is_empty() {
        words.push("nothing is missing: nearly every heading has an image within half a metre".to_owned());
    }
    let label = |most: f64| if most == 0.0 { "none".to_owned() } else { format!("up to {:.0} %", 100.0 * most) };
    let legend = GUIDE_STEPS.iter().map(|(most, colour)| (*colour, label(*most))).collect();
    let right = Sheet::new(field).draw(
        "Where would views be good, where to walk next?",
        &|place, _| guide.colour(guide.cell_at(place)),
        &Legend { entries: legend, words },
        &places,
    );
    beside(&left, &right)
}

/// Colour of a point of the map of images.
fn disc_colour(grid: &PoseGrid, place: DVec2, half_pixel: f64) -> [u8; 3] {
    let cell = (place + grid.half_extent()) / grid.cell_m;
    let (column, row) = ((cell.x as usize).min(grid.columns - 1), (cell.y as usize).min(grid.rows - 1));
    let off = cell - DVec2::new(column as f64 + 0.5, row as f64 + 0.5);
    if off.length() * grid.cell_m > grid.cell_m / 2.0 - half_pixel {
        return CARPET;
    }
    match grid.count(column, row, libm::atan2(off.y, off.x).rem_euclid(TAU)) {
        0 => MISSING,
        count => images_colour(count, most_of(grid)),
    }
}

fn most_of(grid: &PoseGrid) -> u32 {
    grid.counts().iter().copied().max().unwrap_or(0).max(2)
}

fn images_colour(count: u32, most: u32) -> [u8; 3] {
    let share = (libm::log(f64::from(count)) / libm::log(f64::from(most))).clamp(0.0, 1.0);
    core::array::from_fn(|channel| (ONE[channel] + (MANY[channel] - ONE[channel]) * share) as u8)
}

/// What the colours of a map mean, and words below.
struct Legend {
    entries: Vec<([u8; 3], String)>,
    words: Vec<String>,
}

fn disc_legend(grid: &PoseGrid) -> Legend {
    let most = most_of(grid);
    let mut entries = vec![(MISSING, "none".to_owned()), (images_colour(1, most), "1 image".to_owned())];
    entries.push((images_colour(most, most), format!("{most} images")));
    let heading_deg = 360.0 / grid.sectors as f64;
    let share = 100.0 * grid.filled as f64 / grid.cells.max(1) as f64;
    let mut words = vec![format!(
        "each disc is a place of {} m; its sectors are headings of {heading_deg:.0} degrees: {} of {} have an image ({share:.1} %)",
        grid.cell_m, grid.filled, grid.cells
    )];
    if grid.outside > 0 {
        words.push(format!("{} images were taken beside the carpet", grid.outside));
    }
    Legend { entries, words }
}

/// A map with title, axes and legend.
struct Sheet<'a> {
    field: &'a Field,
    plot: Plot,
    /// Height of the title, pixels.
    top: f64,
}

impl<'a> Sheet<'a> {
    fn new(field: &'a Field) -> Self {
        let plot = Plot::new(field, WIDTH_PX);
        let top = 2.2 * plot.text_size;
        let shift = DVec2::new(0.0, top);
        Self { field, plot: Plot { low: plot.low + shift, high: plot.high + shift, ..plot }, top }
    }

    fn draw(
        &self,
        title: &str,
        colour: &dyn Fn(DVec2, f64) -> [u8; 3],
        legend: &Legend,
        places: &[WalkPlace],
    ) -> RgbImage {
        let size = self.plot.text_size;
        let room = f64::from(WIDTH_PX) - self.plot.low.x - size;
        let words: Vec<String> = legend.words.iter().flat_map(|line| text::wrap(size, line, room)).collect();
        let lines = words.len() as f64 + 1.0;
        let height = libm::ceil(self.plot.bottom() + (1.45 * lines + 1.2) * size) as u32;
        let Some(mut page) = Canvas::filled(WIDTH_PX, height, PAGE).map(Canvas::into_image) else {
            return RgbImage::new(WIDTH_PX, height);
        };
        self.paint(&mut page, colour);
        let Some(mut canvas) = Canvas::on_top_of(&page) else { return page };
        self.plot.draw_axes(&mut canvas);
        canvas.text(DVec2::new(self.plot.low.x, 0.68 * self.top), 1.15 * size, TEXT, title);
        for (rank, place) in places.iter().enumerate() {
            draw_place(&mut canvas, &self.plot, place, rank + 1);
        }
        let mut baseline = self.plot.bottom() + 1.45 * size;
        let mut x = self.plot.low.x;
        for (colour, label) in &legend.entries {
            let low = DVec2::new(x, baseline - 0.85 * size);
            canvas.fill_rectangle(low, low + DVec2::new(1.6 * size, size), Ink::solid(*colour));
            canvas.text(DVec2::new(x + 2.0 * size, baseline), size, TEXT, label);
            x += 2.0 * size + text::width(size, label) + 1.6 * size;
        }
        for line in &words {
            baseline += 1.45 * size;
            canvas.text(DVec2::new(self.plot.low.x, baseline), size, TEXT, line);
        }
        canvas.into_image()
    }

    /// Paints each pixel of the carpet, with the field's lines over it.
    fn paint(&self, page: &mut RgbImage, colour: &dyn Fn(DVec2, f64) -> [u8; 3]) {
        let half_pixel = 0.7 / self.plot.pixels_per_metre;
        let middle = (self.plot.low + self.plot.high) / 2.0;
        let half_line = (self.field.line_width() / 4.0).max(half_pixel);
        for (u, v, pixel) in page.enumerate_pixels_mut() {
            let at = DVec2::new(f64::from(u) + 0.5, f64::from(v) + 0.5);
            if at.cmplt(self.plot.low).any() || at.cmpge(self.plot.high).any() {
                continue;
            }
            let off = (at - middle) / self.plot.pixels_per_metre;
            let place = DVec2::new(off.x, -off.y);
            let is_line = self.field.distance_to_centre_line(place) <= half_line;
            *pixel = Rgb(if is_line { LINE } else { colour(place, half_pixel) });
        }
    }
}

fn draw_place(canvas: &mut Canvas, plot: &Plot, place: &WalkPlace, rank: usize) {
    let at = plot.pixel(DVec2::new(place.x, place.y));
    canvas.stroke_circle(at, REACH_M * plot.pixels_per_metre, Ink::solid(PLACE).pen(2.0));
    let (size, number) = (1.6 * plot.text_size, rank.to_string());
    let corner = DVec2::new(at.x - text::width(size, &number) / 2.0, at.y + 0.36 * size);
    canvas.text(corner, size, PLACE, &number);
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use realitysim_config::load_field;
    use realitysim_geometry::{Euler, Isometry};

    fn field() -> Field {
        Field::new(load_field("kid-2009").expect("shipped")).expect("checked")
    }

    fn grid() -> PoseGrid {
        PoseGrid::new(field().carpet_half_extent(), GUIDE_CELL_M, GUIDE_HEADINGS)
    }

    fn all_headings(grid: &mut PoseGrid, x: f64, y: f64) {
        for heading in 0..GUIDE_HEADINGS {
            let yaw = TAU * (heading as f64 + 0.5) / GUIDE_HEADINGS as f64;
            grid.add(&Isometry::from_euler(Euler { yaw, ..Euler::default() }, DVec3::new(x, y, 0.5)));
        }
    }

    #[test]
    fn the_first_place_of_an_empty_database_is_the_centre() {
        let guide = WalkGuide::new(&grid());
        let places = guide.places();
        assert_eq!(places.len(), PLACES);
        assert!(places[0].x.hypot(places[0].y) < GUIDE_CELL_M && places[0].missing == 1.0, "{places:?}");
    }

    #[test]
    fn no_place_is_proposed_where_every_heading_has_an_image() {
        let mut grid = grid();
        let half = field().carpet_half_extent();
        let (mut x, step) = (-half.x + 0.1, 0.2);
        while x < 0.0 {
            let mut y = -half.y + 0.1;
            while y < half.y {
                all_headings(&mut grid, x, y);
                y += step;
            }
            x += step;
        }
        let places = WalkGuide::new(&grid).places();
        assert!(!places.is_empty() && places.iter().all(|place| place.x > 0.5), "{places:?}");
    }

    #[test]
    fn a_coverage_map_of_nothing_and_of_odd_grids_is_a_picture() {
        let field = field();
        for (cell_m, sectors) in [(5.0, 1), (0.02, 3), (0.25, 360)] {
            let grid = PoseGrid::new(field.carpet_half_extent(), cell_m, sectors);
            let picture = coverage_map(&grid, &field);
            assert!(picture.width() == 2 * WIDTH_PX && picture.height() > 400);
        }
    }
}
