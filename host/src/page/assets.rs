//! The page's files, carried in the program: it works without internet and without an installation.

use super::body::Failure;
use axum::extract::Path;
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};

macro_rules! files {
    ($($name:literal: $kind:literal),* $(,)?) => {
        &[$(($name, $kind, include_str!(concat!("web/", $name)))),*]
    };
}

/// Name, kind and text.
const FILES: &[(&str, &str, &str)] = files![
    "index.html": "text/html; charset=utf-8",
    "style.css": "text/css; charset=utf-8",
    "icon.svg": "image/svg+xml",
    "main.js": "text/javascript; charset=utf-8",
    "connection.js": "text/javascript; charset=utf-8",
    "picture.js": "text/javascript; charset=utf-8",
    "axes.js": "text/javascript; charset=utf-8",
    "curve.js": "text/javascript; charset=utf-8",
    "dom.js": "text/javascript; charset=utf-8",
    "wizard.js": "text/javascript; charset=utf-8",
];

/// The page.
pub async fn index() -> Response {
    file(Path("index.html".into())).await
}

/// One of its files.
pub async fn file(Path(name): Path<String>) -> Response {
    match FILES.iter().find(|(own, ..)| *own == name) {
        Some((name, kind, text)) => ([(CONTENT_TYPE, *kind)], source(name, text)).into_response(),
        None => Failure::new(StatusCode::NOT_FOUND, format!("there is no {name} here")).into_response(),
    }
}

/// A program built for debugging reads the files from its source, so that a change to the page needs no build.
#[cfg(debug_assertions)]
fn source(name: &str, text: &'static str) -> String {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src/page/web").join(name);
    std::fs::read_to_string(path).unwrap_or_else(|_| text.into())
}

#[cfg(not(debug_assertions))]
fn source(_name: &str, text: &'static str) -> &'static str {
    text
}
