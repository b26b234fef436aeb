//! Checks by the head of a request whether its sender may ask, before anything is done for it.

use core::net::IpAddr;

use hyper::header::{AUTHORIZATION, HOST, HeaderName, ORIGIN};
use hyper::{Request, StatusCode, Version};

use super::HttpProblem;

/// The rule by which clients are admitted.
#[derive(Clone)]
pub(super) enum Guard {
    /// Clients that send the token with this hash.
    Token(blake3::Hash),
    /// Programs of this machine, and pages of this service in a browser.
    ///
    /// Pages of other sites are refused, also if they have a name of their own for this address (DNS rebinding).
    Loopback,
}

/// Header in which a browser states from where a page asks; programs do not send it.
const FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");

impl Guard {
    /// Refuses a request for a file of the page, which is no secret: without a token the sender must be this machine, else anybody may
    /// have it.
    pub(super) fn check_page<B>(&self, request: &Request<B>) -> Result<(), HttpProblem> {
        match self {
            Self::Token(_) => host(request).map(drop),
            Self::Loopback => self.check(request),
        }
    }

    /// Refuses a request whose sender may not ask.
    pub(super) fn check<B>(&self, request: &Request<B>) -> Result<(), HttpProblem> {
        let host = host(request)?;
        match self {
            Self::Token(token) => {
                let sent = text(request, &AUTHORIZATION)?;
                let sent = sent.as_deref().and_then(|value| value.strip_prefix("Bearer "));
                // Hashes are compared in constant time.
                let right = sent.is_some_and(|sent| blake3::hash(sent.trim().as_bytes()) == *token);
                let what = "a token is needed: `Authorization: Bearer TOKEN`";
                if right { Ok(()) } else { Err(HttpProblem::new(StatusCode::UNAUTHORIZED, what)) }
            }
            Self::Loopback => {
                let forbidden = |what: String| Err(HttpProblem::new(StatusCode::FORBIDDEN, what));
                if !is_loopback(&host) {
                    return forbidden(format!(
                        "the host {host:?} is not this machine: without a token only localhost is answered"
                    ));
                }
                let origin = text(request, &ORIGIN)?;
                if let Some(origin) = origin.filter(|origin| !is_own(origin, &host)) {
                    return forbidden(format!(
                        "a page of {origin:?} asks: without a token only own pages are answered"
                    ));
                }
                let site = text(request, &FETCH_SITE)?;
                match site.filter(|site| site != "same-origin" && site != "none") {
                    Some(site) => forbidden(format!(
                        "a page of another site asks ({FETCH_SITE}: {site}): without a token only own pages are answered"
                    )),
                    None => Ok(()),
                }
            }
        }
    }
}

/// Returns the host that a request is for, with its port. There must be one, in ASCII, except in HTTP/1.0 (RFC 9112, section 3.2).
fn host<B>(request: &Request<B>) -> Result<String, HttpProblem> {
    let sent = text(request, &HOST)?;
    // If the target of the request has a host, that one counts.
    let host = request.uri().authority().map(|own| own.as_str().to_owned()).or_else(|| sent.clone());
    match host {
        Some(host) if sent.is_some() || request.version() < Version::HTTP_11 => Ok(host),
        None if request.version() < Version::HTTP_11 => Ok(String::new()),
        _ => Err(HttpProblem::wrong("Host is missing: HTTP/1.1 wants it")),
    }
}

/// Returns the value of a header that must not come more than once.
pub(super) fn text<B>(request: &Request<B>, name: &HeaderName) -> Result<Option<String>, HttpProblem> {
    let mut values = request.headers().get_all(name).iter();
    let Some(value) = values.next() else { return Ok(None) };
    if values.next().is_some() {
        return Err(HttpProblem::wrong(format!("{name} comes more than once")));
    }
    let value = value.to_str().map_err(|_| HttpProblem::wrong(format!("{name} is not ASCII text")))?;
    Ok(Some(value.trim().to_owned()))
}

