//! The kernels with AVX2.
//!
//! The trick throughout for 8 bits: 32 bytes are 16 even and 16 odd pixels, each of them already in place for 16-bit
//! arithmetic, and loads one byte apart bring the neighbours under them. So nothing is shuffled. `maddubs` with weights
//! (1, 1), (1, −1) or (1, −4) adds two neighbouring bytes at once. Stencils go down a band of rows while the
//! intermediate results of the rows above stay in registers. The last vector of a row overlaps the one before, with
//! the pixels counted already masked out. Sums are integers: the order of adding does not matter.

mod rows;
mod stencils;
pub mod word_rows;
pub mod words;

use super::plane::Plane;
use super::portable;
pub use rows::*;
use std::arch::x86_64::*;
pub use stencils::*;

/// Pixels of 8 bits a vector holds.
const LANES: usize = 32;

/// The 32 bytes of `window` from element `AT` on.
#[inline]
#[target_feature(enable = "avx2")]
fn load<const AT: usize, const N: usize>(window: &[u8; N]) -> __m256i {
    const { assert!(AT + LANES <= N) };
    // SAFETY: the 32 bytes from AT lie inside the array, by the assertion; an unaligned load asks no more.
    unsafe { _mm256_loadu_si256(window.as_ptr().add(AT).cast()) }
}

/// Eight 16-bit pixels of `window` from element `AT` on, as 32-bit numbers.
#[inline]
#[target_feature(enable = "avx2")]
fn load_words<const AT: usize, const N: usize>(window: &[u16; N]) -> __m256i {
    const { assert!(AT + 8 <= N) };
    // SAFETY: the 16 bytes from AT lie inside the array, by the assertion; an unaligned load asks no more.
    _mm256_cvtepu16_epi32(unsafe { _mm_loadu_si128(window.as_ptr().add(AT).cast()) })
}

/// Bytes of a picture that should be on their way from memory ahead of those in work: nothing but reading 5 megapixels
/// from the third-level cache takes half of a kernel's time, and hardware looks ahead within pages of 4 KiB only.
const AHEAD: usize = 2048;

/// The distance, in bytes, to the row below that is at least [`AHEAD`] away: of a region only its own pixels are fetched.
#[inline(always)]
fn ahead<P>(plane: &Plane<'_, P>) -> usize
where
    P: super::Pixel,
{
    let stride = plane.stride() * size_of::<P>();
    stride * AHEAD.div_ceil(stride.max(1))
}

/// Asks for the cache line `ahead` bytes after a pixel.
#[inline(always)]
fn prefetch<P>(pixel: &P, ahead: usize) {
    // SAFETY: a prefetch reads nothing and never faults, wherever it points.
    unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(pixel).cast::<i8>().wrapping_add(ahead)) }
}

/// The `N` pixels of `row` from `at` on.
#[inline(always)]
fn window<P, const N: usize>(row: &[P], at: usize) -> &[P; N] {
    row[at..].first_chunk().expect("a whole window is left")
}

/// Bytes that keep all pixels of a vector but the first `skip`.
#[inline]
#[target_feature(enable = "avx2")]
fn mask(skip: usize) -> __m256i {
    const EDGE: [u8; 2 * LANES] = {
        let mut edge = [0; 2 * LANES];
        let mut k = LANES;
        while k < 2 * LANES {
            edge[k] = 0xff;
            k += 1;
        }
        edge
    };
    load::<0, LANES>(window(&EDGE, LANES - skip))
}

/// `value` where the mask is set, if there is one.
#[inline]
#[target_feature(enable = "avx2")]
fn keep(mask: Option<__m256i>, value: __m256i) -> __m256i {
    match mask {
        Some(mask) => _mm256_and_si256(mask, value),
        None => value,
    }
}

