//! Finds the tip of a micropipette in a picture.

mod dual;
pub mod fit;
pub mod hypothesis;
pub mod light;
pub mod model;
pub mod pyramid;
pub mod search;
pub mod verify;
use crate::picture::View;

/// All that may be tips, best first.
pub fn hypotheses(view: &View<'_>, time: &mut [f64; 4]) -> Vec<hypothesis::Hypothesis> {
    let t = std::time::Instant::now();
    let mut levels = pyramid::levels(view);
    let light = light::Light::of(&levels[levels.len() - 1]);
    let noise = light::noise(&levels[0]);
    for level in &mut levels {
        light.flatten(level);
    }
    time[0] += t.elapsed().as_secs_f64();
    let t = std::time::Instant::now();
    let candidates = search::candidates(&levels, noise, 16, |_| true);
    time[1] += t.elapsed().as_secs_f64();
    let t = std::time::Instant::now();
    let mut found = hypothesis::coarse(&levels, noise, &candidates);
    time[2] += t.elapsed().as_secs_f64();
    let t = std::time::Instant::now();
    found.truncate(5);
    let f = hypothesis::fine(&levels, noise, &found);
    time[3] += t.elapsed().as_secs_f64();
    f
}
