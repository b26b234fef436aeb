//! Reads and writes objects, and waits until each operation is done.

use core::ops::Range;
use std::collections::HashMap;
use std::future::Future;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use futures_util::TryStreamExt;
use object_store::path::Path as ObjectPath;
use object_store::{ObjectMeta, ObjectStore, ObjectStoreExt, PutMode, PutPayload, WriteMultipart};
use realitysim_config::plain_file;
use tokio::runtime::{Builder, Runtime};

use super::address::Address;
use super::error::{RemoteError, io};

/// The object stores that are in use, each with its connections.
///
/// Operations that fail for a while are tried again with growing pauses, for three minutes at most; credentials, region, endpoint and
/// time limits come from the environment. Both are rules of crate `object_store`, whose documentation lists the variables.
pub struct ObjectStores {
    runtime: Runtime,
    open: Mutex<HashMap<String, Arc<dyn ObjectStore>>>,
}

/// What a store says of an object.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ObjectInfo {
    /// Path below the folder that was listed.
    pub name: String,
    /// Size, bytes.
    pub bytes: u64,
    /// What changes with the content: the tag of the store, or the time of the last change if it has none.
    pub tag: String,
}

/// Bytes of one request of a long object. A slow link gets them through before a request is given up.
const REQUEST_BYTES: u64 = 8 << 20;
/// Most objects that a folder is listed with.
const MAX_LISTED: usize = 1_000_000;
/// What the names of the environment's variables begin with that are settings of a store.
const PREFIXES: [&str; 3] = ["AWS_", "AZURE_", "GOOGLE_"];
/// Pauses before an operation is done again that failed quickly: the library repeats refused requests, not answers that break off.
const PAUSES: [Duration; 3] = [Duration::from_millis(200), Duration::from_secs(1), Duration::from_secs(3)];
/// A failure that took less time was not one that the library had repeated.
const QUICK: Duration = Duration::from_secs(5);
/// Requests of one upload at a time.
const MAX_UPLOADS: usize = 4;

impl ObjectStores {
    /// Starts the thread that talks to the stores.
    ///
    /// # Errors
    ///
    /// Fails if the operating system has no thread for it.
    pub fn new() -> std::io::Result<Self> {
        let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
        Ok(Self { runtime, open: Mutex::default() })
    }

    /// Size and tag of an object.
    ///
    /// # Errors
    ///
    /// [`RemoteError`] if the object is not there or the store fails.
    pub fn info(&self, address: &Address) -> Result<ObjectInfo, RemoteError> {
        let meta = self.with(address, |store, path| async move { store.head(&path).await })?;
        Ok(ObjectInfo { name: String::new(), bytes: meta.size, tag: tag_of(meta) })
    }

    /// Reads a part of an object with one request.
    ///
    /// # Errors
    ///
    /// [`RemoteError`] if the object is not there, has fewer bytes, or the store fails.
    pub fn read_range(&self, address: &Address, range: Range<u64>) -> Result<Vec<u8>, RemoteError> {
        let wanted = range.end.saturating_sub(range.start);
        let get = |store: Arc<dyn ObjectStore>, path: ObjectPath| {
            let range = range.clone();
            async move { store.get_range(&path, range).await.map(Vec::from) }
        };
        let bytes = self.with(address, get)?;
        match bytes.len() as u64 == wanted {
            true => Ok(bytes),
            false => Err(content(address, format!("{} bytes came of {wanted} that were asked for", bytes.len()))),
        }
    }

    /// Reads an object piece by piece.
    ///
    /// # Errors
    ///
    /// [`RemoteError`] if the object is not there, the store fails, or `each` does.
    pub fn read_pieces(
        &self,
        address: &Address,
        bytes: u64,
        each: &mut dyn FnMut(&[u8]) -> Result<(), RemoteError>,
    ) -> Result<(), RemoteError> {
        let mut at = 0;
        while at < bytes {
            let end = bytes.min(at + REQUEST_BYTES);
            each(&self.read_range(address, at..end)?)?;
            at = end;
        }
        Ok(())
    }

