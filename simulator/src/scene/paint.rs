//! Adds objects to a picture where they are, and nowhere else.

use super::{Region, Viewpoint};

/// Something that darkens or brightens the light near it.
pub(super) trait Object {
    /// Whether the object can change the light within `reach_um` of a point in ref.
    fn touches(&self, at_um: [f64; 2], reach_um: f64) -> bool;

    /// A blur radius (µm) below which no detail of the object lies within `reach_um` of a point in ref.
    fn finest_um(&self, at_um: [f64; 2], reach_um: f64) -> f64;

    /// The relative change of the light at a point in ref.
    fn contrast(&self, at_um: [f64; 2]) -> f64;
}

/// Pixels of a block's side.
const BLOCK: usize = 8;

/// A blur of this many pixels and more is smooth enough to be interpolated across a block (to 1 % of the contrast).
const SMOOTH_PX: f64 = 24.0;

/// Adds `object` to `contrast`, the pixels of `region` row after row. Blocks lie on a grid of the whole picture, so a pixel
/// is the same in every region.
pub(super) fn add(object: &impl Object, view: &Viewpoint, region: Region, contrast: &mut [f32]) {
    let pitch = view.pitch_um();
    let reach = pitch * BLOCK as f64 * std::f64::consts::FRAC_1_SQRT_2;
    let (right, bottom) = (region.x + region.width, region.y + region.height);
    for by in region.y / BLOCK..bottom.div_ceil(BLOCK) {
        for bx in region.x / BLOCK..right.div_ceil(BLOCK) {
            let (x0, y0) = (bx * BLOCK, by * BLOCK);
            let middle = view.ref_um(x0 as f64 + 0.5 * BLOCK as f64, y0 as f64 + 0.5 * BLOCK as f64);
            if !object.touches(middle, reach) {
                continue;
            }
            let columns = x0.max(region.x)..(x0 + BLOCK).min(right);
            let rows = y0.max(region.y)..(y0 + BLOCK).min(bottom);
            let smooth = object.finest_um(middle, reach) >= SMOOTH_PX * pitch;
            let corner = |i: usize, j: usize| object.contrast(view.ref_um((x0 + i) as f64, (y0 + j) as f64));
            let corners = smooth.then(|| [corner(0, 0), corner(BLOCK, 0), corner(0, BLOCK), corner(BLOCK, BLOCK)]);
            for y in rows {
                let from = (y - region.y) * region.width + (columns.start - region.x);
                let row = &mut contrast[from..from + columns.len()];
                if let Some([a, b, c, d]) = corners {
                    let v = (y - y0) as f64 / BLOCK as f64;
                    let (left, end) = (a + v * (c - a), b + v * (d - b));
                    for (x, value) in columns.clone().zip(row) {
                        let u = (x - x0) as f64 / BLOCK as f64;
                        *value += (left + u * (end - left)) as f32;
                    }
                } else {
                    let start = view.ref_um(columns.start as f64, y as f64);
                    let step = [view.matrix_um_per_px[0][0], view.matrix_um_per_px[1][0]];
                    for (i, value) in row.iter_mut().enumerate() {
                        let i = i as f64;
                        *value += object.contrast([start[0] + i * step[0], start[1] + i * step[1]]) as f32;
                    }
                }
            }
        }
    }
}
