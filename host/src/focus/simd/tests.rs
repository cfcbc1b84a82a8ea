use super::*;
use proptest::prelude::*;

/// Random pixels of `bits` bits with gaps between the rows.
fn plane<P: Pixel + TryFrom<u64>>(width: usize, height: usize, gap: usize, bits: u32, seed: u64) -> Vec<P> {
    let mut state = seed | 1;
    (0..(width + gap) * height)
        .map(|_| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let value = (state >> 33) & ((1 << bits) - 1);
            P::try_from(value).ok().expect("bits of this type")
        })
        .collect()
}

fn kernels_agree<P: Pixel>(plane: &Plane<'_, P>) {
    assert_eq!(moments(plane), portable::moments(plane));
    assert_eq!(extremes(plane), portable::extremes(plane));
    for floor in [0, 1, 100, 255, 256, 40_000, 65_535] {
        assert_eq!(excess(plane, floor), portable::excess(plane, floor), "above {floor}");
    }
    assert_eq!(brenner(plane), portable::brenner(plane));
    assert_eq!(vollath4(plane), portable::vollath4(plane));
    assert_eq!(vollath5(plane), portable::vollath5(plane));
    assert_eq!(tenengrad(plane), portable::tenengrad(plane));
    assert_eq!(laplacian(plane), portable::laplacian(plane));
    assert_eq!(laplacian9(plane), portable::laplacian9(plane));
    assert_eq!(modified_laplacian(plane), portable::modified_laplacian(plane));
    assert_eq!(haar(plane), portable::haar(plane));
}

proptest! {
    #[test]
    fn vectors_give_the_same_sums_bit_for_bit(
        width in 1usize..300, height in 1usize..24, gap in 0usize..9, bits in 0u32..=16, seed: u64,
    ) {
        let bytes: Vec<u8> = plane(width, height, gap, bits.min(8), seed);
        kernels_agree(&Plane::new(&bytes, width, height, width + gap));
        let words: Vec<u16> = plane(width, height, gap, bits, seed);
        kernels_agree(&Plane::new(&words, width, height, width + gap));
    }
}

#[test]
fn rows_of_many_batches_at_full_contrast_agree() {
    for width in [2_080, 2_448, 4_133] {
        let bytes: Vec<u8> = plane::<u8>(width, 19, 0, 1, 7).iter().map(|&b| b * 255).collect();
        kernels_agree(&Plane::new(&bytes, width, 19, width));
        let words: Vec<u16> = plane::<u16>(width, 19, 0, 1, 7).iter().map(|&w| w * 65_535).collect();
        kernels_agree(&Plane::new(&words, width, 19, width));
    }
    for value in [0u16, 32_767, 32_768, 65_535] {
        kernels_agree(&Plane::new(&vec![value; 3 * 9_000], 9_000, 3, 9_000));
    }
}
