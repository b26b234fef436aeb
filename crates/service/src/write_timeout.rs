//! Limits how slowly a client may take its answers, because they stay in memory until then.

use std::future::Future;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::time::{Instant, Sleep, sleep};

use super::connections::ConnectionSlot;

/// Longest wait of a write until the first byte is taken, and for all bytes together beyond what [`MIN_RATE_BYTES_S`] allows for.
const MAX_STALL: Duration = Duration::from_secs(10);
/// Smallest average rate at which a client must take bytes while the service waits for it, bytes per second.
const MIN_RATE_BYTES_S: f64 = 65_536.0;

/// A connection that fails with `TimedOut` if its client takes bytes too slowly.
pub(super) struct WriteTimeout {
    stream: TcpStream,
    slot: Arc<ConnectionSlot>,
    credit: Credit,
    /// Ends when the credit of the write that waits is used up.
    exhausted: Pin<Box<Sleep>>,
    /// Time since which a write has been waiting.
    waits_since: Option<Instant>,
}

/// Time that the service will still wait for a client: waiting uses it up, and bytes that are taken earn it back.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Credit(Duration);

impl Credit {
    fn after_waiting(self, waited: Duration) -> Self {
        Self(self.0.saturating_sub(waited))
    }

    fn after_taking(self, bytes: usize) -> Self {
        Self((self.0 + Duration::from_secs_f64(bytes as f64 / MIN_RATE_BYTES_S)).min(MAX_STALL))
    }
}

impl WriteTimeout {
    pub(super) fn new(stream: TcpStream, slot: Arc<ConnectionSlot>) -> Self {
        let (credit, exhausted) = (Credit(MAX_STALL), Box::pin(sleep(MAX_STALL)));
        Self { stream, slot, credit, exhausted, waits_since: None }
    }

    /// Applies the limit to the result of a write.
    fn within_time(&mut self, context: &mut Context, done: Poll<io::Result<usize>>) -> Poll<io::Result<usize>> {
        if let Poll::Ready(taken) = done {
            if let Some(since) = self.waits_since.take() {
                self.credit = self.credit.after_waiting(since.elapsed());
            }
            if let Ok(bytes) = taken {
                self.credit = self.credit.after_taking(bytes);
                self.slot.record_taken(bytes);
            }
            return Poll::Ready(taken);
        }
        if self.waits_since.is_none() {
            let now = Instant::now();
            self.waits_since = Some(now);
            self.exhausted.as_mut().reset(now + self.credit.0);
        }
        self.exhausted.as_mut().poll(context).map(|()| Err(io::ErrorKind::TimedOut.into()))
    }
}

impl AsyncRead for WriteTimeout {
    fn poll_read(mut self: Pin<&mut Self>, context: &mut Context, buffer: &mut ReadBuf) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl AsyncWrite for WriteTimeout {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let done = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.within_time(context, done)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context,
        parts: &[io::IoSlice],
    ) -> Poll<io::Result<usize>> {
        let done = Pin::new(&mut self.stream).poll_write_vectored(context, parts);
        self.within_time(context, done)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the time after which a client that takes `bytes` every `period` is given up; `None` if it never is.
    fn patience(bytes: usize, period: Duration) -> Option<Duration> {
        let mut credit = Credit(MAX_STALL);
        (0..10_000u32).find_map(|number| {
            if credit.0 < period {
                return Some(period * number + credit.0);
            }
            credit = credit.after_waiting(period).after_taking(bytes);
            None
        })
    }

    #[test]
    fn a_client_below_the_least_rate_is_given_up_and_one_above_it_is_not() {
        assert_eq!(patience(1, Duration::from_secs(11)), Some(MAX_STALL));
        let dripping = patience(1, Duration::from_secs(9)).expect("given up");
        assert!(dripping < 2 * MAX_STALL, "{dripping:?}");
        let half = patience(MIN_RATE_BYTES_S as usize / 2, Duration::from_secs(1)).expect("given up");
        assert!((half.as_secs_f64() - 20.0).abs() < 1.5, "{half:?}");
        assert_eq!(patience(MIN_RATE_BYTES_S as usize, Duration::from_secs(1)), None);
    }

    #[test]
    fn what_was_taken_fast_earns_no_more_than_the_longest_wait() {
        assert_eq!(Credit(Duration::ZERO).after_taking(1 << 30), Credit(MAX_STALL));
    }
}
