//! `parfocal setup`: the first hour at a rig. Finds the boards, tries every axis, measures its scale, writes `rig.toml`.

use super::connection::{Bench, Connection, Purpose, hex, plain_order, shown};
use super::{Output, interrupt, simulated};
use anyhow::{Context, bail};
use parfocal::rig::{Axis, AxisName, BoardId, Device, Moves, Rig};
use parfocal_protocol::message::Request;
use parfocal_protocol::settings::AxisSettings;
use parfocal_protocol::units::{Micrometres, MicrometresPerSecond, StepsPerMicrometre};
use std::io::{BufRead, Write};
use std::path::PathBuf;
use std::str::FromStr;

/// The first hour at a rig: find the boards, try every axis, measure its scale, set limits, write rig.toml
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The file to write
    #[arg(long, default_value = "rig.toml", value_name = "FILE")]
    out: PathBuf,
    /// Overwrite it if it exists
    #[arg(long)]
    force: bool,
    /// The simulated rig's file, without a question: boards, axes, camera, objectives, nothing calibrated
    #[arg(long)]
    simulated: bool,
}

/// Each axis first moves this far, µm: enough to see at 4x, too little to break anything.
const TRY_UM: f64 = 10.0;

/// Slow enough to follow with the eye, µm/s.
const TRY_SPEED: f32 = 20.0;

impl Arguments {
    /// Runs the command.
    ///
    /// # Errors
    /// When a board does not answer, the file exists, or the questions are not answered.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        interrupt::watch();
        if self.out.exists() && !self.force {
            bail!("{} exists: give another --out, or --force to replace it", shown(&self.out));
        }
        if self.simulated {
            return self.simulated(out);
        }
        let model = simulated::Model { seed: connection.seed, ..Default::default() };
        let connection = Connection { rig: None, ..connection.clone() };
        let mut bench = connection.open(Purpose::Control, model)?;
        let mut rig = Rig::new();
        let mut people = People { input: std::io::stdin().lock() };
        let done = interview(&mut bench, &mut rig, &mut people);
        bench.stage.close();
        done?;
        rig.save(&self.out).with_context(|| shown(&self.out))?;
        let text = format!(
            "{} written. Next: `parfocal --rig {} status`, then `parfocal calibrate camera`.",
            shown(&self.out),
            shown(&self.out)
        );
        out.result(&text, &serde_json::json!({ "rig": shown(&self.out) }))
    }
}

impl Arguments {
    fn simulated(&self, out: Output) -> anyhow::Result<()> {
        let mut rig = super::remembered::simulated_rig_file()?;
        rig.save(&self.out).with_context(|| shown(&self.out))?;
        super::remembered::Memory::beside(&self.out).keep(&super::remembered::parked()?)?;
        let path = shown(&self.out);
        let text = format!(
            "{path} written: the simulated rig. Next: `parfocal calibrate camera --rig {path}` (docs/calibrating.md)."
        );
        out.result(&text, &serde_json::json!({ "rig": path }))
    }
}

/// Asks every question, board by board and axis by axis.
fn interview<R: BufRead>(bench: &mut Bench, rig: &mut Rig, people: &mut People<R>) -> anyhow::Result<()> {
    for board in 0..bench.stage.boards_mut().len() {
        let hello = *bench.stage.boards_mut()[board].hello();
        let id = hex(&hello.unique_id);
        people.say(&format!("\nBoard {} ({id}), {} axes.", hello.board.as_str(), hello.axes));
        let name = people.ask("What do you call it?", &format!("board{}", board + 1))?;
        rig.set_board(&name, BoardId::from_str(&id)?);
        let proposed: Vec<AxisName> = if bench.simulated.is_some() {
            bench.stage.axes().filter(|(_, place)| place.board == board).map(|(name, _)| name).collect()
        } else {
            plain_order(hello.axes).into_keys().collect()
        };
        for index in 0..hello.axes {
            let default = proposed.get(usize::from(index)).map_or("-".into(), ToString::to_string);
            let question =
                format!("Axis {index}: what is it? (scope.x … scope.z, m1.x …, '-' if nothing is connected)");
            let answer = people.ask(&question, &default)?;
            if answer == "-" {
                continue;
            }
            let axis_name: AxisName = answer.parse()?;
            let link = &mut bench.stage.boards_mut()[board];
            let axis = parfocal_protocol::units::Axis(index);
            let settings = settle(link, axis, people)?;
            link.request(Request::SetAxis { axis, settings }).context(axis_name)?;
            let moves = if axis_name.device == Device::Scope {
                let answer = people.choose("What does it move?", &["objective", "stage"])?;
                Some(if answer == "stage" { Moves::Stage } else { Moves::Objective })
            } else {
                None
            };
            rig.set_axis(axis_name, Axis { board: name.clone(), index, moves });
        }
        if people.choose("Keep these settings on the board over a power cycle?", &["yes", "no"])? == "yes" {
            bench.stage.boards_mut()[board].request(Request::Save)?;
        }
    }
    Ok(())
}

