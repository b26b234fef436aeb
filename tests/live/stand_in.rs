//! What stands in for a recorder where no real one does: one of an older version, and one that counts what it is asked.

use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixListener;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// Orders that came, in their order.
pub type Orders = Arc<Mutex<Vec<String>>>;

/// Answers each order at a control socket with the bytes that `answer` makes of it. Its threads end with the test's process.
pub fn recorder(socket: &Path, answer: fn(&str) -> Vec<u8>) -> Orders {
    let listener = UnixListener::bind(socket).expect("a socket");
    let orders = Orders::default();
    let taken = Arc::clone(&orders);
    std::thread::spawn(move || {
        for client in listener.incoming().flatten() {
            let taken = Arc::clone(&taken);
            std::thread::spawn(move || {
                for line in BufReader::new(&client).lines().map_while(Result::ok) {
                    taken.lock().unwrap_or_else(PoisonError::into_inner).push(line.clone());
                    if (&client).write_all(&answer(&line)).is_err() {
                        return;
                    }
                }
            });
        }
    });
    orders
}
