//! The kernels in plain Rust: for 16-bit pixels, for processors without AVX2, and for the ends of rows that vectors
//! leave over. Inlined into callers with AVX2 they are compiled for it, with the same integer sums.

use super::plane::{Pixel, Plane};

/// (Σ I, Σ I²) over all pixels.
#[inline(always)]
pub fn moments<P: Pixel>(plane: &Plane<'_, P>) -> (u128, u128) {
    plane.rows().map(moments_of_row).fold((0, 0), |(s, q), (a, b)| (s + u128::from(a), q + u128::from(b)))
}

#[inline(always)]
pub fn moments_of_row<P: Pixel>(row: &[P]) -> (u64, u64) {
    let (mut sum, mut squares) = (0u64, 0u64);
    for &p in row {
        let value: u64 = p.into();
        sum += value;
        squares += value * value;
    }
    (sum, squares)
}

/// (smallest, largest) value.
#[inline(always)]
pub fn extremes<P: Pixel>(plane: &Plane<'_, P>) -> (u32, u32) {
    let first = plane.row(0)[0];
    let (mut low, mut high) = (first, first);
    for row in plane.rows() {
        for &p in row {
            low = low.min(p);
            high = high.max(p);
        }
    }
    (low.into(), high.into())
}

/// Σ max(I − floor, 0).
#[inline(always)]
pub fn excess<P: Pixel>(plane: &Plane<'_, P>, floor: u32) -> u128 {
    plane.rows().map(|row| u128::from(excess_of_row(row, floor))).sum()
}

#[inline(always)]
pub fn excess_of_row<P: Pixel>(row: &[P], floor: u32) -> u64 {
    row.iter().map(|&p| u64::from(Into::<u32>::into(p).saturating_sub(floor))).sum()
}

/// Σ (I(x+2) − I(x))² over all x that have both.
#[inline(always)]
pub fn brenner<P: Pixel>(plane: &Plane<'_, P>) -> u128 {
    plane.rows().map(|row| u128::from(brenner_of_row(row))).sum()
}

#[inline(always)]
pub fn brenner_of_row<P: Pixel>(row: &[P]) -> u64 {
    row.iter().zip(row.iter().skip(2)).map(|(&a, &b)| P::square(Into::<i32>::into(b) - Into::<i32>::into(a))).sum()
}

/// Σ I(x)·(I(x+1) − I(x+2)) over all x that have all three.
#[inline(always)]
pub fn vollath4<P: Pixel>(plane: &Plane<'_, P>) -> i128 {
    plane.rows().map(|row| i128::from(vollath4_of_row(row))).sum()
}

#[inline(always)]
pub fn vollath4_of_row<P: Pixel>(row: &[P]) -> i64 {
    let Some(count) = row.len().checked_sub(2) else { return 0 };
    let (here, next, after) = (&row[..count], &row[1..][..count], &row[2..][..count]);
    let mut sum = 0i64;
    for x in 0..count {
        let [a, b, c]: [i32; 3] = [here[x], next[x], after[x]].map(Into::into);
        sum += i64::from(a) * i64::from(b - c);
    }
    sum
}

/// Σ I(x)·I(x+1), Σ I(x), Σ I(x+1) over all x that have both.
#[inline(always)]
pub fn vollath5<P: Pixel>(plane: &Plane<'_, P>) -> [u128; 3] {
    let mut all = [0u128; 3];
    for row in plane.rows() {
        add_vollath5(&mut all, row, vollath5_of_row(row));
    }
    all
}

/// Adds a row's [`vollath5_of_row`] to the sums of [`vollath5`]: its last pixel is nobody's left neighbour, its first
/// nobody's right one.
#[inline(always)]
pub fn add_vollath5<P: Pixel>(all: &mut [u128; 3], row: &[P], [products, sum]: [u64; 2]) {
    let [first, last]: [u64; 2] = [row[0].into(), row[row.len() - 1].into()];
    all[0] += u128::from(products);
    all[1] += u128::from(sum - last);
    all[2] += u128::from(sum - first);
}

/// Σ I(x)·I(x+1) over all x that have both; Σ I(x) over all x.
#[inline(always)]
pub fn vollath5_of_row<P: Pixel>(row: &[P]) -> [u64; 2] {
    let products = row.iter().zip(row.iter().skip(1)).map(|(&a, &b)| Into::<u64>::into(a) * Into::<u64>::into(b)).sum();
    [products, row.iter().map(|&p| Into::<u64>::into(p)).sum()]
}

