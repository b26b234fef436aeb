//! What goes back: bytes with a type and headers, or a refusal in words.

use std::pin::Pin;
use std::task::{Context, Poll};

use http_body_util::{BodyExt, Full, combinators::BoxBody};
use hyper::body::{Body as HttpBody, Bytes, Frame, SizeHint};
use hyper::header::{ALLOW, CONNECTION, CONTENT_TYPE, HeaderName, HeaderValue, RETRY_AFTER, WWW_AUTHENTICATE};
use hyper::{Response, StatusCode};
use serde_json::json;

use super::connections::UnderWay;

/// A body that comes at once or bit by bit. Errors end the connection: a client sees that the rest is missing.
pub(super) type Body = BoxBody<Bytes, std::io::Error>;
pub(super) type Reply = Response<Body>;

/// A request that is not answered with what it asked for, and why.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct HttpProblem {
    pub(super) status: StatusCode,
    /// What is wrong and what would be right.
    pub(super) what: String,
    /// The methods that a path is asked with, when it was another.
    pub(super) allowed: Option<&'static str>,
}

/// RFC 9457.
pub(super) const PROBLEM: &str = "application/problem+json";

impl HttpProblem {
    pub(super) fn new(status: StatusCode, what: impl Into<String>) -> Self {
        Self { status, what: what.into(), allowed: None }
    }

    pub(super) fn wrong(what: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, what)
    }

    pub(super) fn method(route: &str, allowed: &'static str) -> Self {
        let what = format!("{route} is asked with {}", allowed.replace(", ", " or "));
        Self { allowed: Some(allowed), ..Self::new(StatusCode::METHOD_NOT_ALLOWED, what) }
    }

    pub(super) fn problem(&self) -> Vec<u8> {
        let title = self.status.canonical_reason().unwrap_or("Error");
        json!({ "title": title, "status": self.status.as_u16(), "detail": self.what }).to_string().into_bytes()
    }

    pub(super) fn reply(&self) -> Reply {
        let mut reply = bytes(self.status, PROBLEM, self.problem());
        let mut add = |name, value| reply.headers_mut().insert(name, HeaderValue::from_static(value));
        match self.status {
            StatusCode::SERVICE_UNAVAILABLE => add(RETRY_AFTER, "1"),
            StatusCode::UNAUTHORIZED => add(WWW_AUTHENTICATE, "Bearer"),
            _ => None,
        };
        self.allowed.map(|allowed| add(ALLOW, allowed));
        reply
    }
}

pub(super) fn bytes(status: StatusCode, content_type: &'static str, content: impl Into<Bytes>) -> Reply {
    let body = Full::new(content.into()).map_err(|never| match never {}).boxed();
    let mut reply = Response::new(body);
    *reply.status_mut() = status;
    reply.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static(content_type));
    reply
}

pub(super) fn json_reply(value: &serde_json::Value) -> Reply {
    bytes(StatusCode::OK, "application/json", value.to_string())
}

/// Under way until a client has taken the whole of it, whatever it consists of; and for pages of this service alone.
pub(super) fn finish(reply: Reply, under_way: UnderWay) -> Reply {
    let mut reply = reply.map(|body| Counted { body, _under_way: under_way }.boxed());
    let headers = reply.headers_mut();
    headers.insert("x-content-type-options", HeaderValue::from_static("nosniff"));
    headers.insert("cross-origin-resource-policy", HeaderValue::from_static("same-origin"));
    // A client that may not ask keeps no place.
    if matches!(reply.status(), StatusCode::UNAUTHORIZED | StatusCode::FORBIDDEN) {
        reply.headers_mut().insert(CONNECTION, HeaderValue::from_static("close"));
    }
    reply
}

struct Counted {
    body: Body,
    _under_way: UnderWay,
}

impl HttpBody for Counted {
    type Data = Bytes;
    type Error = std::io::Error;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context) -> Poll<Option<Result<Frame<Bytes>, Self::Error>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

/// Headers of ours; what cannot stand in a header is left out.
pub(super) fn put(reply: &mut Reply, headers: &[(&'static str, String)]) {
    for (name, value) in headers {
        if let Ok(value) = HeaderValue::from_str(value) {
            reply.headers_mut().insert(HeaderName::from_static(name), value);
        }
    }
}
