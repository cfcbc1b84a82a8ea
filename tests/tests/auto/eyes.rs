//! Eyes that know the truth, but for noise and for what is made to go wrong; and a rig with a real rig's faults.

use crate::world::{Eye, Noise, TruthFocuser, World};
use parfocal::autonomous::{AutoError, Calibrated, Eyes, Plan, Work, calibrate};
use parfocal::frames::camera::{Camera, CameraError, Frame};
use parfocal::picture::Picture;
use parfocal::procedure::{Found, FramePixel, Progress, Witness};
use parfocal::rig::{ManipulatorNumber, Rig};
use parfocal_protocol::settings::Side;
use parfocal_protocol::units::{HostTime, Nanometres};
use parfocal_simulator::model::RigModel;

/// A tip is seen this far from focus, µm.
const BLURRED_UM: f64 = 10.0;

/// What goes wrong.
#[derive(Clone, Debug, Default)]
pub struct Wrongs {
    /// Share of detections that are somewhere else.
    pub astray: f64,
    /// Pipettes (from 0) that are not there.
    pub missing: Vec<usize>,
    /// The light goes out after so many frames.
    pub dark_after: Option<usize>,
    /// What looks more like a tip than the tips do, stays in the picture wherever the microscope goes, and cannot be focused, px.
    pub stray_tip: Option<[f64; 2]>,
    /// The pipette (from 0) that breaks off after so many frames.
    pub breaks: Option<(usize, usize)>,
    /// The pipette (from 0) that has a second tip, so far beside it, px.
    pub second_tip: Option<(usize, [f64; 2])>,
    /// The focus is refused one time in so many; 0: never.
    pub refuses: u32,
    /// The person stops the run after so many frames.
    pub stop_after: Option<usize>,
}

/// Sees every tip that is in the picture and not too far from focus.
pub struct TruthEyes {
    world: World,
    noise: Noise,
    wrongs: Wrongs,
    /// Frames looked at.
    pub frames: usize,
    /// Lowest that any tip was in a frame, µm.
    pub lowest_um: f64,
}

impl TruthEyes {
    pub fn new(world: &World, seed: u64, wrongs: &Wrongs) -> Self {
        Self {
            world: world.clone(),
            noise: Noise::new(seed ^ 0xe7e5),
            wrongs: wrongs.clone(),
            frames: 0,
            lowest_um: f64::MAX,
        }
    }
}

impl Eyes for TruthEyes {
    fn tips(&mut self, frame: &Frame) -> Vec<Found> {
        self.frames += 1;
        if frame.picture.view().get(0, 0).is_some_and(|grey| grey < 10) {
            return Vec::new();
        }
        let (begin, end) = frame.exposure.unwrap();
        let at = (begin.0 + end.0) / 2;
        let (pipettes, view) = {
            let rig = self.world.lock();
            (rig.pipettes(at), rig.viewpoint(at))
        };
        self.lowest_um = pipettes.iter().map(|p| p.tip_um[2]).fold(self.lowest_um, f64::min);
        let (w, h) = (view.width as f64, view.height as f64);
        let mut tips: Vec<(f64, f64, f64, f64)> = Vec::new();
        for (i, p) in pipettes.iter().enumerate() {
            let [x, y] = view.picture_px([p.tip_um[0], p.tip_um[1]]).unwrap();
            let (sin, cos) = p.azimuth_rad.sin_cos();
            let [x1, y1] = view.picture_px([p.tip_um[0] + cos, p.tip_um[1] + sin]).unwrap();
            let inside = x > 6.0 && x < w - 7.0 && y > 6.0 && y < h - 7.0;
            let sharp = (p.tip_um[2] - view.focus_um).abs() <= BLURRED_UM;
            let broken = self.wrongs.breaks.is_some_and(|(n, after)| n == i && self.frames > after);
            if inside && sharp && !broken && !self.wrongs.missing.contains(&i) {
                let angle = (y1 - y).atan2(x1 - x).to_degrees();
                tips.push((x, y, angle, 0.9));
                let second = self.wrongs.second_tip.filter(|(n, _)| *n == i);
                tips.extend(second.map(|(_, [dx, dy])| (x + dx, y + dy, angle, 0.9)));
            }
        }
        if let Some([x, y]) = self.wrongs.stray_tip {
            tips.push((x, y, 45.0, 0.95));
        }
        let mut see = |(x, y, angle, confidence): (f64, f64, f64, f64)| {
            let mut normal = || self.noise.normal();
            let mut at = FramePixel { x_px: x + 0.3 * normal(), y_px: y + 0.3 * normal() };
            let angle = angle + normal();
            if self.noise.uniform() < self.wrongs.astray {
                at = FramePixel { x_px: self.noise.uniform() * w, y_px: self.noise.uniform() * h };
            }
            Found { at, confidence, angle_deg: Some(angle), by: Witness::Detector }
        };
        tips.into_iter().map(&mut see).collect()
    }
}