/// A kernel over all pixels that have eight neighbours, and its part for three rows.
macro_rules! stencil {
    ($(#[$doc:meta])* $whole:ident, $of_rows:ident, $term:expr) => {
        $(#[$doc])*
        #[inline(always)]
        pub fn $whole<P: Pixel>(plane: &Plane<'_, P>) -> u128 {
            (2..plane.height()).map(|y| u128::from($of_rows(plane.band(y - 2)))).sum()
        }

        #[inline(always)]
        pub fn $of_rows<P: Pixel>(rows: [&[P]; 3]) -> u64 {
            inner(rows, $term)
        }
    };
}

stencil!(
    /// Σ Gx² + Gy² of the 3x3 Sobel operator over all inner pixels.
    tenengrad, tenengrad_of_rows, |[u, c, d]| {
        let gx = (u[2] - u[0]) + 2 * (c[2] - c[0]) + (d[2] - d[0]);
        let gy = (d[0] + 2 * d[1] + d[2]) - (u[0] + 2 * u[1] + u[2]);
        P::square(gx) + P::square(gy)
    }
);
stencil!(
    /// Σ L² of the Laplacian [0 1 0; 1 −4 1; 0 1 0] over all inner pixels.
    laplacian, laplacian_of_rows, |[u, c, d]| P::square(u[1] + d[1] + c[0] + c[2] - 4 * c[1])
);
stencil!(
    /// Σ L² of the Laplacian [1 4 1; 4 −20 4; 1 4 1] over all inner pixels.
    laplacian9, laplacian9_of_rows, |[u, c, d]| {
        P::square(u[0] + u[2] + d[0] + d[2] + 4 * (u[1] + d[1] + c[0] + c[2]) - 20 * c[1])
    }
);
stencil!(
    /// Σ |2I − I(x−1) − I(x+1)| + |2I − I(y−1) − I(y+1)| over all inner pixels.
    modified_laplacian, modified_laplacian_of_rows, |[u, c, d]| {
        u64::from((2 * c[1] - c[0] - c[2]).unsigned_abs() + (2 * c[1] - u[1] - d[1]).unsigned_abs())
    }
);

/// The sum of `term` over the inner pixels of the middle one of three rows; `term` gets the 3x3 around each.
#[inline(always)]
fn inner<P: Pixel>([u, c, d]: [&[P]; 3], term: impl Fn([[i32; 3]; 3]) -> u64) -> u64 {
    let Some(count) = c.len().checked_sub(2) else { return 0 };
    // Nine slices of one known length: no bounds are left to check inside the loop, so it becomes vectors.
    let (u0, u1, u2) = (&u[..count], &u[1..][..count], &u[2..][..count]);
    let (c0, c1, c2) = (&c[..count], &c[1..][..count], &c[2..][..count]);
    let (d0, d1, d2) = (&d[..count], &d[1..][..count], &d[2..][..count]);
    let mut sum = 0;
    for x in 0..count {
        sum +=
            term([[u0[x], u1[x], u2[x]], [c0[x], c1[x], c2[x]], [d0[x], d1[x], d2[x]]].map(|row| row.map(Into::into)));
    }
    sum
}

/// The sum of the Laplacian [0 1 0; 1 −4 1; 0 1 0] over all inner pixels: second differences telescope, so only
/// the pixels along the border remain.
#[inline(always)]
pub fn laplacian_total<P: Pixel>(plane: &Plane<'_, P>) -> i128 {
    let (width, height) = (plane.width(), plane.height());
    let slope = |from: P, to: P| i128::from(Into::<i32>::into(to) - Into::<i32>::into(from));
    let mut total = 0;
    for y in 1..height - 1 {
        let row = plane.row(y);
        total += slope(row[width - 2], row[width - 1]) - slope(row[0], row[1]);
    }
    let [top, below] = plane.band(0);
    let [above, bottom] = plane.band(height - 2);
    for x in 1..width - 1 {
        total += slope(above[x], bottom[x]) - slope(top[x], below[x]);
    }
    total
}

/// (Σ I², Σ (a+b+c+d)²) over whole 2x2 blocks from the top left: the energy, and four times that of the Haar low-pass.
#[inline(always)]
pub fn haar<P: Pixel>(plane: &Plane<'_, P>) -> (u128, u128) {
    let (mut squares, mut low) = (0u128, 0u128);
    for y in (1..plane.height()).step_by(2) {
        let [top, bottom] = plane.band(y - 1);
        let (s, l) = haar_of_rows(top, bottom);
        squares += u128::from(s);
        low += u128::from(l);
    }
    (squares, low)
}

#[inline(always)]
pub fn haar_of_rows<P: Pixel>(top: &[P], bottom: &[P]) -> (u64, u64) {
    let (mut squares, mut low) = (0, 0);
    for (t, b) in top.chunks_exact(2).zip(bottom.chunks_exact(2)) {
        let block: [i32; 4] = [t[0].into(), t[1].into(), b[0].into(), b[1].into()];
        squares += block.map(P::square).iter().sum::<u64>();
        low += P::square(block.iter().sum());
    }
    (squares, low)
}
