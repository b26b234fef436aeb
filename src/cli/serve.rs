//! Command `realitysim serve`: serves views of a database over HTTP.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use clap::{ArgGroup, Args};
use serde::Serialize;

use super::paths::cannot_read;
use super::settings::UsageError;
use super::values::{address, number, whole};
use super::{Outcome, output};
use crate::cli::host_info::cores;
use crate::config::{Settings, lens_names, load_lens, plain_file};
use crate::geometry::LensParameters;
use crate::live::stop_flag;
use crate::log_input::scene_source;
use crate::recording::session_holding;
use crate::service::{ServeOptions, serve};
use crate::views::{FAR_M, MAX_FAR_M};

/// Serve views of a database over HTTP, for simulators and vision code, and as a page for people
///
/// A browser shows the page at the address that is told: one walks through the images there, and sees the tags of captures
/// (docs/howto/page.md). GET /v1/view?x=..&y=..&z=..&yaw_deg=.. gives a picture; /openapi.json says the rest (docs/howto/simulator.md). The database may be
/// changed meanwhile. Ends with SIGINT or SIGTERM.
#[derive(Args)]
#[command(group = ArgGroup::new("served").args(["db", "captures"]).required(true).multiple(true))]
#[command(after_long_help = concat!(
    "Examples:",
    "\n  realitysim serve --db images/ --captures captures/",
    "\n  realitysim serve --db images/ --listen 0.0.0.0:8765 --token-file token.txt",
))]
pub struct ServeArguments {
    /// The database's folder; without it captures alone are shown
    #[arg(long, value_name = "DIR")]
    db: Option<PathBuf>,
    /// A folder of captures that the page shows: every session in it
    #[arg(long, value_name = "CAPTURES_DIR")]
    captures: Option<PathBuf>,
    /// Address and port; port 0 takes a free one, which is told. Beyond loopback a token is needed
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8765", value_parser = address)]
    listen: SocketAddr,
    /// A file with the token that clients must send
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Threads that make views; without it one for each processor
    #[arg(long, value_name = "N", value_parser = whole(1..=64u16))]
    threads: Option<u16>,
    /// A lens that clients may name beside the shipped ones
    #[arg(long, value_name = "NAME=FILE")]
    lens: Vec<String>,
    /// A scene whose effects clients may ask for; its name is the file's without .toml
    #[arg(long, value_name = "FILE")]
    scene: Vec<String>,
    /// Refuse when the nearest image was taken farther away than this, or images show less than a quarter of an exact view,
    /// if the client does not say
    #[arg(long, value_name = "M", default_value_t = FAR_M, value_parser = number(0.0..=MAX_FAR_M))]
    max_distance: f64,
    /// Robot config, for its section [views]
    #[arg(long, value_name = "FILE")]
    config: Option<String>,
}

pub fn run(arguments: &ServeArguments, json: bool) -> anyhow::Result<Outcome> {
    let settings = arguments.config.as_deref().map_or(Ok(Settings::default()), Settings::load)?;
    let mut scenes = BTreeMap::new();
    for path in &arguments.scene {
        let name = Path::new(path).file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        if scenes.insert(name.clone(), scene_source::load(path)?).is_some() {
            return Err(UsageError(format!("--scene {path}: there is another scene named {name}")).into());
        }
    }
    let options = ServeOptions {
        database: arguments.db.clone(),
        live: None,
        captures: captures_folder(arguments.captures.as_deref())?,
        listen: arguments.listen,
        token: arguments.token_file.as_deref().map(token).transpose()?,
        threads: arguments.threads.map_or_else(cores, usize::from),
        settings: settings.views,
        lenses: lenses(&arguments.lens)?,
        scenes,
        max_distance_m: arguments.max_distance,
    };
    let stop = stop_flag()?;
    let words = "serving views";
    serve(options, &stop, |address, images| tell_ready(address, images, words, None, json), output::say)?;
    Ok(Outcome::Whole)
}

/// Says where the service listens, and where Foxglove finds the same, if it does. A closed standard output does not stop it.
pub(super) fn tell_ready(address: SocketAddr, images: usize, words: &str, viewers: Option<SocketAddr>, json: bool) {
    #[derive(Serialize)]
    struct Ready {
        listening: SocketAddr,
        images: usize,
        #[serde(skip_serializing_if = "Option::is_none")]
        foxglove: Option<SocketAddr>,
    }
    let _ = if json {
        output::json(&Ready { listening: address, images, foxglove: viewers })
    } else {
        let viewers = viewers.map_or(String::new(), |viewers| format!("\nFoxglove and Lichtblick: ws://{viewers}"));
        output::lines(&format!("{words}, {images} images, on http://{address}: open it in a browser{viewers}"))
    };
}

/// The folder of captures, which must be there.
pub(super) fn captures_folder(folder: Option<&Path>) -> anyhow::Result<Option<PathBuf>> {
    let Some(folder) = folder else { return Ok(None) };
    if session_holding(folder).is_some() {
        let what = "it is a capture, and the folder that holds captures is needed";
        return Err(UsageError(format!("--captures {}: {what}", folder.display())).into());
    }
    if !folder.is_dir() {
        return Err(UsageError(format!("--captures {}: there is no such folder", folder.display())).into());
    }
    Ok(Some(folder.to_owned()))
}

/// The shipped lenses, and those that are given as NAME=FILE.
pub(super) fn lenses(given: &[String]) -> anyhow::Result<BTreeMap<String, LensParameters>> {
    let mut lenses = BTreeMap::new();
    for name in lens_names() {
        let lens = load_lens(&name)?.lens.parameters().clone();
        lenses.insert(name, lens);
    }
    for pair in given {
        let wrong = || UsageError(format!("--lens {pair}: NAME=FILE is needed"));
        let (name, file) = pair.split_once('=').ok_or_else(wrong)?;
        lenses.insert(name.to_owned(), load_lens(file)?.lens.parameters().clone());
    }
    Ok(lenses)
}

/// Largest file with a token; a longer token fits no HTTP header.
const MAX_TOKEN_BYTES: u64 = 4096;

/// Reads the token of a file.
pub(super) fn token(path: &Path) -> anyhow::Result<String> {
    let text = plain_file::read_text(path, MAX_TOKEN_BYTES).map_err(|error| cannot_read(path, error))?;
    let token = text.trim();
    if token.is_empty() {
        return Err(UsageError(format!("--token-file {}: no token in it", path.display())).into());
    }
    if !token.chars().all(|letter| letter.is_ascii_graphic()) {
        let what = "a token is made of letters, digits and signs, without blanks between them";
        return Err(UsageError(format!("--token-file {}: {what}", path.display())).into());
    }
    Ok(token.to_owned())
}
