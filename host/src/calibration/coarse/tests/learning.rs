//! From markers to tips: what was learned holds when everything has moved on.

use super::scene::{BTreeMap, pose};
use super::*;
use crate::calibration::coarse::graph::MarkerPose;
use crate::calibration::coarse::learn::fine::{self, Fine, Objective};
use crate::calibration::coarse::learn::moves::{self, Stop};
use crate::calibration::coarse::learn::{LearnError, Learned, ManipulatorMarker, Now, place};
use nalgebra::{Isometry3, Matrix3, Point3, Translation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// A manipulator with oblique joints, its marker and pipette, in ref, mm.
struct Arm {
    fine: Fine,
    /// Marker to ref with all joints at 0.
    marker: Isometry3<f64>,
    /// Substrate marker to ref.
    to_ref: Isometry3<f64>,
    random: Pcg64Mcg,
}

impl Arm {
    fn new(seed: u64) -> Self {
        let axes = Matrix3::new(0.9, 0.1, -0.5, -0.2, 1.0, 0.05, -0.45, 0.02, 0.88);
        let pipette = Some([Degrees(31.0), Degrees(-12.0)]);
        Self {
            fine: Fine { axes, origin_um: Vector3::new(900.0, -400.0, 1500.0), pipette },
            marker: pose(-60.0, 12.0, 35.0, [0.8, 0.5, 0.1], 160.0),
            to_ref: pose(7.0, -3.0, -1.0, [1.0, 0.02, 0.05], 178.0),
            random: Pcg64Mcg::seed_from_u64(seed),
        }
    }

    fn around(&mut self, range: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| range * (2.0 * self.random.random::<f64>() - 1.0))
    }

    /// The marker as photographed: marker to substrate marker, 0.05 mm and 0.1° off.
    fn seen(&mut self, joints_um: Vector3<f64>) -> Isometry3<f64> {
        let moved = Translation3::from(self.fine.axes * joints_um / 1000.0) * self.marker;
        self.blurred(&(self.to_ref.inverse() * moved))
    }

    fn blurred(&mut self, pose: &Isometry3<f64>) -> Isometry3<f64> {
        let (shift, turn) = (self.around(0.05), self.around(0.001));
        super::super::fit::nudge(pose, &nalgebra::Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z))
    }

    fn tip_ref_mm(&self, joints_um: Vector3<f64>) -> Point3<f64> {
        Point3::from((self.fine.axes * joints_um + self.fine.origin_um) / 1000.0)
    }

    fn stop(&mut self, joints_um: Vector3<f64>, click: bool) -> Stop {
        let marker = self.seen(joints_um);
        let tip = self.to_ref.inverse() * self.tip_ref_mm(joints_um);
        let ((st, ct), (sp, cp)) = (31f64.to_radians().sin_cos(), (-12f64).to_radians().sin_cos());
        let along = self.to_ref.rotation.inverse() * Vector3::new(ct * cp, ct * sp, -st);
        let (a, b) = (self.around(0.1), self.around(0.1));
        Stop { joints_um, marker, tip_mm: click.then(|| tip + a), shank_mm: click.then(|| tip - along * 35.0 + b) }
    }

    fn moves(&mut self) -> Vec<Stop> {
        let mut stops = vec![self.stop(Vector3::zeros(), true)];
        for k in 0..3 {
            let joints = Vector3::from_fn(|i, _| if i == k { 12_000.0 } else { 0.0 });
            stops.push(self.stop(joints, false));
        }
        stops
    }

    /// Pictures of another day: substrate moved by hand, joints and microscope elsewhere.
    fn another_day(&mut self, joints_um: Vector3<f64>, objective: Option<Isometry3<f64>>) -> Registration {
        let marker = self.seen(joints_um);
        let ids = [(MarkerId(1), Some(marker)), (MarkerId(3), objective)];
        let good = |pose| MarkerPose { pose, position: Millimetres(0.05), orientation: Degrees(0.1) };
        let markers = ids.into_iter().filter_map(|(id, pose)| Some((id, good(pose?)))).collect();
        Registration { substrate: MarkerId(0), markers, places: BTreeMap::new(), rejected: vec![], unconnected: vec![] }
    }
}

fn joints(x: f64, y: f64, z: f64) -> Vector3<f64> {
    Vector3::new(x, y, z)
}

