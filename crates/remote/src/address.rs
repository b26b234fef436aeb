//! Addresses of folders and objects.

use core::fmt;

use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, utf8_percent_encode};
use url::Url;

use super::error::RemoteError;

/// The address of a folder or an object in a store, such as `s3://bucket/captures`, without a slash at its end.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Address {
    text: String,
}

/// What the addresses begin with. `file` is a folder of this machine, by which stores are tried out.
const SCHEMES: [&str; 10] = ["s3", "s3a", "gs", "az", "adl", "abfs", "abfss", "https", "http", "file"];

/// Characters of a name that stand for themselves in an address.
const ESCAPED: AsciiSet = NON_ALPHANUMERIC.remove(b'-').remove(b'_').remove(b'.').remove(b'~').remove(b'/');

impl Address {
    /// Whether a text is meant as an address: it begins with one of the schemes and `://`.
    pub fn is_address(text: &str) -> bool {
        text.split_once("://").is_some_and(|(scheme, _)| SCHEMES.contains(&scheme))
    }

    /// Parses an address.
    ///
    /// # Errors
    ///
    /// [`RemoteError::Address`] if the scheme is unknown, no bucket or host is named, or a query or a password is part of it.
    pub fn parse(text: &str) -> Result<Self, RemoteError> {
        let wrong = |what: &str| RemoteError::Address { address: text.to_owned(), what: what.to_owned() };
        if !Self::is_address(text) {
            return Err(wrong("an address such as s3://bucket/captures, gs://…, az://… or https://… is needed"));
        }
        let url = Url::parse(text).map_err(|error| wrong(&error.to_string()))?;
        if url.scheme() != "file" && url.host_str().is_none_or(str::is_empty) {
            return Err(wrong("it names no bucket or host"));
        }
        if url.query().is_some() || url.fragment().is_some() || url.password().is_some() {
            return Err(wrong(
                "it has a password, a query or a fragment: credentials are taken from the environment alone",
            ));
        }
        Ok(Self { text: text.trim_end_matches('/').to_owned() })
    }

    /// The address of something within this folder. `name` is a name as files have it, or several with slashes between them.
    #[must_use]
    pub fn join(&self, name: &str) -> Self {
        Self { text: format!("{}/{}", self.text, utf8_percent_encode(name, &ESCAPED)) }
    }

    /// Whether it names a folder or file of this machine.
    pub fn is_of_this_machine(&self) -> bool {
        self.text.starts_with("file:")
    }

    /// The address as text.
    pub fn as_str(&self) -> &str {
        &self.text
    }

    /// The last part of the path: the name of a folder or an object.
    pub fn name(&self) -> &str {
        self.text.rsplit('/').next().unwrap_or_default()
    }

    /// The address as a URL.
    pub(super) fn url(&self) -> Result<Url, RemoteError> {
        Url::parse(&self.text)
            .map_err(|error| RemoteError::Address { address: self.text.clone(), what: error.to_string() })
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}
