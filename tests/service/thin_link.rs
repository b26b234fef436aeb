//! The page behind a link of 200 kbit/s.

use std::fs;
use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::process::Command;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use serde_json::Value;

use super::Served;

/// What the link carries towards the client, bytes per second: 200 kbit/s.
const LINK_BYTES_PER_S: f64 = 25_000.0;
/// Bytes that are passed on at a time.
const PIECE_BYTES: usize = 1024;

/// A link to a service, which all its connections share. Its threads end with the connections.
struct ThinLink {
    address: SocketAddr,
}

impl ThinLink {
    fn to(service: SocketAddr) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = listener.local_addr().expect("an address");
        std::thread::spawn(move || {
            let line = Arc::<Mutex<()>>::default();
            for client in listener.incoming().flatten() {
                let Ok(server) = TcpStream::connect(service) else { return };
                let (from, to) = (client.try_clone().expect("a socket"), server.try_clone().expect("a socket"));
                std::thread::spawn(move || pass_on(from, to, || ()));
                let line = Arc::clone(&line);
                std::thread::spawn(move || {
                    pass_on(server, client, || {
                        let _taken = line.lock().unwrap_or_else(PoisonError::into_inner);
                        std::thread::sleep(Duration::from_secs_f64(PIECE_BYTES as f64 / LINK_BYTES_PER_S));
                    })
                });
            }
        });
        Self { address }
    }
}

fn pass_on(mut from: TcpStream, mut to: TcpStream, wait: impl Fn()) {
    let mut piece = [0; PIECE_BYTES];
    while let Ok(count @ 1..) = from.read(&mut piece) {
        wait();
        if to.write_all(&piece[..count]).is_err() {
            break;
        }
    }
    let _ = (from.shutdown(Shutdown::Both), to.shutdown(Shutdown::Both));
}

/// What the page's own modules ask for over the link, as `thin_link.mjs` prints it; `None` without Node.
fn asked_over(link: &ThinLink, served: &Served) -> Option<Value> {
    let modules = served.room.path("modules");
    fs::create_dir(&modules).expect("a folder");
    fs::write(modules.join("package.json"), "{\"type\": \"module\"}").expect("written");
    for file in fs::read_dir("crates/service/page").expect("the page").flatten() {
        fs::copy(file.path(), modules.join(file.file_name())).expect("copied");
    }
    let mut node = Command::new("node");
    node.arg("tests/service/thin_link.mjs").arg(link.address.to_string()).arg(&modules);
    let Ok(output) = node.output() else {
        println!("skipped: there is no Node");
        return None;
    };
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(serde_json::from_slice(&output.stdout).expect("JSON"))
}

#[test]
fn over_a_thin_link_the_page_asks_for_small_pictures_one_at_a_time() {
    let served = Served::new("");
    let Some(asked) = asked_over(&ThinLink::to(served.address), &served) else { return };
    assert_eq!(asked["mostAtOnce"], 1, "{asked}");
    let widths: Vec<u64> = asked["asked"].as_array().expect("a list").iter().filter_map(Value::as_u64).collect();
    assert!(widths[0] == 640 && widths[1..].iter().all(|width| *width <= 320), "{asked}");
    let drawn = |method: &str| asked["drawn"][method].as_u64().expect("a count");
    assert!(drawn("exact") > 2 && drawn("nearest") > 2, "each picture gets its turn: {asked}");
}
