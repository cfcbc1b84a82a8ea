//! 3x3 stencils for 8-bit pixels, and the way down a band of rows that all stencils share.

use super::super::plane::{Pixel, Plane};
use super::*;

/// Rows of output a stencil makes in one go, and the rows of pixels which that takes.
const ROWS: usize = 8;
const BAND: usize = ROWS + 2;
/// Vectors of a row, [`ROWS`] deep, after which 32-bit sums move on into 64-bit ones.
const BATCH: usize = 64;

/// The functions that make a stencil of windows of `N` pixels, which give `N - 2` results.
///
/// `across` prepares what a row's window contributes to results above, beside and below it; `down` adds the results of
/// three neighbouring rows to sums, as far as the mask keeps them; `mask` drops the first results of a window; `finish` says what
/// sums amount to; `rest` is the portable kernel.
pub(super) struct Stencil<Across, Down, Mask, Finish, Rest, S> {
    pub across: Across,
    pub down: Down,
    pub mask: Mask,
    pub finish: Finish,
    pub rest: Rest,
    pub zero: S,
    /// Vectors of a row, [`ROWS`] rows deep, that the sums can take.
    pub batch: usize,
}

/// The stencil's sum over all inner pixels.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn sum<P: Pixel, A: Copy, S: Copy, M: Copy, const N: usize>(
    plane: &Plane<'_, P>,
    stencil: &Stencil<
        impl Fn(&[P; N]) -> A,
        impl Fn(S, [A; 3], Option<M>) -> S,
        impl Fn(usize) -> M,
        impl Fn(S) -> u64,
        impl Fn([&[P]; 3]) -> u64,
        S,
    >,
) -> u128 {
    let (mut y, mut sum) = (0, 0u128);
    // While a band is in work the next one is on its way from memory.
    let below = ROWS * plane.stride() * size_of::<P>();
    while y + BAND <= plane.height() {
        sum += u128::from(sum_of_band::<P, A, S, M, N, BAND>(plane.band(y), below, stencil));
        y += ROWS;
    }
    while y + 3 <= plane.height() {
        sum += u128::from(sum_of_band::<P, A, S, M, N, 3>(plane.band(y), 0, stencil));
        y += 1;
    }
    sum
}

/// The stencil's sum over the inner rows of a band; what lies `below` bytes further on is fetched ahead.
#[inline]
#[target_feature(enable = "avx2")]
fn sum_of_band<P: Pixel, A: Copy, S: Copy, M: Copy, const N: usize, const BAND: usize>(
    rows: [&[P]; BAND],
    below: usize,
    stencil: &Stencil<
        impl Fn(&[P; N]) -> A,
        impl Fn(S, [A; 3], Option<M>) -> S,
        impl Fn(usize) -> M,
        impl Fn(S) -> u64,
        impl Fn([&[P]; 3]) -> u64,
        S,
    >,
) -> u64 {
    let Some(cut) = Cut::new(rows[0].len(), N - 2, N) else {
        return rows.array_windows().map(|three| (stencil.rest)(*three)).sum();
    };
    let column = |mut sums: S, x: usize, mask: Option<M>| {
        let mut above = (stencil.across)(window(rows[0], x));
        let mut here = (stencil.across)(window(rows[1], x));
        for row in &rows[2..] {
            prefetch(&row[x], below);
            let below = (stencil.across)(window(row, x));
            sums = (stencil.down)(sums, [above, here, below], mask);
            (above, here) = (here, below);
        }
        sums
    };
    let mut sum = 0;
    for batch in cut.batches(stencil.batch) {
        let mut sums = stencil.zero;
        for x in batch {
            sums = column(sums, x, None);
        }
        sum += (stencil.finish)(sums);
    }
    if let Some((at, skip)) = cut.last {
        sum += (stencil.finish)(column(stencil.zero, at, Some((stencil.mask)(skip))));
    }
    sum
}

/// What a row contributes to the even and odd results above and below it, and to those in it.
#[derive(Clone, Copy)]
struct Across {
    outer: [__m256i; 2],
    inner: [__m256i; 2],
}

/// The masks for even and odd results.
#[inline]
#[target_feature(enable = "avx2")]
fn halves(skip: usize) -> [__m256i; 2] {
    let bytes = mask(skip);
    [even(bytes), odd(bytes)].map(|m| _mm256_cmpgt_epi16(m, _mm256_setzero_si256()))
}

#[inline]
#[target_feature(enable = "avx2")]
fn totals([even, odd]: [__m256i; 2]) -> u64 {
    total(even) + total(odd)
}

