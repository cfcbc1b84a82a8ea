//! Pins what stands on the wire: the byte of every variant of every enum. A byte that changes here breaks boards that are
//! already out there: add variants at the end, and raise `VERSION` if an old peer could misread one.

use parfocal_protocol::autofocus::*;
use parfocal_protocol::message::*;
use parfocal_protocol::settings::*;
use parfocal_protocol::units::*;
use parfocal_protocol::{SCHEMA, VERSION};

/// Checks that each value is written with its byte first. The matches below have no `_`, so a new variant does not compile
/// until it is pinned; the examples must then hold each byte once.
fn pinned<T: serde::Serialize>(examples: &[T], byte: impl Fn(&T) -> u8) {
    for (i, example) in examples.iter().enumerate() {
        let mut buffer = [0; 512];
        let written = postcard::to_slice(example, &mut buffer).unwrap();
        assert_eq!(written[0], byte(example), "{} variant {i}", std::any::type_name::<T>());
        assert_eq!(
            usize::from(byte(example)),
            i,
            "{} has an example for every variant, in order",
            std::any::type_name::<T>()
        );
    }
}

macro_rules! pin {
    ($type:ty: $($pattern:pat => $byte:literal, $example:expr;)*) => {
        pinned::<$type>(&[$($example),*], |value| match value { $($pattern => $byte,)* });
    };
}

const SAMPLE: SampleWanted = SampleWanted { scan: ScanId(1), index: 2, z: Nanometres(3), since: BoardTime(4) };
const PARAMETERS: ScanParameters = ScanParameters {
    scan: ScanId(1),
    axis: Axis(2),
    strategy: Strategy::Climb,
    mode: Mode::Step,
    subject: Subject::Peak,
    low: Nanometres(0),
    high: Nanometres(1),
    sample_step: Nanometres(1),
    trap: Nanometres(1),
    probe: Nanometres(1),
    speed: MicrometresPerSecond(0.0),
    sample_timeout: Milliseconds(1),
    verify: false,
};
const REPORT: ScanReport = ScanReport {
    scan: ScanId(1),
    outcome: Outcome::Focused,
    start: Nanometres(0),
    best: Nanometres(0),
    end: Nanometres(0),
    travel: Nanometres(0),
    approach: Nanometres(0),
    frames: 0,
    duration: Milliseconds(0),
};

#[test]
fn requests() {
    let value = Ok(FocusValue(1.0));
    pin!(Request:
        Request::Hello { .. } => 0, Request::Hello { role: Role::Watch };
        Request::Status => 1, Request::Status;
        Request::Move { .. } => 2, Request::Move { to: [None; AXES], speed: None };
        Request::Stop { .. } => 3, Request::Stop { how: Stop::Decelerate };
        Request::Jog { .. } => 4, Request::Jog { axis: Axis(0), speed: MicrometresPerSecond(1.0) };
        Request::Vibrate { .. } => 5, Request::Vibrate { axis: Axis(0), amplitude: Nanometres(1), frequency: Hertz(1.0), cycles: 1 };
        Request::Home { .. } => 6, Request::Home { axis: Axis(0) };
        Request::Hold => 7, Request::Hold;
        Request::Resume => 8, Request::Resume;
        Request::GetAxis { .. } => 9, Request::GetAxis { axis: Axis(0) };
        Request::SetAxis { .. } => 10, Request::SetAxis { axis: Axis(0), settings: AxisSettings::default() };
        Request::GetBoard => 11, Request::GetBoard;
        Request::SetBoard { .. } => 12, Request::SetBoard { settings: BoardSettings::default() };
        Request::Save => 13, Request::Save;
        Request::SetPosition { .. } => 14, Request::SetPosition { axis: Axis(0), at: Nanometres(0) };
        Request::Enable { .. } => 15, Request::Enable { axis: Axis(0), on: true };
        Request::ClearEmergency => 16, Request::ClearEmergency;
        Request::Trigger { .. } => 17, Request::Trigger { plan: TriggerPlan::Off };
        Request::AutofocusStart(_) => 18, Request::AutofocusStart(PARAMETERS);
        Request::AutofocusSample(_) => 19, Request::AutofocusSample(FocusSample { scan: ScanId(1), index: 0, value });
        Request::AutofocusSweepSample(_) => 20, Request::AutofocusSweepSample(SweepSample { scan: ScanId(1), index: 0, at: BoardTime(0), value });
        Request::AutofocusState => 21, Request::AutofocusState;
        Request::AutofocusAbort { .. } => 22, Request::AutofocusAbort { scan: ScanId(1) };
        Request::Clock { .. } => 23, Request::Clock { sent: HostTime(0) };
        Request::EnterDfu => 24, Request::EnterDfu;
        Request::Goodbye => 25, Request::Goodbye;
    );
    pin!(Role: Role::Watch => 0, Role::Watch; Role::Control => 1, Role::Control; Role::TakeControl => 2, Role::TakeControl;);
    pin!(Stop: Stop::Decelerate => 0, Stop::Decelerate; Stop::Emergency => 1, Stop::Emergency;);
    pin!(TriggerPlan:
        TriggerPlan::Off => 0, TriggerPlan::Off;
        TriggerPlan::Every { .. } => 1, TriggerPlan::Every { axis: Axis(0), first: Nanometres(0), every: Nanometres(1), count: 1 };
        TriggerPlan::At { .. } => 2, TriggerPlan::At { axis: Axis(0), positions: [Nanometres(0); 8], len: 0 };
    );
}