/// Returns the value of a header that is a list, whose lines are joined.
pub(super) fn list<B>(request: &Request<B>, name: &HeaderName) -> Option<String> {
    let lines: Vec<&str> = request.headers().get_all(name).iter().filter_map(|line| line.to_str().ok()).collect();
    (!lines.is_empty()).then(|| lines.join(", "))
}

/// Returns whether an origin is this service, under the name by which it is asked.
fn is_own(origin: &str, host: &str) -> bool {
    origin.strip_prefix("http://").is_some_and(|own| own.eq_ignore_ascii_case(host))
}

/// Returns whether a host is `localhost`, 127.x.x.x or `[::1]`, with or without a port, or empty as in HTTP/1.0.
fn is_loopback(host: &str) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if !port.is_empty() && port.bytes().all(|byte| byte.is_ascii_digit()) => name,
        _ => host,
    };
    let name = name.trim_matches(['[', ']']);
    name.is_empty()
        || name.eq_ignore_ascii_case("localhost")
        || name.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn status(version: Version, headers: &[(&str, &[u8])]) -> u16 {
        let mut request = Request::builder().uri("/v1/view").version(version);
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        let request = request.body(()).expect("a request");
        Guard::Loopback.check(&request).map_or_else(|refusal| refusal.status.as_u16(), |()| 200)
    }

    #[test]
    fn only_this_machine_needs_no_token() {
        for host in ["localhost", "LOCALHOST:8000", "127.0.0.1:8000", "127.8.9.1", "[::1]:8000", "[::1]"] {
            assert_eq!(status(Version::HTTP_11, &[("host", host.as_bytes())]), 200, "{host}");
        }
        for host in
            ["example.org", "example.org:8000", "192.168.0.1", "localhost.example.org", "127.0.0.1.example.org:1"]
        {
            assert_eq!(status(Version::HTTP_11, &[("host", host.as_bytes())]), 403, "{host}");
        }
    }

    #[test]
    fn one_host_is_said_in_ascii() {
        assert_eq!(status(Version::HTTP_10, &[]), 200);
        assert_eq!(status(Version::HTTP_11, &[]), 400);
        assert_eq!(status(Version::HTTP_11, &[("host", b"\xff\xfe")]), 400);
        for pair in [[b"localhost".as_slice(), b"evil.example"], [b"evil.example", b"localhost"]] {
            assert_eq!(status(Version::HTTP_11, &pair.map(|host| ("host", host))), 400);
        }
        let absolute = Request::get("http://evil.example/v1/view").header("host", "localhost").body(());
        let refusal = Guard::Loopback.check(&absolute.expect("a request")).expect_err("another host");
        assert_eq!(refusal.status, 403);
    }

    #[test]
    fn a_page_of_another_site_may_not_ask() {
        let here = ("host", b"localhost:8765".as_slice());
        for own in [
            vec![here],
            vec![here, ("origin", b"http://localhost:8765")],
            vec![here, ("origin", b"http://localhost:8765"), ("sec-fetch-site", b"same-origin")],
            vec![here, ("sec-fetch-site", b"none")],
        ] {
            assert_eq!(status(Version::HTTP_11, &own), 200, "{own:?}");
        }
        for foreign in [
            vec![here, ("origin", b"http://evil.example".as_slice())],
            vec![here, ("origin", b"null")],
            vec![here, ("origin", b"https://localhost:8765")],
            vec![here, ("origin", b"http://localhost:9000")],
            vec![here, ("origin", b"http://localhost:8765"), ("origin", b"http://evil.example")],
            vec![here, ("sec-fetch-site", b"cross-site")],
            vec![here, ("sec-fetch-site", b"same-site")],
            vec![here, ("origin", b"http://localhost:8765"), ("sec-fetch-site", b"cross-site")],
        ] {
            assert!(status(Version::HTTP_11, &foreign) >= 400, "{foreign:?}");
        }
    }
}
