//! How a picture's values relate to light, from the edges themselves.
//!
//! Blurred by any symmetric blur, the edge between black and white is symmetric in light. In a gamma-encoded picture it is not, and its middle
//! value lies on the black side: by 0.4 standard deviations of the blur at γ = 2.2. The γ under which symmetric edges fit the pixels best is
//! the pictures' own.

use super::camera::StereoCamera;
use super::edges::Grey;
use super::fit::{Target, refine};
use nalgebra::Isometry3;

/// A marker to judge by: its pictures, what it is, and about where.
pub type Sample<'a> = ([Option<&'a Grey>; 2], &'a Target, Isometry3<f64>);

/// Exponents tried, from that of linear pictures towards where the misfit falls.
const TRIED: [f64; 9] = [0.6, 0.8, 1.0, 1.2, 1.45, 1.75, 2.1, 2.5, 3.0];
const LINEAR: usize = 2;
/// Share of the misfit that another γ has to take away for the pictures not to count as linear.
const WORTH: f64 = 0.01;

/// The γ of pictures that are light^(1/γ); 1 when nothing speaks against it.
pub fn estimate(samples: &[Sample<'_>], camera: &StereoCamera) -> f64 {
    let misfit = |gamma: f64| {
        let mut sum = 0.0;
        for (pictures, target, pose) in samples {
            match refine(*pictures, camera, target, pose, gamma) {
                Some(fit) => sum += fit.noise.ln(),
                // A γ under which markers cannot be measured any more is no candidate.
                None => return f64::INFINITY,
            }
        }
        sum / samples.len() as f64
    };
    if samples.is_empty() {
        return 1.0;
    }
    let mut curve = [f64::NAN; TRIED.len()];
    for k in [LINEAR - 1, LINEAR, LINEAR + 1] {
        curve[k] = misfit(TRIED[k]);
    }
    let upwards = curve[LINEAR + 1] <= curve[LINEAR - 1];
    let mut best = if upwards { LINEAR + 1 } else { LINEAR - 1 };
    if !(curve[best] < curve[LINEAR]) {
        return 1.0;
    }
    // The misfit has one valley: downhill until it rises.
    while let Some(next) = if upwards { Some(best + 1).filter(|k| *k < TRIED.len()) } else { best.checked_sub(1) } {
        curve[next] = misfit(TRIED[next]);
        if !(curve[next] < curve[best]) {
            break;
        }
        best = next;
    }
    if curve[LINEAR] - curve[best] < WORTH {
        return 1.0;
    }
    let ends = best.checked_sub(1).zip((best + 1 < TRIED.len()).then_some(best + 1));
    match ends {
        Some((a, b)) if curve[a].is_finite() && curve[b].is_finite() => {
            vertex([a, best, b].map(|k| (TRIED[k].ln(), curve[k]))).exp()
        }
        _ => TRIED[best],
    }
}

/// Where the parabola through three points has its minimum.
fn vertex([a, b, c]: [(f64, f64); 3]) -> f64 {
    let (left, right) = ((b.0 - a.0) * (b.1 - c.1), (b.0 - c.0) * (b.1 - a.1));
    if (left - right).abs() < 1e-15 {
        return b.0;
    }
    b.0 - 0.5 * ((b.0 - a.0) * left - (b.0 - c.0) * right) / (left - right)
}
