//! The operations as HTTP with JSON: what the page itself calls, and scripts. docs/api.md describes them.

use super::body::{Body, Failure};
use super::control::Key;
use super::front::App;
use super::jpeg::Levels;
use super::order::{Focus, Order};
use super::snapshot;
use crate::calibration::chain::Pixel;
use crate::focus::{Measure, measure};
use crate::link::transport::real_now;
use crate::picture::Roi;
use crate::rig::{AxisName, Device};
use axum::Json;
use axum::Router;
use axum::extract::{FromRequestParts, Query, State};
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::http::request::Parts;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use parfocal_protocol::autofocus::{Strategy, Subject};
use parfocal_protocol::message::Stop;
use parfocal_protocol::units::{Micrometres, MicrometresPerSecond};
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::time::Duration;

/// The header that carries an operator's key.
pub const KEY: &str = "x-parfocal-key";

/// Longest name of an operator.
const NAME: usize = 60;

/// The routes below `/api`.
pub fn routes() -> Router<App> {
    Router::new()
        .route("/state", get(state))
        .route("/curve", get(curve))
        .route("/frame.jpg", get(frame))
        .route("/control", post(take).delete(release))
        .route("/stop", post(stop))
        .route("/cancel", post(cancel))
        .route("/move", post(go))
        .route("/jog", post(jog))
        .route("/click", post(click))
        .route("/autofocus", post(autofocus))
        .route("/look", post(look))
        .route("/objective", post(objective))
        .route("/camera/restart", post(restart))
        .route("/emergency/clear", post(clear))
        .nest("/calibration", super::api_calibration::routes())
}

/// What a request comes to.
pub type Answer = Result<Json<Value>, Failure>;

/// The operator's key: without it nothing moves.
pub struct Operator;

impl FromRequestParts<App> for Operator {
    type Rejection = Failure;

    async fn from_request_parts(parts: &mut Parts, app: &App) -> Result<Self, Failure> {
        let key = parts.headers.get(KEY).and_then(|value| value.to_str().ok()).unwrap_or("");
        app.desk.control().check(real_now(), key)?;
        Ok(Self)
    }
}

async fn state(State(app): State<App>) -> Response {
    let text = snapshot::now(&app.desk).to_string();
    ([(CONTENT_TYPE, "application/json")], text).into_response()
}

