//! Roots that `core` lacks, from + − × ÷ alone: the same bits on every machine.

/// √x; 0 for what is not positive.
pub fn sqrt(x: f64) -> f64 {
    if !(x > 0.0 && x.is_finite()) {
        return 0.0;
    }
    // Half the exponent, then Newton: four rounds reach the last bits.
    let mut y = f64::from_bits((x.to_bits() >> 1) + (0x1ff8 << 48));
    for _ in 0..4 {
        y = 0.5 * (y + x / y);
    }
    y
}

/// ∛x for positive x; 0 otherwise.
pub fn cbrt(x: f64) -> f64 {
    if !(x > 0.0 && x.is_finite()) {
        return 0.0;
    }
    let mut y = f64::from_bits(x.to_bits() / 3 + (0x2a9f << 48));
    for _ in 0..5 {
        y = (2.0 * y + x / (y * y)) / 3.0;
    }
    y
}

/// The whole number at or below, for |x| < 2⁶³.
pub fn floor(x: f64) -> f64 {
    let whole = x as i64 as f64;
    if whole > x { whole - 1.0 } else { whole }
}

/// The whole number of ticks at or above.
pub fn ceil_ticks(x: f64) -> u64 {
    let whole = x as u64;
    if (whole as f64) < x { whole + 1 } else { whole }
}

/// acos(x) / 2π for x in 0..=1: turns from a cosine's top.
pub fn acos_turn(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    // acos x = 2 atan √((1−x)/(1+x)); twice halved, the series takes ten terms.
    let mut z = sqrt((1.0 - x) / (1.0 + x));
    for _ in 0..2 {
        z /= 1.0 + sqrt(1.0 + z * z);
    }
    let (square, mut sum) = (z * z, 0.0);
    for n in (0..14u32).rev() {
        let term = 1.0 / f64::from(2 * n + 1);
        sum = if n % 2 == 0 { term } else { -term } + square * sum;
    }
    8.0 * z * sum / core::f64::consts::TAU
}

/// cos(x · π/2) for x in 0..=1.
pub fn cos_quarter(x: f64) -> f64 {
    let square = x * x * core::f64::consts::FRAC_PI_2 * core::f64::consts::FRAC_PI_2;
    let mut sum = 1.0;
    for n in (1..13u32).rev() {
        sum = 1.0 - sum * square / f64::from(2 * n * (2 * n - 1));
    }
    sum
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn roots_are_exact_to_the_last_bits(x in prop_oneof![1e-30f64..1e-10, 1e-6f64..1e6, 1e10f64..1e30]) {
            prop_assert!((sqrt(x) / x.sqrt() - 1.0).abs() < 4e-16);
            prop_assert!((cbrt(x) / x.cbrt() - 1.0).abs() < 1e-15);
        }

        #[test]
        fn turns_are_exact(x in 0.0f64..1.0) {
            prop_assert!((acos_turn(x) * std::f64::consts::TAU - x.acos()).abs() < 1e-14);
        }

        #[test]
        fn cosines_are_exact(x in 0.0f64..1.0) {
            prop_assert!((cos_quarter(x) - (x * std::f64::consts::FRAC_PI_2).cos()).abs() < 1e-15);
        }

        #[test]
        fn floor_is_floor(x in -1e12f64..1e12) {
            prop_assert_eq!(floor(x), x.floor());
            prop_assert_eq!(ceil_ticks(x.abs()), x.abs().ceil() as u64);
        }
    }
}
