//! Captures and databases that lie in an object store: Amazon S3 and what speaks its protocol, Google Cloud Storage, Azure Blob
//! Storage, and servers of WebDAV or plain HTTP that answer ranges.
//!
//! An [`Address`] names a folder or an object, such as `s3://bucket/captures`. [`ObjectStores`] reads and writes objects, and takes
//! credentials from the environment as crate `object_store` does. [`RemoteParts`] reads single images, each with one request, and
//! keeps them in a bounded [`PartCache`]. [`copy_of`] keeps whole captures and databases here, each segment verified by the hash in
//! its manifest. [`upload`] copies captures to a store and acknowledges segments that were read back from it.
//!
//! ```rust
//! use realitysim_remote::{Address, ObjectStores};
//!
//! let folder = tempfile::tempdir()?;
//! std::fs::write(folder.path().join("0000.mcap"), b"a segment")?;
//! let captures = Address::parse(&format!("file://{}", folder.path().display()))?;
//!
//! let stores = ObjectStores::new()?;
//! assert_eq!(stores.read_range(&captures.join("0000.mcap"), 2..9)?, b"segment");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod address;
mod copies;
mod error;
mod object_stores;
mod part_cache;
mod remote_parts;
mod upload;

pub use address::Address;
pub use copies::{Copies, copy_of};
pub use error::RemoteError;
pub use object_stores::{ObjectInfo, ObjectStores};
pub use part_cache::PartCache;
pub use remote_parts::RemoteParts;
pub use upload::{UploadEvent, UploadReport, upload};
