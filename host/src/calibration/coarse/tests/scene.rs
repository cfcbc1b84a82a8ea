//! A rig as a stereo camera sees it: the substrate's marker 0 flat on the table, markers 1 and 2 on manipulators, 3 on the objective.

use super::super::edges::Grey;
use super::super::marker::{CELLS, cells};
use super::super::*;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use parfocal_simulator::stereo::{self, Camera, Finish, Occluder, Pose, Print, Scene};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// What stands where, and how it is photographed.
pub struct Rig {
    pub seed: u64,
    pub size_mm: f64,
    /// Marker to substrate marker.
    pub truth: BTreeMap<MarkerId, Isometry3<f64>>,
    /// Substrate marker to left camera.
    pub places: Vec<Isometry3<f64>>,
    pub camera: StereoCamera,
    pub finish: Finish,
    /// Dark discs, in the substrate's frame, at each place.
    pub occluders: Vec<(Place, Occluder)>,
    /// Poses that differ at one place; none for a marker that is hidden there.
    pub otherwise: BTreeMap<(Place, MarkerId), Option<Isometry3<f64>>>,
    /// More prints of a marker already there.
    pub doubles: Vec<(MarkerId, Isometry3<f64>)>,
    pub mirrored: Option<MarkerId>,
}

pub use std::collections::BTreeMap;

pub fn pose(x: f64, y: f64, z: f64, axis: [f64; 3], degrees: f64) -> Isometry3<f64> {
    let axis = nalgebra::Unit::new_normalize(Vector3::from(axis));
    Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_axis_angle(&axis, degrees.to_radians()))
}

/// A camera at `from`, looking at a point near the substrate, turned about the line of sight.
pub fn looking(from: [f64; 3], at: [f64; 3], roll_degrees: f64) -> Isometry3<f64> {
    let (from, at) = (Vector3::from(from), Vector3::from(at));
    let z = (at - from).normalize();
    let x = Vector3::new(1.0, 0.1, 0.0).cross(&z).cross(&z).normalize();
    let x = if x.x < 0.0 { -x } else { x };
    let to_world = Matrix3::from_columns(&[x, z.cross(&x), z]);
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(to_world));
    let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll_degrees.to_radians());
    Isometry3::from_parts(Translation3::from(from), turn * roll).inverse()
}

pub fn stereo_camera() -> StereoCamera {
    let turn = Rotation3::from_euler_angles(0.002, -0.12, 0.004);
    let centre = Vector3::new(62.0, 1.0, -2.0);
    let t = -(turn * centre) / 1000.0;
    let r: Vec<Vec<f64>> = (0..3).map(|i| (0..3).map(|j| turn[(i, j)]).collect()).collect();
    let file = serde_json::json!({
        "image_size": [1280, 960],
        "left": {"fx": 1105.0, "fy": 1103.0, "cx": 652.0, "cy": 471.0, "k1": -0.11, "k2": 0.06, "p1": 0.0006, "p2": -0.0004},
        "right": {"fx": 1098.0, "fy": 1099.0, "cx": 630.0, "cy": 488.0, "k1": -0.10, "k2": 0.05, "p1": -0.0003, "p2": 0.0005},
        "R": r, "t_m": [t.x, t.y, t.z],
    });
    StereoCamera::from_json(&file.to_string()).unwrap()
}

impl Rig {
    /// A rig whose bodies and two camera places differ a little with the seed.
    pub fn new(seed: u64) -> Self {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut around = |range: f64| range * (2.0 * random.random::<f64>() - 1.0);
        let mut truth = BTreeMap::from([(MarkerId(0), Isometry3::identity())]);
        for (id, x, y, z, axis, degrees) in [
            (1, -62.0, 8.0, -25.0, [0.2, 1.0, 0.1], 20.0),
            (2, 60.0, -6.0, -28.0, [0.1, 1.0, -0.3], -20.0),
            (3, 4.0, -55.0, -40.0, [1.0, 0.1, 0.1], 30.0),
        ] {
            let p = pose(x + around(6.0), y + around(6.0), z + around(5.0), axis, degrees + around(5.0));
            truth.insert(MarkerId(id), p);
        }
        let mut place = |x: f64, y: f64, z: f64| {
            looking([x + around(15.0), y + around(15.0), z + around(15.0)], [0.0, -15.0, -15.0], around(15.0))
        };
        let places = vec![place(-110.0, 110.0, -255.0), place(90.0, 140.0, -250.0)];
        Self {
            seed,
            size_mm: 20.0,
            truth,
            places,
            camera: stereo_camera(),
            finish: Finish::default(),
            occluders: Vec::new(),
            otherwise: BTreeMap::new(),
            doubles: Vec::new(),
            mirrored: None,
        }
    }

