//! Rendered pairs: what the registration is worth.

mod bad_input;
mod board;
mod learning;
mod poses_file;
mod scene;

use super::*;
use scene::{Rig, errors, rms};

/// Position and orientation errors of markers 1 to 3 over seeds.
fn over_seeds(seeds: std::ops::Range<u64>, change: impl Fn(&mut Rig)) -> (Vec<f64>, Vec<f64>) {
    let (mut mm, mut deg) = (Vec::new(), Vec::new());
    for seed in seeds {
        let mut rig = Rig::new(seed);
        change(&mut rig);
        let found = rig.register().unwrap();
        assert_eq!(found.rejected, [], "seed {seed}");
        let (p, o) = errors(&rig, &found);
        mm.extend(p);
        deg.extend(o);
    }
    (mm, deg)
}

#[test]
fn two_places_give_a_tenth_of_a_millimetre() {
    let (mm, deg) = over_seeds(1..4, |_| {});
    println!("{:.4} mm, {:.4} deg RMS; {mm:.3?} {deg:.3?}", rms(&mm), rms(&deg));
    assert!(rms(&mm) <= 0.12 && rms(&deg) <= 0.2, "{} mm, {} deg", rms(&mm), rms(&deg));
}

#[test]
fn gamma_encoded_pictures_are_read_in_light() {
    let (mm, deg) = over_seeds(1..3, |rig| rig.finish.gamma = 2.2);
    println!("{:.4} mm, {:.4} deg RMS; {mm:.3?} {deg:.3?}", rms(&mm), rms(&deg));
    assert!(rms(&mm) <= 0.3 && rms(&deg) <= 0.3, "{} mm, {} deg", rms(&mm), rms(&deg));
}
