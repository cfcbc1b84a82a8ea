//! Focus measures: how sharp a grey picture is.
//!
//! [`measure`] turns pixels into a number and does nothing else. Sums are taken as integers and are exact; only the last
//! step is floating-point, so a picture gives the same value on every processor.
//!
//! ```
//! use parfocal::focus::{Measure, measure};
//! use parfocal::picture::{Picture, Roi};
//!
//! let edge = Picture::grey8(4, 3, vec![10, 10, 90, 90, 10, 10, 90, 90, 10, 10, 90, 90])?;
//! assert_eq!(measure(edge.view(), Measure::Brenner)?.0, 6400.0);
//! let flat = edge.view().crop(Roi { x: 2, y: 0, width: 2, height: 3 })?;
//! assert_eq!(measure(flat, Measure::Variance)?.0, 0.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod compare;
mod histogram;
mod measure;
pub mod quality;
pub mod region;
pub mod shape;
mod simd;

pub use measure::{Measure, UnknownMeasure};

use crate::picture::View;
use parfocal_protocol::units::FocusValue;
use simd::{Pixel, Plane};
use thiserror::Error;

/// Runs `$body` with `$plane` as the view's pixels in their own type.
macro_rules! with_plane {
    ($view:expr, |$plane:ident| $body:expr) => {{
        let view: $crate::picture::View<'_> = $view;
        let (width, height, stride) = (view.width(), view.height(), view.stride());
        match view.pixels() {
            $crate::picture::Pixels::Grey8(pixels) => {
                let $plane = $crate::focus::simd::Plane::new(pixels, width, height, stride);
                $body
            }
            $crate::picture::Pixels::Grey16(pixels) => {
                let $plane = $crate::focus::simd::Plane::new(pixels, width, height, stride);
                $body
            }
        }
    }};
}
use with_plane;

/// Why there is no focus value.
#[derive(Debug, Error, PartialEq, Eq)]
pub enum FocusError {
    /// The region has fewer pixels than the measure compares.
    #[error("{measure} needs a region of at least {}x{} pixels, this one is {width}x{height}", .measure.least().0, .measure.least().1)]
    TooSmall {
        /// The measure.
        measure: Measure,
        /// The region's columns.
        width: usize,
        /// The region's rows.
        height: usize,
    },
}

/// The focus value Φ of a picture or a region of one ([`View::crop`]), by any [`Measure`]. Never NaN, never infinite.
///
/// # Errors
/// [`FocusError::TooSmall`] for a region below [`Measure::least`].
pub fn measure(view: View<'_>, measure: Measure) -> Result<FocusValue, FocusError> {
    let (width, height) = (view.width(), view.height());
    let least = measure.least();
    if width < least.0 || height < least.1 {
        return Err(FocusError::TooSmall { measure, width, height });
    }
    Ok(FocusValue(with_plane!(view, |plane| value(&plane, measure))))
}

fn value<P: Pixel>(plane: &Plane<'_, P>, measure: Measure) -> f64 {
    let (width, height) = (plane.width(), plane.height());
    let pixels = plane.area() as f64;
    // Counts of pixels that have the neighbours a measure asks for; unused ones may be 0.
    let inner = (width.saturating_sub(2) * height.saturating_sub(2)) as f64;
    let triples = (width.saturating_sub(2) * height) as f64;
    let pairs = (width.saturating_sub(1) * height) as f64;
    match measure {
        Measure::Variance => variance(simd::moments(plane), plane.area()),
        Measure::NormalisedVariance => {
            let (sum, squares) = simd::moments(plane);
            ratio(variance((sum, squares), plane.area()), sum as f64 / pixels)
        }
        Measure::Tenengrad => simd::tenengrad(plane) as f64 / inner,
        Measure::Brenner => simd::brenner(plane) as f64 / triples,
        Measure::SumModifiedLaplacian => simd::modified_laplacian(plane) as f64 / inner,
        Measure::VarianceOfLaplacian => {
            let sum = simd::laplacian_total(plane).unsigned_abs();
            variance((sum, simd::laplacian(plane)), (width - 2) * (height - 2))
        }
        Measure::EnergyOfLaplacian => simd::laplacian9(plane) as f64 / inner,
        Measure::VollathF4 => simd::vollath4(plane) as f64 / triples,
        Measure::VollathF5 => {
            let [products, left, right] = simd::vollath5(plane);
            let n = ((width - 1) * height) as u128;
            ((n * products).cast_signed() - (left * right).cast_signed()) as f64 / (pairs * pairs)
        }
        Measure::Entropy => histogram::entropy(&histogram::histogram(plane), plane.area()),
        Measure::Range => {
            let (low, high) = simd::extremes(plane);
            f64::from(high - low)
        }
        Measure::ThresholdContent => {
            let mean = simd::moments(plane).0 / plane.area() as u128;
            let floor = u32::try_from(mean).expect("a mean of 16-bit values");
            simd::excess(plane, floor) as f64 / pixels
        }
        Measure::WaveletRatio => {
            // a² + b² + c² + d² of a block is the energy of its four bands, (a+b+c+d)²/4 that of the low one.
            let (squares, low) = simd::haar(plane);
            ratio((4 * squares - low) as f64, low as f64)
        }
    }
}

/// Variance of `count` numbers from their sum's magnitude and the sum of their squares, both exact.
fn variance((sum, squares): (u128, u128), count: usize) -> f64 {
    let n = count as u128;
    (n * squares - sum * sum) as f64 / (count as f64 * count as f64)
}

/// a / b, and 0 where there is nothing to divide by: a black picture.
fn ratio(a: f64, b: f64) -> f64 {
    if b > 0.0 { a / b } else { 0.0 }
}

#[cfg(test)]
mod tests;