#[test]
fn a_fine_calibration_is_carried_on_by_the_markers() {
    for seed in 0..5 {
        let mut arm = Arm::new(seed);
        // The focal point is ref's origin plus P_M; its marker hangs 60 mm beside.
        let mic_to_marker = pose(10.0, 58.0, -30.0, [1.0, 0.3, 0.2], 140.0);
        let objective_at = |arm: &mut Arm, p_m: Vector3<f64>| {
            let exact = arm.to_ref.inverse() * Translation3::from(p_m / 1000.0) * mic_to_marker.inverse();
            arm.blurred(&exact)
        };
        let p_m = joints(100.0, -200.0, 300.0);
        let seen = objective_at(&mut arm, p_m);
        let good = MarkerPose { pose: seen, position: Millimetres(0.05), orientation: Degrees(0.1) };
        let objective = Objective { marker: MarkerId(3), pose: good, microscope_um: p_m };
        let stops = arm.moves();
        let all = BTreeMap::from([(MarkerId(1), (arm.fine, stops))]);
        let learned = fine::learn(&all, Some(&objective)).unwrap();
        let learned: Learned = serde_json::from_str(&serde_json::to_string(&learned).unwrap()).unwrap();

        arm.to_ref = pose(-20.0, 14.0, -2.0, [1.0, 0.01, -0.2], 181.0);
        let (p_m, at) = (joints(-900.0, 400.0, 1200.0), joints(3000.0, -1500.0, 800.0));
        let seen = objective_at(&mut arm, p_m);
        let found = arm.another_day(at, Some(seen));
        let now = Now { microscope_um: p_m, joints_um: BTreeMap::from([(MarkerId(1), at)]) };
        let coarse = place(&found, &learned, &now).unwrap()[&MarkerId(1)];
        let tip = Point3::from(coarse.tip_um.unwrap()) / 1000.0;
        let off = (tip - arm.tip_ref_mm(at)).norm();
        assert!(off < 1.0, "seed {seed}: {off} mm");
        assert!(
            (coarse.theta.unwrap().0 - 31.0).abs() < 0.5 && (coarse.psi.unwrap().0 + 12.0).abs() < 0.7,
            "{coarse:?}"
        );
        for j in 0..3 {
            for i in 0..3 {
                assert!((coarse.man_to_ref_um[i][j] - arm.fine.axes[(i, j)]).abs() < 0.02, "{coarse:?}");
            }
        }
    }
}

#[test]
fn three_moves_and_clicks_do_without_a_fine_calibration() {
    for seed in 10..15 {
        let mut arm = Arm::new(seed);
        // The substrate's marker flat on the table: its z down, ref's up.
        arm.to_ref = pose(0.0, 0.0, 0.0, [1.0, 0.0, 0.0], 180.0);
        let stops = arm.moves();
        let marker = moves::learn(MarkerId(1), &stops).unwrap();
        let learned = Learned { manipulators: BTreeMap::from([(MarkerId(1), marker)]), ..Learned::default() };
        let at = joints(-2000.0, 500.0, 4000.0);
        let found = arm.another_day(at, None);
        let now = Now { joints_um: BTreeMap::from([(MarkerId(1), at)]), ..Now::default() };
        let coarse = place(&found, &learned, &now).unwrap()[&MarkerId(1)];
        let off = (Point3::from(coarse.tip_um.unwrap()) / 1000.0 - arm.tip_ref_mm(at)).norm();
        assert!(off < 0.6, "seed {seed}: {off} mm");
        assert!((coarse.theta.unwrap().0 - 31.0).abs() < 0.5, "seed {seed}: {coarse:?}");
    }
}

#[test]
fn what_was_learned_without_clicks_comes_back_from_a_rigs_file() {
    let mut arm = Arm::new(3);
    let marker = ManipulatorMarker { tip_mm: None, pipette: None, ..moves::learn(MarkerId(1), &arm.moves()).unwrap() };
    let learned = Learned { manipulators: BTreeMap::from([(MarkerId(1), marker)]), ..Learned::default() };
    let text = toml::to_string(&learned).unwrap();
    assert_eq!(toml::from_str::<Learned>(&text).unwrap(), learned, "{text}");
}

#[test]
fn moves_that_do_not_span_space_are_refused() {
    let mut arm = Arm::new(3);
    let mut stops = arm.moves();
    stops.truncate(3);
    assert_eq!(moves::learn(MarkerId(1), &stops), Err(LearnError::Moves { marker: MarkerId(1) }));
    let mut stops = arm.moves();
    stops[2].joints_um = joints(0.0, 12.0, 0.0);
    assert_eq!(moves::learn(MarkerId(1), &stops), Err(LearnError::Moves { marker: MarkerId(1) }));
}

#[test]
fn a_fine_calibration_of_another_day_is_refused() {
    let mut arm = Arm::new(4);
    let mut stops = arm.moves();
    stops.push(arm.stop(joints(9000.0, 9000.0, 0.0), true));
    arm.fine.axes *= 1.5;
    let all = BTreeMap::from([(MarkerId(1), (arm.fine, stops))]);
    assert!(matches!(fine::learn(&all, None), Err(LearnError::Contradiction { .. })));
}
