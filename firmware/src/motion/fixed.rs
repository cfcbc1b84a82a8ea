//! Numbers with 32 bits behind the point, and single precision beside them: the step interrupt's arithmetic. The same bits
//! on every machine. The conversions that a compiler puts in between go through 64-bit software floats, several times as long.

/// (a · b) / 2⁶⁴, rounded down.
#[inline(always)]
pub fn mul_high(a: i64, b: u64) -> i64 {
    let (a0, a1) = (a as u32 as u64, a >> 32);
    let (b0, b1) = (b as u32 as u64, b >> 32);
    let low = (a0 * b0) >> 32;
    let cross = a0 * b1 + low;
    let middle = a1 * b0 as i64 + (cross & 0xffff_ffff) as i64;
    a1 * b1 as i64 + (cross >> 32) as i64 + (middle >> 32)
}

/// a / b, rounded down, for 0 < b < 2¹⁶: three divisions of 32 bits, which the core has, instead of one of 64, which it has not.
#[inline(always)]
pub fn divide(a: u64, b: u32) -> u64 {
    let (high, low) = ((a >> 32) as u32, a as u32);
    let middle = (high % b) << 16 | low >> 16;
    let last = (middle % b) << 16 | (low & 0xffff);
    (u64::from(high / b) << 32) + (u64::from(middle / b) << 16) + u64::from(last / b)
}

/// 2^n for |n| ≤ 126.
#[inline(always)]
pub fn power(n: i32) -> f32 {
    f32::from_bits(((127 + n) as u32) << 23)
}

/// x as x · 2³², for |x| < 2³¹; what lies beyond becomes about 2³¹.
#[inline(always)]
pub fn fixed(x: f32) -> i64 {
    let whole = x as i32;
    let part = x - whole as f32;
    (i64::from(whole) << 32).wrapping_add(i64::from((part * power(31)) as i32) << 1)
}

/// The nearest single, or the one beside it, to x = `fixed` · 2³².
#[inline(always)]
pub fn unfixed(x: u64) -> f32 {
    ((x >> 32) as u32) as f32 + (x as u32) as f32 * power(-32)
}

/// The nearest single to a small number; to 32 leading bits less than that to a large one.
#[inline(always)]
pub fn single(x: i64) -> f32 {
    match i32::try_from(x) {
        Ok(small) => small as f32,
        Err(_) => (x >> 32) as i32 as f32 * power(32) + (x as u32) as f32,
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_product_is_that_of_128_bits(a in any::<i64>(), b in any::<u64>()) {
            prop_assert_eq!(i128::from(mul_high(a, b)), (i128::from(a) * i128::from(b)) >> 64);
        }

        #[test]
        fn a_quotient_is_that_of_64_bits(a in any::<u64>(), b in 1u32..65_536) {
            prop_assert_eq!(divide(a, b), a / u64::from(b));
        }

        #[test]
        fn fixed_is_what_it_says(x in prop_oneof![-2e9f32..2e9, -1e4f32..1e4, -1f32..1.0, -1e-6f32..1e-6]) {
            let exact = (f64::from(x) * 4_294_967_296.0) as i64;
            prop_assert!((exact - fixed(x)).abs() <= 1, "{} is not {}", fixed(x), exact);
        }

        #[test]
        fn singles_are_near(x in prop_oneof![any::<i64>(), -(1i64 << 36)..1 << 36, -100_000i64..100_000]) {
            let exact = x as f64;
            prop_assert!((f64::from(single(x)) - exact).abs() <= exact.abs() * 1.2e-7);
            let u = x.unsigned_abs();
            prop_assert!((f64::from(unfixed(u)) * 4_294_967_296.0 - u as f64).abs() <= u as f64 * 1.2e-7);
        }
    }
}
