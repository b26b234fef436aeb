//! Similarity of two pictures within a mask.

/// Peak signal-to-noise ratio and structural similarity (Wang 2004, gray, Gaussian window of sigma 1.5).
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Similarity {
    /// Peak signal-to-noise ratio, dB.
    pub psnr_db: f64,
    /// Mean structural similarity over the pixels whose whole window lies in the mask; NaN if there is none.
    pub ssim: f64,
    /// Share of the wanted pixels that were compared.
    pub compared: f64,
}

/// Half width of the window, pixels: it has 11 x 11.
const REACH: usize = 5;
/// Standard deviation of the window, pixels.
const SIGMA: f64 = 1.5;
/// (0.01 * 255)^2, as in Wang 2004.
const C1: f64 = 6.5025;
/// (0.03 * 255)^2.
const C2: f64 = 58.5225;

/// Compares two pictures of equal size, given as R, G, B and any fourth value. Pixels both `wanted` and `shown` are compared.
///
/// # Panics
///
/// If the slices differ in length.
pub fn similarity(a: &[[u8; 4]], b: &[[u8; 4]], width: usize, wanted: &[bool], shown: &[bool]) -> Similarity {
    assert!(a.len() == b.len() && a.len() == wanted.len() && a.len() == shown.len(), "pictures of one size");
    let mask: Vec<bool> = wanted.iter().zip(shown).map(|(wanted, shown)| *wanted && *shown).collect();
    let (mut squares, mut count) = (0.0, 0usize);
    for ((a, b), _) in a.iter().zip(b).zip(&mask).filter(|(_, mask)| **mask) {
        squares += (0..3).map(|c| (f64::from(a[c]) - f64::from(b[c])).powi(2)).sum::<f64>();
        count += 1;
    }
    let psnr_db = 10.0 * (255.0 * 255.0 * 3.0 * count as f64 / squares.max(1e-12)).log10();
    let wanted = wanted.iter().filter(|wanted| **wanted).count();
    Similarity { psnr_db, ssim: ssim(a, b, width, &mask), compared: count as f64 / wanted.max(1) as f64 }
}

/// Mean structural similarity of the gray pictures.
fn ssim(a: &[[u8; 4]], b: &[[u8; 4]], width: usize, mask: &[bool]) -> f64 {
    let gray = |p: &[[u8; 4]]| -> Vec<f64> {
        p.iter().map(|p| 0.299 * f64::from(p[0]) + 0.587 * f64::from(p[1]) + 0.114 * f64::from(p[2])).collect()
    };
    let (a, b) = (gray(a), gray(b));
    let product = |x: &[f64], y: &[f64]| -> Vec<f64> { x.iter().zip(y).map(|(x, y)| x * y).collect() };
    let whole = blurred(&mask.iter().map(|mask| f64::from(u8::from(*mask))).collect::<Vec<_>>(), width);
    let [ma, mb] = [&a, &b].map(|x| blurred(x, width));
    let [aa, bb, ab] = [(&a, &a), (&b, &b), (&a, &b)].map(|(x, y)| blurred(&product(x, y), width));
    let (mut sum, mut count) = (0.0, 0usize);
    for i in (0..a.len()).filter(|i| whole[*i] > 1.0 - 1e-9) {
        let (va, vb, cov) = (aa[i] - ma[i] * ma[i], bb[i] - mb[i] * mb[i], ab[i] - ma[i] * mb[i]);
        sum += (2.0 * ma[i] * mb[i] + C1) * (2.0 * cov + C2) / ((ma[i] * ma[i] + mb[i] * mb[i] + C1) * (va + vb + C2));
        count += 1;
    }
    sum / count as f64
}

/// Convolves a plane with the window. Beyond the edges it is 0, so that a mask's blur is 1 only where the whole window lies in it.
fn blurred(plane: &[f64], width: usize) -> Vec<f64> {
    let kernel: Vec<f64> = {
        let raw: Vec<f64> =
            (0..=2 * REACH).map(|i| (-(i as f64 - REACH as f64).powi(2) / (2.0 * SIGMA * SIGMA)).exp()).collect();
        let sum: f64 = raw.iter().sum();
        raw.iter().map(|x| x / sum).collect()
    };
    let height = plane.len() / width;
    let mut across = vec![0.0; plane.len()];
    for (to, from) in across.chunks_exact_mut(width).zip(plane.chunks_exact(width)) {
        for u in REACH..width.saturating_sub(REACH) {
            to[u] = kernel.iter().zip(&from[u - REACH..]).map(|(k, x)| k * x).sum();
        }
    }
    let mut both = vec![0.0; plane.len()];
    for v in REACH..height.saturating_sub(REACH) {
        let to = &mut both[v * width..(v + 1) * width];
        for (k, row) in kernel.iter().zip(across[(v - REACH) * width..].chunks_exact(width)) {
            to.iter_mut().zip(row).for_each(|(to, x)| *to += k * x);
        }
    }
    both
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_values() {
        let picture: Vec<[u8; 4]> = (0..900u32).map(|i| [(i * 7 % 200) as u8, (i * 13 % 180) as u8, 90, 255]).collect();
        let brighter: Vec<[u8; 4]> = picture.iter().map(|p| [p[0] + 10, p[1] + 10, p[2] + 10, 255]).collect();
        let all = [true; 900];
        let same = similarity(&picture, &picture, 30, &all, &all);
        assert!(same.psnr_db > 100.0 && (same.ssim - 1.0).abs() < 1e-12 && same.compared == 1.0);
        // 20 log10(255 / 10).
        let off = similarity(&picture, &brighter, 30, &all, &all);
        assert!((off.psnr_db - 28.1308).abs() < 1e-3, "{off:?}");
        assert!(off.ssim < 1.0 && off.ssim > 0.9);
        let half: Vec<bool> = (0..900).map(|i| i < 450).collect();
        assert_eq!(similarity(&picture, &brighter, 30, &all, &half).compared, 0.5);
    }
}