/// Tries one axis: direction, scale, limits.
fn settle<R: BufRead>(
    link: &mut parfocal::link::Link,
    axis: parfocal_protocol::units::Axis,
    people: &mut People<R>,
) -> anyhow::Result<AxisSettings> {
    let parfocal_protocol::message::Response::Axis(mut settings) = link.request(Request::GetAxis { axis })? else {
        bail!("the board on {} answered out of turn", link.port());
    };
    if people.choose(&format!("It will now move {TRY_UM} µm up and back, slowly. Ready?"), &["yes", "skip"])? == "yes"
    {
        there_and_back(link, axis, TRY_UM)?;
        let way = people.choose("Which way did it go first, by its scale?", &["larger", "smaller", "none"])?;
        match way.as_str() {
            "smaller" => settings.inverted = !settings.inverted,
            "none" => bail!(
                "nothing moved: check the driver's supply, EN and the wiring (docs/wiring.md), then run setup again"
            ),
            _ => {}
        }
    }
    let told = people.number("How far shall it go to measure its scale, µm? (0: the steps per µm are known)", 0.0)?;
    if told > 0.0 {
        one_way(link, axis, told)?;
        let seen =
            people.number("How far did it go by a stage micrometer or the manipulator's own scale, µm?", told)?;
        one_way(link, axis, -told)?;
        if seen > 0.0 {
            settings.steps_per_um = StepsPerMicrometre((f64::from(settings.steps_per_um.0) * told / seen) as f32);
            people.say(&format!("That makes {} steps/µm.", settings.steps_per_um.0));
        }
    } else {
        settings.steps_per_um =
            StepsPerMicrometre(people.number("Steps per µm?", f64::from(settings.steps_per_um.0))? as f32);
    }
    let limit = |um: f64| Micrometres(um).nanometres().context("that is no position a stage can have");
    settings.low = limit(people.number("Lowest position it may go to, µm?", settings.low.micrometres().0)?)?;
    settings.high = limit(people.number("Highest position it may go to, µm?", settings.high.micrometres().0)?)?;
    let speed = people.number("Fastest speed, µm/s?", f64::from(settings.speed.0))?;
    settings.speed = MicrometresPerSecond(speed as f32);
    Ok(settings)
}

fn there_and_back(
    link: &mut parfocal::link::Link,
    axis: parfocal_protocol::units::Axis,
    um: f64,
) -> anyhow::Result<()> {
    one_way(link, axis, um)?;
    one_way(link, axis, -um)
}

fn one_way(link: &mut parfocal::link::Link, axis: parfocal_protocol::units::Axis, um: f64) -> anyhow::Result<()> {
    let i = axis.index().context("the board has no such axis")?;
    let from = parfocal::stage::status(link)?.axes[i].position.micrometres().0;
    let mut to = [None; parfocal_protocol::units::AXES];
    to[i] = Micrometres(from + um).nanometres();
    link.request(Request::Move { to, speed: Some(MicrometresPerSecond(TRY_SPEED)) })?;
    while !parfocal::stage::status(link)?.in_position {
        if !interrupt::keep_on() {
            link.request(Request::Stop { how: parfocal_protocol::message::Stop::Decelerate })?;
            bail!("stopped on request");
        }
        let until = parfocal::link::transport::later(link.now(), 50);
        while link.event(until)?.is_some() {}
    }
    Ok(())
}

/// The person at the rig. Questions go to stderr, so that stdout stays clean for `--json`.
struct People<R> {
    input: R,
}

impl<R: BufRead> People<R> {
    fn say(&mut self, text: &str) {
        eprintln!("{text}");
    }

    /// A line of text; an empty one means the default.
    fn ask(&mut self, question: &str, default: &str) -> anyhow::Result<String> {
        eprint!("{question} [{default}] ");
        std::io::stderr().flush().ok();
        let mut line = String::new();
        if self.input.read_line(&mut line)? == 0 {
            bail!("the questions were not answered: nothing was written");
        }
        let line = line.trim();
        Ok(if line.is_empty() { default.into() } else { line.into() })
    }

    /// One of a few words, the first being the default; asks again until it is one of them.
    fn choose(&mut self, question: &str, words: &[&str]) -> anyhow::Result<String> {
        loop {
            let answer = self.ask(&format!("{question} ({})", words.join("/")), words[0])?;
            if let Some(word) = words.iter().find(|w| w.starts_with(&answer.to_lowercase())) {
                return Ok((*word).into());
            }
        }
    }

    /// A number; asks again until it is one.
    fn number(&mut self, question: &str, default: f64) -> anyhow::Result<f64> {
        loop {
            let answer = self.ask(question, &default.to_string())?;
            if let Some(number) = answer.replace(',', ".").parse().ok().filter(|v: &f64| v.is_finite()) {
                return Ok(number);
            }
            self.say("Please answer with a number.");
        }
    }
}
