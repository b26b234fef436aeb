//! Sources of recordings: `robot:`, `user@host:dir` or a folder.

use std::path::Path;

use super::error::SyncError;

/// Folder of captures of the service (systemd/realitysim.service).
pub const SERVICE_CAPTURES: &str = "/var/lib/realitysim/captures";

/// Where recordings are synced from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Source {
    /// `user@host`, or `None` for a folder of this machine.
    pub host: Option<String>,
    /// The folder of captures.
    pub folder: String,
}

impl Source {
    /// Parses a source as rsync and scp do: a colon before any slash ends a host.
    pub fn parse(text: &str) -> Result<Self, SyncError> {
        let refused = |why: &str| Err(SyncError::Source(format!("{text:?} is no source: {why}")));
        let host_and_folder = text.split_once(':').filter(|(host, _)| !host.contains('/'));
        let Some((host, folder)) = host_and_folder else {
            if text.is_empty() || text.starts_with('-') {
                return refused("name robot:, user@host:dir or a folder");
            }
            return Ok(Self { host: None, folder: text.to_owned() });
        };
        let names_nobody = host.is_empty() || host.starts_with(['-', '@']) || host.ends_with('@');
        if names_nobody || host.chars().any(|c| c.is_whitespace() || c.is_control()) {
            return refused("what stands before the colon must be a host, as for ssh");
        }
        if folder.starts_with(':') {
            return refused("rsync's own daemon is not spoken to: name user@host:dir");
        }
        let folder = if folder.is_empty() { SERVICE_CAPTURES } else { folder };
        Ok(Self { host: Some(host.to_owned()), folder: folder.to_owned() })
    }

    /// Argument of rsync for a path within the source. `within` ends with a slash if the content of that folder is
    /// meant.
    pub fn argument(&self, within: &str) -> String {
        let folder = self.folder.trim_end_matches('/');
        match &self.host {
            Some(host) => format!("{host}:{folder}/{within}"),
            // The path is made absolute, since rsync takes a name with a colon for a host's.
            None => format!("{}/{within}", std::path::absolute(folder).unwrap_or_else(|_| folder.into()).display()),
        }
    }

    /// Whether the source is on another machine.
    pub fn is_remote(&self) -> bool {
        self.host.is_some()
    }

    /// The source as people write it.
    pub fn shown(&self) -> String {
        match &self.host {
            Some(host) => format!("{host}:{}", self.folder),
            None => self.folder.clone(),
        }
    }

    /// Name of a folder that stands for the source: readable, and different for each source.
    pub fn key(&self) -> String {
        let full = match &self.host {
            Some(_) => self.shown(),
            None => {
                Path::new(&self.folder).canonicalize().map_or_else(|_| self.shown(), |path| path.display().to_string())
            }
        };
        let name = self.host.as_deref().or_else(|| Path::new(&self.folder).file_name()?.to_str()).unwrap_or("folder");
        let plain: String = name
            .chars()
            .map(|c| if c.is_ascii_alphanumeric() || "-_@".contains(c) { c } else { '_' })
            .take(40)
            .collect();
        format!("{plain}-{}", &blake3::hash(full.as_bytes()).to_hex()[..12])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_source_is_read_as_scp_reads_it() {
        let source = |text: &str| Source::parse(text).map(|s| (s.host.unwrap_or_default(), s.folder)).ok();
        let some = |host: &str, folder: &str| Some((host.to_owned(), folder.to_owned()));
        assert_eq!(source("robot:"), some("robot", SERVICE_CAPTURES));
        assert_eq!(source("nao@10.0.0.7:logs/x y"), some("nao@10.0.0.7", "logs/x y"));
        assert_eq!(source("/media/stick/a:b"), some("", "/media/stick/a:b"));
        assert_eq!(source("./robot:"), some("", "./robot:"));
        assert_eq!(source("captures"), some("", "captures"));
        for text in ["", ":x", "-oProxyCommand=x:y", "--rsh", "a b:c", "robot::module", "nao@:", "@robot:x"] {
            assert_eq!(source(text), None, "{text}");
        }
    }

    #[test]
    fn sources_have_keys_of_their_own() {
        let key = |text: &str| Source::parse(text).unwrap().key();
        assert_ne!(key("robot:"), key("robot:other"));
        assert_ne!(key("a_b:"), key("a.b:"));
        assert!(key("nao@10.0.0.7:x").starts_with("nao@10_0_0_7-"));
    }
}
