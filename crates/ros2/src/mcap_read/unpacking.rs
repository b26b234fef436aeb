//! Limits how much a log may decompress to: a few hundred kilobytes can claim gigabytes of zeros.

/// Bytes that any log may decompress to, in addition to what [`MAX_EXPANSION`] allows.
const MAX_UNPACKED_BYTES: u64 = 512 << 20;
/// Bytes that each compressed byte may decompress to. Images of one colour are compressed by a factor of some hundreds.
const MAX_EXPANSION: u64 = 1000;

/// The total size of the compressed chunks of one file so far.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Unpacking {
    packed_bytes: u64,
    unpacked_bytes: u64,
}

impl Unpacking {
    /// Admits a chunk before it is decompressed, by the sizes in its header. A chunk that decompresses to another size fails
    /// later.
    pub(super) fn admit(&mut self, packed_bytes: u64, unpacked_bytes: u64) -> Result<(), String> {
        let packed_bytes = self.packed_bytes.saturating_add(packed_bytes);
        let unpacked_bytes = self.unpacked_bytes.saturating_add(unpacked_bytes);
        let limit = MAX_UNPACKED_BYTES.saturating_add(packed_bytes.saturating_mul(MAX_EXPANSION));
        if unpacked_bytes > limit {
            return Err(format!("{packed_bytes} bytes of compressed chunks unpack to more than {limit} bytes"));
        }
        *self = Self { packed_bytes, unpacked_bytes };
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_decompression_bomb_is_refused_and_camera_images_are_not() {
        let mut zeros = Unpacking::default();
        let taken = (0..100).filter(|_| zeros.admit(16 << 10, 256 << 20).is_ok()).count();
        assert_eq!(taken, 2, "of 25 GiB in 1.6 MB");
        let mut grey = Unpacking::default();
        assert!((0..10_000).all(|_| grey.admit(2 << 10, 900 << 10).is_ok()));
        assert!(Unpacking::default().admit(u64::MAX, u64::MAX).is_ok());
        assert!(Unpacking::default().admit(1, u64::MAX).is_err());
    }
}
