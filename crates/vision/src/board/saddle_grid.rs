//! Saddles by their place in the picture, so that those near a place are found without looking at all.

use glam::DVec2;

use super::saddles::Saddle;

/// Side of a cell, pixels. Neighbouring corners of a board are some tens of pixels apart.
const CELL_PX: f64 = 24.0;

/// The saddles of a picture in square cells.
pub(super) struct SaddleGrid<'a> {
    saddles: &'a [Saddle],
    columns: usize,
    rows: usize,
    /// Cell i has `items[starts[i]..starts[i + 1]]`. There is one start more than there are cells.
    starts: Vec<usize>,
    items: Vec<usize>,
}

impl<'a> SaddleGrid<'a> {
    /// Sorts the saddles of a picture of this size.
    pub(super) fn new(saddles: &'a [Saddle], width: usize, height: usize) -> Self {
        let cells = |pixels: usize| (pixels as f64 / CELL_PX) as usize + 1;
        let mut grid =
            Self { saddles, columns: cells(width), rows: cells(height), starts: Vec::new(), items: Vec::new() };
        let mut by_cell: Vec<(usize, usize)> = saddles
            .iter()
            .enumerate()
            .map(|(number, saddle)| {
                let [column, row] = grid.cell(saddle.pixel);
                (row * grid.columns + column, number)
            })
            .collect();
        by_cell.sort_unstable();
        grid.starts =
            (0..=grid.columns * grid.rows).map(|cell| by_cell.partition_point(|(at, _)| *at < cell)).collect();
        grid.items = by_cell.into_iter().map(|(_, number)| number).collect();
        grid
    }

    /// The saddles, in the order in which their numbers count them.
    pub(super) fn saddles(&self) -> &'a [Saddle] {
        self.saddles
    }

    /// Numbers and distances of the saddles at most `reach` pixels from a place, in no order.
    pub(super) fn within(&self, place: DVec2, reach: f64) -> impl Iterator<Item = (f64, usize)> {
        let [left, top] = self.cell(place - reach);
        let [right, bottom] = self.cell(place + reach);
        let rows = (top..=bottom).map(move |row| row * self.columns + left..row * self.columns + right + 1);
        let numbers = rows.flat_map(|cells| &self.items[self.starts[cells.start]..self.starts[cells.end]]);
        numbers
            .map(move |number| (self.saddles[*number].pixel.distance(place), *number))
            .filter(move |(distance, _)| *distance <= reach)
    }

    /// Column and row of the cell of a place; beyond the picture those of the nearest cell.
    fn cell(&self, place: DVec2) -> [usize; 2] {
        // A cast takes what is below zero as zero.
        let index = |pixels: f64, count: usize| ((pixels / CELL_PX) as usize).min(count - 1);
        [index(place.x, self.columns), index(place.y, self.rows)]
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn as_many_are_found_as_by_looking_at_all(
            places in prop::collection::vec((-1.5..321.5f64, -1.5..241.5f64), 0..200),
            (x, y, reach) in (-50.0..400.0f64, -50.0..300.0f64, 0.0..200.0f64),
        ) {
            let edges = [DVec2::X, DVec2::Y];
            let saddles: Vec<Saddle> =
                places.iter().map(|(x, y)| Saddle { pixel: DVec2::new(*x, *y), edges }).collect();
            let place = DVec2::new(x, y);
            let grid = SaddleGrid::new(&saddles, 320, 240);
            let mut found: Vec<usize> = grid.within(place, reach).map(|(_, number)| number).collect();
            found.sort_unstable();
            let is_near = |number: &usize| saddles[*number].pixel.distance(place) <= reach;
            prop_assert_eq!(found, (0..saddles.len()).filter(is_near).collect::<Vec<_>>());
        }
    }
}
