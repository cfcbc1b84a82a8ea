//! The shape of a focus curve Φ(z): what makes a measure easy or hard to climb.
//!
//! The criteria are those by which Firestone et al. (Cytometry 12, 1991) compare measures: false maxima, width,
//! range, noise.

use parfocal_protocol::units::{FocusValue, Micrometres};

/// Prominence, as a share of the curve's height, from which on a maximum counts; below it lies the jitter of rounding.
pub const PROMINENT: f64 = 0.01;

/// What a focus curve looks like. Its height is its largest value less its smallest.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Shape {
    /// The sample with the largest value, from 0.
    pub peak: usize,
    /// Its z.
    pub peak_um: f64,
    /// The largest value is among the first or the last two: the true peak may lie outside.
    pub at_edge: bool,
    /// Maxima besides the largest one that stand out by [`PROMINENT`].
    pub other_maxima: usize,
    /// The greatest distance of one of these from the largest.
    pub farthest_maximum_um: Option<f64>,
    /// Height of the highest of these above the smallest value, as a share of the curve's height.
    pub highest_other: Option<f64>,
    /// The lowest sample between the peak and another maximum of at least half its height: where two lobes of a phase object
    /// have its focus between them.
    pub valley_um: Option<f64>,
    /// Full width at half height around the peak; `None` when the curve does not fall to it on both sides.
    pub width_um: Option<f64>,
    /// From where to where the curve rises towards the peak without a dip of [`PROMINENT`].
    pub climb_um: [f64; 2],
    /// Standard deviation of the noise as a share of the curve's height. It is estimated from third differences, in which a
    /// smooth curve sampled finely enough leaves almost nothing; `None` below 8 samples.
    pub noise: Option<f64>,
}

impl Shape {
    /// Describes a curve of samples in the order of z. `None` without samples, when z and Φ differ in number, or for a flat curve.
    pub fn of(z: &[Micrometres], phi: &[FocusValue]) -> Option<Self> {
        let values: Vec<f64> = phi.iter().map(|p| p.0).collect();
        if values.is_empty() || z.len() != values.len() {
            return None;
        }
        let (low, high) = values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &v| (l.min(v), h.max(v)));
        // NaN among the values makes no height either.
        if !(high - low > 0.0 && values.iter().all(|v| v.is_finite())) {
            return None;
        }
        // From here on 0 is the curve's foot and 1 its peak.
        let curve: Vec<f64> = values.iter().map(|v| (v - low) / (high - low)).collect();
        let peak = curve.iter().position(|&v| v == 1.0)?;
        let at = |k: usize| z[k].0;
        let others: Vec<usize> =
            maxima(&curve).into_iter().filter(|&k| k != peak && prominence(&curve, k) >= PROMINENT).collect();
        let highest = others.iter().copied().max_by(|&a, &b| curve[a].total_cmp(&curve[b]));
        let lobe = highest.filter(|&k| curve[k] >= 0.5);
        let valley =
            lobe.and_then(|lobe| (lobe.min(peak)..=lobe.max(peak)).min_by(|&a, &b| curve[a].total_cmp(&curve[b])));
        let side = |towards: Vec<usize>| crossing(&curve, &towards, &at);
        let (left, right) = (side((0..=peak).rev().collect()), side((peak..curve.len()).collect()));
        Some(Self {
            peak,
            peak_um: at(peak),
            at_edge: peak < 2 || peak + 2 >= curve.len(),
            other_maxima: others.len(),
            farthest_maximum_um: others.iter().map(|&k| (at(k) - at(peak)).abs()).reduce(f64::max),
            highest_other: highest.map(|k| curve[k]),
            valley_um: valley.map(at),
            width_um: left.zip(right).map(|(l, r)| r - l),
            climb_um: [at(foot(&curve, (0..=peak).rev())), at(foot(&curve, peak..curve.len()))],
            noise: noise(&curve),
        })
    }
}

/// Samples above both neighbours; a plateau counts once, at its first sample; the ends count when they are highest around.
fn maxima(curve: &[f64]) -> Vec<usize> {
    let mut found = Vec::new();
    let mut start = 0;
    for plateau in curve.chunk_by(|a, b| a == b) {
        let end = start + plateau.len();
        let rises = start == 0 || curve[start - 1] < curve[start];
        let falls = end == curve.len() || curve[end] < curve[start];
        if rises && falls {
            found.push(start);
        }
        start = end;
    }
    found
}

/// How far one must go down from a maximum before one can go higher.
fn prominence(curve: &[f64], k: usize) -> f64 {
    let valley = |side: &mut dyn Iterator<Item = &f64>| {
        let mut lowest = curve[k];
        for &v in side {
            if v > curve[k] {
                return Some(lowest);
            }
            lowest = lowest.min(v);
        }
        None
    };
    let left = valley(&mut curve[..k].iter().rev());
    let right = valley(&mut curve[k + 1..].iter());
    // The way out over the higher saddle; a maximum as high as the peak is judged by its lowest surroundings.
    let saddle = match (left, right) {
        (Some(l), Some(r)) => l.max(r),
        (Some(s), None) | (None, Some(s)) => s,
        (None, None) => curve.iter().copied().fold(f64::INFINITY, f64::min),
    };
    curve[k] - saddle
}

