//! Work on many images at once.

use std::thread;

/// Computes a value for each number up to `count`, in order, on all processors.
///
/// # Panics
///
/// If `value` panics.
pub fn in_parallel<T: Send>(count: usize, value: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let threads = thread::available_parallelism().map_or(1, usize::from);
    let share = count.div_ceil(threads).max(1);
    let value = &value;
    thread::scope(|scope| {
        let part =
            |first: usize| scope.spawn(move || (first..(first + share).min(count)).map(value).collect::<Vec<T>>());
        let parts: Vec<_> = (0..count).step_by(share).map(part).collect();
        parts
            .into_iter()
            .flat_map(|part| part.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
            .collect()
    })
}
