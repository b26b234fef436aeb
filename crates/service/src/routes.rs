//! Answers a request: finds its route, reads its parameters, and makes the reply.

use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use http_body_util::{BodyExt, Limited};
use hyper::body::{Body, Bytes, Incoming};
use hyper::header::{ACCEPT, CONTENT_TYPE};
use hyper::{Method, Request, StatusCode};
use serde_json::json;
use tokio::time::timeout;

use super::batch::Batch;
use super::captures::{Captures, MAX_PIECE_S};
use super::connections::ConnectionSlot;
use super::encode::{Form, accepted};
use super::guard::{Guard, list, text};
use super::live;
use super::page::{PageFile, page_file};
use super::parameters::{Parameters, ViewRequest};
use super::response::{bytes, finish, json_reply, put_headers};
use super::view_service::{Picture, ViewService};
use super::{HttpProblem, OPENAPI, Reply, Service};

/// The paths of the service.
const ROUTES: [&str; 16] = [
    "/v1/view",
    "/v1/views",
    "/v1/info",
    "/v1/coverage",
    "/v1/captures",
    "/v1/capture",
    "/v1/tags",
    "/v1/frame",
    "/v1/tag",
    "/v1/explain",
    "/v1/piece",
    "/v1/live",
    "/v1/live/frame",
    "/v1/live/order",
    "/metrics",
    "/openapi.json",
];
/// Largest body of a batch, bytes: a thousand poses have some hundred kilobytes.
const MAX_BODY_BYTES: usize = 1 << 20;
/// Longest time for the body of a batch to come.
const MAX_BODY_TIME: Duration = Duration::from_secs(10);

impl Service {
    /// Returns the views, if a database is served.
    fn views(&self) -> Result<&ViewService, HttpProblem> {
        let what = "no database is served: name one with --db DIR";
        self.views.as_ref().ok_or_else(|| HttpProblem::new(StatusCode::NOT_FOUND, what))
    }

    /// Makes and encodes a view, and counts and times it.
    pub(super) fn picture(&self, asked: &ViewRequest, forms: &[Form]) -> Result<Picture, HttpProblem> {
        let started = Instant::now();
        let mut picture = self.views()?.picture(asked, forms)?;
        let took = started.elapsed();
        self.metrics.view(picture.made, took);
        picture.headers.push(("server-timing", format!("view;dur={:.3}", 1e3 * took.as_secs_f64())));
        Ok(picture)
    }
}

/// Answers a request. A refusal is an answer, too.
pub(super) async fn answer(
    service: Arc<Service>,
    guard: Guard,
    slot: Arc<ConnectionSlot>,
    request: Request<Incoming>,
) -> Result<Reply, Infallible> {
    let active = slot.request();
    let route = ROUTES.into_iter().find(|route| *route == request.uri().path());
    if let Some(file) = page_file(request.uri().path()) {
        let reply = page(&guard, &request, file).unwrap_or_else(|refusal| refusal.reply());
        service.metrics.request("page", reply.status().as_u16());
        return Ok(finish(reply, active));
    }
    let reply = match (guard.check(&request), route) {
        (Err(refusal), _) => Err(refusal),
        (Ok(()), Some(route)) => dispatch(&service, &slot, route, request).await,
        (Ok(()), None) => {
            let what = format!("there is no such path: there are {}", ROUTES.join(", "));
            Err(HttpProblem::new(StatusCode::NOT_FOUND, what))
        }
    };
    let reply = reply.unwrap_or_else(|refusal| refusal.reply());
    service.metrics.request(route.unwrap_or("other"), reply.status().as_u16());
    Ok(finish(reply, active))
}

/// Answers with a file of the page.
fn page(guard: &Guard, request: &Request<Incoming>, file: &PageFile) -> Result<Reply, HttpProblem> {
    guard.check_page(request)?;
    match *request.method() {
        Method::GET | Method::HEAD => Ok(file.reply()),
        _ => Err(HttpProblem::method("the page", "GET, HEAD")),
    }
}

/// Hands an admitted request to its route.
async fn dispatch(
    service: &Arc<Service>,
    slot: &Arc<ConnectionSlot>,
    route: &'static str,
    request: Request<Incoming>,
) -> Result<Reply, HttpProblem> {
    let allowed = if ["/v1/views", "/v1/live/order"].contains(&route) { "POST" } else { "GET, HEAD" };
    if !allowed.split(", ").any(|method| request.method() == method) {
        return Err(HttpProblem::method(route, allowed));
    }
    let parameters = Parameters::from_query(request.uri().query().unwrap_or_default())?;
    match route {
        "/v1/view" => view(service, slot, &parameters, &request).await,
        "/v1/views" => views(service, slot, &parameters, request).await,
        "/v1/coverage" => coverage(service, slot, parameters, &request).await,
        "/v1/info" => {
            parameters.only(&[])?;
            let none = || json!({ "version": env!("CARGO_PKG_VERSION"), "images": 0, "field": null, "lenses": {}, "scenes": {} });
            Ok(json_reply(&service.views.as_ref().map_or_else(none, ViewService::info)))
        }
        "/v1/captures" | "/v1/capture" | "/v1/tags" | "/v1/frame" | "/v1/tag" | "/v1/explain" | "/v1/piece" => {
            let raw = accepts_raw(list(&request, &ACCEPT).as_deref());
            capture(service, slot, parameters, route, raw).await
        }
        "/v1/live" => {
            parameters.only(&[])?;
            Ok(json_reply(&live::state(service.live.as_deref())))
        }
        "/v1/live/frame" => live_frame(service, slot, &parameters).await,
        "/v1/live/order" => live_order(service, &parameters, request).await,
        "/metrics" => Ok(bytes(StatusCode::OK, "text/plain; version=0.0.4", metrics(service))),
        _ => Ok(bytes(StatusCode::OK, "application/json", OPENAPI)),
    }
}

