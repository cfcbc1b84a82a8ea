//! 3x3 stencils for 16-bit pixels: eight at a time as 32-bit numbers, their squares as 64-bit ones.

use super::super::plane::Plane;
use super::stencils::{Stencil, sum};
use super::*;

/// Pixels of a window: eight results and their neighbours.
const N: usize = 10;

/// What a row contributes to the results above and below it, and to those in it.
#[derive(Clone, Copy)]
struct Across {
    outer: __m256i,
    inner: __m256i,
}

/// Left, middle and right pixels.
#[inline]
#[target_feature(enable = "avx2")]
fn three(w: &[u16; N]) -> [__m256i; 3] {
    [load_words::<0, N>(w), load_words::<1, N>(w), load_words::<2, N>(w)]
}

/// Drops the first `skip` results.
#[inline]
#[target_feature(enable = "avx2")]
fn lanes(skip: usize) -> __m256i {
    let skip = i32::try_from(skip).expect("at most eight");
    _mm256_cmpgt_epi32(_mm256_setr_epi32(1, 2, 3, 4, 5, 6, 7, 8), _mm256_set1_epi32(skip))
}

/// Squares of eight 32-bit numbers on top of four 64-bit sums.
#[inline]
#[target_feature(enable = "avx2")]
fn add_squares64(sums: __m256i, value: __m256i) -> __m256i {
    let odd = _mm256_srli_epi64::<32>(value);
    _mm256_add_epi64(sums, _mm256_add_epi64(_mm256_mul_epi32(value, value), _mm256_mul_epi32(odd, odd)))
}

#[inline]
#[target_feature(enable = "avx2")]
fn add(a: __m256i, b: __m256i) -> __m256i {
    _mm256_add_epi32(a, b)
}

#[inline]
#[target_feature(enable = "avx2")]
fn subtract(a: __m256i, b: __m256i) -> __m256i {
    _mm256_sub_epi32(a, b)
}

/// A kernel from what a row contributes, what three rows add, and the portable kernel.
macro_rules! stencil {
    ($(#[$doc:meta])* $name:ident, $across:expr, $add:expr, $rest:path) => {
        $(#[$doc])*
        #[target_feature(enable = "avx2")]
        pub fn $name(plane: &Plane<'_, u16>) -> u128 {
            let stencil = Stencil {
                across: $across,
                down: $add,
                mask: |skip| lanes(skip),
                finish: |sums| total64(sums),
                rest: $rest,
                zero: _mm256_setzero_si256(),
                // 64-bit sums take any row.
                batch: usize::MAX,
            };
            sum(plane, &stencil)
        }
    };
}

stencil!(
    /// See [`portable::tenengrad`].
    tenengrad,
    |w: &[u16; N]| {
        let [a, b, c] = three(w);
        Across { outer: add(add(a, c), add(b, b)), inner: subtract(c, a) }
    },
    |sums: __m256i, [u, c, d]: [Across; 3], mask: Option<__m256i>| {
        let gx = add(add(u.inner, c.inner), add(c.inner, d.inner));
        let gy = subtract(d.outer, u.outer);
        add_squares64(add_squares64(sums, keep(mask, gx)), keep(mask, gy))
    },
    portable::tenengrad_of_rows
);
stencil!(
    /// See [`portable::laplacian`].
    laplacian,
    |w: &[u16; N]| {
        let [a, b, c] = three(w);
        Across { outer: b, inner: subtract(add(a, c), _mm256_slli_epi32::<2>(b)) }
    },
    |sums: __m256i, [u, c, d]: [Across; 3], mask: Option<__m256i>| {
        add_squares64(sums, keep(mask, add(c.inner, add(u.outer, d.outer))))
    },
    portable::laplacian_of_rows
);
stencil!(
    /// See [`portable::laplacian9`].
    laplacian9,
    |w: &[u16; N]| {
        let [a, b, c] = three(w);
        let outer = add(add(a, c), _mm256_slli_epi32::<2>(b));
        // 4a − 20b + 4c = 4(a + 4b + c) − 36b
        let centre = add(_mm256_slli_epi32::<5>(b), _mm256_slli_epi32::<2>(b));
        Across { outer, inner: subtract(_mm256_slli_epi32::<2>(outer), centre) }
    },
    |sums: __m256i, [u, c, d]: [Across; 3], mask: Option<__m256i>| {
        add_squares64(sums, keep(mask, add(c.inner, add(u.outer, d.outer))))
    },
    portable::laplacian9_of_rows
);
stencil!(
    /// See [`portable::modified_laplacian`].
    modified_laplacian,
    |w: &[u16; N]| {
        let [a, b, c] = three(w);
        Across { outer: b, inner: _mm256_abs_epi32(subtract(add(b, b), add(a, c))) }
    },
    |sums: __m256i, [u, c, d]: [Across; 3], mask: Option<__m256i>| {
        let along = _mm256_abs_epi32(subtract(add(c.outer, c.outer), add(u.outer, d.outer)));
        let both = keep(mask, add(c.inner, along));
        let zero = _mm256_setzero_si256();
        let (low, high) = (_mm256_unpacklo_epi32(both, zero), _mm256_unpackhi_epi32(both, zero));
        _mm256_add_epi64(sums, _mm256_add_epi64(low, high))
    },
    portable::modified_laplacian_of_rows
);
