//! The thread that moves things runs a calibration procedure; what it asks and finds is put on the desk.

use super::desk::{Desk, Doing, Level};
use super::focusing::PageFocuser;
use super::turret::ask_for;
use super::wizard::{Plan, Row, What};
use crate::procedure::{
    CameraPlan, Clicker, DetectorFinder, FramePixel, InView, IntoViewPlan, LiveRig, ObjectivePlan, Parts, PointFinder,
    ProcedureError, Progress, Purpose, Recorder, RegistrationPlan, Window, camera, clicks, into_view, objectives,
    registration,
};
use crate::rig::{Camera, ManipulatorNumber, Rig};
use crate::stage::Stage;
use std::sync::Arc;
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

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
            What::Objectives(_, names) => (format!("Objectives {}", names.join(", ")), (plan.places + 3) * names.len()),
            What::IntoView(number, names) => (format!("{number} into view, through {}", names.join(", ")), 1),
        };
        let id = desk.begin(Doing::Calibration, title.clone());
        desk.wizard().begin(&plan, title, of);
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
            What::Camera(_) | What::Objectives(..) => Purpose::Microscope,
            What::Registration(_) | What::IntoView(..) => Purpose::Registration,
        };
        let mut recorder = Recorder::memory(purpose);
        let ran = if self.plan.by_clicks {
            let (mut finder, clicker) = clicks();
            desk.wizard().clicks_to(clicker.answers.clone());
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
        let said = match &ran {
            Ok(_) => "All places were seen.".into(),
            Err(error) => format!("It ended early: {error}"),
        };
        wizard.end(said, recorder.samples().to_vec(), &rig);
        if let (What::IntoView(number, _), Ok(Some(found))) = (&self.plan.what, &ran)
            && let Some((proposed, verdict)) = in_view(&rig, *number, found)
        {
            wizard.propose(proposed, verdict);
        }
        let ready = wizard.ready();
        drop(wizard);
        match ran {
            Ok(_) if ready => {
                desk.end(true, "the samples are recorded and solved: look at the residuals, then use the calibration")
            }
            Ok(_) => desk.end(false, "the samples are recorded, and do not give a calibration"),
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
    ) -> Result<Option<InView>, ProcedureError> {
        learn_the_size(desk);
        let rig = desk.rig().clone();
        let mut feed = desk.feed.camera(going.clone());
        let mut focuser = PageFocuser::new(desk.clone());
        let window = rig.contents().camera.as_ref().map(Window::of);
        let mut found = None;
        let mut progress = |progress: Progress| note(desk, window, &mut found, progress);
        let mut change = |name: &str| ask_for(desk, &**going, name);
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
                camera(&mut live, finder, &plan, recorder)?;
            }
            What::Registration(manipulator) => {
                let Plan { depth_um, focus_within_um, .. } = self.plan;
                let plan = RegistrationPlan { manipulator: *manipulator, places, seed, depth_um, focus_within_um };
                registration(&mut live, finder, &plan, recorder)?;
            }
            What::Objectives(subject, names) => {
                let (names, subject) = (names.clone(), subject.clone());
                let plan = ObjectivePlan { names, subject, places, seed, focus_within_um: self.plan.focus_within_um };
                objectives(&mut live, finder, &plan, &mut change, recorder)?;
            }
            What::IntoView(manipulator, names) => {
                let plan = IntoViewPlan { manipulator: *manipulator, objectives: names.clone() };
                return into_view(&mut live, finder, &plan, &mut change, recorder).map(Some);
            }
        }
        Ok(None)
    }
}

/// The rig with a coarse registration that was moved to where the tip is, and what that means.
fn in_view(rig: &Rig, number: ManipulatorNumber, found: &InView) -> Option<(Rig, String)> {
    let mut proposed = rig.clone();
    found
        .put(&mut proposed, number, humantime::format_rfc3339_seconds(std::time::SystemTime::now()).to_string())
        .ok()?;
    let off = found.correction.coordinates.norm();
    let verdict = format!(
        "The tip of {number} is in view, in focus. The markers were {off:.0} µm off; now its coarse registration is good to {:.1} µm here.",
        found.error_um
    );
    Some((proposed, verdict))
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
                let hint = question.hint;
                desk.wizard().ask_point(hint.subject.to_string(), hint.expected, hint.within_px);
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
        if !going() {
            clicker.end();
        }
    }
}

/// Shows how a procedure goes. What was `found` last before a sample is recorded is the sample's.
fn note(desk: &Desk, window: Option<Window>, found: &mut Option<[f64; 2]>, progress: Progress) {
    let objective = desk.rig().contents().objective_in_use.clone();
    let mut wizard = desk.wizard();
    let Some(shown) = wizard.shown_mut() else { return };
    match progress {
        Progress::Begins(text) => shown.doing = text,
        Progress::Focused { axis, at } => shown.doing = format!("{axis} is in focus at {:.2} µm.", at.0),
        Progress::Found { pixel, .. } => {
            let at = window.map_or(FramePixel { x_px: pixel.x_px, y_px: pixel.y_px }, |window| window.to_frame(pixel));
            shown.doing = format!("Found at {:.1}, {:.1} px.", at.x_px, at.y_px);
            *found = Some([at.x_px, at.y_px]);
        }
        Progress::Recorded { of, .. } => {
            if let Some(at_px) = found.take() {
                let (undone, outlier) = (false, false);
                shown.samples.push(Row { at_px, objective, undone, solved_px: None, residual_um: None, outlier });
            }
            // Of several objectives a procedure counts those of one.
            shown.of = shown.of.max(of).max(shown.samples.len());
            shown.doing = format!("Sample {} of {} is recorded; moving on.", shown.samples.len(), shown.of);
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
