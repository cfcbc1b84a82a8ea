//! Searches for the peak that others use, for comparison only: none of them knows its noise. They stand behind the same
//! trait as the board's own, and their answer is their largest sample.

mod brent;
mod coarse_fine;
mod golden;

pub use brent::Brent;
pub use coarse_fine::CoarseFine;
pub use golden::Golden;

use parfocal_firmware::autofocus::curve::{Curve, Place, STRIDE, Side};
use parfocal_firmware::autofocus::search::{Next, Search};

/// The value at the place of the latest frame.
fn value(curve: &Curve) -> f64 {
    curve.at(curve.here()).map_or(f64::MIN, |cell| cell.mean)
}

/// The whole range in full steps.
fn range(curve: &Curve) -> (f64, f64) {
    (f64::from(curve.limit(Side::Low).0), f64::from(curve.limit(Side::High).0))
}

/// The nearest place that is a whole number of sample steps from the start.
fn on_grid(at: f64) -> Place {
    let step = f64::from(STRIDE);
    Place((at / step).round() as i32 * STRIDE)
}

/// Runs a search on a curve by itself: `phi(k, z_nm)` is frame `k` at `z`. Tells every position in order, nm, the largest
/// sample's last, and how many frames it took.
pub fn run(search: &mut dyn Search, curve: &mut Curve, mut phi: impl FnMut(u32, i32) -> f64) -> (Vec<i32>, u32) {
    use parfocal_protocol::units::FocusValue;
    let (mut place, mut way, mut best) = (Place(0), Vec::new(), (f64::MIN, 0));
    let mut frames = 0;
    loop {
        let z = curve.position(place);
        let value = phi(frames, z.0);
        frames += 1;
        way.push(z.0);
        if value > best.0 {
            best = (value, z.0);
        }
        curve.add(z, FocusValue(value));
        match search.next(curve) {
            Next::Sample(next) => place = next,
            Next::Thinking => unreachable!("none of these has much to work out"),
            Next::Enough => {
                way.push(best.1);
                return (way, frames);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use parfocal_protocol::units::Nanometres;
    use proptest::prelude::*;

    fn find(search: &mut dyn Search, peak_um: f64, width_um: f64) -> f64 {
        let um = |x: i32| Nanometres(x * 1000);
        let mut curve = Curve::new(um(0), um(-100), um(100), Nanometres(500));
        let phi = |_: u32, z: i32| 1.0 / (1.0 + ((f64::from(z) / 1000.0 - peak_um) / width_um).powi(2));
        let (way, frames) = run(search, &mut curve, phi);
        assert!(frames < 500, "{frames} frames");
        f64::from(*way.last().unwrap()) / 1000.0
    }

    proptest! {
        #[test]
        fn each_finds_a_single_smooth_peak(peak in -90.0f64..90.0, width in 10.0f64..60.0) {
            for search in [&mut Golden::default() as &mut dyn Search, &mut CoarseFine::default(), &mut Brent::default()] {
                let found = find(search, peak, width);
                prop_assert!((found - peak).abs() <= 2.0, "{found} for {peak}");
            }
        }
    }
}
