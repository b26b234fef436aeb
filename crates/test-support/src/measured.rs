//! One rule for every largest error that a test measures and docs/numerics.md shows; the unit tests of the crate share it.

/// Prints the largest error that was found and holds it to the table's figure: no larger, nor so much smaller that the
/// figure would mislead. `tests/numerics/table.rs` compares figure and unit with the table.
/// `REALITYSIM_MEASURE=1` only prints, so that one run shows all that changed.
#[track_caller]
pub fn largest_error(found: f64, figure: f64, unit: &str) {
    println!("largest error found: {found:.3e} {unit}; docs/numerics.md says {figure:e} {unit}");
    if std::env::var_os("REALITYSIM_MEASURE").is_some() {
        return;
    }
    assert!(found <= figure, "{found:.3e} {unit} is more than {figure:e}");
    assert!(found >= figure / 10.0, "{found:.3e} {unit}: {figure:e} is out of date");
}
