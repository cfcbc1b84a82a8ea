//! Kernels that look along rows, for 16-bit pixels.
//!
//! Products of 16-bit numbers are made of signed ones, so pixels are taken from their middle: I = I' + 2^15. What the products
//! of I' leave out is put back from sums over whole rows.

use super::super::plane::Plane;
use super::rows::along;
use super::*;

/// The middle of a pixel's range.
const MIDDLE: i64 = 1 << 15;

/// The least sum of two products of I'; the greatest is 2^31. From it on they are unsigned 32-bit numbers.
const LEAST: i32 = -(2 * 32_768 * 32_767);

/// Sixteen pixels of `window` from element `AT` on, from their middle.
#[inline]
#[target_feature(enable = "avx2")]
fn centred<const AT: usize, const N: usize>(window: &[u16; N]) -> __m256i {
    centre(load_16::<AT, N>(window))
}

#[inline]
#[target_feature(enable = "avx2")]
fn centre(pixels: __m256i) -> __m256i {
    _mm256_xor_si256(pixels, _mm256_set1_epi16(i16::MIN))
}

/// Sixteen pixels of `window` from element `AT` on.
#[inline]
#[target_feature(enable = "avx2")]
fn load_16<const AT: usize, const N: usize>(window: &[u16; N]) -> __m256i {
    const { assert!(AT + 16 <= N) };
    // SAFETY: the 32 bytes from AT lie inside the array, by the assertion; an unaligned load asks no more.
    unsafe { _mm256_loadu_si256(window.as_ptr().add(AT).cast()) }
}

/// Neighbouring unsigned 32-bit numbers added, as four 64-bit ones.
#[inline]
#[target_feature(enable = "avx2")]
fn wide(numbers: __m256i) -> __m256i {
    let low = _mm256_and_si256(numbers, _mm256_set1_epi64x(0xffff_ffff));
    _mm256_add_epi64(low, _mm256_srli_epi64::<32>(numbers))
}

/// Products of I' from [`LEAST`] on.
#[inline]
#[target_feature(enable = "avx2")]
fn products(a: __m256i, b: __m256i) -> __m256i {
    wide(_mm256_sub_epi32(_mm256_madd_epi16(a, b), _mm256_set1_epi32(LEAST)))
}

/// Squares of I' on top of four 64-bit sums.
#[inline]
#[target_feature(enable = "avx2")]
fn add_squares64(sums: __m256i, a: __m256i) -> __m256i {
    _mm256_add_epi64(sums, wide(_mm256_madd_epi16(a, a)))
}

/// All I' on top of eight 32-bit sums.
#[inline]
#[target_feature(enable = "avx2")]
fn add_all(sums: __m256i, a: __m256i) -> __m256i {
    add_products(sums, a, _mm256_set1_epi16(1))
}

/// Sum I and sum I^2 of `count` numbers from those of I'.
#[inline(always)]
fn whole(count: usize, sum: i64, squares: u64) -> (u64, u64) {
    let count = count as i64;
    let all = sum + count * MIDDLE;
    (all.cast_unsigned(), (squares.cast_signed() + 2 * MIDDLE * sum + count * MIDDLE * MIDDLE).cast_unsigned())
}

/// See [`portable::moments`].
#[target_feature(enable = "avx2")]
pub fn moments(plane: &Plane<'_, u16>) -> (u128, u128) {
    let zero = _mm256_setzero_si256();
    let (mut sum, mut squares) = (0u128, 0u128);
    let ahead = ahead(plane);
    for row in plane.rows() {
        let (mut s, mut q) = (0i64, 0u64);
        let step = |[sums, squares]: [__m256i; 2], w: &[u16; 16], mask: Option<__m256i>| {
            let pixels = keep(mask, centred::<0, 16>(w));
            [add_all(sums, pixels), add_squares64(squares, pixels)]
        };
        let done = along(row, ahead, [zero; 2], step, |[sums, squares]| {
            s += total_signed(sums);
            q += total64(squares);
        });
        let (s, q) = if done { whole(row.len(), s, q) } else { portable::moments_of_row(row) };
        sum += u128::from(s);
        squares += u128::from(q);
    }
    (sum, squares)
}

