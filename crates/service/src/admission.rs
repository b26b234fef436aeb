//! Limits how many requests are worked on and how many wait; further ones are told to come back.

use std::sync::Arc;
use std::time::Duration;

use hyper::StatusCode;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::timeout;

use super::HttpProblem;

/// The limits on requests.
pub(super) struct AdmissionControl {
    /// Permits of requests that are at work or wait.
    inside: Arc<Semaphore>,
    /// Permits of batches.
    batches: Arc<Semaphore>,
    /// Permits of threads.
    at_work: Arc<Semaphore>,
    /// Number of permits of `inside`.
    max_inside: usize,
}

/// Largest number of requests that wait for a thread; further ones are refused.
const MAX_WAITING: usize = 32;
/// Longest wait for a thread, or for the beginning of a batch.
const MAX_WAIT: Duration = Duration::from_secs(5);

/// Largest number of batches under way, each with one view at work or waiting; a further one waits to begin.
const MAX_BATCHES: usize = 8;

impl AdmissionControl {
    /// Creates the limits for a number of threads that make views.
    pub(super) fn new(threads: usize) -> Self {
        let max_inside = threads + MAX_WAITING;
        let [inside, batches, at_work] =
            [max_inside, MAX_BATCHES, threads].map(|permits| Arc::new(Semaphore::new(permits)));
        Self { inside, batches, at_work, max_inside }
    }

    /// Waits for a thread. Refuses at once if too many requests wait; a client that hangs up leaves the queue.
    pub(super) async fn enter(&self) -> Result<WorkPermit, HttpProblem> {
        let place = Arc::clone(&self.inside).try_acquire_owned();
        let place = place.map_err(|_| busy("too many requests are waiting: come back in a second"))?;
        match timeout(MAX_WAIT, Arc::clone(&self.at_work).acquire_owned()).await {
            Ok(Ok(work)) => Ok(WorkPermit { _place: Some(place), _work: work }),
            _ => Err(busy("no thread became free in time: come back in a second")),
        }
    }

    /// Waits for the right to make many views, each of which [waits for its turn](Self::next_of_batch).
    pub(super) async fn begin_batch(&self) -> Result<OwnedSemaphorePermit, HttpProblem> {
        match timeout(MAX_WAIT, Arc::clone(&self.batches).acquire_owned()).await {
            Ok(Ok(batch)) => Ok(batch),
            _ => Err(busy("too many batches are under way: come back in a second")),
        }
    }

    /// Waits for a thread for one view of a batch, in the order of coming. A batch holds no thread while its client reads.
    pub(super) async fn next_of_batch(&self) -> Result<WorkPermit, HttpProblem> {
        let work = Arc::clone(&self.at_work).acquire_owned().await;
        work.map(|work| WorkPermit { _place: None, _work: work }).map_err(|_| busy("the service ends"))
    }

    /// Returns the number of requests that are at work or wait.
    pub(super) fn inside(&self) -> usize {
        self.max_inside - self.inside.available_permits()
    }
}

/// Refusal that tells a client to come back.
fn busy(what: &str) -> HttpProblem {
    HttpProblem::new(StatusCode::SERVICE_UNAVAILABLE, what)
}

/// The right to use a thread while this is held.
pub(super) struct WorkPermit {
    _place: Option<OwnedSemaphorePermit>,
    _work: OwnedSemaphorePermit,
}

impl WorkPermit {
    /// Does the work in a thread of its own. A panic is an error of this request alone.
    pub(super) async fn run<T: Send + 'static>(
        self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, HttpProblem> {
        let done = tokio::task::spawn_blocking(move || {
            let _inside = self;
            work()
        });
        done.await
            .map_err(|_| HttpProblem::new(StatusCode::INTERNAL_SERVER_ERROR, "this request made the service stumble"))
    }
}
