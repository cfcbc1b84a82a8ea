//! Arithmetic that needs no software floats where it multiplies or divides by a power of two: most distances on a grid
//! are one. The results are the same to the bit.

const SIGN: u64 = 1 << 63;
const FRACTION: u64 = (1 << 52) - 1;
const BIAS: i32 = 1023;
const SPECIAL: i32 = 0x7FF;

/// a/b.
pub fn quotient(a: f64, b: f64) -> f64 {
    match power(b) {
        Some(n) => scaled(signed(a, b), -n),
        None => divided(a, b),
    }
}

/// a·b.
pub fn product(a: f64, b: f64) -> f64 {
    match power(b) {
        Some(n) => scaled(signed(a, b), n),
        None => multiplied(a, b),
    }
}

/// a/b by software. Like the others of its kind a function of its own: the compiler takes an operation for cheap, and would
/// do it in any case and then throw it away.
#[cold]
#[inline(never)]
pub fn divided(a: f64, b: f64) -> f64 {
    a / b
}

/// a·b by software.
#[cold]
#[inline(never)]
pub fn multiplied(a: f64, b: f64) -> f64 {
    a * b
}

/// a+b by software.
#[cold]
#[inline(never)]
pub fn added(a: f64, b: f64) -> f64 {
    a + b
}

/// 2a.
pub fn doubled(a: f64) -> f64 {
    scaled(a, 1)
}

/// a/2.
pub fn halved(a: f64) -> f64 {
    scaled(a, -1)
}

fn biased(x: f64) -> i32 {
    (x.to_bits() >> 52) as i32 & SPECIAL
}

/// The n of a number ±2ⁿ that a product can be shifted by.
fn power(x: f64) -> Option<i32> {
    let n = biased(x) - BIAS;
    // Far from the ends, where 2⁻ⁿ has a bit pattern of the same kind.
    (x.to_bits() & FRACTION == 0 && (-1000..1000).contains(&n)).then_some(n)
}

/// a with the sign of a·b.
fn signed(a: f64, b: f64) -> f64 {
    f64::from_bits(a.to_bits() ^ (b.to_bits() & SIGN))
}

/// a·2ⁿ.
fn scaled(a: f64, n: i32) -> f64 {
    let (from, to) = (biased(a), biased(a) + n);
    if from > 0 && from < SPECIAL && to > 0 && to < SPECIAL {
        f64::from_bits((a.to_bits() & !((SPECIAL as u64) << 52)) | (to as u64) << 52)
    } else {
        // Zero, and what is not normal or would not be.
        multiplied(a, f64::from_bits(((BIAS + n) as u64) << 52))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_same_to_the_bit(a in proptest::num::f64::ANY, n in -1022i32..1024, odd in any::<f64>(), negative: bool) {
            let power = f64::from_bits(((BIAS + n) as u64) << 52);
            for b in [odd, if negative { -power } else { power }] {
                let same = |x: f64, y: f64| x.to_bits() == y.to_bits() || (x.is_nan() && y.is_nan());
                prop_assert!(same(quotient(a, b), a / b), "{a} / {b}");
                prop_assert!(same(product(a, b), a * b), "{a} * {b}");
            }
            prop_assert!(a.is_nan() || doubled(a).to_bits() == (2.0 * a).to_bits());
            prop_assert!(a.is_nan() || halved(a).to_bits() == (0.5 * a).to_bits());
        }
    }
}