/// z where the curve first falls to half on the way along `path`, by a line between samples.
fn crossing(curve: &[f64], path: &[usize], at: &impl Fn(usize) -> f64) -> Option<f64> {
    let [above, below] = *path.array_windows().find(|[_, b]| curve[*b] <= 0.5)?;
    let part = (curve[above] - 0.5) / (curve[above] - curve[below]);
    Some(at(above) + (at(below) - at(above)) * part)
}

/// The lowest sample on the way down from the peak before the curve rises again by [`PROMINENT`].
fn foot(curve: &[f64], path: impl Iterator<Item = usize>) -> usize {
    let mut lowest = None;
    for k in path {
        match lowest {
            Some(low) if curve[k] >= curve[low] + PROMINENT => break,
            Some(low) if curve[k] >= curve[low] => {}
            _ => lowest = Some(k),
        }
    }
    lowest.unwrap_or(0)
}

/// Robust noise from third differences: their weights 1, −3, 3, −1 make √20 of it.
fn noise(curve: &[f64]) -> Option<f64> {
    if curve.len() < 8 {
        return None;
    }
    let mut third: Vec<f64> = curve.array_windows().map(|[a, b, c, d]| (d - a + 3.0 * (b - c)).abs()).collect();
    third.sort_by(f64::total_cmp);
    // The median of |normal| is 0.6745 of its standard deviation.
    Some(third[third.len() / 2] / 0.6745 / 20f64.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_pcg::Pcg64Mcg;

    fn shape(phi: impl Fn(f64) -> f64) -> Option<Shape> {
        let z: Vec<_> = (-40..=40).map(|k| Micrometres(0.5 * f64::from(k))).collect();
        let values: Vec<_> = z.iter().map(|z| FocusValue(phi(z.0))).collect();
        Shape::of(&z, &values)
    }

    #[test]
    fn one_clean_peak_is_described_exactly() {
        // A triangle of half-width 10 µm around 2 µm on a foot of 5.
        let s = shape(|z| 5.0 + (1.0 - (z - 2.0).abs() / 10.0).max(0.0)).unwrap();
        assert_eq!((s.peak_um, s.other_maxima, s.at_edge, s.valley_um), (2.0, 0, false, None));
        assert!((s.width_um.unwrap() - 10.0).abs() < 1e-9);
        assert_eq!(s.climb_um, [-8.0, 12.0]);
        assert!(s.noise.unwrap() < 1e-9);
    }

    #[test]
    fn other_maxima_are_counted_and_the_farthest_named() {
        let bump = |z: f64, c: f64, h: f64| h * (-(z - c).powi(2) / 2.0).exp();
        let s = shape(|z| bump(z, -3.0, 1.0) + bump(z, 6.0, 0.6) + bump(z, 11.5, 0.2) + bump(z, 17.0, 0.005)).unwrap();
        assert_eq!((s.peak_um, s.other_maxima, s.farthest_maximum_um), (-3.0, 2, Some(14.5)));
        assert!((s.highest_other.unwrap() - 0.6).abs() < 0.01 && (0.0..4.0).contains(&s.valley_um.unwrap()));
        assert!(s.climb_um[0] < -5.0 && (0.0..4.0).contains(&s.climb_um[1]), "{:?}", s.climb_um);
    }

    #[test]
    fn edges_flat_curves_and_nan_are_told() {
        let rising = shape(|z| z).unwrap();
        assert!(rising.at_edge && rising.width_um.is_none());
        assert_eq!(shape(|_| 3.0), None);
        assert_eq!(shape(|z| if z == 0.0 { f64::NAN } else { z }), None);
        assert_eq!(Shape::of(&[], &[]), None);
    }

    #[test]
    fn noise_is_found_again() {
        for sigma in [0.002, 0.02] {
            let mut random = Pcg64Mcg::seed_from_u64(7);
            let z: Vec<_> = (0..400).map(|k| Micrometres(f64::from(k) * 0.5)).collect();
            let mut normal = || (0..12).map(|_| rand::RngExt::random::<f64>(&mut random)).sum::<f64>() - 6.0;
            let phi: Vec<_> = z
                .iter()
                .map(|z| FocusValue((1.0 + ((z.0 - 100.0) / 20.0).powi(2)).recip() + sigma * normal()))
                .collect();
            let found = Shape::of(&z, &phi).unwrap().noise.unwrap();
            assert!((found / sigma - 1.0).abs() < 0.25, "{found} instead of {sigma}");
        }
    }
}
