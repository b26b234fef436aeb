//! Loops that are compiled twice: for every x86-64 processor, and for those with AVX2.
//!
//! Both versions have the same operations in the same order, and the compiler fuses none of them, so they give the same bits.

/// Runs a loop in the version for the best instructions that this processor has.
///
/// The loop is written as a closure over the local variables that it uses, with their types:
/// `multiversioned!(|sums: &mut [u16], row: &[u8]| { ... })`. A constant parameter of the surrounding function is named first:
/// `multiversioned!(const SIDE: usize, |row: &[u8]| { ... })`. Functions that the loop calls must be `#[inline(always)]`, or they
/// are compiled only once.
///
/// This is a macro because a function that takes a closure would not do: the compiler does not inline a large closure, which
/// would then be compiled once, for every processor.
#[macro_export]
macro_rules! multiversioned {
    ($(const $number:ident: $number_kind:ty,)? |$($name:ident: $kind:ty),* $(,)?| $body:block) => {
        $crate::multiversioned!($(const $number: $number_kind,)? |$($name: $kind),*| -> () $body)
    };
    ($(const $number:ident: $number_kind:ty,)? |$($name:ident: $kind:ty),* $(,)?| -> $out:ty $body:block) => {{
        #[inline(always)]
        fn plain$(<const $number: $number_kind>)?($($name: $kind),*) -> $out $body
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx2")]
        fn with_avx2$(<const $number: $number_kind>)?($($name: $kind),*) -> $out {
            plain$(::<$number>)?($($name),*)
        }
        #[cfg(target_arch = "x86_64")]
        let out = if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2.
            unsafe { with_avx2$(::<$number>)?($($name),*) }
        } else {
            plain$(::<$number>)?($($name),*)
        };
        #[cfg(not(target_arch = "x86_64"))]
        let out = plain$(::<$number>)?($($name),*);
        out
    }};
}

/// Rounds a value from 0 to 2^22 to the nearest integer.
///
/// An `as` conversion handles values out of range, which the compiler does not vectorise. Here the addition rounds, because
/// f32 has no fractions above 2^23.
#[inline(always)]
pub fn rounded(value: f32) -> u32 {
    (value + 8_388_608.0).to_bits() & 0x7f_ffff
}

#[cfg(test)]
mod tests {
    use super::rounded;

    #[test]
    fn values_go_to_the_nearest_whole_number() {
        for tenth in 0..=2550u16 {
            let value = f32::from(tenth) / 10.0;
            assert!((rounded(value) as f32 - value).abs() <= 0.5, "{value}");
        }
        assert_eq!([0.0, 0.49, 254.51, 255.0, 4_194_304.0].map(rounded), [0, 0, 255, 255, 4_194_304]);
    }
}