    /// Reads a small object as a whole.
    ///
    /// # Errors
    ///
    /// [`RemoteError`] if the object is not there, is larger than `max_bytes`, or the store fails.
    pub fn read(&self, address: &Address, max_bytes: u64) -> Result<Vec<u8>, RemoteError> {
        let ObjectInfo { bytes, .. } = self.info(address)?;
        if bytes > max_bytes {
            return Err(content(address, format!("has {bytes} bytes, and at most {max_bytes} are read")));
        }
        let mut all = Vec::with_capacity(bytes as usize);
        self.read_pieces(address, bytes, &mut |piece| {
            all.extend_from_slice(piece);
            Ok(())
        })?;
        Ok(all)
    }

    /// The objects below a folder, sorted by name.
    ///
    /// # Errors
    ///
    /// [`RemoteError`] if the store fails, cannot list, or lists more than a million objects.
    pub fn list(&self, folder: &Address) -> Result<Vec<ObjectInfo>, RemoteError> {
        let listed = |store: Arc<dyn ObjectStore>, prefix: ObjectPath| async move {
            let mut stream = store.list(Some(&prefix));
            let mut found = Vec::new();
            while let Some(meta) = stream.try_next().await? {
                let name = meta.location.as_ref().strip_prefix(prefix.as_ref()).unwrap_or_default();
                let name = name.trim_start_matches('/').to_owned();
                // Some programs mark a folder by an empty object of its name.
                if !name.is_empty() {
                    found.push(ObjectInfo { name, bytes: meta.size, tag: tag_of(meta) });
                }
                if found.len() > MAX_LISTED {
                    break;
                }
            }
            Ok(found)
        };
        let mut found: Vec<ObjectInfo> = self.with(folder, listed)?;
        if found.len() > MAX_LISTED {
            return Err(content(folder, format!("holds more than {MAX_LISTED} objects: name a folder in it")));
        }
        found.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(found)
    }

    /// Writes a small object.
    ///
    /// # Errors
    ///
    /// [`RemoteError`] if the store fails.
    pub fn write(&self, address: &Address, content: Vec<u8>) -> Result<(), RemoteError> {
        let content = PutPayload::from(content);
        let put = |store: Arc<dyn ObjectStore>, path: ObjectPath| {
            let content = content.clone();
            async move { store.put(&path, content).await }
        };
        self.with(address, put).map(drop)
    }

    /// Writes a small object if there is none at the address; `false` if there is one. Stores that cannot do so in one step overwrite it.
    ///
    /// # Errors
    ///
    /// [`RemoteError`] if the store fails.
    pub fn create(&self, address: &Address, content: Vec<u8>) -> Result<bool, RemoteError> {
        let (store, path) = self.store(address)?;
        let only_new = PutMode::Create.into();
        match self.runtime.block_on(store.put_opts(&path, PutPayload::from(content.clone()), only_new)) {
            Ok(_) => Ok(true),
            Err(object_store::Error::AlreadyExists { .. }) => Ok(false),
            Err(object_store::Error::NotImplemented { .. } | object_store::Error::NotSupported { .. }) => {
                self.write(address, content).map(|()| true)
            }
            Err(error) => Err(RemoteError::of(address.as_str(), &error)),
        }
    }