#[test]
fn answers_and_events() {
    let hello = Hello {
        schema: SCHEMA,
        firmware: [0; 3],
        git: Label::default(),
        board: Label::default(),
        unique_id: [0; 12],
        boot: 0,
        reset: ResetCause::Power,
        axes: 4,
        role: Role::Watch,
        can_save: true,
        last_stop: None,
    };
    let status = Status {
        time: BoardTime(0),
        axes: [AxisStatus::default(); AXES],
        motion: MotionId(0),
        in_position: true,
        held: false,
        stopped: None,
        emergency: false,
        controller: Session(0),
        scan: ScanState::None,
    };
    pin!(Response:
        Response::Hello(_) => 0, Response::Hello(hello);
        Response::Status(_) => 1, Response::Status(status);
        Response::Moving { .. } => 2, Response::Moving { motion: MotionId(1) };
        Response::Done => 3, Response::Done;
        Response::Axis(_) => 4, Response::Axis(AxisSettings::default());
        Response::Board(_) => 5, Response::Board(BoardSettings::default());
        Response::Scan(_) => 6, Response::Scan(ScanState::None);
        Response::Clock { .. } => 7, Response::Clock { sent: HostTime(0), received: BoardTime(0), answered: BoardTime(0) };
        Response::Swept { .. } => 8, Response::Swept { z: Nanometres(0), state: ScanState::None };
    );
    pin!(Event:
        Event::Position { .. } => 0, Event::Position { time: BoardTime(0), steps: [Steps(0); AXES] };
        Event::InPosition { .. } => 1, Event::InPosition { motion: MotionId(1) };
        Event::Stopped { .. } => 2, Event::Stopped { motion: MotionId(1), cause: StopCause::Asked };
        Event::SampleWanted(_) => 3, Event::SampleWanted(SAMPLE);
        Event::ScanEnded(_) => 4, Event::ScanEnded(REPORT);
        Event::Triggered { .. } => 5, Event::Triggered { index: 0, time: BoardTime(0), position: Nanometres(0) };
        Event::EmergencyInput { .. } => 6, Event::EmergencyInput { pressed: true };
    );
    pin!(FromBoard:
        FromBoard::Reply { .. } => 0, FromBoard::Reply { session: Session(1), sequence: Sequence(1), result: Ok(Response::Done) };
        FromBoard::Event { .. } => 1, FromBoard::Event { count: 0, event: Event::SampleWanted(SAMPLE) };
    );
    pin!(ResetCause:
        ResetCause::Power => 0, ResetCause::Power;
        ResetCause::Pin => 1, ResetCause::Pin;
        ResetCause::Software => 2, ResetCause::Software;
        ResetCause::Watchdog => 3, ResetCause::Watchdog;
        ResetCause::Panic => 4, ResetCause::Panic;
    );
    pin!(StopCause:
        StopCause::Asked => 0, StopCause::Asked;
        StopCause::HostLost => 1, StopCause::HostLost;
        StopCause::ControlTaken => 2, StopCause::ControlTaken;
        StopCause::HardLimit { .. } => 3, StopCause::HardLimit { axis: Axis(0), side: Side::Low };
        StopCause::Emergency => 4, StopCause::Emergency;
        StopCause::Underrun { .. } => 5, StopCause::Underrun { axis: Axis(0) };
        StopCause::Homing { .. } => 6, StopCause::Homing { axis: Axis(0), fault: HomingFault::Stuck };
    );
    pin!(HomingFault:
        HomingFault::Stuck => 0, HomingFault::Stuck;
        HomingFault::Missing => 1, HomingFault::Missing;
        HomingFault::WrongSide => 2, HomingFault::WrongSide;
    );
    pin!(Trust:
        Trust::Unknown => 0, Trust::Unknown;
        Trust::Known => 1, Trust::Known;
        Trust::Restored => 2, Trust::Restored;
        Trust::RestoredRoughly => 3, Trust::RestoredRoughly;
        Trust::Lost => 4, Trust::Lost;
    );
}