/// Returns the metrics as text.
fn metrics(service: &Service) -> String {
    let database = service.views.as_ref().map(ViewService::database);
    service.metrics.text(&[
        ("connections", "Connections that are open", service.connections.len()),
        ("requests_inside", "Requests at work or waiting for a thread", service.admission.inside()),
        ("unsent_bytes", "Memory of answers that clients have not taken yet", service.connections.unsent_bytes()),
        ("images", "Images in the database", database.as_ref().map_or(0, |database| database.index().len())),
        ("decoded_bytes", "Memory of decoded images", database.as_ref().map_or(0, |database| database.decoded_bytes())),
    ])
}

/// Answers `/v1/view`.
async fn view(
    service: &Arc<Service>,
    slot: &Arc<ConnectionSlot>,
    parameters: &Parameters,
    request: &Request<Incoming>,
) -> Result<Reply, HttpProblem> {
    let asked = parameters.view_request()?;
    let forms = accepted(list(request, &ACCEPT).as_deref(), core::iter::once(&asked))?;
    let shared = Arc::clone(service);
    let picture = service.admission.enter().await?.run(move || shared.picture(&asked, &forms)).await??;
    let mut reply = bytes(StatusCode::OK, picture.form.media_type(), hold_answer(slot, picture.bytes)?);
    put_headers(&mut reply, &picture.headers);
    Ok(reply)
}

/// Counts the bytes of an answer until the client has taken them; refuses it if there is no room.
fn hold_answer(slot: &Arc<ConnectionSlot>, bytes: Vec<u8>) -> Result<Bytes, HttpProblem> {
    let what = "clients have not taken too many answers yet: come back in a second";
    slot.hold(bytes).map_err(|_| HttpProblem::new(StatusCode::SERVICE_UNAVAILABLE, what))
}

/// Answers `/v1/views`: a batch.
async fn views(
    service: &Arc<Service>,
    slot: &Arc<ConnectionSlot>,
    parameters: &Parameters,
    request: Request<Incoming>,
) -> Result<Reply, HttpProblem> {
    parameters.only(&[])?;
    service.views()?;
    let accept = list(&request, &ACCEPT).filter(|accept| !accept.contains("multipart/"));
    let batch = Batch::from_json(&json_body(request).await?)?;
    let forms = accepted(accept.as_deref(), batch.asked.iter().flatten())?;
    let begun = service.admission.begin_batch().await?;
    Ok(batch.stream(Arc::clone(service), Arc::clone(slot), begun, forms))
}

/// Reads the body of a request, which must be JSON and not too large.
async fn json_body(request: Request<Incoming>) -> Result<Bytes, HttpProblem> {
    let kind = text(&request, &CONTENT_TYPE)?.unwrap_or_default();
    let is_json = kind.split(';').next().is_some_and(|kind| kind.trim().eq_ignore_ascii_case("application/json"));
    if !is_json {
        let what = format!("Content-Type is {kind:?}: application/json is needed");
        return Err(HttpProblem::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, what));
    }
    let too_large = || {
        let what = format!("the body has more than {MAX_BODY_BYTES} bytes: ask for fewer views");
        HttpProblem::new(StatusCode::PAYLOAD_TOO_LARGE, what)
    };
    // A body that is announced as too large is refused before it comes.
    if request.body().size_hint().lower() > MAX_BODY_BYTES as u64 {
        return Err(too_large());
    }
    let body = Limited::new(request.into_body(), MAX_BODY_BYTES);
    let body = timeout(MAX_BODY_TIME, body.collect()).await;
    let body = body.map_err(|_| HttpProblem::new(StatusCode::REQUEST_TIMEOUT, "the body did not come in time"))?;
    let body = body.map_err(|error| match error.downcast_ref::<http_body_util::LengthLimitError>() {
        Some(_) => too_large(),
        None => HttpProblem::wrong(format!("the body did not come whole: {error}")),
    })?;
    Ok(body.to_bytes())
}

/// Answers `/v1/coverage` with JSON, or with a picture if the client asks for PNG.
async fn coverage(
    service: &Arc<Service>,
    slot: &Arc<ConnectionSlot>,
    parameters: Parameters,
    request: &Request<Incoming>,
) -> Result<Reply, HttpProblem> {
    let picture = list(request, &ACCEPT).is_some_and(|accept| accept.contains("image/png"));
    let shared = Arc::clone(service);
    let work = move || shared.views()?.coverage(&parameters, picture);
    let (content, kind) = service.admission.enter().await?.run(work).await??;
    Ok(bytes(StatusCode::OK, kind, hold_answer(slot, content)?))
}

