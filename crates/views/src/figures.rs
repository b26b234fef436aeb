//! The figures that stand on the carpet of a recorded image: which pixels show them, and where they stand.

use glam::DVec2;

/// The figures in one image: robots, people, balls, each a connected region of the image with a place on the ground.
///
/// The regions are known in blocks of `side` x `side` pixels. A view draws a figure as an upright board at its foot, which is
/// right for all of it if the figure is thin compared with its distance.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Figures {
    /// Side of a block, pixels.
    side: usize,
    /// Blocks in a row.
    columns: usize,
    /// For each block: 0, or the number of its figure plus 1.
    labels: Vec<u16>,
    /// Where each figure stands: the point of the ground nearest to the camera, in `map`, metres.
    feet: Vec<DVec2>,
}

impl Figures {
    /// Separates marked blocks into connected regions. `foot` gives the point of the ground that a block shows, if an obstacle
    /// stands there; a region without one has no place and is no figure. `reaches` says whether a block can be of a body that
    /// stands so far away, metres.
    pub(super) fn of_blocks(
        marked: &[bool],
        (side, columns): (usize, usize),
        camera: DVec2,
        foot: impl Fn(usize) -> Option<DVec2>,
        reaches: impl Fn(usize, f64) -> bool,
    ) -> Self {
        let mut figures = Self { side, columns, labels: vec![0; marked.len()], feet: Vec::new() };
        let mut visited = vec![false; marked.len()];
        for first in 0..marked.len() {
            if !marked[first] || visited[first] || figures.feet.len() + 1 >= usize::from(u16::MAX) {
                continue;
            }
            let region = region(marked, &mut visited, columns, first);
            let distance = |at: &DVec2| at.distance_squared(camera);
            let feet = region.iter().filter_map(|block| foot(*block));
            let Some(nearest) = feet.min_by(|a, b| distance(a).total_cmp(&distance(b))) else { continue };
            figures.feet.push(nearest);
            let label = figures.feet.len() as u16;
            let distance_m = nearest.distance(camera);
            let body = region.into_iter().filter(|block| reaches(*block, distance_m));
            body.for_each(|block| figures.labels[block] = label);
        }
        figures
    }

    /// For each block, row by row: whether it shows a figure.
    pub(super) fn marked(&self) -> impl Iterator<Item = bool> + '_ {
        self.labels.iter().map(|label| *label > 0)
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.feet.is_empty()
    }

    /// Side of a block, pixels.
    pub(super) fn side(&self) -> usize {
        self.side
    }

    /// Where a figure stands, in `map`, metres.
    pub(super) fn foot(&self, figure: usize) -> DVec2 {
        self.feet[figure]
    }

    /// The blocks of a figure as (column, row), row by row.
    pub(super) fn blocks(&self, figure: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        let label = figure as u16 + 1;
        let own = self.labels.iter().enumerate().filter(move |(_, own)| **own == label);
        own.map(|(index, _)| (index % self.columns, index / self.columns))
    }

    /// The figure that a pixel shows.
    pub(super) fn at(&self, u: usize, v: usize) -> Option<usize> {
        let (column, row) = (u / self.side.max(1), v / self.side.max(1));
        let label = self.labels.get(row * self.columns + column).filter(|_| column < self.columns)?;
        usize::from(*label).checked_sub(1)
    }
}

/// Marks the blocks between two marked ones of the same row or column that are at most `reach` apart.
pub(super) fn fill_gaps(marked: &mut [bool], columns: usize, reach: usize) {
    let rows = marked.len() / columns.max(1);
    let mut line = |first: usize, step: usize, count: usize| {
        let mut last = None;
        for at in 0..count {
            if marked[first + at * step] {
                let gap = last.map_or(at..at, |last| last + 1..at);
                if gap.len() < reach {
                    gap.for_each(|between| marked[first + between * step] = true);
                }
                last = Some(at);
            }
        }
    };
    (0..rows).for_each(|row| line(row * columns, 1, columns));
    (0..columns).for_each(|column| line(column, columns, rows));
}

/// The marked blocks that are connected with `first`, diagonals included.
fn region(marked: &[bool], visited: &mut [bool], columns: usize, first: usize) -> Vec<usize> {
    let rows = marked.len() / columns;
    let (mut region, mut next) = (vec![first], 0);
    visited[first] = true;
    while let Some(block) = region.get(next).copied() {
        next += 1;
        let (column, row) = (block % columns, block / columns);
        for r in row.saturating_sub(1)..(row + 2).min(rows) {
            for c in column.saturating_sub(1)..(column + 2).min(columns) {
                let near = r * columns + c;
                if marked[near] && !visited[near] {
                    visited[near] = true;
                    region.push(near);
                }
            }
        }
    }
    region
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_that_do_not_touch_are_figures_of_their_own() {
        // Two regions and a block that stands nowhere, in 6 x 3 blocks of 4 pixels.
        let marked: Vec<bool> = "##..#.\n.#....\n.##..#".chars().filter(|c| *c != '\n').map(|c| c == '#').collect();
        let foot = |block: usize| (block != 4).then(|| DVec2::new((block % 6) as f64, (block / 6) as f64));
        let figures = Figures::of_blocks(&marked, (4, 6), DVec2::new(1.0, 5.0), foot, |block, _| block != 13);
        assert_eq!(figures.feet, [DVec2::new(1.0, 2.0), DVec2::new(5.0, 2.0)]);
        assert_eq!(figures.blocks(0).collect::<Vec<_>>(), [(0, 0), (1, 0), (1, 1), (2, 2)]);
        assert_eq!(
            [figures.at(7, 5), figures.at(23, 11), figures.at(17, 0), figures.at(40, 5)],
            [Some(0), Some(1), None, None]
        );
        let mut gaps: Vec<bool> = "#..#...#".chars().map(|c| c == '#').collect();
        fill_gaps(&mut gaps, 8, 3);
        assert_eq!(gaps, [true, true, true, true, false, false, false, true]);
        assert!(Figures::default().is_empty() && Figures::default().at(3, 3).is_none());
    }
}
