//! The Gaussian bell and its integral.

/// The standard normal density.
pub(super) fn gauss(u: f64) -> f64 {
    (-0.5 * u * u).exp() / std::f64::consts::TAU.sqrt()
}

/// The standard normal distribution, to 1.2e-7 (W. J. Cody's form of erfc as a Chebyshev fit, Press et al., Numerical Recipes §6.2).
pub(super) fn step(u: f64) -> f64 {
    let z = u.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.5 * z);
    let terms = [
        0.170_872_77,
        -0.822_152_23,
        1.488_515_87,
        -1.135_203_98,
        0.278_868_07,
        -0.186_288_06,
        0.096_784_18,
        0.374_091_96,
        1.000_023_68,
        -1.265_512_23,
    ];
    let power = terms.iter().fold(0.0, |sum, c| sum * t + c);
    let tail = 0.5 * t * (power - z * z).exp();
    if u < 0.0 { tail } else { 1.0 - tail }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_step_is_the_integral_of_the_bell() {
        let mut sum = 0.5;
        for k in 0..4000 {
            let u = f64::from(k) * 1e-3;
            assert!((step(u) - sum).abs() < 1e-6 && (step(-u) - (1.0 - sum)).abs() < 1e-6, "{u}: {} {sum}", step(u));
            sum += gauss(u + 5e-4) * 1e-3;
        }
    }
}
