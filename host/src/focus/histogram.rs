//! How often each grey level occurs.
//!
//! A processor counts one thing a cycle at best, and waits for a count that it has only just stored. So what is counted
//! depends on the picture: where neighbours are alike, pairs of pixels, two for one count, in a table of which only the part
//! near its diagonal is used and stays in the cache; elsewhere single pixels, in several tables, so that equal pixels need
//! not wait for each other. Both give the same counts.

use super::simd::{Pixel, Plane};

/// Tables side by side for single 8-bit pixels.
const TABLES: usize = 8;

/// Pixels from which on pairs are worth the table of [`PAIRS`].
const MANY: usize = 1 << 17;

/// Pairs of 8-bit pixels.
const PAIRS: usize = 1 << 16;

/// Rows at which is looked before choosing, and eights of pixels in each.
const SAMPLE: (usize, usize) = (16, 64);

/// Mean difference of neighbours up to which pairs are near the diagonal,
const ALIKE: usize = 24;

/// and the share of pairs that repeat the one before, 1/4, from which on they would wait for each other.
const REPEATING: usize = 4;

/// Occurrences of each grey level, from 0.
pub fn histogram<P: Pixel>(plane: &Plane<'_, P>) -> Vec<u64> {
    match P::bytes(plane) {
        Some(bytes) if bytes.area() >= MANY && suits_pairs(bytes) => by_pairs(bytes),
        Some(bytes) => by_pixels(bytes),
        None => {
            let mut counts = vec![0u64; P::LEVELS];
            for row in plane.rows() {
                for &p in row {
                    counts[Into::<u32>::into(p) as usize] += 1;
                }
            }
            counts
        }
    }
}

/// Whether neighbours are alike, but pairs are not all the same, by a sample.
fn suits_pairs(plane: &Plane<'_, u8>) -> bool {
    let (mut pairs, mut repeated, mut difference) = (0usize, 0usize, 0usize);
    for row in plane.rows().step_by(plane.height().div_ceil(SAMPLE.0)) {
        let eights = row.as_chunks::<8>().0;
        for [a, b, c, d, ..] in eights.iter().step_by(eights.len().div_ceil(SAMPLE.1).max(1)) {
            pairs += 1;
            repeated += usize::from([a, b] == [c, d]);
            difference += usize::from(a.abs_diff(*b));
        }
    }
    difference < ALIKE * pairs && repeated * REPEATING < pairs
}

fn by_pairs(plane: &Plane<'_, u8>) -> Vec<u64> {
    let mut total = vec![0u64; 256];
    let mut table = vec![0u32; PAIRS];
    let mut counted = 0usize;
    for row in plane.rows() {
        // Rows of less than 2³¹ pixels keep every 32-bit count from running over.
        if counted + row.len() > 1 << 31 {
            drain_pairs(&mut table, &mut total);
            counted = 0;
        }
        counted += row.len();
        let table: &mut [u32; PAIRS] = table.first_chunk_mut().expect("a table of all pairs");
        let (eights, rest) = row.as_chunks::<8>();
        for eight in eights {
            let mut word = u64::from_le_bytes(*eight);
            for _ in 0..4 {
                table[(word & 0xffff) as usize] += 1;
                word >>= 16;
            }
        }
        for &p in rest {
            total[usize::from(p)] += 1;
        }
    }
    drain_pairs(&mut table, &mut total);
    total
}

/// The pairs of one first and of one second pixel, from the lower bits, belong to that pixel's level.
fn drain_pairs(table: &mut [u32], total: &mut [u64]) {
    for (second, firsts) in table.as_chunks_mut::<256>().0.iter_mut().enumerate() {
        let mut sum = 0;
        for (count, sum_of_first) in firsts.iter_mut().zip(&mut *total) {
            let count = u64::from(std::mem::take(count));
            *sum_of_first += count;
            sum += count;
        }
        total[second] += sum;
    }
}

fn by_pixels(plane: &Plane<'_, u8>) -> Vec<u64> {
    let mut tables = [[0u32; 256]; TABLES];
    let mut total = vec![0u64; 256];
    let mut counted = 0usize;
    for row in plane.rows() {
        // As above.
        if counted + row.len() > 1 << 31 {
            drain(&mut tables, &mut total);
            counted = 0;
        }
        counted += row.len();
        let (eights, rest) = row.as_chunks::<TABLES>();
        for eight in eights {
            // One load of eight pixels instead of eight.
            let mut word = u64::from_le_bytes(*eight);
            for table in &mut tables {
                table[(word & 0xff) as usize] += 1;
                word >>= 8;
            }
        }
        for &p in rest {
            tables[0][usize::from(p)] += 1;
        }
    }
    drain(&mut tables, &mut total);
    total
}

fn drain(tables: &mut [[u32; 256]; TABLES], total: &mut [u64]) {
    for table in tables {
        for (count, sum) in table.iter_mut().zip(&mut *total) {
            *sum += u64::from(std::mem::take(count));
        }
    }
}

/// −Σ p log₂ p, bits.
pub fn entropy(counts: &[u64], pixels: usize) -> f64 {
    let n = pixels as f64;
    // log₂ n − Σ c log₂ c / n: a single level gives exactly 0.
    let occupied = counts.iter().filter(|&&c| c > 0);
    let weighted: f64 = occupied.map(|&c| c as f64 * (c as f64).log2()).sum();
    (n.log2() - weighted / n).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Counted one by one.
    fn plainly(plane: &Plane<'_, u8>) -> Vec<u64> {
        let mut counts = vec![0; 256];
        plane.rows().flatten().for_each(|&p| counts[usize::from(p)] += 1);
        counts
    }

    proptest! {
        #[test]
        fn pairs_and_pixels_count_the_same(width in 1usize..70, height in 1usize..9, gap in 0usize..3, seed: u32, mask: u8) {
            let grey = |i: usize| ((i as u32 ^ seed).wrapping_mul(2_654_435_761) >> 11) as u8 & mask;
            let pixels: Vec<u8> = (0..(width + gap) * height).map(grey).collect();
            let plane = Plane::new(&pixels, width, height, width + gap);
            prop_assert_eq!(by_pairs(&plane), plainly(&plane));
            prop_assert_eq!(by_pixels(&plane), plainly(&plane));
        }
    }

    #[test]
    fn pictures_are_counted_the_way_that_suits_them() {
        let (width, height) = (512, 257);
        let suits = |grey: fn(usize) -> u8| {
            let pixels: Vec<u8> = (0..width * height).map(grey).collect();
            let plane = Plane::new(&pixels, width, height, width);
            assert_eq!(histogram(&plane), plainly(&plane));
            suits_pairs(&plane)
        };
        let noise = |i: usize| (i as u32).wrapping_mul(2_654_435_761) >> 12;
        assert!(!suits(|_| 9), "equal pairs wait for each other");
        assert!(suits(|i| (100.0 + 90.0 * (i as f64 / 40.0).sin()) as u8 ^ ((i * i) % 7) as u8));
        // Neighbours that have nothing to do with each other fill the whole table.
        let pixels: Vec<u8> = (0..width * height).map(|i| noise(i) as u8).collect();
        assert!(!suits_pairs(&Plane::new(&pixels, width, height, width)));
    }
}
