//! The web server's frame: what every request has in common.

use super::desk::Desk;
use super::jpeg::Encoder;
use super::order::{Answer, Envelope, Order, OrderError};
use super::security::{Refused, Request as Judged, Rules};
use super::{api, assets, body::Failure, socket};
use crate::link::transport::real_now;
use axum::Router;
use axum::extract::{DefaultBodyLimit, Request, State};
use axum::http::header::{AUTHORIZATION, COOKIE, HOST, HeaderName, HeaderValue, ORIGIN, SET_COOKIE};
use axum::http::{HeaderMap, Method, StatusCode};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Redirect, Response};
use axum::routing::{any, get};
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;
use std::sync::mpsc::Sender;
use std::time::Duration;
use tokio::sync::{oneshot, watch};

/// Longest body that is read, bytes.
const BODY: usize = 64 * 1024;
/// The cookie that carries the token.
const TOKEN: &str = "parfocal_token";
/// How long an order may take to be accepted.
const PATIENCE: Duration = Duration::from_secs(6);

/// What all requests share.
#[derive(Clone)]
pub struct App {
    /// What there is to see.
    pub desk: Arc<Desk>,
    /// It as JSON.
    pub states: watch::Receiver<Arc<str>>,
    /// Pictures for browsers.
    pub encoder: Arc<Encoder>,
    /// Pages that are open.
    pub pages: Arc<AtomicUsize>,
    orders: Sender<Envelope>,
    rules: Arc<Rules>,
}

impl App {
    /// Everything that a request may need.
    pub fn new(desk: Arc<Desk>, orders: Sender<Envelope>, states: watch::Receiver<Arc<str>>, rules: Rules) -> Self {
        let (encoder, pages) = Default::default();
        Self { desk, states, encoder, pages, orders, rules: Arc::new(rules) }
    }

    /// Gives an order to the thread that moves things, and waits until it is begun or refused.
    ///
    /// # Errors
    /// As the order.
    pub async fn order(&self, order: Order) -> Answer {
        // The thread is busy to the end of a scan or a procedure: an order would come late.
        let activity = self.desk.activity().clone();
        if activity.doing.keeps_the_thread() {
            return Err(OrderError::Busy(activity.text));
        }
        let (answer, answered) = oneshot::channel();
        let envelope = Envelope { order, at: real_now(), answer };
        self.orders.send(envelope).map_err(|_| OrderError::Ending)?;
        match tokio::time::timeout(PATIENCE, answered).await {
            Ok(answer) => answer.unwrap_or(Err(OrderError::Ending)),
            Err(_) => Err(OrderError::Stale),
        }
    }

    /// Lets go of every jog, without waiting.
    pub fn let_go(&self) {
        let (answer, _) = oneshot::channel();
        let _ = self.orders.send(Envelope { order: Order::LetGo, at: real_now(), answer });
    }
}

/// Serves until the runtime ends.
pub async fn serve(listener: tokio::net::TcpListener, app: App) {
    let moving = api::routes();
    let router = Router::new()
        .route("/", get(assets::index))
        .route("/{file}", get(assets::file))
        .route("/api/live", any(socket::open))
        .nest("/api", moving)
        .fallback(|| async { Failure::new(StatusCode::NOT_FOUND, "there is nothing here: docs/api.md lists what is") })
        .method_not_allowed_fallback(|| async {
            Failure::new(StatusCode::METHOD_NOT_ALLOWED, "not with this method: docs/api.md lists which")
        })
        .layer(DefaultBodyLimit::max(BODY))
        .layer(from_fn_with_state(app.clone(), guard))
        .with_state(app);
    if let Err(error) = axum::serve(listener, router).await {
        eprintln!("the web server ended: {error}");
    }
}

/// Lets through what may be answered, and marks every answer as this page's own.
async fn guard(State(app): State<App>, request: Request, next: Next) -> Response {
    let headers = request.headers();
    let text = |name: HeaderName| headers.get(name).and_then(|value| value.to_str().ok());
    let by_address = (request.method() == Method::GET && request.uri().path() == "/")
        .then(|| request.uri().query().and_then(|query| query.strip_prefix("token=")))
        .flatten();
    let token = text(AUTHORIZATION).and_then(|value| value.strip_prefix("Bearer ")).or_else(|| cookie(headers));
    // A header that is not text is there all the same.
    let origin = headers.get(ORIGIN).map(|value| value.to_str().unwrap_or("null"));
    let judged = Judged {
        host: text(HOST).or_else(|| request.uri().authority().map(|a| a.as_str())),
        origin,
        site: text(HeaderName::from_static("sec-fetch-site")),
        token: by_address.or(token),
    };
    let navigation = text(HeaderName::from_static("sec-fetch-mode")) == Some("navigate");
    // Following a link from another page to this one is what a person does; it moves nothing.
    let judged = if navigation && request.method() == Method::GET { Judged { site: None, ..judged } } else { judged };
    let mut response = match app.rules.judge(&judged) {
        Err(Refused::Token) => Failure::new(StatusCode::UNAUTHORIZED, Refused::Token).into_response(),
        Err(refused) => Failure::new(StatusCode::FORBIDDEN, refused).into_response(),
        // The token leaves the address bar and goes into a cookie that scripts and other sites do not get.
        Ok(()) if by_address.is_some() && app.rules.token().is_some() => {
            let cookie =
                format!("{TOKEN}={}; HttpOnly; SameSite=Strict; Path=/", app.rules.token().unwrap_or_default());
            let mut response = Redirect::to("/").into_response();
            if let Ok(value) = HeaderValue::from_str(&cookie) {
                response.headers_mut().insert(SET_COOKIE, value);
            }
            response
        }
        Ok(()) => next.run(request).await,
    };
    for (name, value) in [
        (
            "content-security-policy",
            "default-src 'self'; img-src 'self' blob: data:; frame-ancestors 'none'; base-uri 'none'",
        ),
        ("cross-origin-resource-policy", "same-origin"),
        ("cross-origin-opener-policy", "same-origin"),
        ("referrer-policy", "no-referrer"),
        ("x-content-type-options", "nosniff"),
        ("cache-control", "no-store"),
    ] {
        response.headers_mut().insert(HeaderName::from_static(name), HeaderValue::from_static(value));
    }
    response
}

fn cookie(headers: &HeaderMap) -> Option<&str> {
    let all = headers.get_all(COOKIE).iter().filter_map(|value| value.to_str().ok());
    let mut pairs = all.flat_map(|line| line.split(';')).filter_map(|pair| pair.trim().split_once('='));
    pairs.find(|(name, _)| *name == TOKEN).map(|(_, value)| value)
}
