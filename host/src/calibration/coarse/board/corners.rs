//! A marker's corners from its edges, without knowing where the camera is: a homography is moved until the borders lie on the edges.

use super::super::CoarseError;
use super::super::camera::Lens;
use super::super::edges::{Edge, Grey, Tone, borders, measure as measure_edges};
use super::super::levels::Levels;
use super::super::marker::{Found, cells, find, outline};
use super::super::weighted::{Row, solve};
use super::Board;
use nalgebra::{Matrix3, SMatrix, SVector, Vector2, Vector3};

/// The board's markers in a picture, those seen twice left out.
pub(super) fn find_on(board: &Board, picture: &Grey) -> Result<Vec<Found>, CoarseError> {
    let all = find(picture)?;
    let once = |f: &&Found| all.iter().filter(|g| g.id == f.id).count() == 1;
    Ok(all.iter().filter(once).filter(|f| board.centre(f.id).is_some()).copied().collect())
}

/// Corners on the board (mm) and in the picture (px).
pub(super) fn measure(
    board: &Board,
    picture: &Grey,
    found: &[Found],
    lens: &Lens,
) -> Vec<(Vector2<f64>, Vector2<f64>)> {
    let mut all = Vec::new();
    for tag in found {
        let Some((centre, corners)) = board.centre(tag.id).zip(refine(board.tag_mm, picture, tag, lens)) else {
            continue;
        };
        all.extend(outline(board.tag_mm).map(|c| c + centre).into_iter().zip(corners));
    }
    all
}

const ROUNDS: usize = 5;
const LEAST_SHARE: f64 = 0.5;

/// The corners, and by how much edges are drawn in or out, are moved until the borders lie on the edges.
fn refine(size_mm: f64, picture: &Grey, tag: &Found, lens: &Lens) -> Option<[Vector2<f64>; 4]> {
    let cells = cells(tag.id)?;
    let borders = borders(&cells, size_mm);
    let mut corners = tag.corners;
    let mut blur_px = 1.3;
    for round in 0..ROUNDS {
        let map = homography(size_mm, &corners.map(|c| lens.direction(c)))?;
        let project = |p: Vector2<f64>| through(&map, p).map(|d| lens.pixel(d));
        let tone = Tone { gamma: 1.0, blur_px };
        let levels = Levels::read(picture, &cells, size_mm, tone, &project)?;
        let (edges, tried) = measure_edges(picture, &borders, size_mm, tone, &levels, &project);
        if (edges.len() as f64) < LEAST_SHARE * tried as f64 || edges.len() < 16 {
            return None;
        }
        let sharper = edges.iter().fold((0.0, 0.0), |s, e| (s.0 + e.sharper.0, s.1 + e.sharper.1));
        blur_px = (blur_px + (sharper.0 / sharper.1).clamp(-0.4, 0.4)).clamp(0.5, 4.0);
        let step = step(size_mm, &corners, lens, &edges)?;
        for (k, corner) in corners.iter_mut().enumerate() {
            *corner += Vector2::new(step[2 * k], step[2 * k + 1]);
        }
        if round > 1 && step.fixed_rows::<8>(0).amax() < 1e-3 {
            break;
        }
    }
    let drift = corners.iter().zip(&tag.corners).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
    (drift < 0.1 * tag.span() + 2.0).then_some(corners)
}

fn step(size_mm: f64, corners: &[Vector2<f64>; 4], lens: &Lens, edges: &[Edge]) -> Option<SVector<f64, 9>> {
    let slope = |k: usize| {
        let mut moved = *corners;
        moved[k / 2][k % 2] += 1e-3;
        homography(size_mm, &moved.map(|c| lens.direction(c)))
    };
    let here = homography(size_mm, &corners.map(|c| lens.direction(c)))?;
    let maps: Vec<Matrix3<f64>> = (0..8).map(slope).collect::<Option<_>>()?;
    let mut rows = Vec::new();
    for edge in edges {
        let at = lens.pixel(through(&here, edge.middle)?);
        let mut slopes = [0.0; 9];
        for (slope, map) in slopes.iter_mut().zip(&maps) {
            *slope = edge.normal.dot(&(lens.pixel(through(map, edge.middle)?) - at)) / 1e-3;
        }
        slopes[8] = -1.0;
        rows.push(Row { slopes, offset: edge.offset_px, weight: 1.0 / (edge.variance + 1e-5), picture: 0 });
    }
    solve(&rows, [1e-9; 9], 4, 1e-6).map(|solved| solved.by)
}

/// The map from a marker's plane to four directions.
fn homography(size_mm: f64, to: &[Vector2<f64>; 4]) -> Option<Matrix3<f64>> {
    let mut a = SMatrix::<f64, 8, 8>::zeros();
    let mut b = SVector::<f64, 8>::zeros();
    for (k, (p, q)) in outline(size_mm).iter().zip(to).enumerate() {
        let at = Vector3::new(p.x, p.y, 1.0);
        for (row, v) in [(2 * k, q.x), (2 * k + 1, q.y)] {
            a.fixed_view_mut::<1, 3>(row, 3 * (row % 2)).copy_from(&at.transpose());
            a[(row, 6)] = -v * p.x;
            a[(row, 7)] = -v * p.y;
            b[row] = v;
        }
    }
    let h = a.lu().solve(&b)?;
    Some(Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0))
}

fn through(map: &Matrix3<f64>, p: Vector2<f64>) -> Option<Vector2<f64>> {
    let row = |k: usize| map[(k, 0)] * p.x + map[(k, 1)] * p.y + map[(k, 2)];
    let (x, y, z) = (row(0), row(1), row(2));
    (z > 1e-9).then(|| Vector2::new(x / z, y / z))
}
