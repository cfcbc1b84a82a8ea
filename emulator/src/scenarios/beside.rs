//! What goes on beside a fast move: telemetry, a scan's samples, questions.

use crate::Machine;
use crate::talk::Talk;
use anyhow::{bail, ensure};
use parfocal_protocol::autofocus::{ScanId, SweepSample};
use parfocal_protocol::message::{Event, Refusal, Request, Status};
use parfocal_protocol::settings::BoardSettings;
use parfocal_protocol::units::{BoardTime, FocusValue, Hertz};
use std::fmt;
use std::time::Duration;

/// A camera of 330 frames a second, each giving a value.
const SAMPLE: Duration = Duration::from_millis(3);

/// Samples between two questions how the board is.
const STATUS: u32 = 2;

/// Positions told a second.
const TELEMETRY: Hertz = Hertz(250.0);

/// What was exchanged while the axes moved.
#[derive(Clone, Copy, Debug, Default)]
pub struct Beside {
    samples: u32,
    /// Positions told, and the board's time of the first and the last, µs.
    told: u32,
    times: [u64; 2],
}

impl Beside {
    /// Settings of the board for such a move.
    pub fn settings() -> BoardSettings {
        BoardSettings { telemetry: TELEMETRY, ..BoardSettings::default() }
    }

    /// Sends a sweep's samples and asks for the status until the board rests. The samples belong to a scan that has ended, for
    /// a scan moves one axis only: the board reads, judges and answers each as it does in a sweep.
    ///
    /// # Errors
    /// When an answer is wrong or missing, a position goes back, or it moves for 10 s.
    pub fn of(board: &mut Machine, talk: &mut Talk) -> anyhow::Result<(Status, Self)> {
        let mut beside = Self::default();
        let mut before = [0; 4];
        let until = board.now() + Duration::from_secs(10);
        while board.now() < until {
            board.run_for(SAMPLE)?;
            let at = BoardTime(board.now().as_micros() as u64);
            let value = Ok(FocusValue(0.5));
            let sample = SweepSample { scan: ScanId(1), index: beside.samples, at, value };
            let answer = talk.try_ask(board, Request::AutofocusSweepSample(sample))?;
            ensure!(matches!(answer, Err(Refusal::NoSuchScan { .. })), "a stale sample was answered with {answer:?}");
            beside.samples += 1;
            let status = if beside.samples % STATUS == 0 { Some(talk.status(board)?) } else { None };
            while let Some(event) = talk.events.pop_front() {
                let Event::Position { time, steps } = event else { continue };
                let now = steps.map(|s| s.0);
                ensure!(now.iter().zip(before).all(|(now, before)| *now >= before), "positions go back: {now:?}");
                before = now;
                beside.times = [if beside.told == 0 { time.0 } else { beside.times[0] }, time.0];
                beside.told += 1;
            }
            if let Some(status) = status.filter(|s| s.in_position) {
                return Ok((status, beside));
            }
        }
        bail!("it still moves after 10 s")
    }

    /// Positions told a second.
    pub fn telemetry_hz(&self) -> f64 {
        f64::from(self.told.saturating_sub(1)) * 1e6 / (self.times[1] - self.times[0]).max(1) as f64
    }
}

impl fmt::Display for Beside {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "beside it {} samples and {:.0} positions a second", self.samples, self.telemetry_hz())
    }
}
