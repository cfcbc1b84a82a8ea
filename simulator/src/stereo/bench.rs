//! The virtual rig's printed markers, and where a person holds the stereo camera over it.
//!
//! World: the substrate marker's frame, mm, its z into the table. Ref has its z upwards; y is turned with it.

use super::{Lens, Pose};
use crate::rig::Rig;
use parfocal_protocol::units::Axis;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Outer edge of the markers' black border, mm.
pub const TAG_MM: f64 = 20.0;
/// The substrate's marker; manipulator n (from 0) carries n + 1, the objective the next one.
pub const SUBSTRATE: u16 = 0;
/// The substrate's marker in ref, mm.
const SUBSTRATE_AT_MM: [f64; 3] = [0.0, -20.0, -2.0];
/// From a tip back along its pipette to the marker on its holder, mm.
const HOLDER_MM: f64 = 65.0;
/// The objective's marker from the focal point, mm in ref.
const OBJECTIVE_AT_MM: [f64; 3] = [4.0, 35.0, 40.0];

/// Two cameras held rigidly, as the virtual one is built.
#[derive(Clone, Copy, Debug)]
pub struct Pair {
    /// Left and right lens.
    pub lenses: [Lens; 2],
    /// Left camera's frame to right camera's frame, mm.
    pub left_to_right: Pose,
    /// Columns and rows.
    pub size: (usize, usize),
}

impl Pair {
    /// 1280x960 pixels, 62 mm apart, turned to each other by 7°.
    pub fn new() -> Self {
        let lens = |f: [f64; 2], c: [f64; 2], distortion| Lens { fx: f[0], fy: f[1], cx: c[0], cy: c[1], distortion };
        let (sin, cos) = 0.12f64.sin_cos();
        let rotation = [[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]];
        let turn = Pose { rotation, translation: [0.0; 3] };
        let translation = turn.map([62.0, 1.0, -2.0]).map(|v| -v);
        Self {
            lenses: [
                lens([1105.0, 1103.0], [652.0, 471.0], [-0.11, 0.06, 6e-4, -4e-4]),
                lens([1098.0, 1099.0], [630.0, 488.0], [-0.10, 0.05, -3e-4, 5e-4]),
            ],
            left_to_right: Pose { rotation, translation },
            size: (1280, 960),
        }
    }
}

impl Default for Pair {
    fn default() -> Self {
        Self::new()
    }
}

/// World to left camera from the places where a person puts it down, a little elsewhere with every seed.
pub fn places(seed: u64) -> Vec<Pose> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut around = |mm: f64| mm * (2.0 * random.random::<f64>() - 1.0);
    let mut place = |x: f64, y: f64, z: f64| {
        let from = [x + around(15.0), y + around(15.0), z + around(15.0)];
        // The left camera looks to the left of the middle, so that the right one sees as much on its own left.
        looking(from, [-25.0, -15.0, -15.0])
    };
    vec![place(-110.0, 110.0, -255.0), place(90.0, 140.0, -250.0)]
}

/// A camera at `from` that looks at `at`, its x to the right as seen from above.
fn looking(from: [f64; 3], at: [f64; 3]) -> Pose {
    let z = unit(std::array::from_fn(|k| at[k] - from[k]));
    let y = unit(cross(z, [1.0, 0.1, 0.0]));
    let rotation = [cross(y, z), y, z];
    Pose { rotation, translation: Pose { rotation, translation: [0.0; 3] }.map(from).map(|v| -v) }
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    v.map(|x| x / length)
}

/// A place of ref, µm, in the world, mm.
pub fn from_ref(um: [f64; 3]) -> [f64; 3] {
    let mm: [f64; 3] = std::array::from_fn(|k| um[k] / 1000.0 - SUBSTRATE_AT_MM[k]);
    [mm[0], -mm[1], -mm[2]]
}

/// All markers where the rig's bodies hold them now: number, and marker to world.
pub fn markers(rig: &Rig) -> Vec<(u16, Pose)> {
    let here = |board| [0, 1, 2].map(|axis| rig.truth(board, Axis(axis), rig.now()).0);
    let mut all = vec![(SUBSTRATE, tilted([0.0; 3], [1.0, 0.0, 0.0], 0.0))];
    for (n, manipulator) in rig.model().manipulators.iter().enumerate() {
        let (tip, away) = (manipulator.tip(here(n + 1)), 1000.0 * HOLDER_MM);
        let (across, down) = (manipulator.descent_rad.cos(), manipulator.descent_rad.sin());
        let along = [across * manipulator.azimuth_rad.cos(), across * manipulator.azimuth_rad.sin(), -down];
        let at = from_ref(std::array::from_fn(|k| tip[k] - away * along[k]));
        // Turned up towards the middle, where the camera will be.
        let side = if manipulator.azimuth_rad.cos() > 0.0 { 1.0 } else { -1.0 };
        all.push((n as u16 + 1, tilted(at, [0.15, 1.0, 0.1 * side], side * 20.0)));
    }
    let focus: [f64; 3] = here(0);
    let at = from_ref(std::array::from_fn(|k| focus[k] + 1000.0 * OBJECTIVE_AT_MM[k]));
    all.push((all.len() as u16, tilted(at, [1.0, 0.1, 0.1], 30.0)));
    all
}

/// A marker there, turned about an axis from lying flat (Rodrigues 1840).
fn tilted(translation: [f64; 3], axis: [f64; 3], degrees: f64) -> Pose {
    let (a, (s, c)) = (unit(axis), degrees.to_radians().sin_cos());
    let skew = [[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]];
    let rotation = std::array::from_fn(|i| {
        std::array::from_fn(|j| f64::from(u8::from(i == j)) * c + (1.0 - c) * a[i] * a[j] + s * skew[i][j])
    });
    Pose { rotation, translation }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::RigModel;

    #[test]
    fn poses_are_rotations_and_every_marker_is_in_both_pictures() {
        let rig = Rig::new(RigModel::new(3));
        let pair = Pair::new();
        for place in places(3) {
            for (id, marker) in markers(&rig) {
                for (side, lens) in pair.lenses.iter().enumerate() {
                    let to_camera = if side == 0 { place } else { pair.left_to_right.after(&place) };
                    let whole = to_camera.after(&marker);
                    let r = whole.rotation;
                    let determinant: f64 = (0..3).map(|k| cross(r[0], r[1])[k] * r[2][k]).sum();
                    assert!((determinant - 1.0).abs() < 1e-9);
                    let p = whole.translation;
                    let [x, y] = lens.pixel([p[0] / p[2], p[1] / p[2]]);
                    let inside = x > 60.0 && y > 60.0 && x < 1220.0 && y < 900.0;
                    assert!(p[2] > 150.0 && inside, "marker {id}: {x:.0} {y:.0} at {p:.0?}");
                }
            }
        }
    }
}
