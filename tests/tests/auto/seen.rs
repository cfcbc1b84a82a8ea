//! With the eyes it has in earnest: rendered frames, the tip detector, and the boards' own scans for focus.

use crate::eyes::{both, faulty};
use crate::rendered::Rendered;
use crate::unattended::farthest_off;
use crate::world::{World, rig_file};
use parfocal::autonomous::{DetectorEyes, Plan, Work, calibrate};
use parfocal::focus::Measure;
use parfocal::procedure::{Progress, ScanFocuser};

/// Calibrates everything; how far tips that are sent to random pixels then are from there at worst, µm.
fn calibrated(seed: u64) -> f64 {
    let world = World::new(faulty(seed));
    let mut rig = rig_file();
    let (mut stage, mut camera) = (world.stage(), Rendered(world.clone()));
    let mut focuser = ScanFocuser::new(Measure::Tenengrad, 1);
    let mut eyes = DetectorEyes::default();
    let mut progress = |said: Progress| {
        if let Progress::Passed(said) | Progress::Warning(said) = said {
            eprintln!("{said}");
        }
    };
    let mut work = Work {
        stage: &mut stage,
        camera: &mut camera,
        focuser: &mut focuser,
        eyes: &mut eyes,
        keep_on: &|| true,
        progress: &mut progress,
        turret: None,
    };
    let date = || "2026-11-25T00:00:00Z".into();
    let plan = Plan::new(both(), seed);
    let done = calibrate(&mut work, &mut rig, &plan, &date, &mut |_| Ok(())).unwrap_or_else(|e| panic!("{seed}: {e}"));
    stage.close();
    let minutes = world.lock().now() as f64 / 60e6;
    let worst = farthest_off(&world, &rig, seed);
    eprintln!("seed {seed}: {:#?}, {minutes:.1} min of the rig's time, {worst:.2} µm at worst", done.done);
    assert!(done.missing.is_empty(), "{:?}", done.missing);
    worst
}

/// As the one below.
#[test]
#[ignore = "half a minute in release, minutes in the dev profile"]
fn the_detector_and_the_boards_scans_calibrate_a_rig_that_is_really_seen() {
    let worst = calibrated(1);
    assert!(worst <= 1.5, "{worst:.2} µm");
}

/// `cargo nextest run --release -p parfocal-tests --test auto --run-ignored only detector --no-capture`
#[test]
#[ignore = "minutes; the same as the one above, with other rigs"]
fn the_detector_and_the_boards_scans_calibrate_six_rigs() {
    for seed in 2..=7 {
        let worst = calibrated(seed);
        assert!(worst <= 1.5, "seed {seed}: {worst:.2} µm");
    }
}
