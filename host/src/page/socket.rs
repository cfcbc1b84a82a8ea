//! The page's WebSocket: states and curves as text, pictures as they can be taken, jogs the other way.
//!
//! A picture is sent only when the browser has drawn the one before the last: a slow browser misses pictures, nothing
//! queues up, and no browser gets more than an eye can follow. Reading and writing are tasks of their own: a browser that never reads can still be heard, and is left when it
//! has not taken a message for some seconds.

use super::body::{Failure, read};
use super::front::App;
use super::jpeg::Levels;
use super::order::Order;
use crate::link::transport::real_now;
use crate::rig::AxisName;
use axum::extract::State;
use axum::extract::ws::{CloseFrame, Message, Utf8Bytes, WebSocket, WebSocketUpgrade};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use futures_util::stream::{SplitSink, SplitStream};
use futures_util::{SinkExt, StreamExt};
use parfocal_protocol::message::Stop;
use parfocal_protocol::units::MicrometresPerSecond;
use serde::Deserialize;
use serde_json::json;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use tokio::sync::{Semaphore, mpsc, watch};
use tokio::time::Instant;

/// Pages open at once.
const PAGES: usize = 16;
/// Longest message from a browser, bytes.
const MESSAGE: usize = 16 * 1024;
/// Pictures on their way to a browser at once.
const PICTURES: usize = 2;
/// Least time between two pictures for one browser: eyes need no more, and what they do not need costs a scan its processor.
const PERIOD: Duration = Duration::from_millis(30);
/// How long a browser may take for one message.
const PATIENCE: Duration = Duration::from_secs(5);

/// What a page says.
#[derive(Debug, Deserialize)]
#[serde(tag = "type", rename_all = "lowercase", deny_unknown_fields)]
enum Said {
    /// An axis is to be kept moving for a moment; 0 lets go.
    Jog { key: String, axis: AxisName, speed_um_s: f64 },
    /// Stop everything.
    Stop,
    /// A picture was drawn: the next may come.
    Drawn,
    /// Which grey values to show.
    Levels { levels: Levels },
    /// The operator's page is there.
    Here { key: String },
}

/// Opens the page's WebSocket.
pub async fn open(
    State(app): State<App>,
    upgrade: Result<WebSocketUpgrade, axum::extract::ws::rejection::WebSocketUpgradeRejection>,
) -> Response {
    let upgrade = match upgrade {
        Ok(upgrade) => upgrade,
        Err(e) => {
            return Failure::new(StatusCode::BAD_REQUEST, format!("this is the page's WebSocket: {}", e.body_text()))
                .into_response();
        }
    };
    let Some(place) = Place::take(&app.pages) else {
        return Failure::new(StatusCode::SERVICE_UNAVAILABLE, format!("{PAGES} pages are open already: close one"))
            .into_response();
    };
    upgrade.max_message_size(MESSAGE).max_frame_size(MESSAGE).on_upgrade(move |socket| converse(app, socket, place))
}

/// One of the places for open pages.
struct Place(Arc<AtomicUsize>);

impl Place {
    fn take(pages: &Arc<AtomicUsize>) -> Option<Self> {
        let taken = pages.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |n| (n < PAGES).then_some(n + 1));
        taken.is_ok().then(|| Self(pages.clone()))
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}

async fn converse(app: App, socket: WebSocket, place: Place) {
    let (sink, stream) = socket.split();
    let (tell, told) = mpsc::channel(16);
    let credits = Arc::new(Semaphore::new(PICTURES));
    let (levels, shown) = watch::channel(Levels::default());
    let writer = tokio::spawn(write(app.clone(), sink, told, credits.clone(), shown));
    let mut reader = Reader { app: app.clone(), tell, credits, levels, key: None, jogged: false };
    // Whichever ends first: the other has nobody left.
    let aborting = writer.abort_handle();
    tokio::select! {
        () = reader.run(stream) => {
            // A refusal that waits may still be told.
            drop(tokio::time::timeout(Duration::from_millis(200), reader.tell.closed()).await);
        }
        _ = writer => {}
    }
    aborting.abort();
    if reader.jogged {
        app.let_go();
    }
    if let Some(key) = reader.key {
        app.desk.control().left(real_now(), &key);
    }
    drop(place);
}

struct Reader {
    app: App,
    tell: mpsc::Sender<Message>,
    credits: Arc<Semaphore>,
    levels: watch::Sender<Levels>,
    key: Option<String>,
    jogged: bool,
}

impl Reader {
    async fn run(&mut self, mut stream: SplitStream<WebSocket>) {
        while let Some(Ok(message)) = stream.next().await {
            let said = match message {
                Message::Text(text) => read::<Said>(text.as_bytes()),
                Message::Binary(_) => Err("only text is understood here".into()),
                Message::Close(_) => break,
                Message::Ping(_) | Message::Pong(_) => continue,
            };
            match said {
                Ok(said) => self.hear(said).await,
                Err(why) => {
                    let reason = format!("refused: {why}").chars().take(110).collect::<String>();
                    let close = CloseFrame { code: 1008, reason: Utf8Bytes::from(reason) };
                    let _ = self.tell.try_send(Message::Close(Some(close)));
                    break;
                }
            }
        }
    }

