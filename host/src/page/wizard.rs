//! A calibration as the page shows it: what to do next, the clicks so far, what they came to.

use super::order::OrderError;
use super::solving::{Solved, solve};
use crate::procedure::{Answer, FramePixel, Sample, Subject};
use crate::rig::{ManipulatorNumber, Rig};
use serde::Serialize;
use std::sync::mpsc::SyncSender;

/// What is calibrated.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum What {
    /// The camera's matrix, with a point that stays where it is.
    Camera(Subject),
    /// A manipulator's map to ref.
    Registration(ManipulatorNumber),
    /// Objectives against the default one, which is named first.
    Objectives(Subject, Vec<String>),
    /// A tip brought into view by its coarse registration, through these objectives, the weakest first.
    IntoView(ManipulatorNumber, Vec<String>),
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

/// What the person is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum AskedFor {
    /// A click on a point.
    Point,
    /// An objective in the light path.
    Objective,
}

/// A question to the person.
#[derive(Clone, Debug, Serialize)]
pub struct Asked {
    /// Counts the questions of this program: another number is another question.
    n: u64,
    /// What for.
    r#for: AskedFor,
    /// What to click on, or which objective.
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
    pub at_px: [f64; 2],
    /// Through which objective.
    pub objective: Option<String>,
    /// Taken back by the person.
    pub undone: bool,
    /// Where the solution has it, px of the frame.
    pub solved_px: Option<[f64; 2]>,
    /// How far the solution is off, µm.
    pub residual_um: Option<f64>,
    /// Left out by the solver.
    pub outlier: bool,
}

/// What the page shows of a calibration.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Shown {
    /// Camera, or which manipulator.
    pub title: String,
    /// What goes on, in words.
    pub doing: String,
    /// What the person is asked now.
    asked: Option<Asked>,
    /// The samples.
    pub samples: Vec<Row>,
    /// How many there are going to be.
    pub of: usize,
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
    clicks: Option<SyncSender<Answer>>,
    changed: Option<SyncSender<()>>,
    proposed: Option<Rig>,
    questions: u64,
}

impl Wizard {
    /// Begins another calibration; `of` samples are going to be taken.
    pub fn begin(&mut self, plan: &Plan, title: String, of: usize) {
        let shown = Shown { title, of, doing: "The first picture is taken.".into(), ..Shown::default() };
        let (shown, what, questions) = (Some(shown), Some(plan.what.clone()), self.questions);
        *self = Self { shown, what, seed: plan.seed, questions, ..Self::default() };
    }

    /// What the page shows; nothing when there is no calibration.
    pub fn shown(&self) -> Option<&Shown> {
        self.shown.as_ref()
    }

    /// The same, to show how it goes.
    pub fn shown_mut(&mut self) -> Option<&mut Shown> {
        self.shown.as_mut()
    }

    /// Where a person's clicks go from now on.
    pub fn clicks_to(&mut self, clicks: SyncSender<Answer>) {
        self.clicks = Some(clicks);
    }

    /// Asks the person for something; that an objective was changed is told to `changed`.
    pub fn ask(&mut self, what: AskedFor, subject: String, changed: Option<SyncSender<()>>) {
        self.question(Asked { n: 0, r#for: what, subject, expected: None, within_px: None });
        self.changed = changed;
    }

    /// Asks the person to click on a point.
    pub fn ask_point(&mut self, subject: String, expected: Option<FramePixel>, within_px: Option<f64>) {
        let expected = expected.map(|at| [at.x_px, at.y_px]);
        self.question(Asked { n: 0, r#for: AskedFor::Point, subject, expected, within_px });
    }

    fn question(&mut self, asked: Asked) {
        self.questions += 1;
        if let Some(shown) = &mut self.shown {
            shown.asked = Some(Asked { n: self.questions, ..asked });
        }
    }

    /// The moves are over: what they came to is solved.
    pub fn end(&mut self, said: String, samples: Vec<Sample>, rig: &Rig) {
        (self.clicks, self.changed, self.samples) = (None, None, samples);
        if let Some(shown) = &mut self.shown {
            (shown.asked, shown.over, shown.doing) = (None, true, said);
        }
        self.solve(rig);
    }

    /// Proposes a rig that needed no solving.
    pub fn propose(&mut self, rig: Rig, verdict: String) {
        self.proposed = Some(rig);
        if let Some(shown) = &mut self.shown {
            (shown.verdict, shown.ready) = (Some(verdict), true);
        }
    }

    /// Whether there is something to put in force.
    pub fn ready(&self) -> bool {
        self.proposed.is_some()
    }

    /// A person's answer to the question that is asked.
    ///
    /// # Errors
    /// Nothing is asked, or the click is not where the point can be.
    pub fn answer(&mut self, answer: Answer) -> Result<(), OrderError> {
        let nothing = || OrderError::Value("nothing is asked now: wait until the microscope rests".into());
        let shown = self.shown.as_mut().ok_or_else(nothing)?;
        let asked = shown.asked.as_ref().filter(|asked| asked.r#for == AskedFor::Point).ok_or_else(nothing)?;
        if let (Answer::At(at), Some([x, y]), Some(within)) = (answer, asked.expected, asked.within_px) {
            let off = at.distance_px(FramePixel { x_px: x, y_px: y });
            if off > within {
                let subject = &asked.subject;
                return Err(OrderError::Value(format!(
                    "{subject} should be within {within:.0} px of the circle, this is {off:.0} px away: click it, or pass"
                )));
            }
        }
        self.clicks.as_ref().ok_or_else(nothing)?.try_send(answer).map_err(|_| nothing())?;
        shown.asked = None;
        Ok(())
    }

    /// The person says that the objective asked for is in the light path.
    ///
    /// # Errors
    /// No objective is asked for.
    pub fn changed(&mut self) -> Result<(), OrderError> {
        let nothing = || OrderError::Value("no objective is asked for now".into());
        let shown = self.shown.as_mut().ok_or_else(nothing)?;
        self.changed.take().ok_or_else(nothing)?.try_send(()).map_err(|_| nothing())?;
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

    /// The rig as it is now, with the new calibration in force.
    ///
    /// # Errors
    /// There is none to put in force.
    pub fn accept(&mut self, rig: &Rig) -> Result<Rig, OrderError> {
        let none = || OrderError::Value("there is no calibration to put in force: finish one first".into());
        // The objective in use may be another than when this was solved.
        self.solve(rig);
        let mut proposed = self.proposed.take().ok_or_else(none)?;
        if let Some(What::IntoView(number, _)) = &self.what {
            let found = proposed.contents_mut().manipulators.remove(number).and_then(|m| m.coarse);
            proposed = rig.clone();
            proposed.contents_mut().manipulators.entry(*number).or_default().coarse = found;
        }
        *self = Self { questions: self.questions, ..Self::default() };
        Ok(proposed)
    }

    /// Forgets what is over.
    pub fn discard(&mut self) {
        if self.shown.as_ref().is_some_and(|shown| shown.over) {
            *self = Self { questions: self.questions, ..Self::default() };
        }
    }

    /// Solves what was not taken back.
    fn solve(&mut self, rig: &Rig) {
        let (Some(shown), Some(what)) = (&mut self.shown, &self.what) else { return };
        if matches!(what, What::IntoView(..)) {
            return;
        }
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
