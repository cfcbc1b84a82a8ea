//! Makes curves of the family: one broad lopsided peak with up to four bumps, as real focus measures have them; all local
//! maxima within the trap radius of the highest.

use super::TRAP;
use super::curves::{Curves, Truth, mix64, uniform};

/// The probe's length, µm.
const J0: f64 = 5.0;

/// Half-widths of the ranges, µm.
const RANGES: [f64; 4] = [100.0, 200.0, 300.0, 500.0];

/// Bumps at most.
const BUMPS: f64 = 4.0;

/// Bumps lie within this distance of the broad peak, µm.
const NEAR: f64 = 9.5;

/// The highest place is found on a grid of this step, µm,
const GRID: f64 = 0.01;

/// this far to both sides of the broad peak: beyond, no bump is left.
const LOOK: f64 = 20.0;

/// A curve falls by this share of its height towards both ends of the range.
const FALL: f64 = 0.06;

/// `count` curves; the same seed gives the same ones.
pub fn curves(count: u32, seed: u64) -> Curves {
    let curves = (0..u64::from(count)).map(|k| {
        let id = seed.wrapping_mul(1_000_000).wrapping_add(k);
        // What does not belong to the family is drawn again.
        (0..).find_map(|attempt| draw(id, attempt)).expect("most draws belong to it")
    });
    Curves { j0: J0, curves: curves.collect() }
}

/// One draw; `None` when it is outside the family.
fn draw(id: u64, attempt: u64) -> Option<Truth> {
    let sequence = mix64(id ^ 0xF0C5).wrapping_add(attempt << 32);
    let mut j = 0;
    let mut between = |low: f64, high: f64| {
        j += 1;
        low + (high - low) * uniform(sequence, j)
    };
    let r = RANGES[between(0.0, RANGES.len() as f64) as usize];
    let zc = between(TRAP - r, r - TRAP);
    let wl = between(5f64.ln(), 60f64.ln()).exp();
    let wr = wl * between(2.0 / 3.0, 1.5);
    let (p, b) = (between(0.6, 1.5), between(0.05, 0.5));
    let bumps = between(0.0, BUMPS + 1.0) as usize;
    let bumps = (0..bumps).map(|_| [between(0.02, 0.3), zc + between(-NEAR, NEAR), between(0.5, 1.5)]).collect();
    let mut curve = Truth { id, r, zc, wl, wr, p, b, bumps, zstar: zc, z0random: between(-r, r) };

    let steps = (LOOK / GRID) as i32;
    let places: Vec<f64> = (-steps..=steps).map(|k| zc + f64::from(k) * GRID).collect();
    let values: Vec<f64> = places.iter().map(|&z| curve.phi(z)).collect();
    let highest = (0..values.len()).max_by(|&a, &b| values[a].total_cmp(&values[b]))?;
    curve.zstar = places[highest];
    let maxima = (1..values.len() - 1).filter(|&k| values[k] > values[k - 1] && values[k] >= values[k + 1]);
    let near = maxima.map(|k| places[k]).all(|z| (z - curve.zstar).abs() <= TRAP);
    // Where the curve does not fall enough inside the range, its peak is refused as being at the edge, as it should be.
    let (top, ends) = (curve.phi(curve.zstar), [curve.phi(-r), curve.phi(r)]);
    let falls = top - ends[0].max(ends[1]) >= FALL * (top - ends[0].min(ends[1]));
    (near && falls && curve.zstar.abs() <= r - TRAP).then_some(curve)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_repeat_and_keep_the_familys_rules() {
        let made = curves(60, 3);
        assert_eq!(serde_json::to_string(&made).unwrap(), serde_json::to_string(&curves(60, 3)).unwrap());
        assert_ne!(serde_json::to_string(&made).unwrap(), serde_json::to_string(&curves(60, 4)).unwrap());
        for curve in &made.curves {
            // Coarser, and over the whole range.
            let places = (0..).map(|k| 0.05 * f64::from(k) - curve.r).take_while(|z| *z <= curve.r);
            let values: Vec<(f64, f64)> = places.map(|z| (z, curve.phi(z))).collect();
            let top = curve.phi(curve.zstar);
            for [a, b, c] in values.array_windows() {
                assert!(b.1 <= top + 1e-3, "{}: {} is higher", curve.id, b.0);
                if b.1 > a.1 && b.1 >= c.1 {
                    assert!((b.0 - curve.zstar).abs() <= TRAP + 0.1, "{}: a maximum at {}", curve.id, b.0);
                }
            }
            assert!(curve.bumps.len() <= 4 && curve.z0random.abs() <= curve.r);
        }
    }
}