async fn curve(State(app): State<App>) -> Json<Value> {
    let curve = app.desk.curve().clone();
    Json(json!({
        "scan": curve.id, "axis": curve.axis, "samples": curve.samples,
        "latency_us": curve.latency_us, "focused_um": curve.focused_um, "refused": curve.refused,
    }))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Shown {
    low: Option<u16>,
    high: Option<u16>,
    #[serde(default)]
    full: bool,
}

async fn frame(State(app): State<App>, Query(shown): Query<Shown>) -> Result<Response, Failure> {
    let levels = match (shown.low, shown.high) {
        (Some(low), Some(high)) => Levels::Fixed { low, high },
        _ if shown.full => Levels::Full,
        _ => Levels::Auto,
    };
    let none = || Failure::new(StatusCode::SERVICE_UNAVAILABLE, "the camera has given no frame yet");
    let (number, frame) = app.desk.feed.latest().ok_or_else(none)?;
    let ending = || Failure::from(super::order::OrderError::Ending);
    let encoded = app.encoder.encode(number, frame, levels).await.ok_or_else(ending)?;
    Ok(([(CONTENT_TYPE, "image/jpeg")], encoded.jpeg()).into_response())
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Take {
    name: Option<String>,
    #[serde(default)]
    force: bool,
}

async fn take(State(app): State<App>, Body(take): Body<Take>) -> Answer {
    let name = take.name.as_deref().unwrap_or("a script").trim();
    if name.is_empty() || name.chars().count() > NAME || name.chars().any(char::is_control) {
        return Err(Failure::value(format!("name: 1 to {NAME} printable characters")));
    }
    let key = Key::random();
    let lost = app.desk.control().take(real_now(), key.clone(), name, take.force)?;
    if lost && take.force {
        // What the other one began is nobody's now.
        app.desk.stop(Stop::Decelerate);
    }
    app.desk.tell(super::desk::Level::Info, format!("{name} has control"));
    Ok(Json(json!({ "key": key.as_str() })))
}

async fn release(State(app): State<App>, headers: axum::http::HeaderMap) -> Json<Value> {
    let key = headers.get(KEY).and_then(|value| value.to_str().ok()).unwrap_or("");
    let released = app.desk.control().release(key);
    if released {
        app.let_go();
    }
    Json(json!({ "released": released }))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StopBody {
    #[serde(default)]
    emergency: bool,
}

/// Anyone who sees something go wrong may stop it.
async fn stop(State(app): State<App>, Body(stop): Body<StopBody>) -> Json<Value> {
    let how = if stop.emergency { Stop::Emergency } else { Stop::Decelerate };
    let desk = app.desk.clone();
    let told = tokio::task::spawn_blocking(move || desk.stop(how)).await.unwrap_or(0);
    Json(json!({ "boards_told": told }))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Nothing {}

async fn cancel(State(app): State<App>, _: Operator, Body(Nothing {}): Body<Nothing>) -> Json<Value> {
    app.desk.cancel();
    Json(json!({}))
}

async fn restart(State(app): State<App>, _: Operator, Body(Nothing {}): Body<Nothing>) -> Json<Value> {
    app.desk.feed.restart();
    Json(json!({}))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct InUse {
    name: String,
    #[serde(default)]
    new: bool,
}

async fn objective(State(app): State<App>, _: Operator, Body(body): Body<InUse>) -> Answer {
    app.order(Order::Objective { name: body.name.clone(), new: body.new }).await?;
    Ok(Json(json!({ "objective": body.name })))
}

async fn clear(State(app): State<App>, _: Operator, Body(Nothing {}): Body<Nothing>) -> Answer {
    app.order(Order::ClearEmergency).await?;
    Ok(Json(json!({})))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Go {
    to_um: BTreeMap<AxisName, f64>,
    #[serde(default)]
    relative: bool,
    speed_um_s: Option<f64>,
    #[serde(default)]
    wait: bool,
}

async fn go(State(app): State<App>, _: Operator, Body(go): Body<Go>) -> Answer {
    if go.to_um.is_empty() {
        return Err(Failure::value("to_um: name at least one axis, as in {\"scope.z\": 10}"));
    }
    let to = go.to_um.into_iter().map(|(axis, at)| (axis, Micrometres(at))).collect();
    let speed = go.speed_um_s.map(|speed| positive("speed_um_s", speed)).transpose()?;
    let id = app.order(Order::Move { to, relative: go.relative, speed }).await?;
    ended(&app, id, go.wait).await
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Jog {
    axis: AxisName,
    speed_um_s: f64,
}

async fn jog(State(app): State<App>, _: Operator, Body(jog): Body<Jog>) -> Answer {
    let speed = finite("speed_um_s", jog.speed_um_s)?;
    let id = app.order(Order::Jog { axis: jog.axis, speed }).await?;
    Ok(Json(json!({ "id": id })))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Click {
    device: Device,
    x_px: f64,
    y_px: f64,
    #[serde(default)]
    wait: bool,
}

async fn click(State(app): State<App>, _: Operator, Body(click): Body<Click>) -> Answer {
    let at = Pixel { x_px: click.x_px, y_px: click.y_px };
    let picture = app.desk.feed.latest().map(|(_, frame)| (frame.picture.width as f64, frame.picture.height as f64));
    let inside = |v: f64, size: f64| v >= -0.5 && v <= size - 0.5;
    let none = || Failure::new(StatusCode::SERVICE_UNAVAILABLE, "the camera has given no frame yet");
    let (width, height) = picture.ok_or_else(none)?;
    if !inside(at.x_px, width) || !inside(at.y_px, height) {
        return Err(Failure::value("x_px, y_px: not in the picture"));
    }
    let id = app.order(Order::Click { device: click.device, at }).await?;
    ended(&app, id, click.wait).await
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AutofocusBody {
    axis: Option<AxisName>,
    range_um: Option<[f64; 2]>,
    sample_step_um: Option<f64>,
    strategy: Option<StrategyName>,
    #[serde(default)]
    phase_object: bool,
    #[serde(default)]
    wait: bool,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum StrategyName {
    Climb,
    Mixed,
    Scan,
}

async fn autofocus(State(app): State<App>, _: Operator, Body(body): Body<AutofocusBody>) -> Answer {
    let axis = match body.axis {
        Some(axis) => axis,
        None => "scope.z".parse().map_err(Failure::value)?,
    };
    let focus = Focus {
        axis,
        range_um: body.range_um,
        sample_step: body.sample_step_um.map(Micrometres),
        strategy: match body.strategy {
            None | Some(StrategyName::Climb) => Strategy::Climb,
            Some(StrategyName::Mixed) => Strategy::Mixed,
            Some(StrategyName::Scan) => Strategy::Scan,
        },
        subject: if body.phase_object { Subject::PhaseObject } else { Subject::Peak },
    };
    let id = app.order(Order::Autofocus(focus)).await?;
    ended(&app, id, body.wait).await
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Look {
    measure: Option<Measure>,
    /// `null` is the whole frame.
    #[serde(default, deserialize_with = "given")]
    region: Option<Option<Roi>>,
}

fn given<'de, D: serde::Deserializer<'de>>(reader: D) -> Result<Option<Option<Roi>>, D::Error> {
    Option::deserialize(reader).map(Some)
}

async fn look(State(app): State<App>, _: Operator, Body(look): Body<Look>) -> Answer {
    let before = app.desk.looking();
    let region = look.region.unwrap_or(before.region);
    let chosen = look.measure.unwrap_or(before.measure);
    if let (Some(roi), Some((_, frame))) = (region, app.desk.feed.latest()) {
        let part = frame.picture.view().crop(roi).map_err(Failure::value)?;
        measure(part, chosen).map_err(Failure::value)?;
    }
    app.desk.look(|looking| (looking.region, looking.measure) = (region, chosen));
    Ok(Json(json!({ "region": region, "measure": chosen })))
}

/// The activity's number, or its end once it has come.
pub async fn ended(app: &App, id: u64, wait: bool) -> Answer {
    if !wait {
        return Ok(Json(json!({ "id": id })));
    }
    loop {
        let found = app.desk.activity().ended.iter().find(|ended| ended.id == id).cloned();
        if let Some(ended) = found {
            return Ok(Json(json!({ "id": id, "ok": ended.ok, "text": ended.text })));
        }
        if app.desk.activity().id > id + 20 || app.desk.ending() {
            return Err(Failure::new(StatusCode::GONE, "it ended long ago"));
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

fn finite(key: &str, value: f64) -> Result<MicrometresPerSecond, Failure> {
    let speed = MicrometresPerSecond(value as f32);
    if speed.0.is_finite() { Ok(speed) } else { Err(Failure::value(format!("{key}: {value} is no speed"))) }
}

fn positive(key: &str, value: f64) -> Result<MicrometresPerSecond, Failure> {
    finite(key, value)
        .ok()
        .filter(|speed| speed.0 > 0.0)
        .ok_or_else(|| Failure::value(format!("{key}: must be above 0")))
}
