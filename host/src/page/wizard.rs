//! A calibration as the page shows it: what to do next, the clicks so far, what they came to.

use super::desk::{Desk, Doing, Level};
use super::focusing::PageFocuser;
use super::order::OrderError;
use super::solving::{Solved, solve};
use crate::procedure::{
    Answer, CameraPlan, Clicker, DetectorFinder, FramePixel, LiveRig, Parts, PointFinder, ProcedureError, Progress,
    Purpose, Recorder, RegistrationPlan, Sample, Subject, Window, camera, clicks, registration,
};
use crate::rig::{Camera, ManipulatorNumber, Rig};
use crate::stage::Stage;
use serde::Serialize;
use std::sync::Arc;
use std::sync::mpsc::{RecvTimeoutError, SyncSender};
use std::time::Duration;

/// What is calibrated.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum What {
    /// The camera's matrix, with a point that stays where it is.
    Camera(Subject),
    /// A manipulator's map to ref.
    Registration(ManipulatorNumber),
}

/// How.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// What.
    pub what: What,
    /// Places to look at the point, besides the first ones.
    pub places: usize,
    /// Of the random places.
    pub seed: u64,
    /// Whether a person clicks, or the tip detector finds.
    pub by_clicks: bool,
    /// How far places spread in depth, µm.
    pub depth_um: f64,
    /// How far the focus may be, µm.
    pub focus_within_um: f64,
}

/// A question to the person.
#[derive(Clone, Debug, Serialize)]
pub struct Asked {
    /// Counts the questions of this program: another number is another question.
    n: u64,
    /// What to click on.
    subject: String,
    /// Where it should be, px of the frame.
    expected: Option<[f64; 2]>,
    /// How far from there a click counts, px of the frame.
    within_px: Option<f64>,
}

/// One sample on the page.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Where the point was, px of the frame.
    at_px: [f64; 2],
    /// Taken back by the person.
    pub undone: bool,
    /// Where the solution has it, px of the frame.
    solved_px: Option<[f64; 2]>,
    /// How far the solution is off, µm.
    residual_um: Option<f64>,
    /// Left out by the solver.
    outlier: bool,
}

/// What the page shows of a calibration.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Shown {
    /// Camera, or which manipulator.
    title: String,
    /// What goes on, in words.
    doing: String,
    /// What the person is asked now.
    asked: Option<Asked>,
    /// The samples.
    samples: Vec<Row>,
    /// How many there are going to be.
    of: usize,
    /// Whether the moves are over.
    over: bool,
    /// What the samples came to, or why to nothing.
    verdict: Option<String>,
    /// Whether there is something to put in force.
    ready: bool,
    /// RMS of the residuals, µm.
    rms_um: Option<f64>,
}

/// A calibration under way, or waiting to be put in force.
#[derive(Default)]
pub struct Wizard {
    shown: Option<Shown>,
    what: Option<What>,
    seed: u64,
    samples: Vec<Sample>,
    found: Option<[f64; 2]>,
    answers: Option<SyncSender<Answer>>,
    proposed: Option<Rig>,
    questions: u64,
}

impl Wizard {
    /// What the page shows; nothing when there is no calibration.
    pub fn shown(&self) -> Option<&Shown> {
        self.shown.as_ref()
    }

    /// A person's answer to the question that is asked.
    ///
    /// # Errors
    /// Nothing is asked, or the click is not where the point can be.
    pub fn answer(&mut self, answer: Answer) -> Result<(), OrderError> {
        let nothing = || OrderError::Value("nothing is asked now: wait until the microscope rests".into());
        let shown = self.shown.as_mut().ok_or_else(nothing)?;
        let asked = shown.asked.as_ref().ok_or_else(nothing)?;
        if let (Answer::At(at), Some([x, y]), Some(within)) = (answer, asked.expected, asked.within_px) {
            let off = at.distance_px(FramePixel { x_px: x, y_px: y });
            if off > within {
                let subject = &asked.subject;
                return Err(OrderError::Value(format!(
                    "{subject} should be within {within:.0} px of the circle, this is {off:.0} px away: click it, or pass"
                )));
            }
        }
        self.answers.as_ref().ok_or_else(nothing)?.try_send(answer).map_err(|_| nothing())?;
        shown.asked = None;
        Ok(())
    }

    /// Takes a sample back, or in again; what was solved is solved anew.
    ///
    /// # Errors
    /// There is no such sample.
    pub fn undo(&mut self, sample: usize, undone: bool, rig: &Rig) -> Result<(), OrderError> {
        let none = || OrderError::Value(format!("there is no sample {sample}"));
        let shown = self.shown.as_mut().ok_or_else(none)?;
        shown.samples.get_mut(sample).ok_or_else(none)?.undone = undone;
        if shown.over {
            self.solve(rig);
        }
        Ok(())
    }

