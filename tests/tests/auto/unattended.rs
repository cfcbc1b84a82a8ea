//! Unattended, from nothing to tips that go where they are sent.

use crate::eyes::{Wrongs, both, faulty, run};
use crate::world::{Noise, World, rig_file};
use parfocal::autonomous::Plan;
use parfocal::calibration::chain::Pixel;
use parfocal::procedure::{Guard, tip_to_pixel};
use parfocal::rig::{ManipulatorNumber, Rig};
use parfocal_protocol::units::Micrometres;

/// Sends every tip to random pixels; the largest distance in xy from where those are, µm.
pub fn farthest_off(world: &World, rig: &Rig, seed: u64) -> f64 {
    both().into_iter().map(|n| send_to_random_pixels(world, rig, n, seed)).fold(0.0, f64::max)
}

/// Sends one tip to 50 random pixels.
pub fn send_to_random_pixels(world: &World, rig: &Rig, n: ManipulatorNumber, seed: u64) -> f64 {
    let mut stage = world.stage();
    let keep_on = || true;
    let mut guard = Guard::new(&mut stage, rig, &keep_on);
    let mut noise = Noise::new(seed ^ u64::from(n.get()) << 32);
    let mut worst = 0.0_f64;
    for _ in 0..50 {
        let pixel = Pixel { x_px: 32.0 + 576.0 * noise.uniform(), y_px: 32.0 + 416.0 * noise.uniform() };
        let pose = guard.pose().unwrap();
        let targets = tip_to_pixel(rig, &pose, n, pixel, Micrometres(0.0)).unwrap();
        guard.move_to(&targets).unwrap();
        let [x, y, _] = world.tip(usize::from(n.get()) - 1);
        let [sx, sy] = world.shown(pixel.x_px, pixel.y_px);
        worst = worst.max((x - sx).hypot(y - sy));
    }
    stage.close();
    worst
}

fn calibrated(seed: u64) -> (f64, f64, usize) {
    let world = World::new(faulty(seed));
    let mut rig = rig_file();
    let wrongs = Wrongs { astray: 0.1, ..Wrongs::default() };
    let ran = run(&world, &mut rig, seed, &wrongs, &Plan::new(both(), seed));
    let done = ran.result.unwrap_or_else(|e| panic!("seed {seed}: {e}; said {:?}", ran.said));
    assert!(done.missing.is_empty(), "seed {seed}: {:?}; said {:?}", done.missing, ran.said);
    assert_eq!(ran.saves, 3, "after the camera and after each manipulator");
    let minutes = world.lock().now() as f64 / 60e6;
    for (n, descent) in both().into_iter().zip([30.3, 30.3]) {
        let pipette = rig.contents().manipulators[&n].pipette.as_ref().expect("the axis lies along the pipette");
        assert!((pipette.descent_deg - descent).abs() < 1.0, "seed {seed}: {pipette:?}");
    }
    (farthest_off(&world, &rig, seed), minutes, ran.frames)
}

/// `cargo nextest run -p parfocal-tests --test auto twenty --no-capture`
#[test]
fn twenty_seeds_are_twenty_successes() {
    for seed in 100..120 {
        let (worst, minutes, frames) = calibrated(seed);
        eprintln!("seed {seed}: {worst:.2} µm at worst, {minutes:.1} min of the rig's time, {frames} frames");
        assert!(worst <= 1.5, "seed {seed}: {worst:.2} µm");
    }
}
