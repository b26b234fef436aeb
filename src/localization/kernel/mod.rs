//! The hot loop: the sum over line points of the bilinearly interpolated ground table, for one pose.
//!
//! Eight lanes, each summing every eighth point, added up in one fixed order, without fused multiply-add: all paths
//! give the same bits.

mod scalar;
#[cfg(target_arch = "x86_64")]
mod x86;

use glam::DVec2;

pub use crate::config::SimdPath;
use crate::geometry::Pose2;
use crate::vision::GroundTable;
use crate::vision::ground::SIDE;

pub const LANES: usize = 8;

/// The wanted path if this processor has it, else the next best. Every x86-64 processor has SSE2, and the plain path is
/// compiled for it: hand-written, it was slower (four words loaded one by one for want of a gather).
pub fn available(wanted: SimdPath) -> SimdPath {
    #[cfg(target_arch = "x86_64")]
    {
        match wanted {
            SimdPath::Auto | SimdPath::Avx2 if std::arch::is_x86_feature_detected!("avx2") => SimdPath::Avx2,
            SimdPath::Scalar => SimdPath::Scalar,
            _ => SimdPath::Sse2,
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        let _ = wanted;
        SimdPath::Scalar
    }
}

/// Line points in `map`, padded to whole groups of lanes.
#[derive(Clone, Debug, Default)]
pub struct Points {
    xs: Vec<f32>,
    ys: Vec<f32>,
    count: usize,
}

/// Far outside any table: reads as neutral.
const PADDING_M: f32 = 1e6;

impl Points {
    /// Whole groups of `other`'s points that lie in the given groups of lanes; nothing is allocated twice.
    pub fn select(&mut self, other: &Points, groups: impl Iterator<Item = usize>) {
        self.xs.clear();
        self.ys.clear();
        for group in groups {
            let lanes = group * LANES..(group + 1) * LANES;
            self.xs.extend_from_slice(&other.xs[lanes.clone()]);
            self.ys.extend_from_slice(&other.ys[lanes]);
        }
        self.count = self.xs.len();
    }

    pub fn new(positions: impl IntoIterator<Item = DVec2>) -> Self {
        let (mut xs, mut ys): (Vec<f32>, Vec<f32>) =
            positions.into_iter().map(|point| (point.x as f32, point.y as f32)).unzip();
        let count = xs.len();
        let padded = count.next_multiple_of(LANES);
        xs.resize(padded, PADDING_M);
        ys.resize(padded, PADDING_M);
        Self { xs, ys, count }
    }

    pub fn len(&self) -> usize {
        self.count
    }

    pub fn is_empty(&self) -> bool {
        self.count == 0
    }
}

/// From `map` to table cells for one pose: u = cos x + sin y + u0, v = cos y - sin x + v0.
#[derive(Clone, Copy)]
struct Placement {
    cos: f32,
    sin: f32,
    u0: f32,
    v0: f32,
}

const LAST: f32 = (SIDE - 1) as f32;

/// Sum over the points of the table's level less its neutral one, for the robot standing at `pose`.
pub fn sum_levels(path: SimdPath, table: &GroundTable, points: &Points, pose: &Pose2) -> f64 {
    let (scale, offset) = table.to_cells();
    let (sin, cos) = libm::sincos(pose.yaw);
    let placement = Placement {
        cos: (cos * scale) as f32,
        sin: (sin * scale) as f32,
        u0: (offset - (cos * pose.x + sin * pose.y) * scale) as f32,
        v0: (offset - (cos * pose.y - sin * pose.x) * scale) as f32,
    };
    let quads = table.quads();
    assert_eq!(quads.len(), SIDE * SIDE, "the kernel reads without further checks");
    let lanes = match path {
        #[cfg(target_arch = "x86_64")]
        SimdPath::Avx2 if std::arch::is_x86_feature_detected!("avx2") => {
            // SAFETY: the processor has AVX2, and `quads` holds SIDE x SIDE words.
            unsafe { x86::avx2(quads, &points.xs, &points.ys, placement) }
        }
        _ => scalar::sum(quads, &points.xs, &points.ys, placement),
    };
    let [a, b, c, d, e, f, g, h] = lanes;
    let sum = ((a + e) + (c + g)) + ((b + f) + (d + h));
    f64::from(sum) - points.xs.len() as f64 * f64::from(table.readings().zero)
}

#[cfg(test)]
mod tests;