/// A camera whose frames are grey until the light goes out.
pub struct Lamp {
    eye: Eye,
    frames: usize,
    dark_after: Option<usize>,
}

impl Camera for Lamp {
    fn name(&self) -> String {
        self.eye.name()
    }

    fn next_frame(&mut self, deadline: HostTime) -> Result<Option<Frame>, CameraError> {
        let frame = self.eye.next_frame(deadline)?;
        self.frames += 1;
        let lit = self.dark_after.is_none_or(|n| self.frames <= n);
        Ok(frame.map(|frame| {
            let (w, h) = (frame.picture.width, frame.picture.height);
            let picture = Picture::grey8(w, h, vec![if lit { 120 } else { 1 }; w * h]).unwrap();
            Frame { picture: picture.into(), ..frame }
        }))
    }
}

/// Two manipulators with axes 59.7° apart, 3 % scale error, and 3 µm of backlash that the boards take up.
pub fn faulty(seed: u64) -> RigModel {
    let mut model = RigModel::new(seed);
    for board in &mut model.boards {
        for axis in &mut board.axes {
            axis.stage.backlash_um = 3.0;
            axis.settings.backlash = Nanometres(3000);
            axis.settings.approach = Some(Side::Low);
        }
    }
    for (manipulator, scale) in model.manipulators.iter_mut().zip([1.03, 0.97]) {
        for row in &mut manipulator.joints {
            row.iter_mut().for_each(|v| *v *= scale);
        }
    }
    model
}

/// A run that has ended.
#[derive(Debug)]
pub struct Ran<T = Calibrated> {
    pub result: Result<T, AutoError>,
    pub frames: usize,
    /// Every warning and every place passed over.
    pub said: Vec<String>,
    /// Times that the rig was saved.
    pub saves: usize,
    /// Lowest that any tip was, µm.
    pub lowest_um: f64,
}

/// Calibrates everything.
pub fn run(world: &World, rig: &mut Rig, seed: u64, wrongs: &Wrongs, plan: &Plan) -> Ran {
    let date = || "2026-11-25T00:00:00Z".to_owned();
    let mut saves = 0;
    let ran = work(world, seed, wrongs, &mut |work| {
        calibrate(work, rig, plan, &date, &mut |_| {
            saves += 1;
            Ok(())
        })
    });
    Ran { saves, ..ran }
}

/// Does something with eyes that know the truth.
pub fn work<T>(
    world: &World,
    seed: u64,
    wrongs: &Wrongs,
    what: &mut dyn FnMut(&mut Work<'_>) -> Result<T, AutoError>,
) -> Ran<T> {
    let mut stage = world.stage();
    let mut camera = Lamp { eye: world.camera(), frames: 0, dark_after: wrongs.dark_after };
    let mut focuser = TruthFocuser { refuses: wrongs.refuses, ..TruthFocuser::new(world, seed) };
    let mut eyes = TruthEyes::new(world, seed, wrongs);
    let mut said = Vec::new();
    let looked = std::cell::Cell::new(0);
    let keep_on = || {
        looked.set(looked.get() + 1);
        wrongs.stop_after.is_none_or(|n| looked.get() <= n)
    };
    let mut progress = |progress: Progress| {
        if let Progress::Passed(text) | Progress::Warning(text) = progress {
            said.push(text);
        }
    };
    let result = what(&mut Work {
        stage: &mut stage,
        camera: &mut camera,
        focuser: &mut focuser,
        eyes: &mut eyes,
        keep_on: &keep_on,
        progress: &mut progress,
        turret: None,
    });
    stage.close();
    let (frames, lowest_um) = (eyes.frames, eyes.lowest_um);
    Ran { result, frames, said, saves: 0, lowest_um }
}

/// Both manipulators.
pub fn both() -> Vec<ManipulatorNumber> {
    [1, 2].into_iter().filter_map(ManipulatorNumber::new).collect()
}
