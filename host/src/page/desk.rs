//! What the thread that moves things and the web server both see: what goes on, what came of it, and what to tell people.

use super::control::Control;
use super::feed::Feed;
use super::line::Watcher;
use super::snapshot::Reading;
use super::turret::Turret;
use super::wizard::Wizard;
use crate::focus::Measure;
use crate::link::transport::real_now;
use crate::picture::Roi;
use crate::rig::{AxisName, Rig};
use crate::stage::Place;
use parfocal_protocol::message::Stop;
use parfocal_protocol::settings::AxisSettings;
use parfocal_protocol::units::HostTime;
use serde::Serialize;
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Messages kept for who opens the page later.
const MESSAGES: usize = 30;

/// An axis as the page shows it.
#[derive(Clone, Copy, Debug)]
pub struct AxisInfo {
    /// Its name.
    pub name: AxisName,
    /// Where it is connected.
    pub place: Place,
    /// Its settings on the board.
    pub settings: AxisSettings,
}

/// What is under way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Doing {
    /// Nothing: everything may be asked for.
    #[default]
    Idle,
    /// Moving to a place.
    Move,
    /// Moving while a button is held.
    Jog,
    /// A scan for focus.
    Autofocus,
    /// A calibration procedure.
    Calibration,
}

impl Doing {
    /// Whether the thread that moves things does nothing else until it is over.
    pub fn keeps_the_thread(self) -> bool {
        matches!(self, Self::Autofocus | Self::Calibration)
    }
}

/// How something ended.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Ended {
    /// Which activity.
    pub id: u64,
    /// Whether it did what was asked.
    pub ok: bool,
    /// In a sentence.
    pub text: String,
}

/// What goes on.
#[derive(Clone, Debug, Default)]
pub struct Activity {
    /// Counts activities; that of the latest.
    pub id: u64,
    /// What kind.
    pub doing: Doing,
    /// In words.
    pub text: String,
    /// How the latest ones ended.
    pub ended: VecDeque<Ended>,
}

/// A focus curve as it grows.
#[derive(Clone, Debug, Default)]
pub struct CurveSoFar {
    /// The activity it belongs to; 0: none yet.
    pub id: u64,
    /// The axis.
    pub axis: Option<AxisName>,
    /// (z in µm, Φ) in the order taken.
    pub samples: Vec<(f64, f64)>,
    /// From each sample's frame's arrival to its value's leaving for the board, µs.
    pub latency_us: Vec<u64>,
    /// Where the focus was found, µm.
    pub focused_um: Option<f64>,
    /// Why not.
    pub refused: Option<String>,
}

/// How grave a message is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// Something went as asked.
    Info,
    /// Something needs a look.
    Warning,
    /// Something went wrong.
    Error,
}

/// Something to tell people.
#[derive(Clone, Debug, Serialize)]
pub struct Message {
    /// Counts messages.
    pub n: u64,
    /// How grave.
    pub level: Level,
    /// In a sentence.
    pub text: String,
}

/// What the focus is measured in.
#[derive(Clone, Copy, Debug, Default)]
pub struct Looking {
    /// The region whose focus matters; the whole frame without one.
    pub region: Option<Roi>,
    /// The focus measure.
    pub measure: Measure,
}

/// The desk that everybody stands around.
pub struct Desk {
    /// The rig's axes.
    pub axes: Vec<AxisInfo>,
    /// The boards' watchers.
    pub watchers: Vec<Watcher>,
    /// The camera's frames.
    pub feed: Feed,
    /// What the camera is called.
    pub camera: String,
    /// Whether this is the simulated rig.
    pub simulated: bool,
    /// Where the rig is kept; `None`: nowhere.
    pub rig_path: Option<PathBuf>,
    /// The microscope's own turret; `None`: a person changes objectives.
    pub turret: Option<Turret>,
    rig: Mutex<Rig>,
    activity: Mutex<Activity>,
    curve: Mutex<CurveSoFar>,
    messages: Mutex<(u64, VecDeque<Message>)>,
    looking: Mutex<Looking>,
    wizard: Mutex<Wizard>,
    reading: Mutex<Reading>,
    control: Mutex<Control>,
    link_problem: Mutex<Option<String>>,
    halts: AtomicU64,
    cancelled: AtomicBool,
    ending: AtomicBool,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // What is behind these locks is whole at any time.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What a [`Desk`] begins with.
pub struct Setup {
    /// The rig's axes.
    pub axes: Vec<AxisInfo>,
    /// The boards' watchers.
    pub watchers: Vec<Watcher>,
    /// The camera's frames.
    pub feed: Feed,
    /// What the camera is called.
    pub camera: String,
    /// Whether this is the simulated rig.
    pub simulated: bool,
    /// The rig's file.
    pub rig: Rig,
    /// Where it is kept.
    pub rig_path: Option<PathBuf>,
    /// The microscope's own turret, if it has one.
    pub turret: Option<Turret>,
}

impl Desk {
    /// A desk at which nothing goes on.
    pub fn new(setup: Setup) -> Self {
        Self {
            axes: setup.axes,
            watchers: setup.watchers,
            feed: setup.feed,
            camera: setup.camera,
            simulated: setup.simulated,
            rig_path: setup.rig_path,
            turret: setup.turret,
            rig: Mutex::new(setup.rig),
            activity: Mutex::default(),
            curve: Mutex::default(),
            messages: Mutex::default(),
            looking: Mutex::default(),
            wizard: Mutex::default(),
            reading: Mutex::default(),
            control: Mutex::default(),
            link_problem: Mutex::default(),
            halts: AtomicU64::new(0),
            cancelled: AtomicBool::new(false),
            ending: AtomicBool::new(false),
        }
    }

