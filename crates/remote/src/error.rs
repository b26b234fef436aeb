//! What can go wrong with an object store.

use std::io;
use std::path::{Path, PathBuf};

use realitysim_recording::RecordingError;

/// Error of an object store, or of what lies in it.
#[derive(Debug, thiserror::Error)]
pub enum RemoteError {
    /// An address cannot be used.
    #[error("{address}: {what}")]
    Address {
        /// The address.
        address: String,
        /// What is wrong with it.
        what: String,
    },
    /// An object, or a bucket, is not there.
    #[error("{address}: is not there")]
    Absent {
        /// Address of the object.
        address: String,
    },
    /// The store refuses access.
    #[error(
        "{address}: the store refuses access ({said}); the credentials are taken from the environment, such as AWS_ACCESS_KEY_ID, \
         AWS_SECRET_ACCESS_KEY and AWS_REGION"
    )]
    Refused {
        /// Address of the object.
        address: String,
        /// What the store says.
        said: String,
    },
    /// The store cannot be reached, answers with an error, or breaks off, also when asked again.
    #[error("{address}: {said}")]
    Store {
        /// Address of the object.
        address: String,
        /// What the store or the network says.
        said: String,
    },
    /// An object is not what it should be.
    #[error("{address}: {what}")]
    Content {
        /// Address of the object.
        address: String,
        /// What is wrong with it.
        what: String,
    },
    /// A file or folder of this machine fails.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the operating system says.
        source: io::Error,
    },
    /// A capture of this machine cannot be read or written.
    #[error(transparent)]
    Recording(#[from] RecordingError),
}

impl RemoteError {
    /// Whether the object is not there.
    pub fn is_absent(&self) -> bool {
        matches!(self, Self::Absent { .. })
    }

    /// The error of an operation with the object at an address.
    pub(super) fn of(address: &str, error: &object_store::Error) -> Self {
        let address = address.to_owned();
        match error {
            object_store::Error::NotFound { .. } => Self::Absent { address },
            object_store::Error::PermissionDenied { source, .. }
            | object_store::Error::Unauthenticated { source, .. } => {
                Self::Refused { address, said: short(&source.to_string()) }
            }
            error => Self::Store { address, said: short(&error.to_string()) },
        }
    }

    /// As an error of input and output, for callers that know no object stores.
    pub fn into_io(self) -> io::Error {
        let kind = match &self {
            Self::Absent { .. } => io::ErrorKind::NotFound,
            Self::Refused { .. } => io::ErrorKind::PermissionDenied,
            Self::Io { source, .. } => source.kind(),
            Self::Content { .. } => io::ErrorKind::InvalidData,
            Self::Address { .. } | Self::Store { .. } | Self::Recording(_) => io::ErrorKind::Other,
        };
        io::Error::new(kind, self)
    }
}

/// Longest text of another library that is shown, characters.
const MAX_SAID: usize = 300;

/// The beginning of what a store says: answers in XML go on for pages.
fn short(said: &str) -> String {
    let line: String = said.split_whitespace().collect::<Vec<_>>().join(" ");
    match line.char_indices().nth(MAX_SAID) {
        Some((end, _)) => format!("{} …", &line[..end]),
        None => line,
    }
}

/// Makes errors of a file.
pub(super) fn io(path: &Path) -> impl Fn(io::Error) -> RemoteError + '_ {
    |source| RemoteError::Io { path: path.to_owned(), source }
}
