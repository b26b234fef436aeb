//! Loops compiled twice, for every x86-64 processor and for those with AVX2. The operations and their order are the
//! same, and the compiler fuses none, so the results are too.

/// Runs a loop, compiled for the best instructions that this processor has. It is written as a closure of the local variables
/// that it uses, with their types: `multiversioned!(|sums: &mut [u16], row: &[u8]| { ... })`; a constant of the function around
/// it stands before: `multiversioned!(const SIDE: usize, |row: &[u8]| { ... })`. What it calls must be
/// `#[inline(always)]` to be compiled along.
///
/// No function of a closure, because the compiler leaves a large one where it is: compiled once, for every processor.
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

/// To the nearest whole number, of values from 0 to 2^22. A conversion looks after what no number holds, which the compiler
/// makes no vectors of; here the addition rounds, because f32 has no halves above 2^23.
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
