//! What goes back: bytes with a type and headers, or a refusal in words.

use http_body_util::{BodyExt, Full, combinators::BoxBody};
use hyper::body::Bytes;
use hyper::header::{ALLOW, CONTENT_TYPE, HeaderName, HeaderValue, RETRY_AFTER, WWW_AUTHENTICATE};
use hyper::{Response, StatusCode};
use serde_json::json;

/// A body that comes at once or bit by bit. Errors end the connection: a client sees that the rest is missing.
pub(super) type Body = BoxBody<Bytes, std::io::Error>;
pub(super) type Reply = Response<Body>;

/// A request that is not answered with what it asked for, and why.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Refusal {
    pub(super) status: StatusCode,
    /// What is wrong and what would be right.
    pub(super) what: String,
}

/// RFC 9457.
pub(super) const PROBLEM: &str = "application/problem+json";

impl Refusal {
    pub(super) fn new(status: StatusCode, what: impl Into<String>) -> Self {
        Self { status, what: what.into() }
    }

    pub(super) fn wrong(what: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, what)
    }

    pub(super) fn problem(&self) -> Vec<u8> {
        let title = self.status.canonical_reason().unwrap_or("Error");
        json!({ "title": title, "status": self.status.as_u16(), "detail": self.what }).to_string().into_bytes()
    }

    pub(super) fn reply(&self) -> Reply {
        let mut reply = bytes(self.status, PROBLEM, self.problem());
        let headers = reply.headers_mut();
        match self.status {
            StatusCode::SERVICE_UNAVAILABLE => headers.insert(RETRY_AFTER, HeaderValue::from_static("1")),
            StatusCode::UNAUTHORIZED => headers.insert(WWW_AUTHENTICATE, HeaderValue::from_static("Bearer")),
            StatusCode::METHOD_NOT_ALLOWED => headers.insert(ALLOW, HeaderValue::from_static("GET, HEAD, POST")),
            _ => None,
        };
        reply
    }
}

pub(super) fn bytes(status: StatusCode, content_type: &'static str, content: impl Into<Bytes>) -> Reply {
    let body = Full::new(content.into()).map_err(|never| match never {}).boxed();
    let mut reply = Response::new(body);
    *reply.status_mut() = status;
    reply.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static(content_type));
    reply.headers_mut().insert("x-content-type-options", HeaderValue::from_static("nosniff"));
    reply
}

pub(super) fn json_reply(value: &serde_json::Value) -> Reply {
    bytes(StatusCode::OK, "application/json", value.to_string())
}

/// Headers of ours; what cannot stand in a header is left out.
pub(super) fn put(reply: &mut Reply, headers: &[(&'static str, String)]) {
    for (name, value) in headers {
        if let Ok(value) = HeaderValue::from_str(value) {
            reply.headers_mut().insert(HeaderName::from_static(name), value);
        }
    }
}
