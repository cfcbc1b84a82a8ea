//! Calibration as HTTP with JSON: begin, answer, take back, put in force.

use super::api::{Answer, Operator, ended};
use super::body::{Body, Failure};
use super::desk::Level;
use super::front::App;
use super::order::Order;
use super::wizard::{Plan, What};
use crate::procedure::{Answer as Said, FramePixel, Subject};
use crate::rig::ManipulatorNumber;
use axum::extract::State;
use axum::routing::post;
use axum::{Json, Router};
use serde::Deserialize;
use serde_json::json;

/// The routes below `/api/calibration`.
pub fn routes() -> Router<App> {
    Router::new()
        .route("/start", post(start))
        .route("/answer", post(answer))
        .route("/undo", post(undo))
        .route("/accept", post(accept))
        .route("/discard", post(discard))
}

#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum Kind {
    Camera,
    Registration,
}

#[derive(Deserialize, PartialEq)]
#[serde(rename_all = "lowercase")]
enum By {
    Click,
    Detector,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Start {
    what: Kind,
    manipulator: Option<ManipulatorNumber>,
    by: By,
    places: Option<usize>,
    seed: Option<u64>,
    depth_um: Option<f64>,
    focus_within_um: Option<f64>,
    #[serde(default)]
    wait: bool,
}

async fn start(State(app): State<App>, _: Operator, Body(start): Body<Start>) -> Answer {
    let within = |key: &str, value: Option<f64>, usual: f64, range: std::ops::RangeInclusive<f64>| {
        let value = value.unwrap_or(usual);
        let (low, high) = (range.start(), range.end());
        if range.contains(&value) { Ok(value) } else { Err(Failure::value(format!("{key}: {low} to {high}"))) }
    };
    let places = start.places.unwrap_or(6);
    if !(1..=100).contains(&places) {
        return Err(Failure::value("places: 1 to 100"));
    }
    let what = match (start.what, start.manipulator) {
        (Kind::Camera, None) => What::Camera(Subject::Point("the fixed point".into())),
        (Kind::Camera, Some(number)) => What::Camera(Subject::Tip(number)),
        (Kind::Registration, Some(number)) => What::Registration(number),
        (Kind::Registration, None) => return Err(Failure::value("manipulator: say whose, as in \"m1\"")),
    };
    let plan = Plan {
        what,
        places,
        seed: start.seed.unwrap_or_else(rand::random),
        by_clicks: start.by == By::Click,
        depth_um: within("depth_um", start.depth_um, 20.0, 0.0..=1000.0)?,
        focus_within_um: within("focus_within_um", start.focus_within_um, 25.0, 1.0..=1000.0)?,
    };
    let id = app.order(Order::Calibrate(plan)).await?;
    ended(&app, id, start.wait).await
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AnswerBody {
    x_px: Option<f64>,
    y_px: Option<f64>,
    #[serde(default)]
    pass: bool,
}

async fn answer(State(app): State<App>, _: Operator, Body(body): Body<AnswerBody>) -> Answer {
    let said = match (body.x_px, body.y_px, body.pass) {
        (Some(x_px), Some(y_px), false) => {
            let picture = app.desk.feed.latest().map(|(_, f)| (f.picture.width as f64, f.picture.height as f64));
            let inside = |v: f64, size: f64| v >= -0.5 && v <= size - 0.5;
            if !picture.is_some_and(|(width, height)| inside(x_px, width) && inside(y_px, height)) {
                return Err(Failure::value("x_px, y_px: not in the picture"));
            }
            Said::At(FramePixel { x_px, y_px })
        }
        (None, None, true) => Said::Pass,
        _ => return Err(Failure::value("send x_px and y_px, or \"pass\": true")),
    };
    app.desk.wizard().answer(said)?;
    Ok(Json(json!({})))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Undo {
    sample: usize,
    #[serde(default = "yes")]
    undone: bool,
}

fn yes() -> bool {
    true
}

async fn undo(State(app): State<App>, _: Operator, Body(undo): Body<Undo>) -> Answer {
    let desk = app.desk.clone();
    let solved = tokio::task::spawn_blocking(move || {
        let rig = desk.rig().clone();
        desk.wizard().undo(undo.sample, undo.undone, &rig)
    });
    solved.await.map_err(Failure::value)??;
    Ok(Json(json!({})))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Nothing {}

async fn accept(State(app): State<App>, _: Operator, Body(Nothing {}): Body<Nothing>) -> Answer {
    let proposed = app.desk.wizard().accept()?;
    let mut rig = app.desk.rig();
    *rig = proposed;
    let text = match &app.desk.rig_path {
        Some(path) => {
            rig.save(path).map_err(Failure::value)?;
            format!("the calibration is in force, and kept in {}", path.display())
        }
        None => "the calibration is in force until this program ends: start it with --rig FILE to keep it".into(),
    };
    drop(rig);
    app.desk.tell(Level::Info, text);
    Ok(Json(json!({})))
}

async fn discard(State(app): State<App>, _: Operator, Body(Nothing {}): Body<Nothing>) -> Answer {
    app.desk.wizard().discard();
    Ok(Json(json!({})))
}
