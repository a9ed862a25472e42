//! The page's files, which are part of the program. A further file is a further line.

use super::api;
use axum::extract::Request;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE, ETAG, IF_NONE_MATCH};
use axum::http::{HeaderValue, Method, StatusCode};
use axum::response::{IntoResponse, Response};

const HTML: &str = "text/html; charset=utf-8";

/// Path, type and content.
const FILES: &[(&str, &str, &[u8])] = &[("/", HTML, include_bytes!("../../../web/index.html"))];

/// A file of the page.
pub async fn serve(request: Request) -> Response {
    let found = FILES.iter().find(|(path, ..)| *path == request.uri().path());
    let Some((_, kind, bytes)) = found.filter(|_| matches!(*request.method(), Method::GET | Method::HEAD)) else {
        return api::nothing().await.into_response();
    };
    let tag = format!("\"{:08x}\"", crc32fast::hash(bytes));
    // A new build has new files: a browser asks each time, and is told in a few bytes that nothing changed.
    let known = request.headers().get(IF_NONE_MATCH).is_some_and(|value| value.as_bytes() == tag.as_bytes());
    let mut response = if known { StatusCode::NOT_MODIFIED.into_response() } else { (*bytes).into_response() };
    let headers = response.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    headers.insert(ETAG, HeaderValue::from_str(&tag).expect("digits and quotes are a header's value"));
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_has_a_path_of_its_own_and_content() {
        let mut paths: Vec<&str> = FILES.iter().map(|(path, ..)| *path).collect();
        paths.sort_unstable();
        paths.dedup();
        assert_eq!(paths.len(), FILES.len());
        for (path, kind, bytes) in FILES {
            assert!(path.starts_with('/') && kind.contains('/') && !bytes.is_empty(), "{path}");
        }
    }
}