    /// Uploads a file, of which `sent` gets the number of bytes that are on their way.
    ///
    /// An object appears once all of its parts are there. An upload that fails is taken back.
    ///
    /// # Errors
    ///
    /// [`RemoteError`] if the file cannot be read or the store fails.
    pub fn upload(&self, file: &Path, address: &Address, sent: &mut dyn FnMut(u64)) -> Result<(), RemoteError> {
        let mut source = plain_file::open(file).map_err(io(file))?;
        let bytes = source.seek(SeekFrom::End(0)).map_err(io(file))?;
        source.rewind().map_err(io(file))?;
        let mut piece = Vec::new();
        let mut next_piece = || -> Result<Vec<u8>, RemoteError> {
            piece.clear();
            (&mut source).take(REQUEST_BYTES).read_to_end(&mut piece).map_err(io(file))?;
            Ok(piece.clone())
        };
        if bytes <= REQUEST_BYTES {
            self.write(address, next_piece()?)?;
            sent(bytes);
            return Ok(());
        }
        let failed = |error: object_store::Error| RemoteError::of(address.as_str(), &error);
        let (store, path) = self.store(address)?;
        let parts = self.runtime.block_on(store.put_multipart(&path)).map_err(failed)?;
        // The parts are uploaded by tasks of the runtime, which must exist already when they are made.
        let _inside = self.runtime.enter();
        let mut writer = WriteMultipart::new_with_chunk_size(parts, REQUEST_BYTES as usize);
        let mut fill = || -> Result<(), RemoteError> {
            let mut done = 0;
            while done < bytes {
                self.runtime.block_on(writer.wait_for_capacity(MAX_UPLOADS)).map_err(failed)?;
                let piece = next_piece()?;
                if piece.is_empty() {
                    break;
                }
                writer.write(&piece);
                done += piece.len() as u64;
                sent(done);
            }
            Ok(())
        };
        match fill() {
            Ok(()) => self.runtime.block_on(writer.finish()).map(drop).map_err(failed),
            Err(error) => {
                // What was uploaded stays unseen if the store does not take it back; the error that counts is the first.
                let _ = self.runtime.block_on(writer.abort());
                Err(error)
            }
        }
    }

    /// Does something with the object at an address, and does it again if an answer breaks off.
    fn with<T, F: Future<Output = object_store::Result<T>>>(
        &self,
        address: &Address,
        operation: impl Fn(Arc<dyn ObjectStore>, ObjectPath) -> F,
    ) -> Result<T, RemoteError> {
        let (store, path) = self.store(address)?;
        let attempt = || {
            let done = self.runtime.block_on(operation(Arc::clone(&store), path.clone()));
            done.map_err(|error| RemoteError::of(address.as_str(), &error))
        };
        for pause in PAUSES {
            let began = Instant::now();
            match attempt() {
                // What took long was tried again by the library, or is as slow the next time.
                Err(RemoteError::Store { .. }) if began.elapsed() < QUICK => std::thread::sleep(pause),
                done => return done,
            }
        }
        attempt()
    }

    /// The store of an address, and the path in it.
    fn store(&self, address: &Address) -> Result<(Arc<dyn ObjectStore>, ObjectPath), RemoteError> {
        let url = address.url()?;
        let failed = |error: &object_store::Error| RemoteError::of(address.as_str(), error);
        let (_, path) = object_store::ObjectStoreScheme::parse(&url).map_err(|error| failed(&error.into()))?;
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        let bucket = url[..url::Position::BeforePath].to_owned();
        if let Some(store) = open.get(&bucket) {
            return Ok((Arc::clone(store), path));
        }
        let environment =
            std::env::vars_os().filter_map(|(name, value)| Some((name.into_string().ok()?, value.into_string().ok()?)));
        let of_stores = environment.filter(|(name, _)| PREFIXES.iter().any(|prefix| name.starts_with(prefix)));
        // An address of HTTP without TLS says by itself that it is meant so.
        let plain = (url.scheme() == "http").then(|| ("allow_http".to_owned(), "true".to_owned()));
        let options = of_stores.map(|(name, value)| (name.to_ascii_lowercase(), value)).chain(plain);
        // Options that the store does not know are passed over.
        let (store, _) = object_store::parse_url_opts(&url, options).map_err(|error| failed(&error))?;
        let store: Arc<dyn ObjectStore> = Arc::from(store);
        open.insert(bucket, Arc::clone(&store));
        Ok((store, path))
    }
}

/// What changes with the content of an object.
fn tag_of(meta: ObjectMeta) -> String {
    meta.e_tag.unwrap_or_else(|| meta.last_modified.to_rfc3339())
}

/// An object is not what it should be.
pub(super) fn content(address: &Address, what: String) -> RemoteError {
    RemoteError::Content { address: address.as_str().to_owned(), what }
}
