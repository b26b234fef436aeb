//! Connections of viewers, bounded, and passed on to the server of Foxglove's SDK.
//!
//! The SDK bounds no connections, and its server ends for good when one cannot be accepted, as when no file descriptor is left. So it
//! listens on loopback alone, and what listens for viewers is this: it accepts so many, refuses the rest, and goes on after an error. Should the SDK's server have ended all the same, viewers are closed at once.

use std::io;
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

/// The listening socket. Dropping it ends it; connections end with the server that they are passed on to.
#[derive(Debug)]
pub(super) struct ViewerConnections {
    address: SocketAddr,
    stop: Arc<AtomicBool>,
    acceptor: Option<JoinHandle<()>>,
}

/// Largest number of viewers at once.
const MAX_VIEWERS: usize = 16;
/// Time between two looks for a new connection.
const ACCEPT_TICK: Duration = Duration::from_millis(50);
/// Longest time that a viewer takes nothing of what is sent.
const MAX_STALL: Duration = Duration::from_secs(20);

impl ViewerConnections {
    /// Listens on an address; port 0 takes a free one. Connections are passed on to `server`.
    pub(super) fn listen(listen: SocketAddr, server: SocketAddr) -> io::Result<Self> {
        let listener = TcpListener::bind(listen)?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        let stop = Arc::<AtomicBool>::default();
        let is_over = Arc::clone(&stop);
        let accept = move || accept_until(&is_over, &listener, server);
        let acceptor = Some(Builder::new().name("viewers-accept".to_owned()).spawn(accept)?);
        Ok(Self { address, stop, acceptor })
    }

    /// Returns where it listens.
    pub(super) fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for ViewerConnections {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(acceptor) = self.acceptor.take() {
            let _ = acceptor.join();
        }
    }
}

fn accept_until(stop: &AtomicBool, listener: &TcpListener, server: SocketAddr) {
    let open = Arc::<AtomicUsize>::default();
    while !stop.load(Ordering::Relaxed) {
        match listener.accept() {
            // A viewer beyond is closed at once: its program says that it could not connect.
            Ok((viewer, _)) if open.load(Ordering::Relaxed) < MAX_VIEWERS => {
                let place = Place::taken(&open);
                // One that cannot be passed on is closed, and tries again.
                let _ = pass_on(viewer, server, place);
            }
            Ok(_) => {}
            // Nobody has come, or no descriptor is left for who has.
            Err(_) => std::thread::sleep(ACCEPT_TICK),
        }
    }
}

/// The place of one viewer, free again when it is dropped.
struct Place(Arc<AtomicUsize>);

impl Place {
    fn taken(open: &Arc<AtomicUsize>) -> Self {
        open.fetch_add(1, Ordering::Relaxed);
        Self(Arc::clone(open))
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Copies both ways between viewer and server, in threads of their own, until either side ends.
fn pass_on(viewer: TcpStream, server: SocketAddr, place: Place) -> io::Result<()> {
    let server = TcpStream::connect(server)?;
    viewer.set_nonblocking(false)?;
    viewer.set_write_timeout(Some(MAX_STALL))?;
    viewer.set_nodelay(true)?;
    server.set_nodelay(true)?;
    let (viewer_again, server_again) = (viewer.try_clone()?, server.try_clone()?);
    let there = move || copy_to_the_end(&viewer_again, &server_again);
    Builder::new().name("viewer-in".to_owned()).spawn(there)?;
    let back = move || {
        copy_to_the_end(&server, &viewer);
        drop(place);
    };
    Builder::new().name("viewer-out".to_owned()).spawn(back)?;
    Ok(())
}

/// Copies until one side ends, and ends both.
fn copy_to_the_end(mut from: &TcpStream, mut to: &TcpStream) {
    let _ = io::copy(&mut from, &mut to);
    for stream in [from, to] {
        let _ = stream.shutdown(Shutdown::Both);
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::time::Instant;

    use super::*;

    /// A server that sends back what it gets.
    fn echo() -> SocketAddr {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = listener.local_addr().expect("bound");
        std::thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                std::thread::spawn(move || io::copy(&mut &stream, &mut &stream));
            }
        });
        address
    }

    fn answer(address: SocketAddr) -> io::Result<(TcpStream, [u8; 5])> {
        let mut viewer = TcpStream::connect(address)?;
        viewer.set_read_timeout(Some(Duration::from_secs(10)))?;
        viewer.write_all(b"hello")?;
        let mut bytes = [0; 5];
        viewer.read_exact(&mut bytes)?;
        Ok((viewer, bytes))
    }

    #[test]
    fn so_many_are_passed_on_and_the_rest_refused() {
        let connections =
            ViewerConnections::listen("127.0.0.1:0".parse().expect("an address"), echo()).expect("listens");
        let mut viewers: Vec<TcpStream> = (0..MAX_VIEWERS)
            .map(|_| {
                let (viewer, bytes) = answer(connections.address()).expect("passed on");
                assert_eq!(&bytes, b"hello");
                viewer
            })
            .collect();
        assert!(answer(connections.address()).is_err(), "all places are taken");
        viewers.pop();
        let until = Instant::now() + Duration::from_secs(20);
        while answer(connections.address()).is_err() {
            assert!(Instant::now() < until, "the place is free again");
        }
    }

    #[test]
    fn without_a_server_a_viewer_is_closed_and_the_next_one_accepted() {
        let gone = TcpListener::bind("127.0.0.1:0").expect("a port").local_addr().expect("bound");
        let connections = ViewerConnections::listen("127.0.0.1:0".parse().expect("an address"), gone).expect("listens");
        for _ in 0..3 {
            assert!(answer(connections.address()).is_err());
        }
    }
}