/// See [`portable::tenengrad`].
#[target_feature(enable = "avx2")]
pub fn tenengrad(plane: &Plane<'_, u8>) -> u128 {
    let stencil = Stencil {
        across: |w: &[u8; 34]| {
            let [ab, bc, cd] = [load::<0, 34>(w), load::<1, 34>(w), load::<2, 34>(w)].map(|v| pairs(v, 1, 1));
            // (b+c) ± (a+b) is a smoothing a+2b+c, and a difference c−a.
            Across {
                outer: [_mm256_add_epi16(bc, ab), _mm256_add_epi16(cd, bc)],
                inner: [_mm256_sub_epi16(bc, ab), _mm256_sub_epi16(cd, bc)],
            }
        },
        down: |sums: [__m256i; 2], [u, c, d]: [Across; 3], mask: Option<[__m256i; 2]>| {
            std::array::from_fn(|k| {
                let mask = mask.map(|m| m[k]);
                let gy = _mm256_sub_epi16(d.outer[k], u.outer[k]);
                let (upper, lower) =
                    (_mm256_add_epi16(u.inner[k], c.inner[k]), _mm256_add_epi16(c.inner[k], d.inner[k]));
                let gx = _mm256_add_epi16(upper, lower);
                add_squares(add_squares(sums[k], keep(mask, gx)), keep(mask, gy))
            })
        },
        mask: |skip| halves(skip),
        finish: |sums| totals(sums),
        rest: portable::tenengrad_of_rows,
        zero: [_mm256_setzero_si256(); 2],
        // A lane gains at most 4 · 1,020² a row.
        batch: BATCH,
    };
    sum(plane, &stencil)
}

/// A Laplacian's sum of squares: what is beside a result, and what is above and below, only have to be added.
macro_rules! laplacian {
    ($(#[$doc:meta])* $name:ident, $across:expr, $rest:path, $batch:expr) => {
        $(#[$doc])*
        #[target_feature(enable = "avx2")]
        pub fn $name(plane: &Plane<'_, u8>) -> u128 {
            let stencil = Stencil {
                across: $across,
                down: |sums: [__m256i; 2], [u, c, d]: [Across; 3], mask: Option<[__m256i; 2]>| {
                    std::array::from_fn(|k| {
                        let l = _mm256_add_epi16(c.inner[k], _mm256_add_epi16(u.outer[k], d.outer[k]));
                        add_squares(sums[k], keep(mask.map(|m| m[k]), l))
                    })
                },
                mask: |skip| halves(skip),
                finish: |sums| totals(sums),
                rest: $rest,
                zero: [_mm256_setzero_si256(); 2],
                batch: $batch,
            };
            sum(plane, &stencil)
        }
    };
}

laplacian!(
    /// See [`portable::laplacian`].
    laplacian,
    |w: &[u8; 34]| {
        let (left, mid, right) = (load::<0, 34>(w), load::<1, 34>(w), load::<2, 34>(w));
        Across {
            outer: [even(mid), odd(mid)],
            inner: [
                _mm256_add_epi16(pairs(mid, -4, 1), even(left)),
                _mm256_add_epi16(pairs(mid, 1, -4), odd(right)),
            ],
        }
    },
    portable::laplacian_of_rows,
    // A lane gains at most 2 · 1,020² a row.
    BATCH
);
laplacian!(
    /// See [`portable::laplacian9`].
    laplacian9,
    |w: &[u8; 34]| {
        let (left, mid, right) = (load::<0, 34>(w), load::<1, 34>(w), load::<2, 34>(w));
        let outer =
            [_mm256_add_epi16(pairs(mid, 4, 1), even(left)), _mm256_add_epi16(pairs(mid, 1, 4), odd(right))];
        // 4a − 20b + 4c = 4(a + 4b + c) − 36b
        let centre = [even(mid), odd(mid)].map(|v| _mm256_mullo_epi16(v, _mm256_set1_epi16(36)));
        let inner = std::array::from_fn(|k| _mm256_sub_epi16(_mm256_slli_epi16::<2>(outer[k]), centre[k]));
        Across { outer, inner }
    },
    portable::laplacian9_of_rows,
    // A lane gains at most 2 · 5,100² a row.
    8
);

/// See [`portable::modified_laplacian`].
#[target_feature(enable = "avx2")]
pub fn modified_laplacian(plane: &Plane<'_, u8>) -> u128 {
    let stencil = Stencil {
        across: |w: &[u8; 34]| {
            let (left, mid, right) = (load::<0, 34>(w), load::<1, 34>(w), load::<2, 34>(w));
            let across =
                [_mm256_sub_epi16(pairs(mid, 2, -1), even(left)), _mm256_sub_epi16(pairs(mid, -1, 2), odd(right))];
            Across { outer: [even(mid), odd(mid)], inner: across.map(|v| _mm256_abs_epi16(v)) }
        },
        down: |sums: [__m256i; 2], [u, c, d]: [Across; 3], mask: Option<[__m256i; 2]>| {
            std::array::from_fn(|k| {
                let twice = _mm256_add_epi16(c.outer[k], c.outer[k]);
                let along = _mm256_sub_epi16(twice, _mm256_add_epi16(u.outer[k], d.outer[k]));
                let both = _mm256_add_epi16(c.inner[k], _mm256_abs_epi16(along));
                add_products(sums[k], keep(mask.map(|m| m[k]), both), _mm256_set1_epi16(1))
            })
        },
        mask: |skip| halves(skip),
        finish: |sums| totals(sums),
        rest: portable::modified_laplacian_of_rows,
        zero: [_mm256_setzero_si256(); 2],
        batch: BATCH,
    };
    sum(plane, &stencil)
}
