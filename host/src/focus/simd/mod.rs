//! The integer sums behind the measures, by the fastest kernel that this processor runs.
//!
//! The one place where it is decided: 8-bit pixels go to the AVX2 kernels, 16-bit ones to the portable kernels compiled
//! for AVX2, and without AVX2 all to the portable kernels. The sums are the same bit for bit.

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
    ($($name:ident($($argument:ident: $type:ty)?) -> $sums:ty, $bytes:path;)*) => {$(
        #[doc = concat!("See [`portable::", stringify!($name), "`].")]
        #[allow(unsafe_code)]
        pub fn $name<P: Pixel>(plane: &Plane<'_, P> $(, $argument: $type)?) -> $sums {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2")]
                fn with_avx2<P: Pixel>(plane: &Plane<'_, P> $(, $argument: $type)?) -> $sums {
                    match P::bytes(plane) {
                        Some(bytes) => $bytes(bytes $(, $argument)?),
                        None => portable::$name(plane $(, $argument)?),
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
    moments() -> (u128, u128), avx2::moments;
    extremes() -> (u32, u32), portable::extremes;
    excess(floor: u32) -> u128, avx2::excess;
    brenner() -> u128, avx2::brenner;
    vollath4() -> i128, avx2::vollath4;
    vollath5() -> [u128; 3], avx2::vollath5;
    tenengrad() -> u128, avx2::tenengrad;
    laplacian() -> u128, avx2::laplacian;
    laplacian9() -> u128, avx2::laplacian9;
    modified_laplacian() -> u128, avx2::modified_laplacian;
    haar() -> (u128, u128), avx2::haar;
}

#[cfg(test)]
mod tests;
