//! Clients that are slow, many, or talk nonsense.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use super::Served;
use super::client::{Response, connect, exchange, get, get_with};

const HERE: &str = "/v1/view?x=0.22&y=0.2&z=0.5&yaw_deg=11&pitch_deg=20";

#[test]
fn garbage_is_refused_and_the_next_client_served() {
    let mut served = Served::new("");
    let long = format!("GET /v1/view?{} HTTP/1.1\r\nHost: localhost\r\n\r\n", "x".repeat(100_000));
    let many = format!("GET / HTTP/1.1\r\n{}\r\n", "a: b\r\n".repeat(5_000));
    let mut seed = 1u64;
    let noise: Vec<u8> = (0..4096)
        .map(|_| {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (seed >> 56) as u8
        })
        .collect();
    for request in [
        b"\r\n\r\n\r\n".as_slice(),
        b"GET\r\n\r\n",
        b"GET / HTTP/9.9\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
        b"GET /v1/view?x=%ff%fe&y=%00 HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n",
        b"POST /v1/views HTTP/1.1\r\nHost: localhost\r\nContent-Length: -5\r\n\r\n",
        b"POST /v1/views HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\nzzz\r\n",
        long.as_bytes(),
        many.as_bytes(),
        &noise,
    ] {
        let mut stream = connect(served.address);
        let _ = stream.write_all(request);
        let _ = stream.shutdown(std::net::Shutdown::Write);
        let mut bytes = Vec::new();
        let _ = stream.read_to_end(&mut bytes);
        if let Some(answer) = Response::parse(&bytes) {
            assert!((400..500).contains(&answer.status), "{:?}: {answer:?}", String::from_utf8_lossy(request));
        }
        assert_eq!(get(served.address, HERE).status, 200);
    }
    assert!(served.is_running());
}

#[test]
fn a_client_that_never_finishes_its_request_is_hung_up_on() {
    let served = Served::new("");
    let started = Instant::now();
    let mut slow = connect(served.address);
    slow.write_all(b"GET /v1/vi").expect("sent");
    let mut idle = connect(served.address);
    // Others are served meanwhile.
    assert_eq!(get(served.address, HERE).status, 200);
    let mut bytes = Vec::new();
    let _ = slow.read_to_end(&mut bytes);
    let _ = idle.read_to_end(&mut bytes);
    assert!(started.elapsed().as_secs_f64() > 5.0, "{:?}", started.elapsed());
}

#[test]
fn a_client_that_does_not_read_its_batch_holds_no_thread() {
    let served = Served::new("--threads 1");
    let poses: Vec<String> = (0..200).map(|i| format!("{{\"x\": 0.2, \"y\": 0.2, \"yaw_deg\": {}}}", i % 20)).collect();
    let body = format!("{{\"z\": 0.5, \"pitch_deg\": 20, \"width\": 640, \"poses\": [{}]}}", poses.join(","));
    let mut deaf = connect(served.address);
    let head = format!(
        "POST /v1/views HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nAccept: application/octet-stream\r\nContent-Length: {}\r\n\r\n",
        body.len()
    );
    deaf.write_all(head.as_bytes()).and_then(|()| deaf.write_all(body.as_bytes())).expect("sent");
    for _ in 0..5 {
        assert_eq!(get(served.address, HERE).status, 200, "the only thread");
    }
    drop(deaf);
}

/// Requests in flight at once.
const CROWD: usize = 500;

#[test]
fn many_at_once_are_served_or_told_to_come_back() {
    let mut served = Served::new("--threads 2");
    let (good, busy) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let address = served.address;
    std::thread::scope(|scope| {
        for client in 0..CROWD {
            let (good, busy) = (&good, &busy);
            scope.spawn(move || {
                let yaw = client % 20;
                let path = format!("/v1/view?x=0.22&y=0.2&z=0.5&yaw_deg={yaw}&pitch_deg=20&width=640");
                let answer = get(address, &path);
                match answer.status {
                    200 => good.fetch_add(1, Ordering::Relaxed),
                    503 => {
                        assert_eq!(answer.header("retry-after"), "1");
                        busy.fetch_add(1, Ordering::Relaxed)
                    }
                    _ => panic!("{}", answer.text()),
                };
            });
        }
    });
    let (good, busy) = (good.into_inner(), busy.into_inner());
    // How many are served before the others have waited too long is a matter of the machine's speed.
    assert!(good >= 2 && good + busy == CROWD, "{good} served, {busy} told to come back");
    assert_eq!(get(served.address, HERE).status, 200, "and it goes on");
    assert_eq!(get(served.address, "/").status, 200, "the page, too");
    assert!(get(served.address, "/metrics").text().contains("realitysim_requests_inside 0"));
    let peak_kb = served.peak_kb();
    assert!(peak_kb < 560_000, "{peak_kb} kB");
    assert!(served.is_running());
}

