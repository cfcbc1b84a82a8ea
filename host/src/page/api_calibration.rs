//! Calibration as HTTP with JSON: begin, answer, take back, put in force.

use super::api::{Answer, Operator, ended};
use super::body::{Body, Failure};
use super::desk::Level;
use super::front::App;
use super::order::{Order, OrderError};
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
#[serde(rename_all = "kebab-case")]
enum Kind {
    Camera,
    Registration,
    Objective,
    IntoView,
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
    /// Objectives.
    through: Option<Vec<String>>,
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
    let whose = || Failure::value("manipulator: say whose, as in \"m1\"");
    let point = start.manipulator.map_or(Subject::Point("the fixed point".into()), Subject::Tip);
    let through = start.through.as_deref();
    let what = match start.what {
        Kind::Camera => What::Camera(point),
        Kind::Registration => What::Registration(start.manipulator.ok_or_else(whose)?),
        Kind::Objective => What::Objectives(point, objectives(&app, through)?),
        Kind::IntoView => What::IntoView(start.manipulator.ok_or_else(whose)?, searchers(&app, through)?),
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

/// The default objective and those to calibrate against it: the ones asked for, or all that the rig's file has.
fn objectives(app: &App, through: Option<&[String]>) -> Result<Vec<String>, Failure> {
    let rig = app.desk.rig();
    let known = &rig.contents().objectives;
    let default = known.iter().find(|(_, o)| o.default).map(|(name, _)| name);
    let default = default.ok_or_else(|| Failure::value("the rig's file has no default objective: add one"))?;
    let others = match through {
        Some(asked) => asked.to_vec(),
        None => known.keys().cloned().collect(),
    };
    if let Some(unknown) = others.iter().find(|name| !known.contains_key(*name)) {
        return Err(Failure::value(format!("through: there is no objective '{unknown}' in the rig's file")));
    }
    let mut names = vec![default.clone()];
    names.extend(others.into_iter().filter(|name| name != default));
    if names.len() < 2 {
        return Err(Failure::value(format!("through: name an objective besides '{default}', the default one")));
    }
    if rig.contents().camera.as_ref().is_none_or(|camera| camera.calibration.is_none()) {
        return Err(Failure::value("calibrate the camera first, with the default objective"));
    }
    Ok(names)
}

/// Calibrated objectives from the weakest on: the ones asked for, or all.
fn searchers(app: &App, through: Option<&[String]>) -> Result<Vec<String>, Failure> {
    let rig = app.desk.rig();
    let zoom = rig.contents().zoom_in_use.unwrap_or(1.0);
    let alpha = |name: &String| {
        let objective = rig.contents().objectives.get(name)?;
        let entry = objective.zooms.iter().find(|z| z.zoom == zoom).map(|z| z.alpha);
        entry.or((objective.default && zoom == 1.0).then_some(1.0))
    };
    let all: Vec<String> = match through {
        Some(asked) => asked.to_vec(),
        None => rig.contents().objectives.keys().filter(|name| alpha(name).is_some()).cloned().collect(),
    };
    if let Some(unknown) = all.iter().find(|name| alpha(name).is_none()) {
        return Err(Failure::value(format!("through: objective '{unknown}' is not calibrated")));
    }
    let mut all = all;
    all.sort_by(|a, b| alpha(b).partial_cmp(&alpha(a)).unwrap_or(std::cmp::Ordering::Equal));
    if all.is_empty() { Err(Failure::value("through: name an objective to look through")) } else { Ok(all) }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AnswerBody {
    x_px: Option<f64>,
    y_px: Option<f64>,
    #[serde(default)]
    pass: bool,
    /// The objective asked for is in the light path.
    #[serde(default)]
    done: bool,
}

async fn answer(State(app): State<App>, _: Operator, Body(body): Body<AnswerBody>) -> Answer {
    if let AnswerBody { x_px: None, y_px: None, pass: false, done: true } = body {
        app.desk.wizard().changed()?;
        return Ok(Json(json!({})));
    }
    let said = match (body.x_px, body.y_px, body.pass) {
        (Some(x_px), Some(y_px), false) if !body.done => {
            let picture = app.desk.feed.latest().map(|(_, f)| (f.picture.width as f64, f.picture.height as f64));
            let inside = |v: f64, size: f64| v >= -0.5 && v <= size - 0.5;
            if !picture.is_some_and(|(width, height)| inside(x_px, width) && inside(y_px, height)) {
                return Err(Failure::value("x_px, y_px: not in the picture"));
            }
            Said::At(FramePixel { x_px, y_px })
        }
        (None, None, true) if !body.done => Said::Pass,
        _ => return Err(Failure::value("send x_px and y_px, or \"pass\": true, or \"done\": true for an objective")),
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
    let desk = app.desk.clone();
    let kept = tokio::task::spawn_blocking(move || {
        let mut rig = desk.rig();
        *rig = desk.wizard().accept(&rig)?;
        let text = match &desk.rig_path {
            Some(path) => {
                rig.save(path).map_err(|e| OrderError::Value(e.to_string()))?;
                format!("the calibration is in force, and kept in {}", path.display())
            }
            None => "the calibration is in force until this program ends: start it with --rig FILE to keep it".into(),
        };
        drop(rig);
        desk.tell(Level::Info, text);
        Ok::<_, OrderError>(())
    });
    kept.await.map_err(Failure::value)??;
    Ok(Json(json!({})))
}

async fn discard(State(app): State<App>, _: Operator, Body(Nothing {}): Body<Nothing>) -> Answer {
    app.desk.wizard().discard();
    Ok(Json(json!({})))
}
