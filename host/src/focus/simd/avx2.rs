//! The kernels for 8-bit pixels with AVX2.
//!
//! The trick throughout: 32 bytes are 16 even and 16 odd pixels, each of them already in place for 16-bit arithmetic,
//! and loads one byte apart bring the neighbours under them. So nothing is shuffled. `maddubs` with weights (1, 1),
//! (1, −1) or (1, −4) adds two neighbouring bytes at once. Stencils go down a band of rows while the intermediate
//! results of the rows above stay in registers. Sums are integers: the order of adding does not matter.

use super::plane::Plane;
use super::portable;
use std::arch::x86_64::*;

/// Pixels a vector holds.
const LANES: usize = 32;
/// Vectors of a row after which the 32-bit sums move on into 64-bit ones.
const BATCH: usize = 64;
/// Rows of output a stencil makes in one go, and the rows of pixels which that takes.
const ROWS: usize = 8;
const BAND: usize = ROWS + 2;

/// The 32 bytes of `window` from `AT` on.
#[inline]
#[target_feature(enable = "avx2")]
fn load<const AT: usize, const N: usize>(window: &[u8; N]) -> __m256i {
    const { assert!(AT + LANES <= N) };
    // SAFETY: the 32 bytes from AT lie inside the array, by the assertion; an unaligned load asks no more.
    unsafe { _mm256_loadu_si256(window.as_ptr().add(AT).cast()) }
}

