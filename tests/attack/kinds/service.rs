//! Requests to `realitysim serve`: while a hostile client does what it does, another gets its answers.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rustix::net::sockopt::{Timeout, set_socket_timeout};
use rustix::net::{AddressFamily, SocketFlags, SocketType, bind, connect, socket_with};
use serde_json::Value;

use crate::case::{Case, Class, Finding, Outcome, Taken};
use crate::draw::Draw;
use crate::worker::{MAX_MEMORY_MB, peak_mb_of};
use crate::{bytes, text};

/// Ends with the process that runs cases.
pub struct Served {
    address: SocketAddr,
    child: Child,
}

/// What a healthy client waits for its answer.
const PATIENCE: Duration = Duration::from_secs(8);
/// What a hostile client waits for its own.
const HOSTILE_WAITS: Duration = Duration::from_millis(1500);
const HEALTHY: &str = "/v1/view?x=-1.9&y=0.1&z=0.5&yaw_deg=5&pitch_deg=17&width=64";

impl Served {
    pub fn of(database: &std::path::Path) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_realitysim"))
            .args(["serve", "--json", "--listen", "127.0.0.1:0", "--db"])
            .arg(database)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("the program starts");
        let mut line = String::new();
        BufReader::new(child.stdout.take().expect("piped")).read_line(&mut line).expect("where it listens");
        let ready: Value = serde_json::from_str(&line).expect("where it listens");
        let address = ready["listening"].as_str().and_then(|text| text.parse().ok()).expect("an address");
        Self { address, child }
    }

    pub fn has_ended(&mut self) -> bool {
        self.child.try_wait().is_ok_and(|ended| ended.is_some())
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// As many as there are places for, and some more.
const MANY: usize = 280;
/// Megabytes of answer for a kilobyte of question.
const LARGE: &str = "{\"z\": 0.5, \"pitch_deg\": 17, \"width\": 640, \"from\": {\"x\": -1.9, \"y\": 0.1, \"yaw_deg\": 5}, \
                     \"to\": {\"x\": -1.7, \"y\": 0.1, \"yaw_deg\": 9}, \"count\": 100}";

pub fn run(case: &mut Case) -> Outcome {
    let mut served = case.walks.service();
    let address = served.address;
    let besieged = case.draw.chance(0.02);
    let requests = if besieged { vec![costly(&mut case.draw)] } else { requests(case) };
    // So many at once; most are alone.
    let clients = *case.draw.one_of(if besieged { &[40, MANY] } else { &[1, 1, 1, 1, 1, 1, 1, 8, 40] });
    let manner =
        *case.draw.one_of(&[Manner::Asks, Manner::Asks, Manner::Asks, Manner::Leaves, Manner::Stops, Manner::Drips]);
    case.tell(format!("{clients} clients, {manner:?}"));
    let mut streams: Vec<TcpStream> = (0..clients).filter_map(|_| connected(address).ok()).collect();
    let mut statuses = Vec::new();
    for (index, stream) in streams.iter_mut().enumerate() {
        send(stream, &requests[index % requests.len()], manner);
    }
    let healthy = healthy(address);
    if manner == Manner::Asks {
        for stream in streams.iter_mut().take(2) {
            statuses.extend(read(stream, &requests)?);
        }
    }
    drop(streams);
    if let Some(status) = served.child.try_wait().expect("a child") {
        return Err(Finding::new(Class::Panic, format!("the service ended: {status}")));
    }
    let peak_mb = peak_mb_of(&served.child.id().to_string());
    if peak_mb > MAX_MEMORY_MB {
        return Err(Finding::new(Class::Memory, format!("the service holds {peak_mb} MB")));
    }
    healthy?;
    if let Some(status) = statuses.iter().find(|status| **status >= 500 && **status != 503) {
        return Err(Finding::new(Class::Panic, format!("answered with {status}: {}", shown(&requests))));
    }
    Ok(if statuses.contains(&200) { Taken::Accepted } else { Taken::Refused })
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Manner {
    /// Sends all and reads the answer.
    Asks,
    /// Sends all and is gone.
    Leaves,
    /// Sends all and reads nothing.
    Stops,
    /// Sends all but the last bytes.
    Drips,
}

/// From an address that nobody else has: the service cannot know that all of them are one machine's.
fn connected(address: SocketAddr) -> std::io::Result<TcpStream> {
    let socket = socket_with(AddressFamily::INET, SocketType::STREAM, SocketFlags::CLOEXEC, None)?;
    // Of a connection as well, when all places are taken.
    set_socket_timeout(&socket, Timeout::Send, Some(HOSTILE_WAITS))?;
    bind(&socket, &SocketAddr::from(([127, 0, 0, 2], 0)))?;
    connect(&socket, &address)?;
    let stream = TcpStream::from(socket);
    stream.set_read_timeout(Some(HOSTILE_WAITS))?;
    Ok(stream)
}

fn send(stream: &mut TcpStream, request: &[u8], manner: Manner) {
    let all = if manner == Manner::Drips { request.len().saturating_sub(3) } else { request.len() };
    // It may hang up before all is sent.
    let _ = stream.write_all(&request[..all]);
    if manner == Manner::Leaves {
        let _ = stream.shutdown(std::net::Shutdown::Both);
    }
}

/// Statuses of what comes back; what an answer says of itself must be finite.
fn read(stream: &mut TcpStream, requests: &[Vec<u8>]) -> Result<Vec<u16>, Finding> {
    let (mut bytes, mut part) = (Vec::new(), [0; 65_536]);
    let started = Instant::now();
    while started.elapsed() < HOSTILE_WAITS
        && bytes.len() < 4 << 20
        && let Ok(count @ 1..) = stream.read(&mut part)
    {
        bytes.extend_from_slice(&part[..count]);
        if is_whole(&bytes) {
            break;
        }
    }
    let text = String::from_utf8_lossy(&bytes);
    let Some(head) = text.split("\r\n\r\n").next().filter(|head| head.starts_with("HTTP/")) else {
        return Ok(Vec::new());
    };
    let wild = head.lines().skip(1).filter_map(|line| line.split_once(": ")).find(|(name, value)| {
        name.to_ascii_lowercase().starts_with("x-")
            && value.split([' ', ',', ';']).any(|word| ["NaN", "inf", "-inf"].contains(&word))
    });
    if let Some((name, value)) = wild {
        return Err(Finding::new(Class::NotFinite, format!("{name}: {value}, of {}", shown(requests))));
    }
    Ok(head.split(' ').nth(1).and_then(|status| status.parse().ok()).into_iter().collect())
}

/// By the length that its head announces; of chunks, the last.
fn is_whole(bytes: &[u8]) -> bool {
    let Some(end) = bytes.windows(4).position(|four| four == b"\r\n\r\n") else { return false };
    let head = String::from_utf8_lossy(&bytes[..end]).to_ascii_lowercase();
    let length = head.lines().find_map(|line| line.strip_prefix("content-length:")?.trim().parse::<usize>().ok());
    length.map_or_else(|| bytes.ends_with(b"0\r\n\r\n"), |length| bytes.len() >= end + 4 + length)
}

/// Somebody who only wants a view, now.
fn healthy(address: SocketAddr) -> Result<(), Finding> {
    let started = Instant::now();
    let mut last = String::new();
    while started.elapsed() < PATIENCE {
        match asked(address) {
            Ok(200) => return Ok(()),
            Ok(status) => last = format!("status {status}"),
            Err(error) => last = error.to_string(),
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    Err(Finding::new(Class::Starved, format!("no answer within {} s: {last}", PATIENCE.as_secs())))
}

fn asked(address: SocketAddr) -> std::io::Result<u16> {
    let mut stream = TcpStream::connect_timeout(&address, PATIENCE)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.write_all(format!("GET {HEALTHY} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").as_bytes())?;
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes)?;
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(40)]).into_owned();
    let status = head.split(' ').nth(1).and_then(|status| status.parse().ok());
    status.ok_or_else(|| std::io::Error::other(format!("no answer: {head:?}")))
}

/// Sound, and as dear as may be, to hold a place or a thread with.
fn costly(draw: &mut Draw) -> Vec<u8> {
    let view = "/v1/view?x=-1.9&y=0.12&z=0.5&yaw_deg=7&pitch_deg=17&width=4096&height=4096&outside=warn";
    let head = "HTTP/1.1\r\nHost: localhost\r\nConnection: keep-alive\r\n";
    let request = match draw.below(4) {
        0 => format!("GET /v1/info {head}\r\n"),
        1 => format!("GET {view} {head}Accept: application/octet-stream\r\n\r\n"),
        2 => format!("GET {view} {head}Accept: image/png\r\n\r\n"),
        _ => {
            let length = LARGE.len();
            format!("POST /v1/views {head}Content-Type: application/json\r\nContent-Length: {length}\r\n\r\n{LARGE}")
        }
    };
    request.into_bytes()
}

fn shown(requests: &[Vec<u8>]) -> String {
    requests
        .iter()
        .map(|request| String::from_utf8_lossy(request).chars().take(300).collect::<String>())
        .collect::<Vec<_>>()
        .join(" | ")
}

/// Sound requests, damaged.
fn requests(case: &mut Case) -> Vec<Vec<u8>> {
    let draw = &mut case.draw;
    let count = 1 + draw.below(2);
    let made: Vec<Vec<u8>> = (0..count).map(|_| request(draw)).collect();
    let told = shown(&made);
    case.tell(format!("{told:?}"));
    made
}

fn request(draw: &mut Draw) -> Vec<u8> {
    let view = "x=-1.9&y=0.1&z=0.5&yaw_deg=5&pitch_deg=17&roll_deg=0&width=64&height=48&method=exact&quality=90&max_distance_m=2&\
                outside=warn&mask=none&frame=0&lens=\"fisheye-640\"";
    let body = "{\"z\": 0.5, \"pitch_deg\": 17, \"width\": 64, \"quality\": 80, \"poses\": [{\"x\": -1.9, \"y\": 0.1, \"yaw_deg\": 5}, \
                {\"x\": -1.8, \"y\": 0.1, \"yaw_deg\": 9, \"mask\": \"only\"}]}";
    let walk = "{\"z\": 0.5, \"width\": 32, \"from\": {\"x\": -1.9, \"y\": 0.1, \"yaw_deg\": 5}, \"to\": {\"x\": -1.7, \"y\": 0.1, \
                \"yaw_deg\": 9}, \"count\": 5}";
    let kind = draw.below(8);
    let (method, mut path, mut body) = match kind {
        0..=2 => ("GET", format!("/v1/view?{view}"), String::new()),
        3 | 4 => ("POST", "/v1/views".to_owned(), body.to_owned()),
        5 => ("POST", "/v1/views".to_owned(), walk.to_owned()),
        6 => ("GET", "/v1/coverage?cell_m=0.5".to_owned(), String::new()),
        _ => (
            "GET",
            (*draw.one_of(&["/v1/info", "/metrics", "/openapi.json", "/", "/v1/view"])).to_owned(),
            String::new(),
        ),
    };
    if draw.chance(0.6) {
        path = lossy(text::damage(draw, &path)).replace([' ', '\r', '\n'], "%20");
    }
    path = path.replace('"', "");
    path.truncate((0..=path.len().min(90_000)).rev().find(|at| path.is_char_boundary(*at)).unwrap_or(0));
    if !body.is_empty() && draw.chance(0.7) {
        body = lossy(text::damage(draw, &body));
    }
    let method =
        if draw.chance(0.05) { *draw.one_of(&["PUT", "HEAD", "OPTIONS", "GETT", "", "CONNECT"]) } else { method };
    let version = if draw.chance(0.05) { *draw.one_of(&["HTTP/1.0", "HTTP/2.0", "HTTP/9.9", ""]) } else { "HTTP/1.1" };
    let mut head = format!("{method} {path} {version}\r\nHost: localhost\r\n");
    let headers = [
        "Connection: close",
        "Connection: keep-alive",
        "Accept: application/octet-stream",
        "Accept: image/png",
        "Accept: image/jpeg",
        "Accept: multipart/mixed",
        "Expect: 100-continue",
        "Upgrade: h2c",
        "Authorization: Bearer x",
        "Origin: http://evil.example",
        "Range: bytes=0-99999999999999999999",
        "If-None-Match: *",
        "Content-Encoding: gzip",
        "Transfer-Encoding: gzip",
        "Host: localhost",
    ];
    for _ in 0..draw.below(4) {
        head += &format!("{}\r\n", draw.one_of(&headers));
    }
    if !body.is_empty() {
        head += "Content-Type: application/json\r\n";
        match draw.below(8) {
            0 => {
                head += &format!(
                    "Content-Length: {}\r\n",
                    draw.one_of(&["0", "-1", "99999999999", "3", "18446744073709551616"])
                )
            }
            1 => {
                head += "Transfer-Encoding: chunked\r\n";
                body = format!(
                    "{:x}\r\n{body}\r\n{}",
                    body.len(),
                    draw.one_of(&["0\r\n\r\n", "", "ffffffffffffffff\r\n", "zz\r\n"])
                );
            }
            _ => head += &format!("Content-Length: {}\r\n", body.len()),
        }
    }
    let mut request = format!("{head}\r\n{body}").into_bytes();
    if draw.chance(0.15) {
        bytes::damage(draw, &mut request);
    }
    request
}

fn lossy(bytes: Vec<u8>) -> String {
    String::from_utf8_lossy(&bytes).into_owned()
}