#[test]
fn refusals() {
    let axis = Axis(0);
    pin!(Refusal:
        Refusal::NoSession => 0, Refusal::NoSession;
        Refusal::NotInControl { .. } => 1, Refusal::NotInControl { controller: Session(1) };
        Refusal::OldSequence => 2, Refusal::OldSequence;
        Refusal::NoSuchAxis { .. } => 3, Refusal::NoSuchAxis { axis };
        Refusal::BeyondLimit { .. } => 4, Refusal::BeyondLimit { axis, low: Nanometres(0), high: Nanometres(1) };
        Refusal::Busy => 5, Refusal::Busy;
        Refusal::QueueFull => 6, Refusal::QueueFull;
        Refusal::Emergency => 7, Refusal::Emergency;
        Refusal::AtHardLimit { .. } => 8, Refusal::AtHardLimit { axis, side: Side::High };
        Refusal::OutOfRange { .. } => 9, Refusal::OutOfRange { field: Field::Speed, low: 0.0, high: 1.0 };
        Refusal::NoSuchScan { .. } => 10, Refusal::NoSuchScan { current: None };
        Refusal::WrongSample { .. } => 11, Refusal::WrongSample { wanted: 1 };
        Refusal::NotANumber => 12, Refusal::NotANumber;
        Refusal::NoHomeSwitch { .. } => 13, Refusal::NoHomeSwitch { axis };
        Refusal::CannotSave => 14, Refusal::CannotSave;
        Refusal::Unsupported => 15, Refusal::Unsupported;
        Refusal::NoTrigger { .. } => 16, Refusal::NoTrigger { axis };
        Refusal::WrongTime { .. } => 17, Refusal::WrongTime { earliest: BoardTime(1), latest: BoardTime(2) };
    );
    pin!(Field:
        Field::StepsPerUm => 0, Field::StepsPerUm;
        Field::Speed => 1, Field::Speed;
        Field::Acceleration => 2, Field::Acceleration;
        Field::Jerk => 3, Field::Jerk;
        Field::Low => 4, Field::Low;
        Field::High => 5, Field::High;
        Field::Backlash => 6, Field::Backlash;
        Field::Settling => 7, Field::Settling;
        Field::HomeSpeed => 8, Field::HomeSpeed;
        Field::HomeAt => 9, Field::HomeAt;
        Field::HostTimeout => 10, Field::HostTimeout;
        Field::Telemetry => 11, Field::Telemetry;
        Field::SampleStep => 12, Field::SampleStep;
        Field::Trap => 13, Field::Trap;
        Field::Probe => 14, Field::Probe;
        Field::ScanRange => 15, Field::ScanRange;
        Field::SampleTimeout => 16, Field::SampleTimeout;
        Field::Amplitude => 17, Field::Amplitude;
        Field::Frequency => 18, Field::Frequency;
        Field::Cycles => 19, Field::Cycles;
        Field::Trigger => 20, Field::Trigger;
        Field::Microsteps => 21, Field::Microsteps;
    );
}

