//! The stereo camera calibrated from rendered pairs of the board.

use super::scene::{looking, render_prints, stereo_camera};
use super::*;
use crate::calibration::coarse::board::{Board, BoardError, calibrate};
use nalgebra::{Isometry3, Translation3};

/// Pairs of the board, tilted in different directions or held parallel to the camera.
fn pairs(board: &Board, count: u32, tilted: bool) -> Vec<Pair> {
    let pair = |k: u32| {
        let turn = f64::from(k) * 2.4;
        let away = if tilted { 150.0 } else { 0.0 };
        let middle = [90.0, 70.0, 0.0];
        let from = [middle[0] + away * turn.cos(), middle[1] + away * turn.sin(), -330.0 - 10.0 * f64::from(k % 3)];
        let to_left = looking(from, middle, 25.0 * f64::from(k % 4) - 30.0);
        // The pair looks from the left camera; the board is moved to where both see it.
        let to_left = Translation3::new(-12.0, 0.0, 0.0) * to_left;
        let prints: Vec<(MarkerId, Isometry3<f64>)> =
            board.markers().map(|(id, c)| (id, Translation3::new(c.x, c.y, 0.0) * Isometry3::identity())).collect();
        render_prints(&prints, board.tag_mm, &to_left, Place(k + 1))
    };
    (0..count).map(pair).collect()
}

fn board() -> Board {
    Board { columns: 6, rows: 5, first: MarkerId(500), tag_mm: 26.0, gap_mm: 8.0 }
}

#[test]
fn the_camera_that_took_the_pictures_is_found() {
    let truth = stereo_camera();
    let found = calibrate(&pairs(&board(), 9, true), &board()).unwrap();
    println!("{found:#?}");
    assert!(found.rms_px < 0.1, "{}", found.rms_px);
    for side in Side::BOTH {
        let (a, b) = (truth.lens(side), found.camera.lens(side));
        assert!((a.fx - b.fx).abs() < 3.0 && (a.cx - b.cx).abs() < 3.0 && (a.cy - b.cy).abs() < 3.0, "{b:?}");
        assert!((a.k1 - b.k1).abs() < 0.02, "{b:?}");
    }
    let (mm, deg) = graph::apart(&truth.left_to_right, &found.camera.left_to_right);
    assert!(mm.0 < 0.6 && deg.0 < 0.3, "{mm} {deg}");
    // What it is for: the distance of two points in view.
    let p = |x: f64, y: f64| nalgebra::Point3::new(x, y, 300.0);
    let ends = [p(-60.0, -40.0), p(50.0, 45.0)].map(|p| {
        let pixel = |side| truth.lens(side).project(&(truth.from_left(side) * p)).unwrap().0;
        found.camera.triangulate(pixel(Side::Left), pixel(Side::Right)).unwrap()
    });
    let length = (p(-60.0, -40.0) - p(50.0, 45.0)).norm();
    assert!(((ends[0] - ends[1]).norm() - length).abs() < 0.15, "{}", (ends[0] - ends[1]).norm() - length);
}

#[test]
fn too_few_pairs_and_flat_ones_are_refused() {
    let few = calibrate(&pairs(&board(), 3, true), &board());
    assert!(matches!(few, Err(BoardError::TooFew { usable: 3, given: 3 })), "{few:?}");
    let flat = calibrate(&pairs(&board(), 5, false), &board());
    assert!(matches!(flat, Err(BoardError::Open { .. } | BoardError::NoFit)), "{flat:?}");
}