#[test]
fn who_comes_when_all_places_are_taken_is_told_so() {
    let served = Served::new("--threads 2");
    // Each place is taken by a client whose first request may be on its way. On a slow machine it comes too late for the last ones.
    let _silent: Vec<TcpStream> = (0..256).map(|_| connect(served.address)).collect();
    let request = "GET /openapi.json HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
    let newcomers: Vec<TcpStream> = (0..50)
        .map(|_| {
            let mut client = connect(served.address);
            client.write_all(request.as_bytes()).expect("sent");
            client
        })
        .collect();
    for mut client in newcomers {
        let mut bytes = Vec::new();
        let _ = client.read_to_end(&mut bytes);
        let status = Response::parse(&bytes).expect("an answer, and no reset").status;
        assert!([200, 503].contains(&status), "{status}");
    }
}

#[test]
fn connections_on_which_nothing_is_asked_give_way_to_newcomers() {
    let served = Served::new("");
    // They are hung up on after ten seconds of silence only: whoever waits for that takes longer every time, and a busy machine
    // does not.
    let is_let_in = |_| wait_behind_silent_connections(&served) < Duration::from_secs(8);
    assert!((0..5).any(is_let_in), "newcomers waited for the silent five times");
}

/// Time for twenty answers while more connections than the service has are held open in silence.
fn wait_behind_silent_connections(served: &Served) -> Duration {
    let mut hogs: Vec<TcpStream> = (0..300).filter_map(|_| TcpStream::connect(served.address).ok()).collect();
    for hog in &mut hogs {
        let _ = hog.write_all(b"GET /openapi.json HTTP/1.1\r\nHost: localhost\r\n\r\n");
    }
    let asked = Instant::now();
    let mut answered = 0;
    while answered < 20 {
        match get(served.address, HERE).status {
            200 => answered += 1,
            // The silent ones may have a request on its way yet.
            503 => std::thread::sleep(Duration::from_millis(200)),
            status => panic!("{status}"),
        }
    }
    asked.elapsed()
}

#[test]
fn readers_that_take_nothing_cost_a_bounded_amount_of_memory() {
    let served = Served::new("");
    let view = format!("{HERE}&width=2048&height=2048&mask=alpha&outside=warn");
    let head = format!("GET {view} HTTP/1.1\r\nHost: localhost\r\nAccept: application/octet-stream\r\n\r\n");
    let mut deaf = Vec::new();
    for _ in 0..40 {
        let mut stream = connect(served.address);
        stream.write_all(head.as_bytes()).expect("sent");
        // Made: its first byte is there.
        let mut first = [0];
        stream.read_exact(&mut first).expect("an answer");
        deaf.push(stream);
    }
    let text = get(served.address, "/metrics").text();
    let unsent = text.lines().find_map(|line| line.strip_prefix("realitysim_unsent_bytes ")).expect("the gauge");
    let unsent: u64 = unsent.parse().expect("a number");
    assert!((1 << 24..=256 << 20).contains(&unsent), "{unsent} bytes");
    let peak_kb = served.peak_kb();
    // Forty answers are 671 MB alone, of which 268 MB may wait.
    assert!(peak_kb < 640_000, "{peak_kb} kB");
    assert_eq!(get(served.address, HERE).status, 200);
    drop(deaf);
}

