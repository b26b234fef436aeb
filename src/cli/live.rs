//! Command `realitysim live`: watches a robot while it records, in a browser.

use std::fs;
#[cfg(feature = "live")]
use std::net::Ipv4Addr;
use std::net::SocketAddr;
use std::os::unix::fs::FileTypeExt;
use std::path::PathBuf;
use std::sync::Arc;

#[cfg(feature = "live")]
use anyhow::Context;
use clap::Args;

use super::record::SOCKET;
use super::serve::{captures_folder, tell_ready, token};
use super::settings::UsageError;
use super::status_text::status_text;
use super::values::address;
use super::{Outcome, output};
use crate::cli::host_info::cores;
use crate::config::Settings;
#[cfg(feature = "live")]
use crate::live::ViewerServer;
use crate::live::{RemoteRecorder, RemoteSocket, Status, stop_flag};
use crate::recording::sync::{SSH, Source};
use crate::service::{ServeOptions, serve};
use crate::views::FAR_M;

/// Watch a robot while it records, in a browser
///
/// Shows what its recorder sees now: the picture with the lines of its tag, where it stands, drops, disk and clocks; `mark`,
/// `place`, `start` and `stop` are buttons. The robot is reached by ssh, which forwards the recorder's control socket: nothing else
/// runs there, and a robot that goes away is tried again. Ends with SIGINT or SIGTERM (docs/howto/page.md).
#[derive(Args)]
#[command(after_long_help = "Example:\n  realitysim live nao@10.0.0.7:")]
pub struct LiveArguments {
    /// user@host: or user@host:SOCKET, as for ssh; a path is a socket of this machine
    robot: String,
    /// A database, to walk through its images beside it
    #[arg(long, value_name = "DIR")]
    db: Option<PathBuf>,
    /// A folder of captures that the page shows
    #[arg(long, value_name = "CAPTURES_DIR")]
    captures: Option<PathBuf>,
    /// Address and port; port 0 takes a free one, which is told. Beyond loopback a token is needed
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8765", value_parser = address)]
    listen: SocketAddr,
    /// A file with the token that clients must send
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Show the same in Foxglove and Lichtblick: a port of this machine, or ADDRESS:PORT. Their protocol has no token: whoever reaches
    /// the port sees the camera, and any page of this machine's browsers does; nobody can give orders there. Port 0 takes a free one, which is told
    #[cfg(feature = "live")]
    #[arg(long, value_name = "PORT", value_parser = port_or_address)]
    foxglove: Option<SocketAddr>,
    /// The command that opens a shell on the robot
    #[arg(long, value_name = "COMMAND", default_value = SSH)]
    ssh: String,
}

pub fn run(arguments: &LiveArguments, json: bool) -> anyhow::Result<Outcome> {
    let robot = Arc::new(RemoteRecorder::watch(remote_socket(arguments)?, describe)?);
    #[cfg(feature = "live")]
    let viewers = start_viewers(arguments.foxglove, &robot)?;
    #[cfg(feature = "live")]
    let viewers_at = viewers.as_ref().map(ViewerServer::address);
    #[cfg(not(feature = "live"))]
    let viewers_at = None;
    let options = ServeOptions {
        database: arguments.db.clone(),
        captures: captures_folder(arguments.captures.as_deref())?,
        live: Some(robot),
        listen: arguments.listen,
        token: arguments.token_file.as_deref().map(token).transpose()?,
        threads: cores(),
        settings: Settings::default().views,
        lenses: super::serve::lenses(&[])?,
        scenes: Default::default(),
        max_distance_m: FAR_M,
    };
    let (stop, words) = (stop_flag()?, format!("watching {}", arguments.robot));
    serve(options, &stop, |address, images| tell_ready(address, images, &words, viewers_at, json), output::say)?;
    Ok(Outcome::Whole)
}

/// Serves Foxglove and Lichtblick, if they are to be served.
#[cfg(feature = "live")]
fn start_viewers(listen: Option<SocketAddr>, robot: &Arc<RemoteRecorder>) -> anyhow::Result<Option<ViewerServer>> {
    let Some(listen) = listen else { return Ok(None) };
    let image_topic = Settings::default().topics.image;
    let server = ViewerServer::start(Arc::clone(robot), listen, &image_topic);
    let server = server.with_context(|| format!("--foxglove {listen}"))?;
    if !listen.ip().is_loopback() {
        let address = server.address();
        output::say(&format!("whoever reaches {address} sees the camera: Foxglove's protocol has no token"));
    }
    Ok(Some(server))
}

/// Accepts a port, which is one of this machine alone, or an address with its port.
#[cfg(feature = "live")]
fn port_or_address(text: &str) -> Result<SocketAddr, String> {
    match text.parse() {
        Ok(port) => Ok(SocketAddr::from((Ipv4Addr::LOCALHOST, port))),
        Err(_) => address(text)
            .map_err(|_| "a port is needed, as in 8766, or an address and a port, as in 0.0.0.0:8766".to_owned()),
    }
}

/// Reads where the recorder's socket is: as for `sync`, and without a path the recorder's own.
fn remote_socket(arguments: &LiveArguments) -> Result<RemoteSocket, UsageError> {
    let LiveArguments { robot, ssh, .. } = arguments;
    let source = Source::parse(robot).map_err(|error| UsageError(error.to_string()))?;
    let names_none = source.is_remote() && robot.ends_with(':');
    let socket = if names_none { SOCKET } else { &source.folder };
    let ssh: Vec<String> = ssh.split_whitespace().map(str::to_owned).collect();
    if ssh.is_empty() {
        return Err(UsageError("--ssh names no program".to_owned()));
    }
    // A socket that is not there yet is waited for.
    let is_other = |found: &fs::Metadata| !found.file_type().is_socket();
    if !source.is_remote() && fs::metadata(socket).is_ok_and(|found| is_other(&found)) {
        return Err(UsageError(format!("{socket}: it is no socket: name user@host: or the recorder's control socket")));
    }
    Ok(RemoteSocket { host: source.host, socket: PathBuf::from(socket), ssh })
}

/// The status in words, without the map of coverage, which the page draws on the field.
fn describe(status: &Status) -> Vec<String> {
    let mut status = status.clone();
    status.coverage.iter_mut().for_each(|coverage| coverage.map.clear());
    status_text(&status).lines().map(str::to_owned).collect()
}
