//! How long a detection takes in a large picture.

use parfocal::picture::Picture;
use parfocal::tip::{Expect, detect};
use parfocal_simulator::scene::{Ranges, Show};
use serde::Serialize;
use std::fmt;
use std::hint::black_box;
use std::time::Instant;

/// Columns and rows.
const PICTURE_PX: [usize; 2] = [1920, 1080];

/// Each picture is looked at this often: the quickest time is the one that nothing else on the machine disturbed.
const TIMES: usize = 5;

/// Times of a detection on one thread.
#[derive(Serialize)]
pub struct Speed {
    picture_px: [usize; 2],
    pictures: usize,
    median_ms: f64,
    most_ms: f64,
}

impl Speed {
    /// Looks for the tips of `pictures` scenes, as dense with cells and debris as the smaller ones.
    pub fn measure(ranges: &Ranges, pictures: u64, seed: u64) -> anyhow::Result<Option<Self>> {
        let [width, height] = ranges.picture_px;
        let denser = (PICTURE_PX[0] * PICTURE_PX[1]) as f64 / (width * height) as f64;
        let specks = ranges.specks.map(|n| (n as f64 * denser).round() as usize);
        let ranges = Ranges { picture_px: PICTURE_PX, specks, ..ranges.clone() };
        let mut quickest = Vec::new();
        for seed in seed..seed + pictures {
            let picture: Picture = super::picture_of(&ranges.draw(Show::Tip, seed))?;
            let times = (0..TIMES).map(|_| {
                let start = Instant::now();
                black_box(detect(&picture.view(), &Expect::default()));
                start.elapsed().as_secs_f64() * 1e3
            });
            quickest.push(times.fold(f64::INFINITY, f64::min));
        }
        quickest.sort_by(f64::total_cmp);
        let Some(most_ms) = quickest.last().copied() else { return Ok(None) };
        let median_ms = quickest[quickest.len() / 2];
        Ok(Some(Self { picture_px: PICTURE_PX, pictures: quickest.len(), median_ms, most_ms }))
    }
}

impl fmt::Display for Speed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [width, height] = self.picture_px;
        writeln!(
            f,
            "a detection in a {width}x{height} picture takes {:.1} ms, at most {:.1} ms ({} pictures, the quickest of {TIMES} times each)",
            self.median_ms, self.most_ms, self.pictures
        )
    }
}