/// Answers with a picture of the robot that is watched.
async fn live_frame(
    service: &Arc<Service>,
    slot: &Arc<ConnectionSlot>,
    parameters: &Parameters,
) -> Result<Reply, HttpProblem> {
    let wanted = parameters.live_picture()?;
    let shared = Arc::clone(service);
    let work = move || live::picture(shared.live.as_deref(), wanted);
    let (content, kind) = service.admission.enter().await?.run(work).await??;
    Ok(bytes(StatusCode::OK, kind, hold_answer(slot, content)?))
}

/// Hands an order to the robot that is watched.
async fn live_order(
    service: &Arc<Service>,
    parameters: &Parameters,
    request: Request<Incoming>,
) -> Result<Reply, HttpProblem> {
    parameters.only(&[])?;
    let body = json_body(request).await?;
    let shared = Arc::clone(service);
    let work = move || live::order(shared.live.as_deref(), &body);
    Ok(json_reply(&service.admission.enter().await?.run(work).await??))
}

/// Whether a client takes pixels and no picture: programs do, browsers and `curl` do not.
fn accepts_raw(accept: Option<&str>) -> bool {
    let accept = accept.unwrap_or("*/*");
    accept.contains("application/octet-stream") && !accept.contains("image/")
}

/// Answers what is asked of captures. With `raw` the image of a frame comes as pixels.
async fn capture(
    service: &Arc<Service>,
    slot: &Arc<ConnectionSlot>,
    parameters: Parameters,
    route: &'static str,
    raw: bool,
) -> Result<Reply, HttpProblem> {
    let shared = Arc::clone(service);
    let work = move || captured(&shared.captures, &parameters, route, raw);
    let answer = service.admission.enter().await?.run(work).await??;
    let mut reply = bytes(StatusCode::OK, answer.media_type, hold_answer(slot, answer.content)?);
    if let Some([width, height]) = answer.pixels {
        let sides = [("realitysim-width", width), ("realitysim-height", height), ("realitysim-channels", 3)];
        put_headers(&mut reply, &sides.map(|(name, side)| (name, side.to_string())));
    }
    Ok(reply)
}

/// Length of a piece if none is asked for, seconds.
const PIECE_S: u32 = 10;

/// What is answered about captures.
struct Captured {
    content: Vec<u8>,
    media_type: &'static str,
    /// Width and height, if the content is pixels.
    pixels: Option<[usize; 2]>,
}

/// Returns what is asked of captures.
fn captured(captures: &Captures, parameters: &Parameters, route: &str, raw: bool) -> Result<Captured, HttpProblem> {
    let of = |content: Vec<u8>, media_type| Captured { content, media_type, pixels: None };
    let json = |value: serde_json::Value| of(value.to_string().into_bytes(), "application/json");
    let known: &[&str] = match route {
        "/v1/captures" => &[],
        "/v1/capture" | "/v1/tags" => &["capture"],
        "/v1/piece" => &["capture", "frame", "seconds"],
        _ => &["capture", "frame"],
    };
    parameters.only(known)?;
    if route == "/v1/captures" {
        return captures.list().map(json);
    }
    let name = parameters.text("capture", "the name of a capture, as /v1/captures lists them")?;
    match route {
        "/v1/capture" => return Ok(of(captures.tags(name)?, "application/json")),
        "/v1/tags" => return Ok(of(captures.tag_arrays(name)?, "application/zip")),
        _ => {}
    }
    let frame = parameters.whole("frame", 0, u32::MAX)?;
    let frame = frame.ok_or_else(|| HttpProblem::wrong("frame is missing: the number of a tagged frame, from 0"))?;
    match route {
        "/v1/frame" if raw => {
            let (content, sides) = captures.pixels(name, frame)?;
            Ok(Captured { content, media_type: "application/octet-stream", pixels: Some(sides) })
        }
        "/v1/frame" => captures.picture(name, frame).map(|(content, media_type)| of(content, media_type)),
        "/v1/tag" => captures.tag(name, frame).map(json),
        "/v1/piece" => {
            let seconds = parameters.whole("seconds", 1, MAX_PIECE_S)?.unwrap_or(PIECE_S);
            Ok(of(captures.piece(name, frame, seconds)?, "application/octet-stream"))
        }
        _ => captures.explanation(name, frame).map(json),
    }
}

/// Reopens the database if it has changed. Returns what to report: the new number of images, or an error.
pub(super) fn refresh(service: &Service) -> Option<String> {
    let views = service.views.as_ref()?;
    match views.refresh() {
        Ok(false) => None,
        Ok(true) => {
            service.metrics.reloads.fetch_add(1, Ordering::Relaxed);
            Some(format!("the database has changed: {} images", views.database().index().len()))
        }
        Err(error) => {
            service.metrics.failed_reloads.fetch_add(1, Ordering::Relaxed);
            Some(format!("the database has changed and cannot be read, the old one is served on: {error}"))
        }
    }
}
