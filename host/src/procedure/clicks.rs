//! Clicks as a [`PointFinder`]: a question with its frame goes out, a person's answer comes back.

use super::point::{Found, FramePixel, Hint, NotFound, PointFinder, Witness};
use crate::frames::camera::Frame;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;

/// What a person is asked.
#[derive(Clone, Debug)]
pub struct Question {
    /// The picture to click in.
    pub frame: Frame,
    /// What to click on, and where it should be.
    pub hint: Hint,
}

/// What a person answers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Answer {
    /// Here, in pixels of the question's frame.
    At(FramePixel),
    /// It is not in this picture: go on without it.
    Pass,
    /// End the procedure.
    End,
}

/// The procedure's end of the questions.
#[derive(Debug)]
pub struct ClickFinder {
    questions: SyncSender<Question>,
    answers: Receiver<Answer>,
    ended: Arc<AtomicBool>,
}

/// The person's end of the questions: a page, or a terminal.
#[derive(Debug)]
pub struct Clicker {
    /// Questions, one after another; the next comes after the answer.
    pub questions: Receiver<Question>,
    /// Where answers go.
    pub answers: SyncSender<Answer>,
    ended: Arc<AtomicBool>,
}

impl Clicker {
    /// Ends the questions: whoever waits for an answer is told that nobody is there.
    pub fn end(&self) {
        self.ended.store(true, Ordering::SeqCst);
    }
}

impl Drop for Clicker {
    fn drop(&mut self) {
        self.end();
    }
}

/// A pair of ends: the finder goes into a procedure, the clicker to whoever asks the person.
pub fn clicks() -> (ClickFinder, Clicker) {
    let (questions, asked) = sync_channel(1);
    let (answers, answered) = sync_channel(1);
    let ended = Arc::new(AtomicBool::new(false));
    let finder = ClickFinder { questions, answers: answered, ended: Arc::clone(&ended) };
    (finder, Clicker { questions: asked, answers, ended })
}

/// How often a waiting finder looks whether anybody is still there.
const LOOK: Duration = Duration::from_millis(100);

impl PointFinder for ClickFinder {
    fn find(&mut self, frame: &Frame, hint: &Hint) -> Result<Found, NotFound> {
        let nobody = || NotFound::Nobody(hint.subject.clone());
        // An answer to a question that is over belongs to nothing.
        while self.answers.try_recv().is_ok() {}
        self.questions.send(Question { frame: frame.clone(), hint: hint.clone() }).map_err(|_| nobody())?;
        loop {
            match self.answers.recv_timeout(LOOK) {
                Ok(Answer::At(at)) => return Ok(Found { at, confidence: 1.0, angle_deg: None, by: Witness::Click }),
                Ok(Answer::Pass) => return Err(NotFound::Passed(hint.subject.clone())),
                Ok(Answer::End) | Err(RecvTimeoutError::Disconnected) => return Err(nobody()),
                Err(RecvTimeoutError::Timeout) if self.ended.load(Ordering::SeqCst) => return Err(nobody()),
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::Picture;
    use crate::procedure::point::Subject;
    use parfocal_protocol::units::HostTime;

    #[test]
    fn a_click_answers_its_question_and_a_person_who_left_ends_it() {
        let picture = Picture::grey8(4, 4, vec![0; 16]).unwrap();
        let frame = Frame { picture: picture.into(), number: 0, exposure: None, arrival: HostTime(0) };
        let hint = Hint::anywhere(Subject::Point("speck".into()));
        let (mut finder, clicker) = clicks();
        let person = std::thread::spawn(move || {
            let question = clicker.questions.recv().unwrap();
            assert_eq!(question.hint.subject.to_string(), "point 'speck'");
            clicker.answers.send(Answer::At(FramePixel { x_px: 1.5, y_px: 2.0 })).unwrap();
            let _second = clicker.questions.recv().unwrap();
            clicker.answers.send(Answer::Pass).unwrap();
            let _third = clicker.questions.recv().unwrap();
        });
        assert_eq!(finder.find(&frame, &hint).unwrap().at, FramePixel { x_px: 1.5, y_px: 2.0 });
        assert!(matches!(finder.find(&frame, &hint), Err(NotFound::Passed(_))));
        assert!(matches!(finder.find(&frame, &hint), Err(NotFound::Nobody(_))));
        person.join().unwrap();
    }
}
