//! From a request to its answer.

use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use http_body_util::{BodyExt, Limited};
use hyper::body::{Body, Incoming};
use hyper::header::{ACCEPT, AUTHORIZATION, HOST, HeaderName};
use hyper::{Method, Request, StatusCode};
use tokio::time::timeout;

use super::answer::{bytes, json_reply, put};
use super::batch::Batch;
use super::encode::{Form, accepted};
use super::parameters::{Asked, MaskWanted, Parameters};
use super::stock::Picture;
use super::{OPENAPI, Refusal, Reply, Service};

/// Who may ask.
#[derive(Clone)]
pub(super) enum Guard {
    /// Who sends this token.
    Token(blake3::Hash),
    /// Programs of this machine: a page in a browser that has got a name of its own for this address is not one.
    Loopback,
}

const ROUTES: [&str; 6] = ["/v1/view", "/v1/views", "/v1/info", "/v1/coverage", "/metrics", "/openapi.json"];
/// Of a batch: a thousand poses have some hundred kilobytes.
const MAX_BODY_BYTES: usize = 1 << 20;
const MAX_BODY_TIME: Duration = Duration::from_secs(10);

impl Service {
    /// A view and its bytes; counted and timed.
    pub(super) fn picture(&self, asked: &Asked, forms: &[Form]) -> Result<Picture, Refusal> {
        let started = Instant::now();
        let mut picture = self.stock.picture(asked, forms)?;
        let took = started.elapsed();
        self.metrics.view(picture.made, took);
        picture.headers.push(("server-timing", format!("view;dur={:.3}", 1e3 * took.as_secs_f64())));
        Ok(picture)
    }
}

pub(super) async fn answer(
    service: Arc<Service>,
    guard: Guard,
    request: Request<Incoming>,
) -> Result<Reply, Infallible> {
    let route = ROUTES.into_iter().find(|route| *route == request.uri().path());
    let reply = match (guard.check(&request), route) {
        (Err(refusal), _) => refusal.reply(),
        (Ok(()), Some(route)) => dispatch(&service, route, request).await.unwrap_or_else(|refusal| refusal.reply()),
        (Ok(()), None) => {
            Refusal::new(StatusCode::NOT_FOUND, format!("there is no such path: there are {}", ROUTES.join(", ")))
                .reply()
        }
    };
    service.metrics.request(route.unwrap_or("other"), reply.status().as_u16());
    Ok(reply)
}

async fn dispatch(service: &Arc<Service>, route: &'static str, request: Request<Incoming>) -> Result<Reply, Refusal> {
    let wanted = if route == "/v1/views" { Method::POST } else { Method::GET };
    if *request.method() != wanted && !(wanted == Method::GET && *request.method() == Method::HEAD) {
        return Err(Refusal::new(StatusCode::METHOD_NOT_ALLOWED, format!("{route} is asked with {wanted}")));
    }
    let parameters = Parameters::from_query(request.uri().query().unwrap_or_default())?;
    match route {
        "/v1/view" => view(service, &parameters, &request).await,
        "/v1/views" => views(service, &parameters, request).await,
        "/v1/coverage" => coverage(service, parameters, &request).await,
        "/v1/info" => {
            parameters.only(&[])?;
            Ok(json_reply(&service.stock.info()))
        }
        "/metrics" => {
            let gallery = service.stock.gallery();
            let text = service.metrics.text(gallery.index().len(), gallery.decoded_bytes(), service.door.inside());
            Ok(bytes(StatusCode::OK, "text/plain; version=0.0.4", text))
        }
        _ => Ok(bytes(StatusCode::OK, "application/json", OPENAPI)),
    }
}

async fn view(service: &Arc<Service>, parameters: &Parameters, request: &Request<Incoming>) -> Result<Reply, Refusal> {
    let asked = parameters.asked()?;
    let forms = accepted(header(request, ACCEPT), asked.mask)?;
    let shared = Arc::clone(service);
    let picture = service.door.enter().await?.run(move || shared.picture(&asked, &forms)).await??;
    let mut reply = bytes(StatusCode::OK, picture.form.media_type(), picture.bytes);
    put(&mut reply, &picture.headers);
    Ok(reply)
}