/// How a row of `width` pixels is cut into vectors of `lanes` results, each of which takes `reach` pixels.
#[derive(Clone, Copy)]
struct Cut {
    vectors: usize,
    lanes: usize,
    /// Where the last, overlapping vector starts, and how many of its results are counted already.
    last: Option<(usize, usize)>,
}

impl Cut {
    /// `None` for a row too short for one vector.
    #[inline(always)]
    fn new(width: usize, lanes: usize, reach: usize) -> Option<Self> {
        let results = width.checked_sub(reach)? + lanes;
        let (vectors, rest) = (results / lanes, results % lanes);
        let last = (rest > 0).then_some((width - reach, lanes - rest));
        Some(Self { vectors, lanes, last })
    }

    /// Where the whole vectors start, `size` by `size`.
    #[inline(always)]
    fn batches(self, size: usize) -> impl Iterator<Item = impl Iterator<Item = usize>> {
        let batch = move |first: usize| (first..self.vectors.min(first + size)).map(move |vector| vector * self.lanes);
        (0..self.vectors).step_by(size).map(batch)
    }
}

/// Even bytes as 16-bit numbers.
#[inline]
#[target_feature(enable = "avx2")]
fn even(bytes: __m256i) -> __m256i {
    _mm256_and_si256(bytes, _mm256_set1_epi16(0xff))
}

/// Odd bytes as 16-bit numbers.
#[inline]
#[target_feature(enable = "avx2")]
fn odd(bytes: __m256i) -> __m256i {
    _mm256_srli_epi16::<8>(bytes)
}

/// Each even byte times `a` plus the odd byte after it times `b`.
#[inline]
#[target_feature(enable = "avx2")]
fn pairs(bytes: __m256i, a: i8, b: i8) -> __m256i {
    _mm256_maddubs_epi16(bytes, _mm256_set1_epi16(i16::from_le_bytes([a.cast_unsigned(), b.cast_unsigned()])))
}

/// Products of 16-bit numbers, neighbouring ones added, on top of `sum`.
#[inline]
#[target_feature(enable = "avx2")]
fn add_products(sum: __m256i, a: __m256i, b: __m256i) -> __m256i {
    _mm256_add_epi32(sum, _mm256_madd_epi16(a, b))
}

#[inline]
#[target_feature(enable = "avx2")]
fn add_squares(sum: __m256i, a: __m256i) -> __m256i {
    add_products(sum, a, a)
}

/// All bytes added, on top of four 64-bit sums.
#[inline]
#[target_feature(enable = "avx2")]
fn add_bytes(sums: __m256i, bytes: __m256i) -> __m256i {
    _mm256_add_epi64(sums, _mm256_sad_epu8(bytes, _mm256_setzero_si256()))
}

/// The sum of eight unsigned 32-bit numbers.
#[inline]
#[target_feature(enable = "avx2")]
fn total(sums: __m256i) -> u64 {
    let zero = _mm256_setzero_si256();
    let wide = _mm256_add_epi64(_mm256_unpacklo_epi32(sums, zero), _mm256_unpackhi_epi32(sums, zero));
    total64(wide)
}

/// The sum of eight signed 32-bit numbers.
#[inline]
#[target_feature(enable = "avx2")]
fn total_signed(sums: __m256i) -> i64 {
    let low = _mm256_cvtepi32_epi64(_mm256_castsi256_si128(sums));
    let high = _mm256_cvtepi32_epi64(_mm256_extracti128_si256::<1>(sums));
    total64(_mm256_add_epi64(low, high)).cast_signed()
}

/// The sum of four 64-bit numbers.
#[inline]
#[target_feature(enable = "avx2")]
fn total64(sums: __m256i) -> u64 {
    let half = _mm_add_epi64(_mm256_castsi256_si128(sums), _mm256_extracti128_si256::<1>(sums));
    let all = _mm_add_epi64(half, _mm_unpackhi_epi64(half, half));
    _mm_cvtsi128_si64(all).cast_unsigned()
}
