//! Loops compiled twice, for every x86-64 processor and for those with AVX2. The operations and their order are the
//! same, and the compiler fuses none, so the results are too.

/// Calls `body`, compiled for the best instructions that this processor has. `body` must be small or
/// `#[inline(always)]` to be compiled along.
#[inline]
pub(crate) fn vectorised<R>(body: impl FnOnce() -> R) -> R {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has AVX2.
        return unsafe { with_avx2(body) };
    }
    body()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn with_avx2<R>(body: impl FnOnce() -> R) -> R {
    body()
}
