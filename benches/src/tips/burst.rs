//! A pipette that vibrates sideways while the camera runs.

use parfocal::picture::{Picture, View};
use parfocal::tip::motion::detect_vibrating;
use parfocal::tip::{Expect, Tip};
use parfocal_simulator::scene::{Drawn, Exposure};
use std::f64::consts::TAU;
use std::time::Instant;

/// Frames a second, and frames of a burst: twenty swings, as docs/tips.md asks for.
const FPS: f64 = 30.0;
const FRAMES: u32 = 120;

/// Vibration as `parfocal vibrate` has it unless told otherwise: frequency, and half of the way from turn to turn.
const VIBRATION_HZ: f64 = 5.0;
const AMPLITUDE_UM: f64 = 2.0;

/// Records a burst of the scene and finds the tip in it; with the time that finding took, ms.
pub fn detect(drawn: &Drawn) -> anyhow::Result<(Option<Tip>, f64)> {
    let phase = TAU * (drawn.exposure.seed % 1000) as f64 / 1000.0;
    let frames: Vec<Picture> = (0..FRAMES).map(|k| frame(drawn, k, phase)).collect::<anyhow::Result<_>>()?;
    let views: Vec<View<'_>> = frames.iter().map(Picture::view).collect();
    let start = Instant::now();
    let tip = detect_vibrating(&views, FPS, VIBRATION_HZ, &Expect::default())?;
    Ok((tip, start.elapsed().as_secs_f64() * 1e3))
}

fn frame(drawn: &Drawn, k: u32, phase: f64) -> anyhow::Result<Picture> {
    let swing = AMPLITUDE_UM * (TAU * VIBRATION_HZ * f64::from(k) / FPS + phase).sin();
    let mut scene = drawn.scene.clone();
    for pipette in &mut scene.pipettes {
        let (sin, cos) = pipette.azimuth_rad.sin_cos();
        pipette.tip_um[0] -= swing * sin;
        pipette.tip_um[1] += swing * cos;
    }
    let exposure = Exposure { seed: drawn.exposure.seed.wrapping_add(u64::from(k)), ..drawn.exposure };
    super::picture(&drawn.view, scene.render(&drawn.view, &exposure))
}
