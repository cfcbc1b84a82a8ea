//! With the eyes it has in earnest: rendered frames, the tip detector, and the boards' own scans for focus.

use crate::eyes::{both, faulty};
use crate::rendered::Rendered;
use crate::unattended::farthest_off;
use crate::world::{World, rig_file};
use parfocal::autonomous::{DetectorEyes, Plan, Work, calibrate};
use parfocal::focus::Measure;
use parfocal::procedure::{Progress, ScanFocuser};

/// `cargo nextest run -p parfocal-tests --test auto --run-ignored only detector --no-capture`
#[test]
#[ignore = "renders and searches thousands of frames: minutes"]
fn the_detector_and_the_boards_scans_calibrate_a_rig_that_is_really_seen() {
    let world = World::new(faulty(1));
    let mut rig = rig_file();
    let (mut stage, mut camera) = (world.stage(), Rendered(world.clone()));
    let mut focuser = ScanFocuser::new(Measure::Tenengrad, 1);
    let mut eyes = DetectorEyes::default();
    let mut progress = |said: Progress| match said {
        Progress::Found { .. } | Progress::Focused { .. } => {}
        said => eprintln!("{said:?}"),
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
    // The camera, and what moves past it, is as noisy as a real one: a micrometre of focus is what a scan can tell.
    let plan = Plan { error_um: 0.6, ..Plan::new(both(), 1) };
    let done = calibrate(&mut work, &mut rig, &plan, &|| "2026-11-25T00:00:00Z".into(), &mut |_| Ok(())).unwrap();
    stage.close();
    eprintln!("{:#?}, {:.1} min of the rig's time", done, world.lock().now() as f64 / 60e6);
    assert!(done.missing.is_empty());
    let worst = farthest_off(&world, &rig, 1);
    eprintln!("{worst:.2} µm at worst");
    assert!(worst <= 1.5, "{worst:.2} µm");
}
