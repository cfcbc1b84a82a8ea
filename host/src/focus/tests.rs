use super::*;
use crate::picture::{Data, Picture, Roi};
use proptest::prelude::*;

/// The measure by its definition in floating-point, pixel by pixel: slow, simple, and none of the kernels' code.
fn by_definition(view: View<'_>, measure: Measure) -> f64 {
    let (w, h) = (view.width() as i64, view.height() as i64);
    let at = |x: i64, y: i64| f64::from(view.get(x as usize, y as usize).unwrap());
    // The mean of f over x in 0..w-right and y likewise, from `left` and `top` on.
    let mean = |x0: i64, x1: i64, y0: i64, y1: i64, f: &dyn Fn(i64, i64) -> f64| {
        let points = (y0..y1).flat_map(|y| (x0..x1).map(move |x| (x, y)));
        points.map(|(x, y)| f(x, y)).sum::<f64>() / ((x1 - x0) * (y1 - y0)) as f64
    };
    let all = |f: &dyn Fn(i64, i64) -> f64| mean(0, w, 0, h, f);
    let inner = |f: &dyn Fn(i64, i64) -> f64| mean(1, w - 1, 1, h - 1, f);
    let stencil = |x: i64, y: i64, weights: [[f64; 3]; 3]| -> f64 {
        (0..9).map(|k| weights[k / 3][k % 3] * at(x + (k % 3) as i64 - 1, y + (k / 3) as i64 - 1)).sum()
    };
    let mu = all(&at);
    let variance = all(&|x, y| (at(x, y) - mu).powi(2));
    match measure {
        Measure::Variance => variance,
        Measure::NormalisedVariance => {
            if mu > 0.0 {
                variance / mu
            } else {
                0.0
            }
        }
        Measure::Tenengrad => inner(&|x, y| {
            stencil(x, y, [[-1., 0., 1.], [-2., 0., 2.], [-1., 0., 1.]]).powi(2)
                + stencil(x, y, [[-1., -2., -1.], [0., 0., 0.], [1., 2., 1.]]).powi(2)
        }),
        Measure::Brenner => mean(0, w - 2, 0, h, &|x, y| (at(x + 2, y) - at(x, y)).powi(2)),
        Measure::SumModifiedLaplacian => inner(&|x, y| {
            stencil(x, y, [[0.; 3], [-1., 2., -1.], [0.; 3]]).abs()
                + stencil(x, y, [[0., -1., 0.], [0., 2., 0.], [0., -1., 0.]]).abs()
        }),
        Measure::VarianceOfLaplacian => {
            let l = |x, y| stencil(x, y, [[0., 1., 0.], [1., -4., 1.], [0., 1., 0.]]);
            let mean_l = inner(&l);
            inner(&|x, y| (l(x, y) - mean_l).powi(2))
        }
        Measure::EnergyOfLaplacian => {
            inner(&|x, y| stencil(x, y, [[1., 4., 1.], [4., -20., 4.], [1., 4., 1.]]).powi(2))
        }
        Measure::VollathF4 => {
            mean(0, w - 2, 0, h, &|x, y| at(x, y) * at(x + 1, y))
                - mean(0, w - 2, 0, h, &|x, y| at(x, y) * at(x + 2, y))
        }
        Measure::VollathF5 => {
            let (left, right) = (mean(0, w - 1, 0, h, &at), mean(1, w, 0, h, &at));
            mean(0, w - 1, 0, h, &|x, y| (at(x, y) - left) * (at(x + 1, y) - right))
        }
        Measure::Entropy => {
            let mut values: Vec<u16> =
                (0..h).flat_map(|y| (0..w).map(move |x| view.get(x as usize, y as usize).unwrap())).collect();
            values.sort_unstable();
            let of = |run: &[u16]| run.len() as f64 / (w * h) as f64;
            values.chunk_by(|a, b| a == b).map(|run| -of(run) * of(run).log2()).sum()
        }
        Measure::Range => {
            let fold = |f: fn(f64, f64) -> f64| {
                (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).map(|(x, y)| at(x, y)).reduce(f).unwrap()
            };
            fold(f64::max) - fold(f64::min)
        }
        Measure::ThresholdContent => all(&|x, y| (at(x, y) - mu.floor()).max(0.0)),
        Measure::WaveletRatio => {
            let (mut high, mut low) = (0.0, 0.0);
            for (y, x) in (0..h / 2).flat_map(|y| (0..w / 2).map(move |x| (2 * y, 2 * x))) {
                let [a, b, c, d] = [at(x, y), at(x + 1, y), at(x, y + 1), at(x + 1, y + 1)];
                low += (a + b + c + d).powi(2);
                high += (a + b - c - d).powi(2) + (a - b + c - d).powi(2) + (a - b - c + d).powi(2);
            }
            if low > 0.0 { high / low } else { 0.0 }
        }
    }
}

