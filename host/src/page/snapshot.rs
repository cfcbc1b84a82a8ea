//! The desk as the page and scripts see it: one JSON object, twenty times a second.

use super::desk::{Desk, Doing, Ended, Message};
use super::feed::Health;
use super::known::{Known, known};
use super::places::{self, Tip};
use super::wizard::Shown;
use crate::autofocus::source::judge;
use crate::link::transport::real_now;
use crate::picture::Roi;
use crate::rig::AxisName;
use parfocal_protocol::autofocus::FrameFault;
use parfocal_protocol::message::Trust;
use serde::Serialize;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;

/// Time between two states.
const PERIOD: Duration = Duration::from_millis(50);
/// A board that was not heard for this long is shown as silent, ms.
const SILENT_MS: u64 = 1000;

/// Everything there is to see.
#[derive(Clone, Debug, Serialize)]
pub struct State {
    r#type: &'static str,
    version: &'static str,
    simulated: bool,
    operator: Option<String>,
    boards: Vec<BoardState>,
    problem: Option<String>,
    axes: Vec<AxisState>,
    activity: ActivityState,
    camera: CameraState,
    focus: FocusState,
    tips: Vec<Tip>,
    calibrated: Known,
    calibration: Option<Shown>,
    messages: Vec<Message>,
}

#[derive(Clone, Debug, Serialize)]
struct BoardState {
    connected: bool,
    emergency: bool,
}

#[derive(Clone, Debug, Serialize)]
struct AxisState {
    name: AxisName,
    position_um: Option<f64>,
    low_um: f64,
    high_um: f64,
    speed_um_s: f32,
    moving: bool,
    trust: &'static str,
    at_low: bool,
    at_high: bool,
}

#[derive(Clone, Debug, Serialize)]
struct ActivityState {
    id: u64,
    doing: Doing,
    text: String,
    ended: Vec<Ended>,
}

#[derive(Clone, Debug, Serialize)]
struct CameraState {
    name: String,
    health: &'static str,
    problem: Option<String>,
    rate_hz: f64,
    frame: u64,
    width_px: usize,
    height_px: usize,
    bits: u32,
}

/// The focus measure now, and the latest scan in short.
#[derive(Clone, Debug, Serialize)]
struct FocusState {
    measure: String,
    region: Option<Roi>,
    value: Option<f64>,
    fault: Option<&'static str>,
    scan: u64,
    axis: Option<AxisName>,
    samples: usize,
    focused_um: Option<f64>,
    refused: Option<String>,
}

/// The focus measure of the latest frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct Reading {
    frame: u64,
    value: Option<f64>,
    fault: Option<&'static str>,
}

/// Starts the thread that publishes states. It ends with the desk.
pub fn publish(desk: Arc<Desk>) -> watch::Receiver<Arc<str>> {
    let (states, receiver) = watch::channel(now(&desk));
    std::thread::spawn(move || {
        let mut reading = Reading::default();
        while !desk.ending() && !states.is_closed() {
            read(&desk, &mut reading);
            *desk.reading() = reading;
            let now = now(&desk);
            states.send_if_modified(|before| {
                let new = **before != *now;
                if new {
                    *before = now;
                }
                new
            });
            std::thread::sleep(PERIOD);
        }
    });
    receiver
}

/// The state at this moment, as JSON: newer than the one that was published last.
pub fn now(desk: &Desk) -> Arc<str> {
    let reading = *desk.reading();
    // Plain data: it cannot fail.
    serde_json::to_string(&state(desk, reading)).unwrap_or_default().into()
}

/// Measures the latest frame, unless a scan does.
fn read(desk: &Desk, reading: &mut Reading) {
    if desk.activity().doing == Doing::Autofocus {
        reading.value = desk.curve().samples.last().map(|(_, phi)| *phi);
        return;
    }
    let Some((number, frame)) = desk.feed.latest().filter(|(number, _)| *number != reading.frame) else { return };
    let looking = desk.looking();
    *reading = match judge(frame.picture.view(), looking.region, looking.measure) {
        Ok(Ok(value)) => Reading { frame: number, value: Some(value.0), fault: None },
        Ok(Err(FrameFault::Saturated)) => Reading { frame: number, value: None, fault: Some("saturated: less light") },
        Ok(Err(_)) => Reading { frame: number, value: None, fault: Some("blank: nothing to see") },
        Err(_) => Reading { frame: number, value: None, fault: Some("the region does not fit the picture") },
    };
}