/// See [`portable::brenner`].
#[target_feature(enable = "avx2")]
pub fn brenner(plane: &Plane<'_, u16>) -> u128 {
    let zero = _mm256_setzero_si256();
    let (mut all, ahead) = (0u128, ahead(plane));
    for row in plane.rows() {
        let (mut s, mut q) = (0i64, 0u64);
        let step = |[sums, squares]: [__m256i; 2], w: &[u16; 18], mask: Option<__m256i>| {
            let (a, b) = (load_16::<0, 18>(w), load_16::<2, 18>(w));
            let distance = _mm256_or_si256(_mm256_subs_epu16(a, b), _mm256_subs_epu16(b, a));
            let distance = keep(mask, centre(distance));
            [add_all(sums, distance), add_squares64(squares, distance)]
        };
        let done = along(row, ahead, [zero; 2], step, |[sums, squares]| {
            s += total_signed(sums);
            q += total64(squares);
        });
        all += u128::from(if done { whole(row.len() - 2, s, q).1 } else { portable::brenner_of_row(row) });
    }
    all
}

/// See [`portable::vollath4`].
#[target_feature(enable = "avx2")]
pub fn vollath4(plane: &Plane<'_, u16>) -> i128 {
    let (mut all, ahead) = (0i128, ahead(plane));
    for row in plane.rows() {
        let mut sum = 0;
        let step = |sums: __m256i, w: &[u16; 18], mask: Option<__m256i>| {
            let pixels = keep(mask, centred::<0, 18>(w));
            // Both from the same least value, which so falls out.
            let (next, after) = (centred::<1, 18>(w), centred::<2, 18>(w));
            _mm256_add_epi64(sums, _mm256_sub_epi64(products(pixels, next), products(pixels, after)))
        };
        if along(row, ahead, _mm256_setzero_si256(), step, |sums| sum += total64(sums).cast_signed()) {
            // The differences of neighbours add up to that of the ends.
            sum += MIDDLE * (i64::from(row[1]) - i64::from(row[row.len() - 1]));
        } else {
            sum = portable::vollath4_of_row(row);
        }
        all += i128::from(sum);
    }
    all
}

/// See [`portable::vollath5`].
#[target_feature(enable = "avx2")]
pub fn vollath5(plane: &Plane<'_, u16>) -> [u128; 3] {
    let zero = _mm256_setzero_si256();
    let (mut all, ahead) = ([0u128; 3], ahead(plane));
    for row in plane.rows() {
        let (mut p, mut s) = (0i64, 0i64);
        // Products less the same of nothing: the least value falls out.
        let step = |[sums, of_products]: [__m256i; 2], w: &[u16; 17], mask: Option<__m256i>| {
            let (pixels, next) = (keep(mask, centred::<0, 17>(w)), centred::<1, 17>(w));
            let both = _mm256_sub_epi64(products(pixels, next), _mm256_set1_epi64x(-2 * i64::from(LEAST)));
            [add_all(sums, pixels), _mm256_add_epi64(of_products, both)]
        };
        let done = along(row, ahead, [zero; 2], step, |[sums, of_products]| {
            s += total_signed(sums);
            p += total64(of_products).cast_signed();
        });
        let of_row = if done {
            let [first, last] = [row[0], row[row.len() - 1]].map(|pixel| i64::from(pixel) - MIDDLE);
            let pairs = row.len() as i64 - 1;
            // (a' + m)(b' + m), summed; s is that of all a', which are all pixels but the last.
            let products = p + MIDDLE * (2 * s - first + last) + pairs * MIDDLE * MIDDLE;
            [products, s + last + (pairs + 1) * MIDDLE].map(i64::cast_unsigned)
        } else {
            portable::vollath5_of_row(row)
        };
        portable::add_vollath5(&mut all, row, of_row);
    }
    all
}
