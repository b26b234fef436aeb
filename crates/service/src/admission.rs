//! How many requests are worked on, how many wait, and that others are told to come back.

use std::sync::Arc;
use std::time::Duration;

use hyper::StatusCode;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::timeout;

use super::HttpProblem;

pub(super) struct AdmissionControl {
    /// Inside: at work or waiting.
    inside: Arc<Semaphore>,
    batches: Arc<Semaphore>,
    at_work: Arc<Semaphore>,
    most_inside: usize,
}

/// Requests that wait for a thread; with more, a client is told to come back.
const MAX_WAITING: usize = 32;
/// So long one waits.
const MAX_WAIT: Duration = Duration::from_secs(5);

/// Batches under way, each with one view at work or waiting; a further one waits for its beginning.
const MAX_BATCHES: usize = 8;

impl AdmissionControl {
    pub(super) fn new(threads: usize) -> Self {
        let most_inside = threads + MAX_WAITING;
        let [inside, batches, at_work] = [most_inside, MAX_BATCHES, threads].map(|most| Arc::new(Semaphore::new(most)));
        Self { inside, batches, at_work, most_inside }
    }

    /// A thread's worth of work, or a refusal at once when too many wait. Who hangs up while waiting leaves the queue.
    pub(super) async fn enter(&self) -> Result<WorkPermit, HttpProblem> {
        let place = Arc::clone(&self.inside).try_acquire_owned();
        let place = place.map_err(|_| busy("too many requests are waiting: come back in a second"))?;
        match timeout(MAX_WAIT, Arc::clone(&self.at_work).acquire_owned()).await {
            Ok(Ok(work)) => Ok(WorkPermit { _place: Some(place), _work: work }),
            _ => Err(busy("no thread became free in time: come back in a second")),
        }
    }

    /// The right to make many views, each of which [waits for its turn](Self::next_of_batch).
    pub(super) async fn begin_batch(&self) -> Result<OwnedSemaphorePermit, HttpProblem> {
        match timeout(MAX_WAIT, Arc::clone(&self.batches).acquire_owned()).await {
            Ok(Ok(batch)) => Ok(batch),
            _ => Err(busy("too many batches are under way: come back in a second")),
        }
    }

    /// A thread's worth of work for one view of a batch, behind those that came before it: a batch holds no thread while its
    /// client reads.
    pub(super) async fn next_of_batch(&self) -> Result<WorkPermit, HttpProblem> {
        let work = Arc::clone(&self.at_work).acquire_owned().await;
        work.map(|work| WorkPermit { _place: None, _work: work }).map_err(|_| busy("the service ends"))
    }

    /// Requests inside.
    pub(super) fn inside(&self) -> usize {
        self.most_inside - self.inside.available_permits()
    }
}

fn busy(what: &str) -> HttpProblem {
    HttpProblem::new(StatusCode::SERVICE_UNAVAILABLE, what)
}

/// The right to use a thread, for as long as it is held.
pub(super) struct WorkPermit {
    _place: Option<OwnedSemaphorePermit>,
    _work: OwnedSemaphorePermit,
}

impl WorkPermit {
    /// Does it in a thread of its own; a panic is an error of this request alone.
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
