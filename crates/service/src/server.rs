//! Listens for clients, with limits that keep any of them from taking more than its share.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use thiserror::Error;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::runtime::Builder;
use tokio::sync::{Semaphore, watch};
use tokio::time::{sleep, timeout};

use super::Service;
use super::admission::AdmissionControl;
use super::captures::Captures;
use super::connections::ConnectionSlot;
use super::guard::Guard;
use super::live::LiveRobot;
use super::metrics::Metrics;
use super::routes::{answer, refresh};
use super::view_service::ViewService;
use super::write_timeout::WriteTimeout;
use realitysim_config::ViewsSettings;
use realitysim_database::DatabaseError;
use realitysim_geometry::LensParameters;
use realitysim_scene::Scene;

/// What to serve, and where.
#[derive(Clone, Debug)]
pub struct ServeOptions {
    /// Folder of the database; without one there are no views.
    pub database: Option<PathBuf>,
    /// Folder of the captures that the page shows, if any.
    pub captures: Option<PathBuf>,
    /// A robot to watch, if there is one.
    pub live: Option<Arc<dyn LiveRobot>>,
    /// Address and port to listen on; port 0 takes any free one.
    pub listen: SocketAddr,
    /// Token that clients must send; needed for any address but loopback.
    pub token: Option<String>,
    /// Number of threads that make views.
    pub threads: usize,
    /// Settings of the views.
    pub settings: ViewsSettings,
    /// Lenses that clients may name.
    pub lenses: BTreeMap<String, LensParameters>,
    /// Scenes that clients may name.
    pub scenes: BTreeMap<String, Scene>,
    /// Largest distance of a view from the nearest image, metres, if the client does not state one.
    pub max_distance_m: f64,
}

