//! Kernels that look along rows, for 8-bit pixels.

use super::super::plane::Pixel;
use super::*;

/// Vectors after which 32-bit sums move on into 64-bit ones: a lane gains at most 4 · 1,020² from each.
const BATCH: usize = 512;

/// Adds up a row, with a look `ahead` bytes forward: `step` takes the pixels of one vector, and a mask for the last;
/// `finish` takes the sums of a batch. `false` when the row is too short for vectors.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn along<P: Pixel, S: Copy, const N: usize>(
    row: &[P],
    ahead: usize,
    zero: S,
    step: impl Fn(S, &[P; N], Option<__m256i>) -> S,
    mut finish: impl FnMut(S),
) -> bool {
    let lanes = LANES / size_of::<P>();
    let Some(cut) = Cut::new(row.len(), lanes, N) else { return false };
    let (mut x, end) = (0, cut.vectors * lanes);
    while x < end {
        let (stop, mut sums) = (end.min(x + BATCH * lanes), zero);
        while x + 4 * lanes <= stop {
            // Four vectors for one look at the bounds.
            let four = &row[x..][..3 * lanes + N];
            prefetch(&four[0], ahead);
            prefetch(&four[2 * lanes], ahead);
            for k in 0..4 {
                sums = step(sums, window(four, k * lanes), None);
            }
            x += 4 * lanes;
        }
        while x < stop {
            sums = step(sums, window(row, x), None);
            x += lanes;
        }
        finish(sums);
    }
    if let Some((at, skip)) = cut.last {
        finish(step(zero, window(row, at), Some(mask(skip * size_of::<P>()))));
    }
    true
}

/// See [`portable::moments`].
#[target_feature(enable = "avx2")]
pub fn moments(plane: &Plane<'_, u8>) -> (u128, u128) {
    let zero = _mm256_setzero_si256();
    let (mut sum, mut squares) = (0u128, 0u128);
    let ahead = ahead(plane);
    for row in plane.rows() {
        let (mut s, mut q) = (0, 0);
        let step = |[sum, e, o]: [__m256i; 3], w: &[u8; 32], mask: Option<__m256i>| {
            let pixels = keep(mask, load::<0, 32>(w));
            [add_bytes(sum, pixels), add_squares(e, even(pixels)), add_squares(o, odd(pixels))]
        };
        let done = along(row, ahead, [zero; 3], step, |[sum, e, o]| {
            s += total64(sum);
            q += total(e) + total(o);
        });
        if !done {
            (s, q) = portable::moments_of_row(row);
        }
        sum += u128::from(s);
        squares += u128::from(q);
    }
    (sum, squares)
}

/// See [`portable::excess`].
#[target_feature(enable = "avx2")]
pub fn excess(plane: &Plane<'_, u8>, floor: u32) -> u128 {
    // A floor above 255 leaves nothing, as one of 255 does.
    let level = _mm256_set1_epi8(floor.min(255).to_le_bytes()[0].cast_signed());
    let mut all = 0u128;
    let ahead = ahead(plane);
    for row in plane.rows() {
        let mut sum = 0;
        let step = |sum: __m256i, w: &[u8; 32], mask: Option<__m256i>| {
            add_bytes(sum, _mm256_subs_epu8(keep(mask, load::<0, 32>(w)), level))
        };
        if !along(row, ahead, _mm256_setzero_si256(), step, |s| sum += total64(s)) {
            sum = portable::excess_of_row(row, floor);
        }
        all += u128::from(sum);
    }
    all
}

