//! Copies of what addresses name, on this machine.

use std::ffi::OsString;
use std::io;
use std::path::{Path, PathBuf};

use super::super::output::Transfer;
use super::super::settings::UsageError;
use crate::database::{RemoteFiles, set_remote_files};
use crate::remote::{Address, Copies, ObjectStores, PartCache, RemoteParts};

/// Variable with the folder of copies and of single images.
const CACHE_FOLDER: &str = "REALITYSIM_CACHE";
/// Variable with the largest size of the copies, and of the single images, megabytes each.
const CACHE_MB: &str = "REALITYSIM_CACHE_MB";
/// Their size if the variable is not set, megabytes.
const DEFAULT_CACHE_MB: u64 = 4096;
/// Options that name what is written: nothing is written into a store but by `sync --to`.
const OUTPUTS: [&str; 4] = ["-o", "--output", "--db", "--write-docs"];

/// Replaces the arguments that are addresses by paths of copies, which are made or brought up to date.
///
/// Commands that read single images by themselves keep the addresses of captures: `db add` and `db remove`. So does `sync --to`.
pub fn with_local_copies(arguments: Vec<OsString>) -> anyhow::Result<Vec<OsString>> {
    let files = RemoteProgramFiles::new()?;
    let words: Vec<Option<&str>> = arguments.iter().map(|argument| argument.to_str()).collect();
    let mut commands = words.iter().flatten().skip(1).filter(|word| !word.starts_with('-'));
    let command = [commands.next().copied(), commands.next().copied()];
    let changes_database = matches!(command, [Some("db"), Some("add" | "remove" | "rebuild")]);
    let changes_captures = matches!(
        command,
        [Some("refine"), _] | [Some("sessions"), Some("pin" | "unpin" | "prune" | "repair")] | [Some("record"), _]
    );
    let mut replaced = Vec::with_capacity(arguments.len());
    for (index, argument) in arguments.iter().enumerate() {
        let Some((option, address)) = words[index].and_then(address_in) else {
            replaced.push(argument.clone());
            continue;
        };
        let before = option.or_else(|| index.checked_sub(1).and_then(|before| words[before]));
        Address::parse(address).map_err(|error| UsageError(error.to_string()))?;
        let is_written =
            before.is_some_and(|option| OUTPUTS.contains(&option) && (option != "--db" || changes_database));
        if is_written || changes_captures {
            let what = "is written to, and that must be a folder or file of this machine; `sync --to` uploads captures";
            return Err(UsageError(format!("{address}: {what}")).into());
        }
        let stays = before == Some("--to") || (changes_database && before != Some("--db"));
        replaced.push(match stays {
            true => argument.clone(),
            false => {
                let copy = files.copy(Path::new(address))?.into_os_string();
                match option {
                    None => copy,
                    Some(option) => [OsString::from(option), OsString::from("="), copy].into_iter().collect(),
                }
            }
        });
    }
    set_remote_files(Box::new(files));
    Ok(replaced)
}

/// The option, if it is `--option=ADDRESS` or `-oADDRESS`, and the address of an argument.
fn address_in(word: &str) -> Option<(Option<&str>, &str)> {
    if Address::is_address(word) {
        return Some((None, word));
    }
    let parts = match word.strip_prefix("-o") {
        Some(address) if Address::is_address(address) => Some(("-o", address)),
        _ => word.split_once('=').filter(|(option, _)| option.starts_with("--")),
    };
    parts.filter(|(_, address)| Address::is_address(address)).map(|(option, address)| (Some(option), address))
}

/// What this program reads from object stores. The stores are opened when the first address is met.
struct RemoteProgramFiles {
    parts: std::sync::OnceLock<RemoteParts>,
    cache: PathBuf,
    max_bytes: u64,
}

impl RemoteProgramFiles {
    fn new() -> anyhow::Result<Self> {
        let megabytes = match std::env::var(CACHE_MB) {
            Ok(text) => text.parse().ok().filter(|megabytes| (1..=1 << 30).contains(megabytes)).ok_or_else(|| {
                UsageError(format!("{CACHE_MB}={text}: must be a whole number of megabytes, from 1 on"))
            })?,
            Err(_) => DEFAULT_CACHE_MB,
        };
        Ok(Self { parts: std::sync::OnceLock::new(), cache: cache_folder(), max_bytes: megabytes << 20 })
    }

    fn parts(&self) -> io::Result<&RemoteParts> {
        if let Some(parts) = self.parts.get() {
            return Ok(parts);
        }
        let cache = PartCache::open(&self.cache.join("images"), self.max_bytes).map_err(io::Error::other)?;
        let copies = Copies::new(&self.cache.join("copies"), self.max_bytes);
        let parts = RemoteParts::new(ObjectStores::new()?, cache, copies);
        Ok(self.parts.get_or_init(|| parts))
    }

    fn copy(&self, folder: &Path) -> io::Result<PathBuf> {
        let mut progress = Transfer::new();
        let copied = self.parts()?.local_copy(folder, &mut |done, total| progress.set(done, total));
        progress.finish();
        copied
    }
}

impl RemoteFiles for RemoteProgramFiles {
    fn is_remote(&self, path: &Path) -> bool {
        path.to_str().is_some_and(Address::is_address)
    }

    fn read(&self, file: &Path, offset: u64, length: u32, crc: u32) -> io::Result<Vec<u8>> {
        self.parts()?.read(file, offset, length, crc)
    }

    fn local_copy(&self, folder: &Path) -> io::Result<PathBuf> {
        self.copy(folder)
    }
}

/// The folder of copies: that of the environment, or `realitysim` in the user's cache as freedesktop.org places it.
fn cache_folder() -> PathBuf {
    let of = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let users =
        || of("XDG_CACHE_HOME").or_else(|| Some(of("HOME")?.join(".cache"))).map(|cache| cache.join("realitysim"));
    of(CACHE_FOLDER).or_else(users).unwrap_or_else(|| std::env::temp_dir().join("realitysim-cache"))
}