    async fn hear(&mut self, said: Said) {
        match said {
            Said::Drawn => {
                if self.credits.available_permits() < PICTURES {
                    self.credits.add_permits(1);
                }
            }
            Said::Levels { levels } => drop(self.levels.send_replace(levels)),
            Said::Here { key } => {
                let yours = self.app.desk.control().check(real_now(), &key).is_ok();
                if yours {
                    self.key = Some(key);
                }
                let _ =
                    self.tell.try_send(Message::Text(json!({ "type": "control", "yours": yours }).to_string().into()));
            }
            Said::Stop => {
                let desk = self.app.desk.clone();
                let _ = tokio::task::spawn_blocking(move || desk.stop(Stop::Decelerate)).await;
            }
            Said::Jog { key, axis, speed_um_s } => {
                if let Err(why) = self.jog(key, axis, speed_um_s).await {
                    let text = json!({ "type": "refused", "jog": axis, "error": why }).to_string();
                    // A page that does not read is not told.
                    let _ = self.tell.try_send(Message::Text(text.into()));
                }
            }
        }
    }

    async fn jog(&mut self, key: String, axis: AxisName, speed_um_s: f64) -> Result<(), String> {
        self.app.desk.control().check(real_now(), &key).map_err(|e| e.to_string())?;
        let speed = MicrometresPerSecond(speed_um_s as f32);
        if !speed.0.is_finite() {
            return Err(format!("{speed_um_s} is no speed"));
        }
        (self.key, self.jogged) = (Some(key), true);
        self.app.order(Order::Jog { axis, speed }).await.map(drop).map_err(|e| e.to_string())
    }
}

/// What a page has seen of the latest curve.
#[derive(Default)]
struct Seen {
    scan: u64,
    samples: usize,
    frame: u64,
    shown: Levels,
}

async fn write(
    app: App,
    mut sink: SplitSink<WebSocket, Message>,
    mut told: mpsc::Receiver<Message>,
    credits: Arc<Semaphore>,
    mut levels: watch::Receiver<Levels>,
) {
    let mut states = app.states.clone();
    let mut frames = app.desk.feed.count();
    let mut seen = Seen::default();
    let mut due = Instant::now();
    states.mark_changed();
    frames.mark_changed();
    loop {
        let picture = async {
            tokio::time::sleep_until(due).await;
            // Nothing is taken before there is a picture to send with it.
            tokio::select! {
                changed = frames.changed() => changed.ok()?,
                changed = levels.changed() => changed.ok()?,
            }
            let credit = credits.acquire().await.ok()?;
            credit.forget();
            Some(())
        };
        let messages = tokio::select! {
            biased;
            message = told.recv() => match message {
                Some(message) => vec![message],
                None => return,
            },
            changed = states.changed() => match changed {
                Ok(()) => {
                    let state = states.borrow_and_update().to_string();
                    let mut messages = vec![Message::Text(state.into())];
                    messages.extend(curve(&app, &mut seen));
                    messages
                }
                Err(_) => return,
            },
            picture = picture => match picture {
                Some(()) => {
                    let shown = *levels.borrow_and_update();
                    match latest(&app, &mut seen, shown).await {
                        Some(message) => {
                            // A camera's own rhythm is kept: a picture that came late does not delay the next.
                            due = (due + PERIOD).max(Instant::now() - PERIOD);
                            vec![message]
                        }
                        None => {
                            credits.add_permits(1);
                            continue;
                        }
                    }
                }
                None => return,
            },
        };
        for message in messages {
            let closing = matches!(message, Message::Close(_));
            match tokio::time::timeout(PATIENCE, sink.send(message)).await {
                Ok(Ok(())) if !closing => {}
                _ => return,
            }
        }
    }
}

/// The samples of the curve that this page has not seen.
fn curve(app: &App, seen: &mut Seen) -> Option<Message> {
    // Copied, and the curve is free again: the scan adds to it.
    let (scan, from, new) = {
        let curve = app.desk.curve();
        let from = if curve.id == seen.scan { seen.samples.min(curve.samples.len()) } else { 0 };
        (curve.id, from, curve.samples[from..].to_vec())
    };
    (seen.scan, seen.samples) = (scan, from + new.len());
    let text = || json!({ "type": "curve", "scan": scan, "from": from, "samples": new }).to_string();
    (!new.is_empty()).then(|| Message::Text(text().into()))
}

/// The latest picture, unless this page has it.
async fn latest(app: &App, seen: &mut Seen, shown: Levels) -> Option<Message> {
    let (number, frame) = app.desk.feed.latest()?;
    if number == seen.frame && shown == seen.shown {
        return None;
    }
    (seen.frame, seen.shown) = (number, shown);
    let encoded = app.encoder.encode(number, frame, shown).await?;
    Some(Message::Binary(encoded.message))
}