    /// The rig's file.
    pub fn rig(&self) -> MutexGuard<'_, Rig> {
        lock(&self.rig)
    }

    /// What goes on.
    pub fn activity(&self) -> MutexGuard<'_, Activity> {
        lock(&self.activity)
    }

    /// The latest focus curve.
    pub fn curve(&self) -> MutexGuard<'_, CurveSoFar> {
        lock(&self.curve)
    }

    /// Who has control.
    pub fn control(&self) -> MutexGuard<'_, Control> {
        lock(&self.control)
    }

    /// The focus measure of the latest frame.
    pub fn reading(&self) -> MutexGuard<'_, Reading> {
        lock(&self.reading)
    }

    /// The calibration under way, or waiting to be put in force.
    pub fn wizard(&self) -> MutexGuard<'_, Wizard> {
        lock(&self.wizard)
    }

    /// Region and measure.
    pub fn looking(&self) -> Looking {
        *lock(&self.looking)
    }

    /// Changes region or measure.
    pub fn look(&self, change: impl FnOnce(&mut Looking)) {
        change(&mut lock(&self.looking));
    }

    /// What is wrong with a board's connection.
    pub fn link_problem(&self) -> MutexGuard<'_, Option<String>> {
        lock(&self.link_problem)
    }

    /// An axis by name.
    pub fn axis(&self, name: AxisName) -> Option<&AxisInfo> {
        self.axes.iter().find(|axis| axis.name == name)
    }

    /// Tells people something.
    pub fn tell(&self, level: Level, text: impl Into<String>) {
        let mut messages = lock(&self.messages);
        messages.0 += 1;
        let message = Message { n: messages.0, level, text: text.into() };
        if messages.1.len() == MESSAGES {
            messages.1.pop_front();
        }
        messages.1.push_back(message);
    }

    /// The messages, the latest last.
    pub fn messages(&self) -> Vec<Message> {
        lock(&self.messages).1.iter().cloned().collect()
    }

    /// Stops everything at once, past whatever the driving thread is in the middle of. How many boards were told.
    pub fn stop(&self, how: Stop) -> usize {
        self.halts.fetch_add(1, Ordering::SeqCst);
        let told = self.watchers.iter().filter(|watcher| watcher.stop(how).is_ok()).count();
        let what = if how == Stop::Emergency { "EMERGENCY STOP: outputs are off" } else { "STOP" };
        self.tell(Level::Warning, what);
        told
    }

    /// How often somebody stopped everything.
    pub fn halts(&self) -> u64 {
        self.halts.load(Ordering::SeqCst)
    }

    /// Asks what runs to end: a scan returns to its start.
    pub fn cancel(&self) {
        self.cancelled.store(true, Ordering::SeqCst);
    }

    /// Whether a person asked what runs to end.
    pub fn cancelled(&self) -> bool {
        self.cancelled.load(Ordering::SeqCst) || self.ending()
    }

    /// Begins something: its number.
    pub fn begin(&self, doing: Doing, text: impl Into<String>) -> u64 {
        self.cancelled.store(false, Ordering::SeqCst);
        let mut activity = self.activity();
        activity.id += 1;
        (activity.doing, activity.text) = (doing, text.into());
        activity.id
    }

    /// Ends it.
    pub fn end(&self, ok: bool, text: impl Into<String>) {
        let text = text.into();
        let quiet = self.activity().doing == Doing::Jog && ok;
        if !quiet {
            self.tell(if ok { Level::Info } else { Level::Warning }, text.clone());
        }
        let mut activity = self.activity();
        let ended = Ended { id: activity.id, ok, text };
        if activity.ended.len() == MESSAGES {
            activity.ended.pop_front();
        }
        activity.ended.push_back(ended);
        activity.doing = Doing::Idle;
        activity.text.clear();
    }

    /// Ends the driving thread and the camera's.
    pub fn close(&self) {
        self.ending.store(true, Ordering::SeqCst);
        self.feed.end();
    }

    /// Whether the program ends.
    pub fn ending(&self) -> bool {
        self.ending.load(Ordering::SeqCst)
    }

    /// An axis' position and whether it moves, as the board said last; with the time at which it did.
    pub fn position(&self, axis: &AxisInfo) -> Option<(parfocal_protocol::message::AxisStatus, HostTime)> {
        let heard = self.watchers.get(axis.place.board)?.heard()?;
        Some((heard.status.axes[axis.place.axis.index()?], heard.at))
    }

    /// For how long a board has not been heard, ms; `None`: never.
    pub fn silent_ms(&self, board: usize) -> Option<u64> {
        let heard = self.watchers.get(board)?.heard()?;
        Some(real_now().0.saturating_sub(heard.at.0) / 1000)
    }
}