    /// The rig with the new calibration in force.
    ///
    /// # Errors
    /// There is none to put in force.
    pub fn accept(&mut self) -> Result<Rig, OrderError> {
        let none = || OrderError::Value("there is no calibration to put in force: finish one first".into());
        let rig = self.proposed.take().ok_or_else(none)?;
        *self = Self::default();
        Ok(rig)
    }

    /// Forgets what is over.
    pub fn discard(&mut self) {
        if self.shown.as_ref().is_some_and(|shown| shown.over) {
            *self = Self::default();
        }
    }

    /// Solves what was not taken back.
    fn solve(&mut self, rig: &Rig) {
        let (Some(shown), Some(what)) = (&mut self.shown, &self.what) else { return };
        let kept: Vec<usize> =
            (0..self.samples.len()).filter(|i| shown.samples.get(*i).is_none_or(|r| !r.undone)).collect();
        let samples: Vec<Sample> = kept.iter().map(|i| self.samples[*i].clone()).collect();
        for row in &mut shown.samples {
            (row.solved_px, row.residual_um, row.outlier) = (None, None, false);
        }
        match solve(rig, what, &samples, self.seed) {
            Err(why) => {
                (shown.verdict, shown.ready, shown.rms_um) = (Some(why), false, None);
                self.proposed = None;
            }
            Ok(Solved { rig: proposed, verdict, rms_um, samples }) => {
                for (i, solved) in kept.into_iter().zip(samples) {
                    if let Some(row) = shown.samples.get_mut(i) {
                        row.solved_px = Some([solved.at.x_px, solved.at.y_px]);
                        (row.residual_um, row.outlier) = (Some(solved.residual_um), solved.outlier);
                    }
                }
                (shown.verdict, shown.ready, shown.rms_um) = (Some(verdict), true, Some(rms_um));
                self.proposed = Some(proposed);
            }
        }
    }
}

/// A calibration that is about to run.
pub struct Calibration {
    id: u64,
    plan: Plan,
    halts: u64,
}

impl Calibration {
    /// Tells the desk of it.
    pub fn begin(desk: &Desk, plan: Plan) -> Self {
        let (title, of) = match &plan.what {
            What::Camera(subject) => (format!("Camera, by {subject}"), plan.places + 3),
            What::Registration(number) => (format!("Registration of {number}"), plan.places + 4),
        };
        let id = desk.begin(Doing::Calibration, title.clone());
        let shown = Shown { title, of, doing: "The first picture is taken.".into(), ..Shown::default() };
        let questions = desk.wizard().questions;
        let wizard = Wizard {
            shown: Some(shown),
            what: Some(plan.what.clone()),
            seed: plan.seed,
            questions,
            ..Wizard::default()
        };
        *desk.wizard() = wizard;
        Self { id, plan, halts: desk.halts() }
    }

    /// Its activity.
    pub fn id(&self) -> u64 {
        self.id
    }

    /// Runs it to its end, and solves what it recorded.
    pub fn run(self, desk: &Arc<Desk>, stage: &mut Stage) {
        let (own, halts) = (desk.clone(), self.halts);
        let going = Arc::new(move || own.halts() == halts && !own.cancelled());
        let purpose = match self.plan.what {
            What::Camera(_) => Purpose::Microscope,
            What::Registration(_) => Purpose::Registration,
        };
        let mut recorder = Recorder::memory(purpose);
        let ran = if self.plan.by_clicks {
            let (mut finder, clicker) = clicks();
            desk.wizard().answers = Some(clicker.answers.clone());
            let (desk_of_asker, going_on) = (desk.clone(), going.clone());
            let asker = std::thread::spawn(move || ask(&desk_of_asker, &clicker, &*going_on));
            let ran = self.procedure(desk, stage, &mut finder, &going, &mut recorder);
            drop(finder);
            // A thread that panicked has told so.
            let _ = asker.join();
            ran
        } else {
            self.procedure(desk, stage, &mut DetectorFinder::default(), &going, &mut recorder)
        };
        let rig = desk.rig().clone();
        let mut wizard = desk.wizard();
        wizard.answers = None;
        wizard.samples = recorder.samples().to_vec();
        if let Some(shown) = &mut wizard.shown {
            (shown.asked, shown.over) = (None, true);
            shown.doing = match &ran {
                Ok(()) => "All places were seen.".into(),
                Err(error) => format!("It ended early: {error}"),
            };
        }
        wizard.solve(&rig);
        let ready = wizard.proposed.is_some();
        drop(wizard);
        match ran {
            Ok(()) if ready => {
                desk.end(true, "the samples are recorded and solved: look at the residuals, then use the calibration")
            }
            Ok(()) => desk.end(false, "the samples are recorded, and do not give a calibration"),
            Err(error) => desk.end(false, format!("the calibration ended early: {error}")),
        }
    }

