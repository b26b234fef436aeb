//! Listens, and sees to it that no client costs more than its share.

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
use tokio::net::{TcpListener, TcpStream};
use tokio::runtime::Builder;
use tokio::sync::{Semaphore, watch};
use tokio::time::{sleep, timeout};

use super::Service;
use super::door::Door;
use super::metrics::Metrics;
use super::patient::Patient;
use super::routes::{Guard, answer, refresh};
use super::stock::Stock;
use crate::config::ViewsSettings;
use crate::database::DatabaseError;
use crate::geometry::LensParameters;
use crate::scene::Scene;

#[derive(Clone, Debug)]
pub struct ServeOptions {
    /// The database's folder.
    pub database: PathBuf,
    pub listen: SocketAddr,
    /// Needed beyond loopback.
    pub token: Option<String>,
    /// Threads that make views.
    pub threads: usize,
    pub settings: ViewsSettings,
    /// That clients may name.
    pub lenses: BTreeMap<String, LensParameters>,
    pub scenes: BTreeMap<String, Scene>,
    /// Farther from the nearest image a view is refused, if the client does not say.
    pub max_distance_m: f64,
}

#[derive(Debug, Error)]
pub enum ServeError {
    #[error("--listen {0}: who can reach it could use it: give a token with --token-file")]
    NoToken(SocketAddr),
    #[error("the token has {0} characters: at least {LEAST_TOKEN} are needed")]
    ShortToken(usize),
    #[error("--listen {address}: {source}")]
    Listen { address: SocketAddr, source: std::io::Error },
    #[error(transparent)]
    Runtime(#[from] std::io::Error),
    #[error(transparent)]
    Database(#[from] DatabaseError),
}

/// Connections at one time; more wait to be accepted.
const MAX_CONNECTIONS: usize = 256;
/// So long a client may take for the head of its request, and between two requests.
const MAX_HEAD_TIME: Duration = Duration::from_secs(10);
const MAX_HEAD_BYTES: usize = 16 << 10;
const MAX_HEADERS: usize = 64;
/// Requests under way when the service ends have this long.
const MAX_LAST_WORDS: Duration = Duration::from_secs(5);
const LOOK_FOR_CHANGES_EVERY: Duration = Duration::from_millis(500);
const LOOK_FOR_STOP_EVERY: Duration = Duration::from_millis(100);
const LEAST_TOKEN: usize = 16;

/// Serves until `stop`. `ready` hears of the address that is listened on (port 0 is any), `say` of changes.
pub fn serve(
    options: ServeOptions,
    stop: &AtomicBool,
    ready: impl FnOnce(SocketAddr, usize),
    say: fn(&str),
) -> Result<(), ServeError> {
    let guard = match &options.token {
        Some(token) if token.chars().count() < LEAST_TOKEN => {
            return Err(ServeError::ShortToken(token.chars().count()));
        }
        Some(token) => Guard::Token(blake3::hash(token.as_bytes())),
        None if options.listen.ip().is_loopback() => Guard::Loopback,
        None => return Err(ServeError::NoToken(options.listen)),
    };
    let ServeOptions { database, listen, threads, settings, lenses, scenes, max_distance_m, .. } = options;
    let stock = Stock::open(&database, &settings, lenses, scenes, max_distance_m)?;
    let service = Arc::new(Service { stock, metrics: Metrics::default(), door: Door::new(threads) });
    // Connections need one thread, views `threads`, the look for changes one.
    let runtime = Builder::new_current_thread().enable_all().max_blocking_threads(threads + 1).build()?;
    runtime.block_on(async {
        let failed = |source| ServeError::Listen { address: listen, source };
        let listener = TcpListener::bind(listen).await.map_err(failed)?;
        ready(listener.local_addr().map_err(failed)?, service.stock.gallery().index().len());
        let changes = tokio::spawn(follow(Arc::clone(&service), say));
        let connections = Arc::new(Semaphore::new(MAX_CONNECTIONS));
        let (end, ended) = watch::channel(false);
        loop {
            tokio::select! {
                () = until(stop) => break,
                accepted = accept(&listener, &connections) => {
                    let (stream, place) = accepted;
                    let (service, guard, ended) = (Arc::clone(&service), guard.clone(), ended.clone());
                    tokio::spawn(async move {
                        converse(service, guard, stream, ended).await;
                        drop(place);
                    });
                }
            }
        }
        changes.abort();
        // Nobody listens if there is no connection.
        let _ = end.send(true);
        let all_gone = connections.acquire_many(MAX_CONNECTIONS as u32);
        let _ = timeout(MAX_LAST_WORDS, all_gone).await;
        Ok(())
    })
}

/// The next client, once there is room for one.
async fn accept(
    listener: &TcpListener,
    connections: &Arc<Semaphore>,
) -> (TcpStream, tokio::sync::OwnedSemaphorePermit) {
    loop {
        if let Ok(place) = Arc::clone(connections).acquire_owned().await {
            match listener.accept().await {
                Ok((stream, _)) => return (stream, place),
                // Out of descriptors, or gone already: the next one may do better.
                Err(_) => sleep(LOOK_FOR_STOP_EVERY).await,
            }
        }
    }
}

async fn converse(service: Arc<Service>, guard: Guard, stream: TcpStream, mut ended: watch::Receiver<bool>) {
    service.metrics.connections.fetch_add(1, Ordering::Relaxed);
    let _ = stream.set_nodelay(true);
    let shared = Arc::clone(&service);
    let answering = service_fn(move |request| answer(Arc::clone(&shared), guard.clone(), request));
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(MAX_HEAD_TIME)
        .max_buf_size(MAX_HEAD_BYTES)
        .max_headers(MAX_HEADERS)
        .serve_connection(TokioIo::new(Patient::new(stream)), answering);
    tokio::pin!(connection);
    // What goes wrong with one client is its own: it has been told, or it has gone.
    tokio::select! {
        _ = connection.as_mut() => {}
        _ = ended.changed() => {
            connection.as_mut().graceful_shutdown();
            let _ = connection.await;
        }
    }
    service.metrics.connections.fetch_sub(1, Ordering::Relaxed);
}

async fn until(stop: &AtomicBool) {
    while !stop.load(Ordering::Relaxed) {
        sleep(LOOK_FOR_STOP_EVERY).await;
    }
}

/// A damaged database is told once, not twice a second.
async fn follow(service: Arc<Service>, say: fn(&str)) {
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