/// The desk now.
fn state(desk: &Desk, reading: Reading) -> State {
    let rig = desk.rig().clone();
    let activity = desk.activity().clone();
    let focus = focus(desk, reading);
    State {
        r#type: "state",
        version: env!("CARGO_PKG_VERSION"),
        simulated: desk.simulated,
        operator: desk.control().operator(real_now()).map(str::to_owned),
        boards: (0..desk.watchers.len()).map(|i| board(desk, i)).collect(),
        problem: desk.link_problem().clone(),
        axes: desk.axes.iter().map(|info| axis(desk, info)).collect(),
        activity: ActivityState {
            id: activity.id,
            doing: activity.doing,
            text: activity.text,
            ended: activity.ended.iter().rev().take(3).cloned().collect(),
        },
        camera: camera(desk),
        focus,
        tips: places::tips(desk, &rig),
        calibrated: known(desk, &rig),
        calibration: desk.wizard().shown().cloned(),
        messages: desk.messages(),
    }
}

fn focus(desk: &Desk, reading: Reading) -> FocusState {
    let looking = desk.looking();
    // Let go of at once: a scan adds to it.
    let curve = desk.curve();
    FocusState {
        measure: looking.measure.to_string(),
        region: looking.region,
        value: reading.value,
        fault: reading.fault,
        scan: curve.id,
        axis: curve.axis,
        samples: curve.samples.len(),
        focused_um: curve.focused_um,
        refused: curve.refused.clone(),
    }
}

fn board(desk: &Desk, i: usize) -> BoardState {
    let connected = desk.silent_ms(i).is_some_and(|ms| ms < SILENT_MS)
        // A scan on another board keeps the thread: this board rests meanwhile.
        || (matches!(desk.activity().doing, Doing::Autofocus | Doing::Calibration) && desk.link_problem().is_none());
    let emergency = desk.watchers[i].heard().is_some_and(|heard| heard.status.emergency);
    BoardState { connected, emergency }
}

fn axis(desk: &Desk, info: &super::desk::AxisInfo) -> AxisState {
    let status = desk.position(info).map(|(status, _)| status);
    AxisState {
        name: info.name,
        position_um: status.map(|s| s.position.micrometres().0),
        low_um: info.settings.low.micrometres().0,
        high_um: info.settings.high.micrometres().0,
        speed_um_s: info.settings.speed.0,
        moving: status.is_some_and(|s| s.moving),
        trust: match status.map(|s| s.trust) {
            None => "not heard",
            Some(Trust::Unknown) => "unknown",
            Some(Trust::Known) => "known",
            Some(Trust::Restored) => "restored",
            Some(Trust::RestoredRoughly) => "roughly restored",
            Some(Trust::Lost) => "lost",
        },
        at_low: status.is_some_and(|s| s.at_low),
        at_high: status.is_some_and(|s| s.at_high),
    }
}

fn camera(desk: &Desk) -> CameraState {
    let (health, rate_hz) = desk.feed.health();
    let latest = desk.feed.latest();
    let picture = latest.as_ref().map(|(_, frame)| &frame.picture);
    let (name, problem) = match health {
        Health::Starting => ("starting", None),
        Health::Running => ("running", None),
        Health::Failed(why) => ("failed", Some(why)),
    };
    CameraState {
        name: desk.camera.clone(),
        health: name,
        problem,
        rate_hz: (rate_hz * 10.0).round() / 10.0,
        frame: latest.as_ref().map_or(0, |(number, _)| *number),
        width_px: picture.map_or(0, |p| p.width),
        height_px: picture.map_or(0, |p| p.height),
        bits: picture.map_or(0, |p| p.view().bits()),
    }
}
