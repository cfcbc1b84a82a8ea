//! What a virtual rig is made of: boards with their axes, stages with their faults, camera, manipulators, scene.

use crate::camera::CameraTiming;
use crate::mechanics::Stage;
use crate::scene::Optics;
use parfocal_protocol::settings::{AxisSettings, Side};
use parfocal_protocol::units::{
    AXES, Axis, Micrometres, MicrometresPerSecond, MicrometresPerSecond2, MicrometresPerSecond3, Milliseconds,
    Nanometres, StepsPerMicrometre,
};

/// One axis of a virtual board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisModel {
    /// The board's settings of it.
    pub settings: AxisSettings,
    /// What hangs on its motor.
    pub stage: Stage,
    /// Where it is when the rig is switched on.
    pub at: Micrometres,
}

/// A virtual controller board.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardModel {
    /// Its axes, at most four.
    pub axes: Vec<AxisModel>,
    /// How fast its clock runs against the rig's, parts per million.
    pub clock_ppm: f64,
    /// What its clock showed when the rig's showed 0, µs.
    pub clock_offset_us: u64,
}

/// How a manipulator is mounted and what it holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ManipulatorModel {
    /// Columns: where a µm of each joint moves the tip in ref. Not orthogonal on real manipulators.
    pub joints: [[f64; 3]; 3],
    /// Where the tip is in ref when all joints are at 0, µm.
    pub origin_um: [f64; 3],
    /// Direction of the pipette seen from above, rad.
    pub azimuth_rad: f64,
    /// Its descent to the tip, rad.
    pub descent_rad: f64,
}

impl ManipulatorModel {
    /// The tip in ref with the joints at `joints_um`.
    pub fn tip(&self, joints_um: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|row| {
            self.origin_um[row] + (0..3).map(|joint| self.joints[row][joint] * joints_um[joint]).sum::<f64>()
        })
    }
}

/// The camera's sensor and what lies between it and the sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraModel {
    /// When frames come.
    pub timing: CameraTiming,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// From picture to microscope, µm/px, row after row (A of the calibration).
    pub matrix_um_per_px: [[f64; 2]; 2],
    /// Standard deviation of the shot noise, as a share of the background.
    pub shot_noise: f64,
    /// Standard deviation of the read noise, as a share of full scale.
    pub read_noise: f64,
}

/// An objective on the virtual turret.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObjectiveModel {
    /// What is engraved on it.
    pub name: &'static str,
    /// Size of its pixel in pixels of the first objective (α of the calibration).
    pub alpha: f64,
    /// Where it looks, from where the first one does, µm (κ).
    pub kappa_um: [f64; 3],
    /// How it blurs.
    pub optics: Optics,
    /// Its depth of field, µm.
    pub depth_of_field_um: f64,
}

impl ObjectiveModel {
    /// A weak one, to find lost tips with; a model has it when it is added.
    pub const SEARCHER: Self = Self {
        name: "4x",
        alpha: 10.06,
        kappa_um: [-35.0, 22.0, 12.0],
        optics: Optics::DRY_4X,
        depth_of_field_um: 55.0,
    };
}

/// A whole virtual rig. Board 0 is the microscope (x, y, z move the objective), board n manipulator n.
#[derive(Clone, Debug, PartialEq)]
pub struct RigModel {
    /// Seed of everything random.
    pub seed: u64,
    /// The boards.
    pub boards: Vec<BoardModel>,
    /// The manipulators.
    pub manipulators: Vec<ManipulatorModel>,
    /// The camera, its matrix as the first objective sees it.
    pub camera: CameraModel,
    /// The turret; the first objective is in the light path at the start.
    pub objectives: Vec<ObjectiveModel>,
    /// Time that bytes take between host and board, µs.
    pub link_us: u64,
}

/// Settings of the virtual microscope's focus: 0.01 µm a step.
fn fine(low_um: i32, high_um: i32) -> AxisSettings {
    AxisSettings {
        steps_per_um: StepsPerMicrometre(100.0),
        speed: MicrometresPerSecond(1000.0),
        acceleration: MicrometresPerSecond2(20_000.0),
        jerk: MicrometresPerSecond3(2_000_000.0),
        low: Nanometres(low_um * 1000),
        high: Nanometres(high_um * 1000),
        settling: Milliseconds(15),
        home: Some(Side::Low),
        home_at: Nanometres(low_um * 1000 - BEYOND_NM),
        has_switches: true,
        ..AxisSettings::default()
    }
}