/// The `N` bytes of `row` from `at` on.
#[inline(always)]
fn window<const N: usize>(row: &[u8], at: usize) -> &[u8; N] {
    row[at..].first_chunk().expect("a whole window is left")
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

/// Where the vectors of a row start that need `N` bytes each, `BATCH` by `BATCH`, and where the rest begins.
#[inline(always)]
fn batches<const N: usize, const BATCH: usize>(
    width: usize,
) -> (impl Iterator<Item = impl Iterator<Item = usize>>, usize) {
    let vectors = if width < N { 0 } else { (width - N) / LANES + 1 };
    let batch = move |first: usize| (first..vectors.min(first + BATCH)).map(|vector| vector * LANES);
    ((0..vectors).step_by(BATCH).map(batch), vectors * LANES)
}

/// See [`portable::moments`].
#[target_feature(enable = "avx2")]
pub fn moments(plane: &Plane<'_, u8>) -> (u128, u128) {
    let (mut sum, mut squares) = (0u128, 0u128);
    for row in plane.rows() {
        let (batches, rest) = batches::<32, BATCH>(row.len());
        let mut sums = _mm256_setzero_si256();
        for batch in batches {
            let [mut e, mut o] = [_mm256_setzero_si256(); 2];
            for x in batch {
                let pixels = load::<0, 32>(window(row, x));
                sums = _mm256_add_epi64(sums, _mm256_sad_epu8(pixels, _mm256_setzero_si256()));
                e = add_squares(e, even(pixels));
                o = add_squares(o, odd(pixels));
            }
            squares += u128::from(total(e) + total(o));
        }
        let (s, q) = portable::moments_of_row(&row[rest..]);
        sum += u128::from(total64(sums) + s);
        squares += u128::from(q);
    }
    (sum, squares)
}

/// See [`portable::brenner`].
#[target_feature(enable = "avx2")]
pub fn brenner(plane: &Plane<'_, u8>) -> u128 {
    let mut sum = 0u128;
    for row in plane.rows() {
        let (batches, rest) = batches::<34, BATCH>(row.len());
        let mut of_row = portable::brenner_of_row(&row[rest..]);
        for batch in batches {
            let [mut e, mut o] = [_mm256_setzero_si256(); 2];
            for x in batch {
                let w = window(row, x);
                let (a, b) = (load::<0, 34>(w), load::<2, 34>(w));
                let distance = _mm256_or_si256(_mm256_subs_epu8(a, b), _mm256_subs_epu8(b, a));
                e = add_squares(e, even(distance));
                o = add_squares(o, odd(distance));
            }
            of_row += total(e) + total(o);
        }
        sum += u128::from(of_row);
    }
    sum
}

/// See [`portable::vollath4`].
#[target_feature(enable = "avx2")]
pub fn vollath4(plane: &Plane<'_, u8>) -> i128 {
    let mut sum = 0i128;
    for row in plane.rows() {
        let (batches, rest) = batches::<34, BATCH>(row.len());
        let mut of_row = portable::vollath4_of_row(&row[rest..]);
        for batch in batches {
            let [mut e, mut o] = [_mm256_setzero_si256(); 2];
            for x in batch {
                let w = window(row, x);
                let pixels = load::<0, 34>(w);
                e = add_products(e, even(pixels), pairs(load::<1, 34>(w), 1, -1));
                o = add_products(o, odd(pixels), pairs(load::<2, 34>(w), 1, -1));
            }
            of_row += total_signed(_mm256_add_epi32(e, o));
        }
        sum += i128::from(of_row);
    }
    sum
}

/// See [`portable::vollath5`].
#[target_feature(enable = "avx2")]
pub fn vollath5(plane: &Plane<'_, u8>) -> [u128; 3] {
    let mut all = [0u128; 3];
    for row in plane.rows() {
        let (batches, rest) = batches::<33, BATCH>(row.len());
        let [mut products, mut sum] = portable::vollath5_of_row(&row[rest..]);
        let mut sums = _mm256_setzero_si256();
        for batch in batches {
            let [mut e, mut o] = [_mm256_setzero_si256(); 2];
            for x in batch {
                let w = window(row, x);
                let (pixels, next) = (load::<0, 33>(w), load::<1, 33>(w));
                sums = _mm256_add_epi64(sums, _mm256_sad_epu8(pixels, _mm256_setzero_si256()));
                e = add_products(e, even(pixels), even(next));
                o = add_products(o, odd(pixels), odd(next));
            }
            products += total(e) + total(o);
        }
        sum += total64(sums);
        portable::add_vollath5(&mut all, row, [products, sum]);
    }
    all
}

/// See [`portable::excess`].
#[target_feature(enable = "avx2")]
pub fn excess(plane: &Plane<'_, u8>, floor: u32) -> u128 {
    // A floor above 255 leaves nothing, as one of 255 does.
    let level = _mm256_set1_epi8(floor.min(255).to_le_bytes()[0].cast_signed());
    let mut sum = 0u128;
    for row in plane.rows() {
        let (batches, rest) = batches::<32, BATCH>(row.len());
        let mut sums = _mm256_setzero_si256();
        for x in batches.flatten() {
            let above = _mm256_subs_epu8(load::<0, 32>(window(row, x)), level);
            sums = _mm256_add_epi64(sums, _mm256_sad_epu8(above, _mm256_setzero_si256()));
        }
        sum += u128::from(total64(sums) + portable::excess_of_row(&row[rest..], floor));
    }
    sum
}

/// See [`portable::haar`].
#[target_feature(enable = "avx2")]
pub fn haar(plane: &Plane<'_, u8>) -> (u128, u128) {
    let (mut squares, mut low) = (0u128, 0u128);
    for y in (1..plane.height()).step_by(2) {
        let rows @ [top, bottom] = plane.band(y - 1);
        let (batches, rest) = batches::<32, BATCH>(top.len());
        let (mut q, mut l) = portable::haar_of_rows(&top[rest..], &bottom[rest..]);
        for batch in batches {
            let [mut of_pixels, mut of_blocks] = [_mm256_setzero_si256(); 2];
            for x in batch {
                let mut block = _mm256_setzero_si256();
                for row in rows {
                    let pixels = load::<0, 32>(window(row, x));
                    of_pixels = add_squares(of_pixels, even(pixels));
                    of_pixels = add_squares(of_pixels, odd(pixels));
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
    // An odd last column belongs to no block.
    (squares, low)
}

/// What a stencil needs of 34 neighbouring pixels of one row: a value for each of the 32 inner ones, even and odd,
/// that counts above and below them, and one that counts beside them.
#[derive(Clone, Copy)]
struct Across {
    outer: [__m256i; 2],
    inner: [__m256i; 2],
}

/// A 3x3 stencil, summed over all inner pixels. `across` prepares a row, `down` adds what a row and the two around it
/// make to the even and odd sums, at most 2³² / (`BATCH` · [`ROWS`]) to each lane; `rest` is the portable kernel.
#[inline]
#[target_feature(enable = "avx2")]
fn stencil<const BATCH: usize>(
    plane: &Plane<'_, u8>,
    across: impl Fn(&[u8; 34]) -> Across,
    down: impl Fn([__m256i; 2], [Across; 3]) -> [__m256i; 2],
    rest: impl Fn([&[u8]; 3]) -> u64,
) -> u128 {
    let (mut y, mut sum) = (0, 0u128);
    while y + BAND <= plane.height() {
        sum += u128::from(stencil_band::<BAND, BATCH>(plane.band(y), &across, &down, &rest));
        y += ROWS;
    }
    while y + 3 <= plane.height() {
        sum += u128::from(stencil_band::<3, BATCH>(plane.band(y), &across, &down, &rest));
        y += 1;
    }
    sum
}

/// [`stencil`] over the inner rows of one band.
#[inline]
#[target_feature(enable = "avx2")]
fn stencil_band<const BAND: usize, const BATCH: usize>(
    rows: [&[u8]; BAND],
    across: impl Fn(&[u8; 34]) -> Across,
    down: impl Fn([__m256i; 2], [Across; 3]) -> [__m256i; 2],
    rest: impl Fn([&[u8]; 3]) -> u64,
) -> u64 {
    let (batches, left) = batches::<34, BATCH>(rows[0].len());
    let mut sum: u64 = rows.array_windows().map(|three: &[&[u8]; 3]| rest(three.map(|row| &row[left..]))).sum();
    for batch in batches {
        let mut sums = [_mm256_setzero_si256(); 2];
        for x in batch {
            let [mut above, mut here] = [across(window(rows[0], x)), across(window(rows[1], x))];
            for row in &rows[2..] {
                let below = across(window(row, x));
                sums = down(sums, [above, here, below]);
                (above, here) = (here, below);
            }
        }
        sum += total(sums[0]) + total(sums[1]);
    }
    sum
}

/// See [`portable::tenengrad`].
#[target_feature(enable = "avx2")]
pub fn tenengrad(plane: &Plane<'_, u8>) -> u128 {
    stencil::<BATCH>(
        plane,
        |w| {
            let [ab, bc, cd] = [load::<0, 34>(w), load::<1, 34>(w), load::<2, 34>(w)].map(|v| pairs(v, 1, 1));
            // (b+c) ± (a+b) is a smoothing a+2b+c, and a difference c−a.
            Across {
                outer: [_mm256_add_epi16(bc, ab), _mm256_add_epi16(cd, bc)],
                inner: [_mm256_sub_epi16(bc, ab), _mm256_sub_epi16(cd, bc)],
            }
        },
        |sums, [u, c, d]| {
            std::array::from_fn(|k| {
                let gy = _mm256_sub_epi16(d.outer[k], u.outer[k]);
                let (upper, lower) =
                    (_mm256_add_epi16(u.inner[k], c.inner[k]), _mm256_add_epi16(c.inner[k], d.inner[k]));
                add_squares(add_squares(sums[k], _mm256_add_epi16(upper, lower)), gy)
            })
        },
        portable::tenengrad_of_rows,
    )
}

/// See [`portable::laplacian`].
#[target_feature(enable = "avx2")]
pub fn laplacian(plane: &Plane<'_, u8>) -> u128 {
    stencil::<BATCH>(
        plane,
        |w| {
            let (left, mid, right) = (load::<0, 34>(w), load::<1, 34>(w), load::<2, 34>(w));
            Across {
                outer: [even(mid), odd(mid)],
                inner: [
                    _mm256_add_epi16(pairs(mid, -4, 1), even(left)),
                    _mm256_add_epi16(pairs(mid, 1, -4), odd(right)),
                ],
            }
        },
        |sums, [u, c, d]| {
            std::array::from_fn(|k| {
                add_squares(sums[k], _mm256_add_epi16(c.inner[k], _mm256_add_epi16(u.outer[k], d.outer[k])))
            })
        },
        portable::laplacian_of_rows,
    )
}

/// See [`portable::laplacian9`]. A term reaches 5,100², so a batch is short.
#[target_feature(enable = "avx2")]
pub fn laplacian9(plane: &Plane<'_, u8>) -> u128 {
    stencil::<8>(
        plane,
        |w| {
            let (left, mid, right) = (load::<0, 34>(w), load::<1, 34>(w), load::<2, 34>(w));
            let outer =
                [_mm256_add_epi16(pairs(mid, 4, 1), even(left)), _mm256_add_epi16(pairs(mid, 1, 4), odd(right))];
            // 4a − 20b + 4c = 4(a + 4b + c) − 36b
            let centre = [even(mid), odd(mid)].map(|v| _mm256_mullo_epi16(v, _mm256_set1_epi16(36)));
            let inner = std::array::from_fn(|k| _mm256_sub_epi16(_mm256_slli_epi16::<2>(outer[k]), centre[k]));
            Across { outer, inner }
        },
        |sums, [u, c, d]| {
            std::array::from_fn(|k| {
                add_squares(sums[k], _mm256_add_epi16(c.inner[k], _mm256_add_epi16(u.outer[k], d.outer[k])))
            })
        },
        portable::laplacian9_of_rows,
    )
}

/// See [`portable::modified_laplacian`].
#[target_feature(enable = "avx2")]
pub fn modified_laplacian(plane: &Plane<'_, u8>) -> u128 {
    stencil::<BATCH>(
        plane,
        |w| {
            let (left, mid, right) = (load::<0, 34>(w), load::<1, 34>(w), load::<2, 34>(w));
            let across =
                [_mm256_sub_epi16(pairs(mid, 2, -1), even(left)), _mm256_sub_epi16(pairs(mid, -1, 2), odd(right))];
            Across { outer: [even(mid), odd(mid)], inner: across.map(|v| _mm256_abs_epi16(v)) }
        },
        |sums, [u, c, d]| {
            std::array::from_fn(|k| {
                let twice = _mm256_add_epi16(c.outer[k], c.outer[k]);
                let along = _mm256_sub_epi16(twice, _mm256_add_epi16(u.outer[k], d.outer[k]));
                let both = _mm256_add_epi16(c.inner[k], _mm256_abs_epi16(along));
                add_products(sums[k], both, _mm256_set1_epi16(1))
            })
        },
        portable::modified_laplacian_of_rows,
    )
}
