//! The state of the agent between two frames, as bytes.
//!
//! A replay can start at any segment with it, and a restarted agent continues from it. Only this program reads it back:
//! the bytes are bincode behind a magic number, a version and a CRC-32 checksum.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::dead_reckoning::DeadReckoning;
use realitysim_geometry::Physical;
use realitysim_localization::LocalizerState;
use realitysim_log_input::synchroniser::SynchroniserState;

/// Everything that the next frame's tag depends on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint {
    /// State of the localizer: particles, track, validation.
    pub tagger: LocalizerState,
    /// Recent measurements and known transforms.
    pub synchroniser: SynchroniserState,
    /// Dead reckoning in progress, if no frame has come for some time.
    pub dead_reckoning: DeadReckoning,
    /// Number of frames tagged in the session so far.
    pub frames: u64,
}

/// Why bytes are not a usable checkpoint.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum CheckpointError {
    /// The bytes do not begin with the magic number.
    #[error("not a checkpoint of this program")]
    Foreign,
    /// Another version of the program wrote it.
    #[error("a checkpoint of version {found}; this program reads version {VERSION}")]
    Version {
        /// The version that the bytes state.
        found: u32,
    },
    /// The bytes are cut, or do not match their checksum.
    #[error("the checkpoint is damaged: its checksum is wrong")]
    Damaged,
    /// The checksum is right, but the content does not decode.
    #[error("the checkpoint does not decode: {0}")]
    Decode(String),
    /// A number in it is not finite or beyond all physical bounds.
    #[error("the checkpoint holds a number that is not finite, or that no robot can have")]
    Impossible,
}

const MAGIC: &[u8; 8] = b"RSIMCKPT";
/// Version of the format; it counts up with every change of what is stored.
pub const VERSION: u32 = 22;
/// Bytes of magic number, version and checksum.
const HEADER: usize = 8 + 4 + 4;
/// Most bytes that decoding may claim: a checkpoint of 2^20 particles has 40 MB.
pub(super) const MAX_BYTES: usize = 256 << 20;

impl Checkpoint {
    /// The checkpoint as bytes.
    pub fn encode(&self) -> Result<Vec<u8>, CheckpointError> {
        let body = bincode::serde::encode_to_vec(self, bincode::config::standard())
            .map_err(|error| CheckpointError::Decode(error.to_string()))?;
        let mut bytes = Vec::with_capacity(HEADER + body.len());
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&VERSION.to_le_bytes());
        bytes.extend_from_slice(&crc32fast::hash(&body).to_le_bytes());
        bytes.extend_from_slice(&body);
        Ok(bytes)
    }

    /// Reads a checkpoint and checks it: checksum, length, and that every number is physically possible.
    pub fn decode(bytes: &[u8]) -> Result<Self, CheckpointError> {
        let body = bytes.strip_prefix(MAGIC).ok_or(CheckpointError::Foreign)?;
        let (version, body) = word(body)?;
        if version != VERSION {
            return Err(CheckpointError::Version { found: version });
        }
        let (checksum, body) = word(body)?;
        if crc32fast::hash(body) != checksum {
            return Err(CheckpointError::Damaged);
        }
        let config = bincode::config::standard().with_limit::<MAX_BYTES>();
        let (checkpoint, used): (Self, usize) = bincode::serde::decode_from_slice(body, config)
            .map_err(|error| CheckpointError::Decode(error.to_string()))?;
        if used != body.len() {
            return Err(CheckpointError::Damaged);
        }
        if checkpoint.is_possible() { Ok(checkpoint) } else { Err(CheckpointError::Impossible) }
    }
}

impl Physical for Checkpoint {
    fn is_possible(&self) -> bool {
        let Self { tagger, synchroniser, dead_reckoning, frames: _ } = self;
        tagger.is_possible() && synchroniser.is_possible() && dead_reckoning.is_possible()
    }
}

/// Splits a little-endian `u32` off the front.
fn word(bytes: &[u8]) -> Result<(u32, &[u8]), CheckpointError> {
    let (word, rest) = bytes.split_first_chunk::<4>().ok_or(CheckpointError::Damaged)?;
    Ok((u32::from_le_bytes(*word), rest))
}

#[cfg(test)]
mod tests {
    use super::*;
    use realitysim_geometry::Pose2;
    use realitysim_localization::{FilterState, Particles};

    fn checkpoint() -> Checkpoint {
        let poses = vec![Pose2::new(1.0, -2.0, 0.5); 3];
        let particles = Particles { poses, log_weights: vec![0.0, -1.5, f64::NEG_INFINITY] };
        let filter = FilterState { particles, steps: 77 };
        Checkpoint {
            tagger: LocalizerState { filter, ..LocalizerState::default() },
            synchroniser: SynchroniserState::default(),
            dead_reckoning: DeadReckoning::default(),
            frames: 12,
        }
    }

    #[test]
    fn a_checkpoint_comes_back() {
        let bytes = checkpoint().encode().expect("encodes");
        assert_eq!(Checkpoint::decode(&bytes), Ok(checkpoint()));
    }

    #[test]
    fn a_state_with_one_wild_number_is_refused() {
        let spoil: [fn(&mut Checkpoint); 4] = [
            |checkpoint| checkpoint.tagger.filter.particles.poses[1].y = f64::NAN,
            |checkpoint| checkpoint.tagger.filter.particles.log_weights[2] = f64::NAN,
            |checkpoint| checkpoint.tagger.last = Some((7, Some(Pose2::new(1e300, 0.0, 0.0)))),
            |checkpoint| checkpoint.tagger.odometry_gap_s = f64::INFINITY,
        ];
        for (index, spoil) in spoil.into_iter().enumerate() {
            let mut checkpoint = checkpoint();
            spoil(&mut checkpoint);
            let bytes = checkpoint.encode().expect("encodes");
            assert_eq!(Checkpoint::decode(&bytes), Err(CheckpointError::Impossible), "spoilt in way {index}");
        }
    }

    #[test]
    fn damage_of_every_kind_is_noticed() {
        let bytes = checkpoint().encode().expect("encodes");
        for cut in 0..bytes.len() {
            assert!(Checkpoint::decode(&bytes[..cut]).is_err(), "cut at {cut}");
        }
        for position in 0..bytes.len() {
            let mut flipped = bytes.clone();
            flipped[position] ^= 0x10;
            assert!(Checkpoint::decode(&flipped).is_err(), "flipped at {position}");
        }
        assert_eq!(Checkpoint::decode(b"something else"), Err(CheckpointError::Foreign));
        let mut newer = bytes;
        newer[8] = VERSION as u8 + 1;
        assert_eq!(Checkpoint::decode(&newer), Err(CheckpointError::Version { found: VERSION + 1 }));
    }
}
