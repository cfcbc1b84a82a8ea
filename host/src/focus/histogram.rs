//! How often each grey level occurs.

use super::simd::{Pixel, Plane};

/// Tables side by side for 8-bit pixels, so that a run of equal pixels need not wait for its own last count.
const TABLES: usize = 8;

/// Occurrences of each grey level, from 0.
pub fn histogram<P: Pixel>(plane: &Plane<'_, P>) -> Vec<u64> {
    match P::bytes(plane) {
        Some(bytes) => of_bytes(bytes),
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

fn of_bytes(plane: &Plane<'_, u8>) -> Vec<u64> {
    let mut tables = [[0u32; 256]; TABLES];
    let mut total = vec![0u64; 256];
    let mut counted = 0usize;
    for row in plane.rows() {
        // Rows of less than 2³¹ pixels keep every 32-bit count from running over.
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
