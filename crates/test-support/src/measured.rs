//! The rule that every largest error obeys which a test measures and docs/reference/numerics.md states.

/// Prints the largest error that a test found and compares it with the figure in docs/reference/numerics.md.
///
/// The error must not exceed the figure, and must be at least a tenth of it, or the figure is out of date.
/// `tests/numerics/table.rs` compares figure and unit with the table. With the environment variable `REALITYSIM_MEASURE`
/// set, the function only prints, so that one run shows every change.
///
/// # Panics
///
/// Panics if the error and the figure do not agree.
#[track_caller]
pub fn largest_error(found: f64, figure: f64, unit: &str) {
    println!("largest error found: {found:.3e} {unit}; docs/reference/numerics.md says {figure:e} {unit}");
    if std::env::var_os("REALITYSIM_MEASURE").is_some() {
        return;
    }
    assert!(found <= figure, "{found:.3e} {unit} is more than {figure:e}");
    assert!(found >= figure / 10.0, "{found:.3e} {unit}: {figure:e} is out of date");
}
