//! The integer sums behind the measures, by the fastest kernel that this processor runs.
//!
//! The one place where it is decided: with AVX2, kernels written for it or the portable ones compiled for it; without, the
//! portable ones. The sums are the same bit for bit.

#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
mod avx2;
mod plane;
mod portable;

pub use plane::{Pixel, Plane};
pub use portable::laplacian_total;

/// A public function for each kernel, choosing at run time. Wider vectors than AVX2 are left alone: they slow some
/// processors' clocks, and here memory is the limit.
macro_rules! kernels {
    ($($name:ident($($argument:ident: $type:ty)?) -> $sums:ty, $bytes:path, $words:path;)*) => {$(
        #[doc = concat!("See [`portable::", stringify!($name), "`].")]
        #[allow(unsafe_code)]
        pub fn $name<P: Pixel>(plane: &Plane<'_, P> $(, $argument: $type)?) -> $sums {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2")]
                fn with_avx2<P: Pixel>(plane: &Plane<'_, P> $(, $argument: $type)?) -> $sums {
                    match (P::bytes(plane), P::words(plane)) {
                        (Some(bytes), _) => $bytes(bytes $(, $argument)?),
                        (_, Some(words)) => $words(words $(, $argument)?),
                        _ => portable::$name(plane $(, $argument)?),
                    }
                }
                if is_x86_feature_detected!("avx2") {
                    // SAFETY: the processor has AVX2, as asked in the line before.
                    return unsafe { with_avx2(plane $(, $argument)?) };
                }
            }
            portable::$name(plane $(, $argument)?)
        }
    )*};
}

kernels! {
    moments() -> (u128, u128), avx2::moments, avx2::word_rows::moments;
    extremes() -> (u32, u32), portable::extremes, portable::extremes;
    excess(floor: u32) -> u128, avx2::excess, portable::excess;
    brenner() -> u128, avx2::brenner, avx2::word_rows::brenner;
    vollath4() -> i128, avx2::vollath4, avx2::word_rows::vollath4;
    vollath5() -> [u128; 3], avx2::vollath5, avx2::word_rows::vollath5;
    tenengrad() -> u128, avx2::tenengrad, avx2::words::tenengrad;
    laplacian() -> u128, avx2::laplacian, avx2::words::laplacian;
    laplacian9() -> u128, avx2::laplacian9, avx2::words::laplacian9;
    modified_laplacian() -> u128, avx2::modified_laplacian, avx2::words::modified_laplacian;
    haar() -> (u128, u128), avx2::haar, portable::haar;
}

#[cfg(test)]
mod tests;
