//! How many requests are worked on, how many wait, and that others are told to come back.

use std::sync::Arc;
use std::time::Duration;

use hyper::StatusCode;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::timeout;

use super::Refusal;

pub(super) struct Door {
    /// Inside: at work or waiting.
    inside: Arc<Semaphore>,
    at_work: Arc<Semaphore>,
    most_inside: usize,
}

/// Requests that wait for a thread; with more, a client is told to come back.
const MAX_WAITING: usize = 32;
/// So long one waits.
const MAX_WAIT: Duration = Duration::from_secs(5);

impl Door {
    pub(super) fn new(threads: usize) -> Self {
        let most_inside = threads + MAX_WAITING;
        Self { inside: Arc::new(Semaphore::new(most_inside)), at_work: Arc::new(Semaphore::new(threads)), most_inside }
    }

    /// A thread's worth of work, or a refusal at once when too many wait. Who hangs up while waiting leaves the queue.
    pub(super) async fn enter(&self) -> Result<Inside, Refusal> {
        let busy = |what: &str| Refusal::new(StatusCode::SERVICE_UNAVAILABLE, what);
        let place = Arc::clone(&self.inside).try_acquire_owned();
        let place = place.map_err(|_| busy("too many requests are waiting: come back in a second"))?;
        match timeout(MAX_WAIT, Arc::clone(&self.at_work).acquire_owned()).await {
            Ok(Ok(work)) => Ok(Inside { _place: place, _work: work }),
            _ => Err(busy("no thread became free in time: come back in a second")),
        }
    }

    /// Requests inside.
    pub(super) fn inside(&self) -> usize {
        self.most_inside - self.inside.available_permits()
    }
}

/// The right to use a thread, for as long as it is held.
pub(super) struct Inside {
    _place: OwnedSemaphorePermit,
    _work: OwnedSemaphorePermit,
}

impl Inside {
    /// Does it in a thread of its own; a panic is an error of this request alone.
    pub(super) async fn run<T: Send + 'static>(self, work: impl FnOnce() -> T + Send + 'static) -> Result<T, Refusal> {
        let done = tokio::task::spawn_blocking(move || {
            let _inside = self;
            work()
        });
        done.await.map_err(|_| Refusal::new(StatusCode::INTERNAL_SERVER_ERROR, "this request made the service stumble"))
    }
}