/// Limit switches lie so far beyond the soft limits.
pub const BEYOND_NM: i32 = 50_000;

/// Settings of the virtual x and y axes and of the manipulators: 1/16 µm a step.
fn coarse() -> AxisSettings {
    AxisSettings {
        steps_per_um: StepsPerMicrometre(16.0),
        speed: MicrometresPerSecond(2000.0),
        acceleration: MicrometresPerSecond2(20_000.0),
        low: Nanometres(-10_000_000),
        high: Nanometres(10_000_000),
        home_speed: MicrometresPerSecond(2000.0),
        home_at: Nanometres(-10_000_000 - BEYOND_NM),
        ..fine(0, 0)
    }
}

impl RigModel {
    /// The rig that `parfocal` works on without a port: a microscope with a 40x and a 20x objective, a camera, and two manipulators
    /// whose axes are as oblique as a real pair's (59.7°, `data/acq4_manipulator_points` in docs/data.md).
    pub fn new(seed: u64) -> Self {
        let stage = Stage { backlash_um: 0.0, lag_ms: 2.0 };
        let still = |settings, at| AxisModel { settings, stage, at: Micrometres(at) };
        let board = |axes: Vec<AxisModel>, i: u64| BoardModel {
            axes,
            clock_ppm: 12.0 - 9.0 * i as f64,
            clock_offset_us: 1_000_000 * (i + 1),
        };
        let scope = vec![still(coarse(), 0.0), still(coarse(), 0.0), still(fine(-200, 200), 40.0)];
        let manipulator = || vec![still(coarse(), 0.0), still(coarse(), 0.0), still(coarse(), 0.0)];
        // The approach axis descends along the pipette, 59.7° from the vertical one, and reaches from its own side.
        let descent = 30.3f64.to_radians();
        let oblique = |azimuth: f64, tip: [f64; 3]| ManipulatorModel {
            joints: [
                [descent.cos() * azimuth.cos(), -azimuth.sin(), 0.0],
                [descent.cos() * azimuth.sin(), azimuth.cos(), 0.0],
                [-descent.sin(), 0.0, 1.0],
            ],
            origin_um: tip,
            azimuth_rad: azimuth,
            descent_rad: descent,
        };
        Self {
            seed,
            boards: vec![board(scope, 0), board(manipulator(), 1), board(manipulator(), 2)],
            manipulators: vec![oblique(0.2, [-12.0, 4.0, 0.0]), oblique(std::f64::consts::PI - 0.3, [38.0, 14.0, 6.0])],
            camera: CameraModel {
                timing: CameraTiming::default(),
                width: 640,
                height: 480,
                matrix_um_per_px: [[0.3229, 0.0056], [0.0056, -0.3241]],
                shot_noise: 0.01,
                read_noise: 0.001,
            },
            objectives: vec![
                ObjectiveModel {
                    name: "40x",
                    alpha: 1.0,
                    kappa_um: [0.0; 3],
                    optics: Optics::WATER_40X,
                    depth_of_field_um: 1.0,
                },
                ObjectiveModel {
                    name: "20x",
                    alpha: 2.013,
                    kappa_um: [7.4, -4.2, 3.1],
                    optics: Optics::DRY_20X,
                    depth_of_field_um: 2.6,
                },
            ],
            link_us: 300,
        }
    }

    /// Soft limits of one axis.
    pub fn set_limits(&mut self, board: usize, axis: Axis, low: Micrometres, high: Micrometres) {
        if let Some(axis) = self.axis(board, axis)
            && let (Some(low), Some(high)) = (low.nanometres(), high.nanometres())
        {
            (axis.settings.low, axis.settings.high) = (low, high);
            axis.settings.home_at = Nanometres(low.0.saturating_sub(BEYOND_NM));
        }
    }

    /// Where one axis is when the rig is switched on.
    pub fn set_position(&mut self, board: usize, axis: Axis, at: Micrometres) {
        if let Some(axis) = self.axis(board, axis) {
            axis.at = at;
        }
    }

    fn axis(&mut self, board: usize, axis: Axis) -> Option<&mut AxisModel> {
        self.boards.get_mut(board)?.axes.get_mut(axis.index().filter(|i| *i < AXES)?)
    }
}
