//! The simulated rig's stereo camera, held over it by a simulated person, who also clicks on the tips.

use super::folder::{Clicks, TipClicks};
use crate::cmd::simulated::Handle;
use anyhow::Context;
use parfocal::calibration::coarse::learn::Click;
use parfocal::calibration::coarse::marker::{CELLS, cells};
use parfocal::calibration::coarse::{MarkerId, Place, Side};
use parfocal_simulator::scene::Pipette;
use parfocal_simulator::stereo::{self, Camera, Finish, Pose, Print, Scene, bench};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::path::Path;

/// A click is off by at most this each way, px.
const CLICK_PX: f64 = 0.7;
/// The shank is clicked on so far behind the tip, µm.
const SHANK_UM: f64 = 25_000.0;

/// Takes a pair at every place; gives the clicks on every tip and shank that both pictures show.
pub(super) fn take(rig: &Handle, places: u32, folder: &Path, seed: u64) -> anyhow::Result<Clicks> {
    let pair = bench::Pair::new();
    let (markers, pipettes) = {
        let rig = rig.lock();
        (bench::markers(&rig), rig.pipettes(rig.now()))
    };
    let print = |(id, pose): (u16, Pose)| {
        let cells = cells(MarkerId(id)).with_context(|| format!("there is no marker {id}"))?;
        Ok(Print { white: cells.concat(), cells: CELLS, cell_mm: bench::TAG_MM / 8.0, pose })
    };
    let prints = markers.into_iter().map(print).collect::<anyhow::Result<Vec<_>>>()?;
    let scene = Scene { prints, occluders: Vec::new() };
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut clicks = Clicks::default();
    let held = (0..).flat_map(|k| bench::places(seed.wrapping_add(k)));
    for (k, place) in (1..=places).zip(held) {
        let poses = [place, pair.left_to_right.after(&place)];
        for (side, n) in Side::BOTH.into_iter().zip(0u64..) {
            let camera = Camera { lens: pair.lenses[side as usize], pose: poses[side as usize], size: pair.size };
            let noise = seed.wrapping_mul(1000).wrapping_add(2 * u64::from(k) + n);
            let bytes = stereo::render(&scene, &camera, &Finish::default(), noise);
            let path = folder.join(format!("place_{}_{side}.png", Place(k)));
            let (w, h) = (pair.size.0 as u32, pair.size.1 as u32);
            let picture = image::GrayImage::from_raw(w, h, bytes).context("a picture has as many values as pixels")?;
            picture.save(&path).with_context(|| format!("{}: cannot be written", path.display()))?;
        }
        for (id, pipette) in (1..).zip(&pipettes) {
            let mut click = |back_um: f64| {
                let at = bench::from_ref(along(pipette, back_um));
                let mut seen = |side: usize| {
                    let p = poses[side].map(at);
                    let [x, y] = pair.lenses[side].pixel([p[0] / p[2], p[1] / p[2]]);
                    let mut off = || CLICK_PX * (2.0 * random.random::<f64>() - 1.0);
                    let px = [x + off(), y + off()];
                    let inside =
                        (0.0..pair.size.0 as f64).contains(&px[0]) && (0.0..pair.size.1 as f64).contains(&px[1]);
                    (p[2] > 1.0 && inside).then_some(px)
                };
                Some(Click { place: Place(k), left: seen(0)?, right: seen(1)? })
            };
            let (tip, shank) = (click(0.0), click(SHANK_UM));
            let of_tip: &mut TipClicks = clicks.entry(MarkerId(id)).or_default();
            of_tip.tip.extend(tip);
            of_tip.shank.extend(shank);
        }
    }
    Ok(clicks)
}

/// A point of a pipette, behind its tip.
fn along(pipette: &Pipette, back_um: f64) -> [f64; 3] {
    let direction = pipette.direction();
    std::array::from_fn(|k| pipette.tip_um[k] - back_um * direction[k])
}