/// Pictures of all depths and contrasts, with a region that leaves an odd stride around it.
fn pictures() -> impl Strategy<Value = (Picture, Roi)> {
    (1usize..120, 1usize..26, 0usize..4, 0usize..3, 0u32..17, any::<u64>()).prop_map(|(w, h, x, y, bits, seed)| {
        let (width, height) = (w + x + seed as usize % 3, h + y);
        let mut state = seed | 1;
        let mut next = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) & ((1u64 << bits) - 1)) as u16
        };
        let n = width * height;
        let data = if seed & 2 == 0 {
            Data::Grey8((0..n).map(|_| next() as u8).collect())
        } else {
            Data::Grey16((0..n).map(|_| next()).collect())
        };
        (Picture { width, height, data }, Roi { x, y, width: w, height: h })
    })
}

proptest! {
    #[test]
    fn every_measure_is_what_its_definition_says((picture, roi) in pictures()) {
        let view = picture.view().crop(roi).unwrap();
        for m in Measure::ALL {
            let (w, h) = m.least();
            if roi.width < w || roi.height < h {
                prop_assert_eq!(measure(view, m), Err(FocusError::TooSmall { measure: m, width: roi.width, height: roi.height }));
                continue;
            }
            let (got, expected) = (measure(view, m).unwrap().0, by_definition(view, m));
            // The definition itself loses digits where large numbers cancel.
            let scale = expected.abs().max(if picture.view().bits() == 8 { 255f64 } else { 65_535f64 }.powi(2) * 1e-3);
            prop_assert!((got - expected).abs() <= 1e-9 * scale, "{} {}: {} instead of {}", m, roi, got, expected);
        }
    }

    #[test]
    fn the_same_picture_measures_the_same_at_8_and_at_16_bits((picture, roi) in pictures()) {
        let Data::Grey8(bytes) = &picture.data else { return Ok(()) };
        let wide = Picture::grey16(picture.width, picture.height, bytes.iter().map(|&b| b.into()).collect()).unwrap();
        for m in Measure::ALL {
            prop_assert_eq!(measure(picture.view().crop(roi).unwrap(), m), measure(wide.view().crop(roi).unwrap(), m));
        }
    }
}

#[test]
fn a_single_pixel_is_measured_or_refused_with_the_size_it_takes() {
    for data in [Data::Grey8(vec![7]), Data::Grey16(vec![40_000])] {
        let picture = Picture { width: 1, height: 1, data };
        for m in Measure::ALL {
            match measure(picture.view(), m) {
                Ok(FocusValue(phi)) => assert_eq!(phi, 0.0, "{m}: one pixel has no contrast"),
                Err(e) => assert!(e.to_string().contains("this one is 1x1"), "{e}"),
            }
        }
    }
}

#[test]
fn the_largest_contrast_overflows_nothing() {
    // Black and white stripes and checks of full scale, wide enough for many batches of vectors.
    for (w, h) in [(4_500, 24), (70_000, 3)] {
        for pattern in [|x: usize, _: usize| x % 4 < 2, |x: usize, y: usize| (x + y).is_multiple_of(2), |_, _| true] {
            let lit = |i: usize| pattern(i % w, i / w);
            let bytes = (0..w * h).map(|i| if lit(i) { 255 } else { 0 }).collect();
            let words = (0..w * h).map(|i| if lit(i) { 65_535 } else { 0 }).collect();
            for picture in [Picture::grey8(w, h, bytes).unwrap(), Picture::grey16(w, h, words).unwrap()] {
                for m in Measure::ALL {
                    let (got, expected) = (measure(picture.view(), m).unwrap().0, by_definition(picture.view(), m));
                    assert!(
                        (got - expected).abs() <= 1e-9 * expected.abs().max(1.0),
                        "{m}: {got} instead of {expected}"
                    );
                }
            }
        }
    }
}

#[test]
fn black_pictures_have_no_focus_and_no_nan() {
    let black = Picture::grey16(8, 8, vec![0; 64]).unwrap();
    for m in Measure::ALL {
        assert_eq!(measure(black.view(), m).unwrap().0, 0.0, "{m}");
    }
}
