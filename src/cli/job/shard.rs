//! Parts of a folder of sessions, each for a machine of its own.

use std::fmt;

/// One of `count` parts of all sessions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Shard {
    /// Number of the part, from 0.
    index: u64,
    count: u64,
}

impl Shard {
    /// Whether a session belongs to this part. Its name alone decides, so that all machines agree, whatever they see of the folder.
    pub(super) fn has(self, session: &str) -> bool {
        let hash = blake3::hash(session.as_bytes());
        let number = hash.as_bytes().first_chunk().map_or(0, |bytes| u64::from_le_bytes(*bytes));
        number % self.count == self.index
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index + 1, self.count)
    }
}

/// Largest number of parts: more than any cluster has machines.
const MAX_SHARDS: u64 = 1_000_000;

/// Parses `I/N`, where I is 1 to N.
pub(super) fn parse_shard(text: &str) -> Result<Shard, String> {
    let parsed = text.split_once('/').and_then(|(number, count)| Some((number.parse().ok()?, count.parse().ok()?)));
    match parsed {
        Some((number @ 1.., count)) if number <= count && count <= MAX_SHARDS => Ok(Shard { index: number - 1, count }),
        _ => Err(format!("I/N is needed, as in 3/16: I from 1 to N, and N at most {MAX_SHARDS}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_session_belongs_to_one_shard() {
        let names: Vec<String> = (0..1000).map(|number| format!("2026-11-28T10-00-00Z-robot-{number}")).collect();
        for count in [1, 2, 7, 16] {
            let shards: Vec<Shard> =
                (1..=count).map(|number| parse_shard(&format!("{number}/{count}")).unwrap()).collect();
            let sizes: Vec<usize> =
                shards.iter().map(|shard| names.iter().filter(|name| shard.has(name)).count()).collect();
            assert!(names.iter().all(|name| shards.iter().filter(|shard| shard.has(name)).count() == 1));
            let even = names.len() / count;
            assert!(sizes.iter().all(|size| (even / 2..=2 * even).contains(size)), "{count}: {sizes:?}");
        }
    }

    /// Results of one version must be found by the next.
    #[test]
    fn the_shard_of_a_name_never_changes() {
        let shard = |name: &str| (1..=16).find(|number| parse_shard(&format!("{number}/16")).unwrap().has(name));
        let found = ["2026-11-28T10-00-00Z-robot", "a", "b"].map(shard);
        assert_eq!(found, [Some(8), Some(8), Some(1)]);
    }

    #[test]
    fn a_wrong_shard_is_refused() {
        for text in ["", "1", "0/4", "5/4", "1/0", "-1/4", "1/4/4", "a/b", "1/1000001"] {
            assert!(parse_shard(text).is_err_and(|said| said.contains("3/16")), "{text}");
        }
    }
}
