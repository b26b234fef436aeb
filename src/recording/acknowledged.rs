//! What dev machines say that they have, each verified by its hash: `ack/<receiver>.jsonl` in a session's folder.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::storage::{ListedKind, Storage, read_small};

/// Where acknowledgements lie, in a session's folder.
pub const ACKNOWLEDGEMENTS: &str = "ack";

/// A line of such a file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Acknowledgement {
    pub file: String,
    pub blake3: String,
    pub bytes: u64,
}

/// Machines that may acknowledge a session.
const MAX_RECEIVERS: usize = 64;
/// A larger file is not read to its end.
const MAX_ACKNOWLEDGEMENT_BYTES: u64 = 16 << 20;

/// Name, hash and size of each file that is acknowledged, with one receiver that has it. Lines that make no sense, as of
/// a machine that was cut off, acknowledge nothing.
pub(super) fn acknowledged(storage: &dyn Storage, session: &Path) -> BTreeMap<(String, String, u64), String> {
    let folder = session.join(ACKNOWLEDGEMENTS);
    let mut all = BTreeMap::new();
    for entry in storage.list(&folder).unwrap_or_default().into_iter().take(MAX_RECEIVERS) {
        let Some(receiver) = entry.name.strip_suffix(".jsonl") else { continue };
        if entry.kind != ListedKind::File {
            continue;
        }
        let Ok(Some(text)) = read_small(storage, &folder.join(&entry.name), MAX_ACKNOWLEDGEMENT_BYTES) else {
            continue;
        };
        for line in text.split(|byte| *byte == b'\n') {
            if let Ok(Acknowledgement { file, blake3, bytes }) = serde_json::from_slice(line) {
                all.entry((file, blake3, bytes)).or_insert_with(|| receiver.to_owned());
            }
        }
    }
    all
}