    fn procedure(
        &self,
        desk: &Arc<Desk>,
        stage: &mut Stage,
        finder: &mut dyn PointFinder,
        going: &Arc<impl Fn() -> bool + Send + Sync + 'static>,
        recorder: &mut Recorder,
    ) -> Result<(), ProcedureError> {
        learn_the_size(desk);
        let rig = desk.rig().clone();
        let mut feed = desk.feed.camera(going.clone());
        let mut focuser = PageFocuser::new(desk.clone());
        let window = rig.contents().camera.as_ref().map(Window::of);
        let mut progress = |progress: Progress| note(desk, window, progress);
        let mut live = LiveRig::new(Parts {
            stage,
            camera: &mut feed,
            focuser: &mut focuser,
            rig: &rig,
            keep_on: &**going,
            progress: &mut progress,
        })?;
        let (places, seed) = (self.plan.places, self.plan.seed);
        match &self.plan.what {
            What::Camera(subject) => {
                let focus_within_um = Some(self.plan.focus_within_um);
                let plan = CameraPlan { subject: subject.clone(), places, seed, focus_within_um };
                camera(&mut live, finder, &plan, recorder).map(drop)
            }
            What::Registration(manipulator) => {
                let Plan { depth_um, focus_within_um, .. } = self.plan;
                let plan = RegistrationPlan { manipulator: *manipulator, places, seed, depth_um, focus_within_um };
                registration(&mut live, finder, &plan, recorder)
            }
        }
    }
}

/// A rig that does not know its camera's size learns it from a frame.
fn learn_the_size(desk: &Desk) {
    let Some((_, frame)) = desk.feed.latest() else { return };
    let (Ok(width_px), Ok(height_px)) = (u32::try_from(frame.picture.width), u32::try_from(frame.picture.height))
    else {
        return;
    };
    let sensor = Camera { width_px, height_px, crop_px: None, binning: 1, calibration: None, latency: None };
    desk.rig().contents_mut().camera.get_or_insert(sensor);
}

/// Puts the procedure's questions on the desk, until it ends or is told to.
fn ask(desk: &Desk, clicker: &Clicker, going: &dyn Fn() -> bool) {
    loop {
        match clicker.questions.recv_timeout(Duration::from_millis(50)) {
            Ok(question) => {
                let mut wizard = desk.wizard();
                wizard.questions += 1;
                let asked = Asked {
                    n: wizard.questions,
                    subject: question.hint.subject.to_string(),
                    expected: question.hint.expected.map(|at| [at.x_px, at.y_px]),
                    within_px: question.hint.within_px,
                };
                if let Some(shown) = &mut wizard.shown {
                    shown.asked = Some(asked);
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
        if !going() {
            clicker.end();
        }
    }
}

/// Shows how a procedure goes.
fn note(desk: &Desk, window: Option<Window>, progress: Progress) {
    let mut wizard = desk.wizard();
    let Some(shown) = &mut wizard.shown else { return };
    match progress {
        Progress::Begins(text) => shown.doing = text,
        Progress::Focused { axis, at } => shown.doing = format!("{axis} is in focus at {:.2} µm.", at.0),
        Progress::Found { pixel, .. } => {
            let at = window.map_or(FramePixel { x_px: pixel.x_px, y_px: pixel.y_px }, |window| window.to_frame(pixel));
            shown.doing = format!("Found at {:.1}, {:.1} px.", at.x_px, at.y_px);
            wizard.found = Some([at.x_px, at.y_px]);
        }
        Progress::Recorded { done, of } => {
            (shown.of, shown.doing) = (of, format!("Sample {done} of {of} is recorded; moving on."));
            // What was found last before a sample is recorded is the sample's.
            if let Some(at_px) = wizard.found.take()
                && let Some(shown) = &mut wizard.shown
            {
                let row = Row { at_px, undone: false, solved_px: None, residual_um: None, outlier: false };
                shown.samples.push(row);
            }
        }
        Progress::Passed(why) => {
            drop(wizard);
            desk.tell(Level::Info, format!("a place was passed over: {why}"));
        }
        Progress::Warning(text) => {
            drop(wizard);
            desk.tell(Level::Warning, text);
        }
    }
}