/// See [`portable::brenner`].
#[target_feature(enable = "avx2")]
pub fn brenner(plane: &Plane<'_, u8>) -> u128 {
    let mut all = 0u128;
    let ahead = ahead(plane);
    for row in plane.rows() {
        let mut sum = 0;
        let step = |[e, o]: [__m256i; 2], w: &[u8; 34], mask: Option<__m256i>| {
            let (a, b) = (load::<0, 34>(w), load::<2, 34>(w));
            let distance = keep(mask, _mm256_or_si256(_mm256_subs_epu8(a, b), _mm256_subs_epu8(b, a)));
            [add_squares(e, even(distance)), add_squares(o, odd(distance))]
        };
        if !along(row, ahead, [_mm256_setzero_si256(); 2], step, |[e, o]| sum += total(e) + total(o)) {
            sum = portable::brenner_of_row(row);
        }
        all += u128::from(sum);
    }
    all
}

/// See [`portable::vollath4`].
#[target_feature(enable = "avx2")]
pub fn vollath4(plane: &Plane<'_, u8>) -> i128 {
    let mut all = 0i128;
    let ahead = ahead(plane);
    for row in plane.rows() {
        let mut sum = 0;
        let step = |[e, o]: [__m256i; 2], w: &[u8; 34], mask: Option<__m256i>| {
            let pixels = keep(mask, load::<0, 34>(w));
            [
                add_products(e, even(pixels), pairs(load::<1, 34>(w), 1, -1)),
                add_products(o, odd(pixels), pairs(load::<2, 34>(w), 1, -1)),
            ]
        };
        if !along(row, ahead, [_mm256_setzero_si256(); 2], step, |[e, o]| sum += total_signed(_mm256_add_epi32(e, o))) {
            sum = portable::vollath4_of_row(row);
        }
        all += i128::from(sum);
    }
    all
}

/// See [`portable::vollath5`].
#[target_feature(enable = "avx2")]
pub fn vollath5(plane: &Plane<'_, u8>) -> [u128; 3] {
    let mut all = [0u128; 3];
    let ahead = ahead(plane);
    for row in plane.rows() {
        let (mut products, mut sum) = (0, 0);
        let step = |[s, e, o]: [__m256i; 3], w: &[u8; 33], mask: Option<__m256i>| {
            let (pixels, next) = (keep(mask, load::<0, 33>(w)), load::<1, 33>(w));
            [add_bytes(s, pixels), add_products(e, even(pixels), even(next)), add_products(o, odd(pixels), odd(next))]
        };
        let done = along(row, ahead, [_mm256_setzero_si256(); 3], step, |[s, e, o]| {
            sum += total64(s);
            products += total(e) + total(o);
        });
        if done {
            // The last pixel has no neighbour, so no vector has counted it.
            sum += row.last().map_or(0, |&p| u64::from(p));
        } else {
            [products, sum] = portable::vollath5_of_row(row);
        }
        portable::add_vollath5(&mut all, row, [products, sum]);
    }
    all
}

/// See [`portable::haar`].
#[target_feature(enable = "avx2")]
pub fn haar(plane: &Plane<'_, u8>) -> (u128, u128) {
    let (ahead, mut squares, mut low) = (ahead(plane), 0u128, 0u128);
    for y in (1..plane.height()).step_by(2) {
        let rows: [&[u8]; 2] = plane.band(y - 1);
        let vectors = plane.width() / LANES;
        let [top, bottom] = rows.map(|row| &row[vectors * LANES..]);
        let (mut q, mut l) = portable::haar_of_rows(top, bottom);
        for from in (0..vectors).step_by(BATCH) {
            let [mut of_pixels, mut of_blocks] = [_mm256_setzero_si256(); 2];
            for vector in from..vectors.min(from + BATCH) {
                let mut block = _mm256_setzero_si256();
                for row in rows {
                    let pixels = load::<0, 32>(window(row, vector * LANES));
                    prefetch(&row[vector * LANES], ahead);
                    of_pixels = add_squares(add_squares(of_pixels, even(pixels)), odd(pixels));
                    block = _mm256_add_epi16(block, pairs(pixels, 1, 1));
                }
                of_blocks = add_squares(of_blocks, block);
            }
            q += total(of_pixels);
            l += total(of_blocks);
        }
        squares += u128::from(q);
        low += u128::from(l);
    }
    (squares, low)
}
