//! Makes replies: bytes with a type and headers, or a refusal in words.

use std::pin::Pin;
use std::task::{Context, Poll};

use http_body_util::{BodyExt, Full, combinators::BoxBody};
use hyper::body::{Body as HttpBody, Bytes, Frame, SizeHint};
use hyper::header::{ALLOW, CONNECTION, CONTENT_TYPE, HeaderName, HeaderValue, RETRY_AFTER, WWW_AUTHENTICATE};
use hyper::{Response, StatusCode};
use serde_json::json;

use super::connections::ActiveRequest;

/// The body of a reply, whole or in parts. An error ends the connection, so that the client sees that the rest is missing.
pub(super) type Body = BoxBody<Bytes, std::io::Error>;
/// The reply to a request.
pub(super) type Reply = Response<Body>;

/// Why a request is refused.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct HttpProblem {
    pub(super) status: StatusCode,
    /// What is wrong, and what would be right.
    pub(super) what: String,
    /// The methods that the path allows, if the request had another.
    pub(super) allowed: Option<&'static str>,
}

/// Media type of a refusal (RFC 9457).
pub(super) const PROBLEM: &str = "application/problem+json";

impl HttpProblem {
    /// Creates a refusal with this status.
    pub(super) fn new(status: StatusCode, what: impl Into<String>) -> Self {
        Self { status, what: what.into(), allowed: None }
    }

    /// Creates a refusal of a wrong request (status 400).
    pub(super) fn wrong(what: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, what)
    }

    /// Creates a refusal of a method that the path does not allow (status 405).
    pub(super) fn method(route: &str, allowed: &'static str) -> Self {
        let what = format!("{route} is asked with {}", allowed.replace(", ", " or "));
        Self { allowed: Some(allowed), ..Self::new(StatusCode::METHOD_NOT_ALLOWED, what) }
    }

    /// Returns the refusal as a JSON document.
    pub(super) fn problem(&self) -> Vec<u8> {
        let title = self.status.canonical_reason().unwrap_or("Error");
        json!({ "title": title, "status": self.status.as_u16(), "detail": self.what }).to_string().into_bytes()
    }

    /// Returns the refusal as a reply.
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

/// Returns a reply with this content.
pub(super) fn bytes(status: StatusCode, content_type: &'static str, content: impl Into<Bytes>) -> Reply {
    let body = Full::new(content.into()).map_err(|never| match never {}).boxed();
    let mut reply = Response::new(body);
    *reply.status_mut() = status;
    reply.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static(content_type));
    reply
}

/// Returns a JSON document as a reply.
pub(super) fn json_reply(value: &serde_json::Value) -> Reply {
    bytes(StatusCode::OK, "application/json", value.to_string())
}

/// Completes a reply: its request counts as active until the client has taken all of it, and only pages of this service may use it.
pub(super) fn finish(reply: Reply, active: ActiveRequest) -> Reply {
    let mut reply = reply.map(|body| Counted { body, _active: active }.boxed());
    let headers = reply.headers_mut();
    headers.insert("x-content-type-options", HeaderValue::from_static("nosniff"));
    headers.insert("cross-origin-resource-policy", HeaderValue::from_static("same-origin"));
    // The connection of a client that may not ask is closed.
    if matches!(reply.status(), StatusCode::UNAUTHORIZED | StatusCode::FORBIDDEN) {
        reply.headers_mut().insert(CONNECTION, HeaderValue::from_static("close"));
    }
    reply
}

/// A body whose request counts as active until it is dropped.
struct Counted {
    body: Body,
    _active: ActiveRequest,
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

/// Adds headers to a reply. A value that is not valid in a header is left out.
pub(super) fn put_headers(reply: &mut Reply, headers: &[(&'static str, String)]) {
    for (name, value) in headers {
        if let Ok(value) = HeaderValue::from_str(value) {
            reply.headers_mut().insert(HeaderName::from_static(name), value);
        }
    }
}
