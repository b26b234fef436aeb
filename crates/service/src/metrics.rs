//! Counts requests and times views for Prometheus, in its text format 0.0.4.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// The counts of the service.
#[derive(Default)]
pub(super) struct Metrics {
    /// Number of requests by route and status.
    requests: Mutex<BTreeMap<(&'static str, u16), u64>>,
    /// Times of views by how they were made.
    views: Mutex<BTreeMap<&'static str, Histogram>>,
    /// Number of changes of the database that were taken over.
    pub(super) reloads: AtomicU64,
    /// Number of changes of the database that could not be read.
    pub(super) failed_reloads: AtomicU64,
}

/// A cumulative histogram of times.
#[derive(Clone, Copy, Default)]
struct Histogram {
    /// Number of times up to each of [`BOUNDS_S`].
    counts: [u64; BOUNDS_S.len()],
    count: u64,
    sum_s: f64,
}

/// Upper bounds of the histogram's buckets, seconds.
const BOUNDS_S: [f64; 10] = [0.0005, 0.001, 0.002, 0.004, 0.008, 0.016, 0.032, 0.064, 0.25, 1.0];

impl Metrics {
    /// Counts a request.
    pub(super) fn request(&self, route: &'static str, status: u16) {
        let mut requests = self.requests.lock().unwrap_or_else(PoisonError::into_inner);
        *requests.entry((route, status)).or_insert(0) += 1;
    }

    /// Counts a view. `took` is the time from finding the nearest images to the last byte of the picture.
    pub(super) fn view(&self, made: &'static str, took: Duration) {
        let mut views = self.views.lock().unwrap_or_else(PoisonError::into_inner);
        let histogram = views.entry(made).or_default();
        let seconds = took.as_secs_f64();
        histogram.count += 1;
        histogram.sum_s += seconds;
        histogram
            .counts
            .iter_mut()
            .zip(BOUNDS_S)
            .filter(|(_, bound)| seconds <= *bound)
            .for_each(|(count, _)| *count += 1);
    }

    /// Returns all counts as text. `gauges` are those of the rest of the service, each with its name, meaning and value.
    pub(super) fn text(&self, gauges: &[(&str, &str, usize)]) -> String {
        let mut text = String::new();
        head(&mut text, "requests_total", "counter", "Requests by route and status");
        for ((route, status), count) in self.requests.lock().unwrap_or_else(PoisonError::into_inner).iter() {
            let _ = writeln!(text, "realitysim_requests_total{{route=\"{route}\",status=\"{status}\"}} {count}");
        }
        head(&mut text, "view_seconds", "histogram", "Time to make a view, encoding included, by how it was made");
        for (made, histogram) in self.views.lock().unwrap_or_else(PoisonError::into_inner).iter() {
            for (bound, count) in BOUNDS_S.iter().zip(histogram.counts) {
                let _ = writeln!(text, "realitysim_view_seconds_bucket{{made=\"{made}\",le=\"{bound}\"}} {count}");
            }
            let Histogram { count, sum_s, .. } = histogram;
            let _ = writeln!(text, "realitysim_view_seconds_bucket{{made=\"{made}\",le=\"+Inf\"}} {count}");
            let _ = writeln!(text, "realitysim_view_seconds_sum{{made=\"{made}\"}} {sum_s:.6}");
            let _ = writeln!(text, "realitysim_view_seconds_count{{made=\"{made}\"}} {count}");
        }
        for (name, help, value) in [
            ("reloads_total", "Changes of the database that were taken over", &self.reloads),
            ("failed_reloads_total", "Changes that could not be read", &self.failed_reloads),
        ] {
            head(&mut text, name, "counter", help);
            let _ = writeln!(text, "realitysim_{name} {}", value.load(Ordering::Relaxed));
        }
        for (name, help, value) in gauges {
            head(&mut text, name, "gauge", help);
            let _ = writeln!(text, "realitysim_{name} {value}");
        }
        text
    }
}

/// Writes the lines that introduce a metric.
fn head(text: &mut String, name: &str, kind: &str, help: &str) {
    let _ = writeln!(text, "# HELP realitysim_{name} {help}\n# TYPE realitysim_{name} {kind}");
}
