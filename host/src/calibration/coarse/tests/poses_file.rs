//! Another tracker's poses: many views, some of them wrong.

use super::scene::{BTreeMap, looking, pose};
use super::*;
use crate::calibration::coarse::poses::{PosesError, Tracker, read};
use crate::calibration::coarse::reject::Why;
use nalgebra::{Isometry3, Vector6};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

const TRACKER: Tracker = Tracker { position: Millimetres(0.1), orientation: Degrees(0.1) };

fn truth() -> BTreeMap<u16, Isometry3<f64>> {
    BTreeMap::from([
        (0, Isometry3::identity()),
        (1, pose(-60.0, 5.0, -20.0, [0.1, 1.0, 0.0], 40.0)),
        (2, pose(55.0, -9.0, -30.0, [0.3, 1.0, 0.2], -50.0)),
    ])
}

/// Rows of views from random places; `change` may spoil a pose.
fn rows(views: u32, noise: f64, change: impl Fn(u32, u16, Isometry3<f64>) -> Option<Isometry3<f64>>) -> String {
    let mut random = Pcg64Mcg::seed_from_u64(9);
    let mut text = poses::HEADER.to_owned() + "\n";
    for view in 1..=views {
        let mut r = |range: f64| range * (2.0 * random.random::<f64>() - 1.0);
        let camera = looking([r(150.0), 120.0 + r(40.0), -260.0], [r(10.0), r(10.0), 0.0], r(180.0));
        for (id, marker) in truth() {
            let off = Vector6::from_fn(|k, _| r(if k < 3 { noise } else { noise * 0.0175 }));
            let Some(seen) = change(view, id, super::super::fit::nudge(&(camera * marker), &off)) else { continue };
            let (q, t) = (seen.rotation.quaternion(), seen.translation.vector);
            text += &format!("{view},{id},{},{},{},{},{},{},{}\n", q.w, q.i, q.j, q.k, t.x, t.y, t.z);
        }
    }
    text
}

fn worst(found: &Registration) -> f64 {
    let off = |(id, m): (&MarkerId, &MarkerPose)| graph::apart(&truth()[&id.0], &m.pose).0.0;
    found.markers.iter().map(off).fold(0.0, f64::max)
}

#[test]
fn exact_poses_give_exact_markers_wherever_the_camera_stood() {
    let views = read(&rows(4, 0.0, |_, _, p| Some(p)), TRACKER).unwrap();
    let found = graph::solve(&views, MarkerId(0)).unwrap();
    assert!(worst(&found) < 1e-6 && found.rejected.is_empty());
}

#[test]
fn a_wrong_view_is_left_out_and_named() {
    let flipped = pose(0.0, 0.0, 0.0, [1.0, 0.2, 0.0], 50.0);
    let spoil = |view, id, p: Isometry3<f64>| Some(if (view, id) == (3, 2) { p * flipped } else { p });
    let views = read(&rows(5, 0.1, spoil), TRACKER).unwrap();
    let found = graph::solve(&views, MarkerId(0)).unwrap();
    let [rejected] = &found.rejected[..] else { panic!("{:?}", found.rejected) };
    assert!(rejected.marker == MarkerId(2) && rejected.place == Some(Place(3)), "{rejected}");
    assert!(matches!(rejected.why, Why::WrongPose { deg, .. } if (deg.0 - 50.0).abs() < 1.0));
    assert!(worst(&found) < 0.3, "{}", worst(&found));
}

#[test]
fn a_chain_without_the_substrate_in_view_links() {
    // Marker 2 is never seen with the substrate's, only with marker 1.
    let hide = |view: u32, id, p| (!(view.is_multiple_of(2) && id == 0 || view % 2 == 1 && id == 2)).then_some(p);
    let views = read(&rows(6, 0.02, hide), TRACKER).unwrap();
    let found = graph::solve(&views, MarkerId(0)).unwrap();
    assert!(found.unconnected.is_empty() && worst(&found) < 0.3, "{}", worst(&found));
    assert!(found.markers[&MarkerId(2)].position > found.markers[&MarkerId(1)].position);
}

#[test]
fn faults_of_the_file_are_named_by_line_and_field() {
    let good = rows(1, 0.0, |_, _, p| Some(p));
    let spoil = |from: &str, to: &str| read(&good.replacen(from, to, 1), TRACKER).unwrap_err();
    assert!(matches!(spoil("qw,qx", "qx,qw"), PosesError::Header(_)));
    assert_eq!(spoil("1,1,", "1,1,0.5,").to_string().split(':').next(), Some("line 3 has 10 fields"));
    assert!(spoil("1,2,", "1,two,").to_string().starts_with("line 4, marker: 'two'"));
    assert!(matches!(spoil("1,2,", "1,1,"), PosesError::Twice { line: 4, .. }));
    assert!(matches!(read("", TRACKER), Err(PosesError::Empty)));
    let double = "view,marker,qw,qx,qy,qz,x_mm,y_mm,z_mm\n1,0,2,0,0,0,0,0,0\n";
    assert_eq!(read(double, TRACKER), Err(PosesError::NotUnit { line: 2, length: 2.0 }));
    assert!(
        read(&double.replace(",2,0,0,0,0,0,0", ",1,0,0,0,nan,0,0"), TRACKER).unwrap_err().to_string().contains("x_mm")
    );
}
