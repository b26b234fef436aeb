//! Option `--where`: sessions are chosen by what the catalogue beside their folder says of their frames.

use std::collections::BTreeMap;
use std::path::Path;

use clap::Args;

#[cfg(feature = "catalogue")]
use super::catalogue::sessions_where;
use super::output;
use crate::recording::SessionId;

#[derive(Args)]
pub struct WhereArguments {
    /// Only sessions with a frame of which this holds, in SQL, such as "valid and x_m > 2": asks the catalogue beside the captures
    #[cfg(feature = "catalogue")]
    #[arg(long = "where", value_name = "CONDITION")]
    condition: Option<String>,
}

/// Whether the condition holds for any frame of a session, by the session's identity; `None` if there is no condition.
pub struct Chosen(Option<BTreeMap<String, bool>>);

impl WhereArguments {
    /// Asks the catalogue beside a folder of captures.
    #[cfg(feature = "catalogue")]
    pub fn chosen(&self, captures: &Path) -> anyhow::Result<Chosen> {
        let holds = self.condition.as_deref().map(|condition| sessions_where(captures, condition));
        Ok(Chosen(holds.transpose()?))
    }

    /// Without the feature there is no catalogue to ask, and no condition.
    #[cfg(not(feature = "catalogue"))]
    pub fn chosen(&self, _captures: &Path) -> anyhow::Result<Chosen> {
        Ok(Chosen(None))
    }
}

impl Chosen {
    /// Keeps what belongs to chosen sessions. `id` is `None` for a session that cannot be read. How many the catalogue does not know is
    /// said.
    pub fn keep<T>(&self, all: &mut Vec<T>, id: impl Fn(&T) -> Option<SessionId>) {
        let Some(holds) = &self.0 else { return };
        let (count, mut unknown) = (all.len(), 0);
        all.retain(|one| {
            let known = id(one).and_then(|id| holds.get(id.as_str()).copied());
            unknown += usize::from(known.is_none());
            known == Some(true)
        });
        if unknown > 0 {
            let what = "not in the catalogue and left out: `realitysim catalogue rebuild` adds those that are here";
            output::say(&format!("{unknown} of {count} sessions are {what}"));
        }
    }
}
