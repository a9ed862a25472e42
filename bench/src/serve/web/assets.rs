//! The page's files, which are part of the program. A further file is a further line.

use super::api;
use axum::extract::Request;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE, ETAG, IF_NONE_MATCH};
use axum::http::{HeaderValue, Method, StatusCode};
use axum::response::{IntoResponse, Response};

const HTML: &str = "text/html; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const TEXT: &str = "text/plain; charset=utf-8";
const PICTURE: &str = "image/svg+xml";

/// A file of `bench/web` under its own name.
macro_rules! page_file {
    ($name:literal, $kind:expr) => {
        (concat!("/", $name), $kind, include_bytes!(concat!("../../../web/", $name)))
    };
}

/// A file of uPlot as it was released; the reports have it, too.
macro_rules! uplot_file {
    ($name:literal, $kind:expr) => {
        (concat!("/uplot/", $name), $kind, include_bytes!(concat!("../../../assets/uplot/", $name)))
    };
}

/// Path, type and content.
const FILES: &[(&str, &str, &[u8])] = &[
    ("/", HTML, include_bytes!("../../../web/index.html")),
    page_file!("monitor.css", STYLE),
    page_file!("icon.svg", PICTURE),
    page_file!("main.js", SCRIPT),
    page_file!("api.js", SCRIPT),
    page_file!("controls.js", SCRIPT),
    page_file!("decimate.js", SCRIPT),
    page_file!("derived.js", SCRIPT),
    page_file!("dom.js", SCRIPT),
    page_file!("events.js", SCRIPT),
    page_file!("format.js", SCRIPT),
    page_file!("histogram.js", SCRIPT),
    page_file!("history.js", SCRIPT),
    page_file!("live.js", SCRIPT),
    page_file!("phase.js", SCRIPT),
    page_file!("plots.js", SCRIPT),
    page_file!("readouts.js", SCRIPT),
    page_file!("runs.js", SCRIPT),
    page_file!("status.js", SCRIPT),
    page_file!("stop.js", SCRIPT),
    page_file!("theme.js", SCRIPT),
    page_file!("uplot.js", SCRIPT),
    uplot_file!("uPlot.iife.min.js", SCRIPT),
    uplot_file!("uPlot.min.css", STYLE),
    uplot_file!("LICENSE", TEXT),
];

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

    #[test]
    fn every_file_that_another_one_names_is_served() {
        let mut named = 0;
        for (path, kind, bytes) in FILES {
            let text = std::str::from_utf8(bytes).expect("all of them are text");
            // In the page `src="main.js"` and `href="monitor.css"`, in a module `from "./api.js"`. The library names none.
            let marks: &[&str] = match *kind {
                HTML => &["src=\"", "href=\""],
                SCRIPT if !path.starts_with("/uplot/") => &["from \"./"],
                _ => &[],
            };
            for rest in marks.iter().flat_map(|mark| text.split(mark).skip(1)) {
                let file = rest.split('"').next().expect("a split has a first part");
                assert!(FILES.iter().any(|(path, ..)| path[1..] == *file), "{path} names {file}");
                named += 1;
            }
        }
        assert!(named > FILES.len() - 5, "{named} names were found");
    }
}