    pub fn pairs(&self) -> Vec<Pair> {
        let pair = |(k, to_left): (usize, &Isometry3<f64>)| {
            let place = Place(k as u32 + 1);
            let take = |side: Side| {
                let [w, h] = self.camera.image_size;
                let pose = plain(&(self.camera.from_left(side) * to_left));
                let camera = Camera { lens: lens(self.camera.lens(side)), pose, size: (w, h) };
                let seed = self.seed * 1000 + k as u64 * 2 + side as u64;
                let bytes = stereo::render(&self.scene(place), &camera, &self.finish, seed);
                Grey { width: w, height: h, values: bytes.into_iter().map(f32::from).collect() }
            };
            Pair { place, left: take(Side::Left), right: take(Side::Right) }
        };
        self.places.iter().enumerate().map(pair).collect()
    }

    pub fn settings(&self) -> Settings {
        Settings::new(self.size_mm, MarkerId(0))
    }

    pub fn register(&self) -> Result<Registration, CoarseError> {
        register(&self.pairs(), &self.camera, &self.settings())
    }

    fn scene(&self, place: Place) -> Scene {
        let mut prints: Vec<Print> = Vec::new();
        for (id, pose) in &self.truth {
            let pose = self.otherwise.get(&(place, *id)).copied().unwrap_or(Some(*pose));
            prints.extend(pose.map(|pose| self.print(*id, &pose)));
        }
        prints.extend(self.doubles.iter().map(|(id, pose)| self.print(*id, pose)));
        let here = self.occluders.iter().filter(|(p, _)| *p == place);
        Scene { prints, occluders: here.map(|(_, o)| *o).collect() }
    }

    fn print(&self, id: MarkerId, pose: &Isometry3<f64>) -> Print {
        let mut cells = cells(id).unwrap();
        if self.mirrored == Some(id) {
            cells.iter_mut().for_each(|row| row.reverse());
        }
        Print { white: cells.concat(), cells: CELLS, cell_mm: self.size_mm / 8.0, pose: plain(pose) }
    }
}

fn lens(lens: &Lens) -> stereo::Lens {
    stereo::Lens {
        fx: lens.fx,
        fy: lens.fy,
        cx: lens.cx,
        cy: lens.cy,
        distortion: [lens.k1, lens.k2, lens.p1, lens.p2],
    }
}

fn plain(pose: &Isometry3<f64>) -> Pose {
    let r = pose.rotation.to_rotation_matrix();
    let rotation = std::array::from_fn(|i| std::array::from_fn(|j| r[(i, j)]));
    Pose { rotation, translation: pose.translation.vector.into() }
}

/// A disc that hides part of a marker: `at` in the marker's frame, a little above it.
pub fn disc(rig: &Rig, id: MarkerId, at: [f64; 2], radius_mm: f64) -> Occluder {
    let centre = rig.truth[&id] * Point3::new(at[0], at[1], -1.0);
    Occluder { centre: centre.coords.into(), radius_mm, reflectance: 0.2 }
}

/// Errors of position (mm) and orientation (degrees) of all markers but the substrate's.
pub fn errors(rig: &Rig, found: &Registration) -> (Vec<f64>, Vec<f64>) {
    let all = found.markers.iter().filter(|(id, _)| **id != found.substrate);
    all.map(|(id, m)| {
        let (mm, deg) = graph::apart(&rig.truth[id], &m.pose);
        (mm.0, deg.0)
    })
    .unzip()
}

/// A pair of pictures of markers lying anywhere, by the default camera.
pub fn render_prints(
    markers: &[(MarkerId, Isometry3<f64>)],
    size_mm: f64,
    to_left: &Isometry3<f64>,
    at: Place,
) -> Pair {
    let mut rig = Rig::new(u64::from(at.0));
    rig.size_mm = size_mm;
    rig.truth = markers.iter().copied().collect();
    rig.places = vec![*to_left];
    let pair = rig.pairs().remove(0);
    Pair { place: at, ..pair }
}

pub fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}
