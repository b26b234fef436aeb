//! The order of the rows of a file: blocks of rows whose poses lie close together.
//!
//! Each block is a row group with statistics of its own, so that a reader passes over those that a range of poses does not touch. The
//! blocks are the leaves of a k-d tree, because a walk covers the field unevenly: cells of equal size would hold few rows or many.

use super::row::{CELL_DEG, CELL_M, CatalogueRow};

/// Puts rows in blocks of `size` rows, the last one smaller. Rows of a block are in time; those without a pose are last.
/// The order depends on the rows alone.
pub(super) fn arrange(rows: &[CatalogueRow], size: usize) -> Vec<&CatalogueRow> {
    let (mut placed, mut unplaced): (Vec<&CatalogueRow>, Vec<_>) = rows.iter().partition(|row| place(row).is_some());
    divide(&mut placed, size);
    unplaced.sort_by_key(in_time);
    placed.extend(unplaced);
    placed
}

/// Halves rows along the axis on which they spread most until a block is left; halves are whole blocks.
fn divide(rows: &mut [&CatalogueRow], size: usize) {
    if rows.len() <= size {
        rows.sort_by_key(in_time);
        return;
    }
    let axis = widest_axis(rows);
    let middle = rows.len().div_ceil(size) / 2 * size;
    rows.select_nth_unstable_by(middle, |a, b| {
        coordinate(a, axis).total_cmp(&coordinate(b, axis)).then_with(|| in_time(a).cmp(&in_time(b)))
    });
    let (low, high) = rows.split_at_mut(middle);
    if is_worth_a_thread(low) {
        std::thread::scope(|scope| {
            scope.spawn(|| divide(low, size));
            divide(high, size);
        });
    } else {
        divide(low, size);
        divide(high, size);
    }
}

/// Whether a half has so many rows that it is worth a thread of its own.
fn is_worth_a_thread(half: &[&CatalogueRow]) -> bool {
    half.len() > 50_000
}

fn widest_axis(rows: &[&CatalogueRow]) -> usize {
    let spread = |axis: usize| {
        let values = || rows.iter().map(|row| coordinate(row, axis));
        values().fold(f32::NEG_INFINITY, f32::max) - values().fold(f32::INFINITY, f32::min)
    };
    (0..3).max_by(|a, b| spread(*a).total_cmp(&spread(*b))).unwrap_or_default()
}

fn coordinate(row: &CatalogueRow, axis: usize) -> f32 {
    place(row).map_or(0.0, |place| place[axis])
}

/// Position and yaw of a row, counted in cells.
fn place(row: &CatalogueRow) -> Option<[f32; 3]> {
    Some([row.x_m? / CELL_M, row.y_m? / CELL_M, row.yaw_deg? / CELL_DEG])
}

fn in_time(row: &&CatalogueRow) -> (i64, i64) {
    (row.stamp_ns, row.sequence)
}
