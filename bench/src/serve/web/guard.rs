//! Who may ask what: the service's own names only, no other site's pages, commands with the token only.

use super::Shared;
use super::api::Refused;
use axum::extract::{Request, State};
use axum::http::header::{
    AUTHORIZATION, CONTENT_SECURITY_POLICY, HOST, HeaderMap, HeaderName, HeaderValue, ORIGIN, REFERRER_POLICY,
    X_CONTENT_TYPE_OPTIONS, X_FRAME_OPTIONS,
};
use axum::http::{Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;

/// Scripts and styles in files of the service alone, and nothing from elsewhere.
const POLICY: &str = "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; form-action 'none'; \
                      frame-ancestors 'none'";

/// The names by which the service may be called.
#[derive(Clone, Debug)]
pub struct Names {
    loopback: bool,
    further: Vec<String>,
}

impl Names {
    /// Of a service that listens here, with these further names.
    pub fn new(address: SocketAddr, further: &[String]) -> Self {
        let further = further.iter().map(|name| name.to_ascii_lowercase()).collect();
        Names { loopback: address.ip().is_loopback(), further }
    }

    /// Whether `authority` (of a `Host` header, or of an origin) is this service. An address in digits can't be pointed elsewhere by a
    /// name server; a name can, so only those that are known count.
    fn has(&self, authority: &str) -> bool {
        let host = host(authority).to_ascii_lowercase();
        if host == "localhost" || self.further.contains(&host) {
            return true;
        }
        let digits = host.trim_start_matches('[').trim_end_matches(']');
        digits.parse::<IpAddr>().is_ok_and(|address| address.is_loopback() || !self.loopback)
    }

    /// Whether a request with these headers is for this service and from none of another site.
    fn accept(&self, headers: &HeaderMap) -> Result<(), Refused> {
        let text = |name| headers.get(name).and_then(|value: &HeaderValue| value.to_str().ok());
        let refused = |what: &str, got: &str| {
            let error = format!("{what}: expected this service, got {got:?}");
            let remedy = "call it by an address in digits or by localhost, or start it with --host NAME";
            Refused::new(StatusCode::FORBIDDEN, error, remedy)
        };
        let host = text(HOST).unwrap_or_default();
        if !self.has(host) {
            return Err(refused("Host", host));
        }
        if !headers.contains_key(ORIGIN) {
            return Ok(());
        }
        let origin = text(ORIGIN).unwrap_or_default();
        let authority = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
        if authority.is_some_and(|authority| authority.eq_ignore_ascii_case(host)) {
            Ok(())
        } else {
            Err(refused("Origin", origin))
        }
    }
}

/// Without the port.
fn host(authority: &str) -> &str {
    match authority.rsplit_once(':') {
        Some((host, port)) if port.bytes().all(|byte| byte.is_ascii_digit()) => host,
        _ => authority,
    }
}

/// Lets through what may pass.
pub async fn check(State(shared): State<Arc<Shared>>, request: Request, next: Next) -> Response {
    if let Err(refused) = shared.names.accept(request.headers()) {
        return refused.into_response();
    }
    if !matches!(*request.method(), Method::GET | Method::HEAD)
        && let Err(refused) = may_command(&shared, request.headers())
    {
        return refused.into_response();
    }
    next.run(request).await
}

fn may_command(shared: &Shared, headers: &HeaderMap) -> Result<(), Refused> {
    let Some(token) = &shared.web.token else {
        return Err(Refused::of(StatusCode::FORBIDDEN, crate::serve::channel::read_only()));
    };
    let said = headers.get(AUTHORIZATION).and_then(|value| value.to_str().ok());
    let said = said.and_then(|value| value.strip_prefix("Bearer "));
    if said.is_some_and(|said| token.is(said.trim())) {
        return Ok(());
    }
    let error = if said.is_none() { "expected a token, got none" } else { "the token is not that of this service" };
    let remedy = "open the address that the service printed at its start, or send Authorization: Bearer TOKEN";
    Err(Refused::new(StatusCode::UNAUTHORIZED, error, remedy))
}

/// What every answer carries, where the answer itself says nothing else.
pub async fn headers(request: Request, next: Next) -> Response {
    let mut response = next.run(request).await;
    let headers = response.headers_mut();
    let all: [(HeaderName, &'static str); 4] = [
        (CONTENT_SECURITY_POLICY, POLICY),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (X_FRAME_OPTIONS, "DENY"),
        (REFERRER_POLICY, "no-referrer"),
    ];
    for (name, value) in all {
        headers.entry(name).or_insert(HeaderValue::from_static(value));
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    fn accepts(listens: &str, further: &[&str], host: &str, origin: Option<&str>) -> bool {
        let further: Vec<String> = further.iter().map(|name| (*name).to_owned()).collect();
        let names = Names::new(listens.parse().expect("an address"), &further);
        let mut headers = HeaderMap::new();
        headers.insert(HOST, host.parse().expect("a value"));
        if let Some(origin) = origin {
            headers.insert(ORIGIN, origin.parse().expect("a value"));
        }
        names.accept(&headers).is_ok()
    }

    #[test]
    fn on_the_loopback_only_its_own_names_count() {
        let loopback = "127.0.0.1:8080";
        for host in ["127.0.0.1:8080", "localhost:8080", "LOCALHOST", "[::1]:8080", "127.0.0.2:1"] {
            assert!(accepts(loopback, &[], host, None), "{host}");
        }
        for host in ["evil.example:8080", "192.168.1.5:8080", "", "localhost.evil.example", "127.0.0.1.evil.example"] {
            assert!(!accepts(loopback, &[], host, None), "{host}");
        }
        assert!(accepts(loopback, &["Bench.Lab"], "bench.lab:8080", None));
    }

    #[test]
    fn open_to_the_network_it_is_called_by_digits_or_by_a_name_that_was_given() {
        let open = "0.0.0.0:8080";
        assert!(accepts(open, &[], "192.168.1.5:8080", None));
        assert!(accepts(open, &[], "[fe80::1]:8080", None));
        assert!(!accepts(open, &[], "bench.lab:8080", None));
        assert!(accepts(open, &["bench.lab"], "bench.lab", None));
    }

    #[test]
    fn a_page_of_another_site_is_refused() {
        let (listens, host) = ("127.0.0.1:8080", "127.0.0.1:8080");
        assert!(accepts(listens, &[], host, Some("http://127.0.0.1:8080")));
        for origin in ["http://evil.example", "null", "http://127.0.0.1:9090", "http://localhost:8080", "file://"] {
            assert!(!accepts(listens, &[], host, Some(origin)), "{origin}");
        }
    }
}
