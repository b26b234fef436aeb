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
use tokio::sync::watch;
use tokio::time::{sleep, timeout};

use super::Service;
use super::admission::AdmissionControl;
use super::connections::Seat;
use super::guard::Guard;
use super::metrics::Metrics;
use super::routes::{answer, refresh};
use super::view_service::ViewService;
use super::write_timeout::WriteTimeout;
use realitysim_config::ViewsSettings;
use realitysim_database::DatabaseError;
use realitysim_geometry::LensParameters;
use realitysim_scene::Scene;

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

/// So long a client may take for the head of its request, and between two requests.
const MAX_HEAD_TIME: Duration = Duration::from_secs(10);
const MAX_HEAD_BYTES: usize = 16 << 10;
const MAX_HEADERS: usize = 64;
/// Requests under way when the service ends have this long.
const MAX_LAST_WORDS: Duration = Duration::from_secs(5);
const LOOK_FOR_CHANGES_EVERY: Duration = Duration::from_millis(500);
const LOOK_FOR_STOP_EVERY: Duration = Duration::from_millis(100);
const LOOK_FOR_LAST_EVERY: Duration = Duration::from_millis(20);
const LEAST_TOKEN: usize = 16;
/// To a client for whom there is no place.
const NO_PLACE: &[u8] =
    b"HTTP/1.1 503 Service Unavailable\r\nRetry-After: 1\r\nConnection: close\r\nContent-Length: 0\r\n\r\n";

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
    let stock = ViewService::open(&database, &settings, lenses, scenes, max_distance_m)?;
    let service = Arc::new(Service {
        stock,
        metrics: Metrics::default(),
        door: AdmissionControl::new(threads),
        connections: Arc::default(),
    });
    // Connections need one thread, views `threads`, the look for changes one.
    let runtime = Builder::new_current_thread().enable_all().max_blocking_threads(threads + 1).build()?;
    runtime.block_on(async {
        let failed = |source| ServeError::Listen { address: listen, source };
        let listener = TcpListener::bind(listen).await.map_err(failed)?;
        ready(listener.local_addr().map_err(failed)?, service.stock.gallery().index().len());
        let changes = tokio::spawn(follow(Arc::clone(&service), say));
        let connections = Arc::clone(&service.connections);
        let (end, ended) = watch::channel(false);
        loop {
            tokio::select! {
                () = until(stop) => break,
                (stream, address) = accept(&listener) => match connections.admit(address.ip()) {
                    Some(seat) => {
                        tokio::spawn(converse(Arc::clone(&service), guard.clone(), stream, seat, ended.clone()));
                    }
                    // What fits into the socket at once, or nothing.
                    None => drop(stream.try_write(NO_PLACE)),
                },
            }
        }
        changes.abort();
        // Nobody listens if there is no connection.
        let _ = end.send(true);
        let all_gone = async {
            while connections.len() > 0 {
                sleep(LOOK_FOR_LAST_EVERY).await;
            }
        };
        let _ = timeout(MAX_LAST_WORDS, all_gone).await;
        Ok(())
    })
}

/// The next client.
async fn accept(listener: &TcpListener) -> (TcpStream, SocketAddr) {
    loop {
        match listener.accept().await {
            Ok(accepted) => return accepted,
            // Out of descriptors, or gone already: the next one may do better.
            Err(_) => sleep(LOOK_FOR_STOP_EVERY).await,
        }
    }
}

async fn converse(
    service: Arc<Service>,
    guard: Guard,
    stream: TcpStream,
    seat: Arc<Seat>,
    mut ended: watch::Receiver<bool>,
) {
    let _ = stream.set_nodelay(true);
    let stream = TokioIo::new(WriteTimeout::new(stream, Arc::clone(&seat)));
    let asker = Arc::clone(&seat);
    let answering = service_fn(move |request| answer(Arc::clone(&service), guard.clone(), Arc::clone(&asker), request));
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(MAX_HEAD_TIME)
        .max_buf_size(MAX_HEAD_BYTES)
        .max_headers(MAX_HEADERS)
        .serve_connection(stream, answering);
    tokio::pin!(connection);
    // What goes wrong with one client is its own: it has been told, or it has gone.
    tokio::select! {
        _ = connection.as_mut() => {}
        () = seat.sent_away() => {}
        _ = ended.changed() => {
            connection.as_mut().graceful_shutdown();
            let _ = connection.await;
        }
    }
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