/// Why the service cannot run.
#[derive(Debug, Error)]
pub enum ServeError {
    /// Another address than loopback needs a token.
    #[error("--listen {0}: who can reach it could use it: give a token with --token-file")]
    NoToken(SocketAddr),
    /// The token is too short; its number of characters.
    #[error("the token has {0} characters: at least {MIN_TOKEN_CHARS} are needed")]
    ShortToken(usize),
    /// The address cannot be listened on.
    #[error("--listen {address}: {source}")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// What the operating system says.
        source: std::io::Error,
    },
    /// The threads of the service cannot be started.
    #[error(transparent)]
    Runtime(#[from] std::io::Error),
    /// The database cannot be opened.
    #[error(transparent)]
    Database(#[from] DatabaseError),
}

/// Longest time for the head of a request to come, and between two requests of a connection.
const MAX_HEAD_TIME: Duration = Duration::from_secs(10);
/// Largest head of a request, bytes.
const MAX_HEAD_BYTES: usize = 16 << 10;
/// Largest number of headers of a request.
const MAX_HEADERS: usize = 64;
/// Time that requests under way have to be answered when the service ends.
const MAX_SHUTDOWN_TIME: Duration = Duration::from_secs(5);
/// Time between two looks for changes of the database.
const LOOK_FOR_CHANGES_EVERY: Duration = Duration::from_millis(500);
/// Time between two looks at the stop flag.
const LOOK_FOR_STOP_EVERY: Duration = Duration::from_millis(100);
/// Time between two looks whether the last connection has gone.
const LOOK_FOR_LAST_EVERY: Duration = Duration::from_millis(20);
/// Smallest number of characters of a token.
const MIN_TOKEN_CHARS: usize = 16;
/// Largest number of clients without a place that are told so at one time; further ones are hung up on.
const MAX_REFUSALS: usize = 256;
/// Longest time that a refused client has to take its answer.
const MAX_REFUSAL_TIME: Duration = Duration::from_secs(2);
/// Answer to a client for which there is no free connection.
const NO_CONNECTION_FREE: &[u8] =
    b"HTTP/1.1 503 Service Unavailable\r\nRetry-After: 1\r\nConnection: close\r\nContent-Length: 0\r\n\r\n";

/// Serves views until `stop` is set.
///
/// `ready` is called once with the address that is listened on and the number of images in the database. `say` is called with
/// a text when the database has changed.
pub fn serve(
    options: ServeOptions,
    stop: &AtomicBool,
    ready: impl FnOnce(SocketAddr, usize),
    say: fn(&str),
) -> Result<(), ServeError> {
    let guard = match &options.token {
        Some(token) if token.chars().count() < MIN_TOKEN_CHARS => {
            return Err(ServeError::ShortToken(token.chars().count()));
        }
        Some(token) => Guard::Token(blake3::hash(token.as_bytes())),
        None if options.listen.ip().is_loopback() => Guard::Loopback,
        None => return Err(ServeError::NoToken(options.listen)),
    };
    let ServeOptions { database, captures, live, listen, threads, settings, lenses, scenes, max_distance_m, .. } =
        options;
    let open = |database: PathBuf| ViewService::open(&database, &settings, lenses, scenes, max_distance_m);
    let views = database.map(open).transpose()?;
    let service = Arc::new(Service {
        views,
        captures: Captures::of(captures),
        live,
        metrics: Metrics::default(),
        admission: AdmissionControl::new(threads),
        connections: Arc::default(),
    });
    // One thread serves the connections, `threads` make views, and one looks for changes.
    let runtime = Builder::new_current_thread().enable_all().max_blocking_threads(threads + 1).build()?;
    runtime.block_on(async {
        let failed = |source| ServeError::Listen { address: listen, source };
        let listener = TcpListener::bind(listen).await.map_err(failed)?;
        ready(listener.local_addr().map_err(failed)?, service.views.as_ref().map_or(0, |views| views.database().index().len()));
        let changes = tokio::spawn(follow_changes(Arc::clone(&service), say));
        let connections = Arc::clone(&service.connections);
        let (end, ended) = watch::channel(false);
        let refusals = Arc::new(Semaphore::new(MAX_REFUSALS));
        loop {
            tokio::select! {
                () = wait_for_stop(stop) => break,
                (stream, address) = accept(&listener) => match connections.admit(address.ip()) {
                    Some(slot) => {
                        tokio::spawn(serve_connection(Arc::clone(&service), guard.clone(), stream, slot, ended.clone()));
                    }
                    None => refuse(stream, &refusals),
                },
            }
        }
        changes.abort();
        // Sending fails if there is no connection.
        let _ = end.send(true);
        let all_gone = async {
            while connections.len() > 0 {
                sleep(LOOK_FOR_LAST_EVERY).await;
            }
        };
        let _ = timeout(MAX_SHUTDOWN_TIME, all_gone).await;
        Ok(())
    })
}

/// Waits for the next client.
async fn accept(listener: &TcpListener) -> (TcpStream, SocketAddr) {
    loop {
        match listener.accept().await {
            Ok(accepted) => return accepted,
            // There are no descriptors left, or the client has gone: the next one may succeed.
            Err(_) => sleep(LOOK_FOR_STOP_EVERY).await,
        }
    }
}

/// Tells a client that there is no place for it.
///
/// What it sends is read meanwhile: closing a socket with unread bytes resets the connection, and the answer is lost.
fn refuse(mut stream: TcpStream, refusals: &Arc<Semaphore>) {
    let Ok(permit) = Arc::clone(refusals).try_acquire_owned() else { return };
    tokio::spawn(async move {
        let telling = async {
            stream.write_all(NO_CONNECTION_FREE).await?;
            stream.shutdown().await?;
            let mut unread = [0; 1024];
            while stream.read(&mut unread).await? > 0 {}
            std::io::Result::Ok(())
        };
        // A client that does not listen is not waited for.
        let _ = timeout(MAX_REFUSAL_TIME, telling).await;
        drop(permit);
    });
}

/// Serves one connection until it is closed, its place is needed, or the service ends.
async fn serve_connection(
    service: Arc<Service>,
    guard: Guard,
    stream: TcpStream,
    slot: Arc<ConnectionSlot>,
    mut ended: watch::Receiver<bool>,
) {
    let _ = stream.set_nodelay(true);
    let stream = TokioIo::new(WriteTimeout::new(stream, Arc::clone(&slot)));
    let own_slot = Arc::clone(&slot);
    let answering =
        service_fn(move |request| answer(Arc::clone(&service), guard.clone(), Arc::clone(&own_slot), request));
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(MAX_HEAD_TIME)
        .max_buf_size(MAX_HEAD_BYTES)
        .max_headers(MAX_HEADERS)
        .serve_connection(stream, answering);
    tokio::pin!(connection);
    // An error of a connection needs no handling: its client has got an answer, or it has gone.
    tokio::select! {
        _ = connection.as_mut() => {}
        () = slot.disconnected() => {}
        _ = ended.changed() => {
            connection.as_mut().graceful_shutdown();
            let _ = connection.await;
        }
    }
}

/// Waits until `stop` is set.
async fn wait_for_stop(stop: &AtomicBool) {
    while !stop.load(Ordering::Relaxed) {
        sleep(LOOK_FOR_STOP_EVERY).await;
    }
}

/// Follows changes of the database for ever. The same error is reported once, not twice a second.
async fn follow_changes(service: Arc<Service>, say: fn(&str)) {
    let mut last = None;
    loop {
        sleep(LOOK_FOR_CHANGES_EVERY).await;
        let shared = Arc::clone(&service);
        let said = tokio::task::spawn_blocking(move || refresh(&shared)).await.ok().flatten();
        if said.is_some() && said != last {
            said.iter().for_each(|said| say(said));
        }
        last = said;
    }
}