#[test]
fn beyond_loopback_a_token_is_needed() {
    let room = crate::replay::support::Room::new();
    super::add_images(&room, "images", &super::PLACES);
    room.write("token", "sixteen-letters-or-more\n");
    room.write("short", "abc");
    room.run("serve --db db --listen 0.0.0.0:0").fails(2, &["give a token with --token-file"]);
    room.run("serve --db db --token-file short").fails(2, &["at least 16 are needed"]);
    room.run("serve --db none").fails(1, &["there is no database here"]);
    let served = Served::of(room, "--listen 0.0.0.0:0 --token-file token");
    let address = std::net::SocketAddr::from(([127, 0, 0, 1], served.address.port()));
    for headers in
        ["", "Authorization: Bearer wrong-wrong-wrong-wrong\r\n", "Authorization: Basic sixteen-letters-or-more\r\n"]
    {
        let answer = get_with(address, HERE, headers);
        assert_eq!((answer.status, answer.header("www-authenticate")), (401, "Bearer"));
    }
    assert_eq!(get_with(address, HERE, "Authorization: Bearer sixteen-letters-or-more\r\n").status, 200);
}

#[test]
fn a_client_that_may_not_ask_keeps_no_connection() {
    let served = Served::new("");
    let refused = exchange(served.address, b"GET /v1/info HTTP/1.1\r\nHost: evil.example\r\n\r\n");
    let answer = Response::parse(&refused).expect("an answer, and the connection closed behind it");
    assert_eq!((answer.status, answer.header("connection")), (403, "close"));
}

#[test]
fn a_page_of_another_site_is_not_answered_and_one_of_its_own_is() {
    let served = Served::new("");
    let own = format!("localhost:{}", served.address.port());
    let body = r#"{"z": 0.5, "yaw_deg": 11, "pitch_deg": 20, "poses": [{"x": 0.22, "y": 0.2}]}"#;
    let status = |host: &str, headers: &str| {
        let length = body.len();
        let request = format!(
            "POST /v1/views HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{headers}Content-Length: {length}\r\n\r\n{body}"
        );
        let answer = Response::parse(&exchange(served.address, request.as_bytes())).expect("an answer");
        assert_eq!(answer.header("cross-origin-resource-policy"), "same-origin");
        answer.status
    };
    const JSON: &str = "Content-Type: application/json\r\n";
    assert_eq!(status(&own, &format!("{JSON}Origin: http://{own}\r\nSec-Fetch-Site: same-origin\r\n")), 200);
    assert_eq!(status(&own, JSON), 200, "a program");
    assert_eq!(status(&own, "Content-Type: application/json; charset=utf-8\r\n"), 200);
    assert_eq!(status("rebound.example.org", JSON), 403);
    assert_eq!(status(&own, &format!("{JSON}Origin: http://evil.example\r\n")), 403);
    assert_eq!(status(&own, &format!("{JSON}Sec-Fetch-Site: cross-site\r\n")), 403);
    for kind in ["", "Content-Type: text/plain\r\n", "Content-Type: application/x-www-form-urlencoded\r\n"] {
        assert_eq!(status(&own, kind), 415, "{kind}");
    }
}

#[test]
fn an_index_that_is_cut_while_it_is_served_changes_no_answer() {
    let mut served = Served::new("");
    let before = get(served.address, HERE);
    assert_eq!(before.status, 200);
    let files = std::fs::read_dir(served.room.path("db")).expect("there").flatten().map(|entry| entry.path());
    let index =
        files.into_iter().find(|path| path.extension().is_some_and(|ending| ending == "bin")).expect("an index");
    std::fs::OpenOptions::new().write(true).open(&index).expect("writable").set_len(10).expect("cut");
    assert_eq!(get(served.address, HERE).body, before.body);
    assert_eq!(get(served.address, "/v1/coverage").status, 200);
    assert!(served.is_running());
    served.room.run("db verify --db db").fails(1, &["cut in its header", "realitysim db rebuild"]);
}

#[test]
fn a_body_that_is_announced_too_large_is_not_waited_for() {
    let served = Served::new("");
    let head = "POST /v1/views HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Type: application/json\r\nContent-Length: 99999999999\r\n\r\n{}";
    let answer = Response::parse(&exchange(served.address, head.as_bytes())).expect("an answer");
    // One that is waited for is refused with 408.
    assert_eq!(answer.status, 413, "{}", answer.text());
}