#[test]
fn scans() {
    pin!(Strategy: Strategy::Climb => 0, Strategy::Climb; Strategy::Mixed => 1, Strategy::Mixed; Strategy::Scan => 2, Strategy::Scan;);
    pin!(Mode: Mode::Step => 0, Mode::Step; Mode::Sweep => 1, Mode::Sweep;);
    pin!(Subject: Subject::Peak => 0, Subject::Peak; Subject::PhaseObject => 1, Subject::PhaseObject;);
    pin!(FrameFault:
        FrameFault::Blank => 0, FrameFault::Blank;
        FrameFault::Saturated => 1, FrameFault::Saturated;
        FrameFault::Stale => 2, FrameFault::Stale;
        FrameFault::NoFrame => 3, FrameFault::NoFrame;
    );
    pin!(Outcome: Outcome::Focused => 0, Outcome::Focused; Outcome::Refused(_) => 1, Outcome::Refused(ScanRefusal::Aborted););
    pin!(ScanRefusal:
        ScanRefusal::NoContrast => 0, ScanRefusal::NoContrast;
        ScanRefusal::Saturated => 1, ScanRefusal::Saturated;
        ScanRefusal::PeakAtEdge => 2, ScanRefusal::PeakAtEdge;
        ScanRefusal::NoSignificantPeak => 3, ScanRefusal::NoSignificantPeak;
        ScanRefusal::TwoPeaks => 4, ScanRefusal::TwoPeaks;
        ScanRefusal::PhaseObject => 5, ScanRefusal::PhaseObject;
        ScanRefusal::LightDrifts => 6, ScanRefusal::LightDrifts;
        ScanRefusal::SamplesStopped => 7, ScanRefusal::SamplesStopped;
        ScanRefusal::StaleFrames => 8, ScanRefusal::StaleFrames;
        ScanRefusal::Aborted => 9, ScanRefusal::Aborted;
        ScanRefusal::MotionStopped => 10, ScanRefusal::MotionStopped;
        ScanRefusal::NotReproduced => 11, ScanRefusal::NotReproduced;
    );
    pin!(ScanState:
        ScanState::None => 0, ScanState::None;
        ScanState::Moving(_) => 1, ScanState::Moving(ScanId(1));
        ScanState::Waiting(_) => 2, ScanState::Waiting(SAMPLE);
        ScanState::Sweeping(_) => 3, ScanState::Sweeping(ScanId(1));
        ScanState::Ended(_) => 4, ScanState::Ended(REPORT);
    );
}

#[test]
fn settings() {
    pin!(Driver: Driver::A4988 => 0, Driver::A4988; Driver::Drv8825 => 1, Driver::Drv8825; Driver::Tmc2209 => 2, Driver::Tmc2209; Driver::External => 3, Driver::External;);
    pin!(Edges: Edges::Rising => 0, Edges::Rising; Edges::Both => 1, Edges::Both;);
    pin!(Side: Side::Low => 0, Side::Low; Side::High => 1, Side::High;);
    pin!(Polarity: Polarity::PressedHigh => 0, Polarity::PressedHigh; Polarity::PressedLow => 1, Polarity::PressedLow;);
}

#[test]
fn a_whole_frame() {
    let hello = ToBoard {
        session: Session(0x01020304),
        sequence: Sequence(1),
        request: Request::Hello { role: Role::Control },
    };
    let mut frame = [0; parfocal_protocol::frame::MAX_FRAME];
    let n = parfocal_protocol::frame::encode(&hello, &mut frame).unwrap();
    assert_eq!(VERSION, 1, "raised: pin the new frame below");
    // Code byte, version, session and sequence as varints, request 0, code byte in its place, role 1, CRC-32C, end.
    assert_eq!(frame[..n], [7, 1, 0x84, 0x86, 0x88, 0x08, 1, 6, 1, 188, 136, 64, 234, 0]);
}