async fn views(service: &Arc<Service>, parameters: &Parameters, request: Request<Incoming>) -> Result<Reply, Refusal> {
    parameters.only(&[])?;
    let accept = header(&request, ACCEPT).filter(|accept| !accept.contains("multipart/")).map(str::to_owned);
    let too_large = || {
        let what = format!("the body has more than {MAX_BODY_BYTES} bytes: ask for fewer views");
        Refusal::new(StatusCode::PAYLOAD_TOO_LARGE, what)
    };
    // What is announced need not be waited for.
    if request.body().size_hint().lower() > MAX_BODY_BYTES as u64 {
        return Err(too_large());
    }
    let body = Limited::new(request.into_body(), MAX_BODY_BYTES);
    let body = timeout(MAX_BODY_TIME, body.collect()).await;
    let body = body.map_err(|_| Refusal::new(StatusCode::REQUEST_TIMEOUT, "the body did not come in time"))?;
    let body = body.map_err(|error| match error.downcast_ref::<http_body_util::LengthLimitError>() {
        Some(_) => too_large(),
        None => Refusal::wrong(format!("the body did not come whole: {error}")),
    })?;
    let batch = Batch::from_json(&body.to_bytes())?;
    let alpha = |mask| {
        batch.asked.iter().flatten().map(|asked| asked.mask).find(|own| *own != MaskWanted::None).unwrap_or(mask)
    };
    let forms = accepted(accept.as_deref(), alpha(MaskWanted::None))?;
    let inside = service.door.enter().await?;
    Ok(batch.stream(Arc::clone(service), inside, forms))
}

async fn coverage(
    service: &Arc<Service>,
    parameters: Parameters,
    request: &Request<Incoming>,
) -> Result<Reply, Refusal> {
    let picture = header(request, ACCEPT).is_some_and(|accept| accept.contains("image/png"));
    let shared = Arc::clone(service);
    let work = move || shared.stock.coverage(&parameters, picture);
    let (content, kind) = service.door.enter().await?.run(work).await??;
    Ok(bytes(StatusCode::OK, kind, content))
}

fn header<B>(request: &Request<B>, name: HeaderName) -> Option<&str> {
    request.headers().get(name)?.to_str().ok()
}

impl Guard {
    fn check<B>(&self, request: &Request<B>) -> Result<(), Refusal> {
        match self {
            Self::Token(token) => {
                let sent = header(request, AUTHORIZATION).and_then(|value| value.strip_prefix("Bearer "));
                // Hashes are compared in constant time.
                let right = sent.is_some_and(|sent| blake3::hash(sent.trim().as_bytes()) == *token);
                let what = "a token is needed: `Authorization: Bearer TOKEN`";
                if right { Ok(()) } else { Err(Refusal::new(StatusCode::UNAUTHORIZED, what)) }
            }
            Self::Loopback => {
                let host = header(request, HOST).unwrap_or_default();
                let what = format!("the host {host:?} is not this machine: without a token only localhost is answered");
                if is_loopback(host) { Ok(()) } else { Err(Refusal::new(StatusCode::FORBIDDEN, what)) }
            }
        }
    }
}

/// `localhost`, 127.x.x.x or `[::1]`, with or without a port; HTTP/1.0 sends none at all.
fn is_loopback(host: &str) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if !port.is_empty() && port.bytes().all(|byte| byte.is_ascii_digit()) => name,
        _ => host,
    };
    let name = name.trim_matches(['[', ']']);
    name.is_empty()
        || name.eq_ignore_ascii_case("localhost")
        || name.parse::<std::net::IpAddr>().is_ok_and(|address| address.is_loopback())
}

/// Takes over changes of the database.
pub(super) fn refresh(service: &Service) -> Option<String> {
    match service.stock.refresh() {
        Ok(false) => None,
        Ok(true) => {
            service.metrics.reloads.fetch_add(1, Ordering::Relaxed);
            Some(format!("the database has changed: {} images", service.stock.gallery().index().len()))
        }
        Err(error) => {
            service.metrics.failed_reloads.fetch_add(1, Ordering::Relaxed);
            Some(format!("the database has changed and cannot be read, the old one is served on: {error}"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_this_machine_needs_no_token() {
        for host in ["", "localhost", "LOCALHOST:8000", "127.0.0.1:8000", "127.8.9.1", "[::1]:8000", "[::1]"] {
            assert!(is_loopback(host), "{host}");
        }
        for host in
            ["example.org", "example.org:8000", "192.168.0.1", "localhost.example.org", "127.0.0.1.example.org:1"]
        {
            assert!(!is_loopback(host), "{host}");
        }
    }
}
