//! A map learned while moving: from where axes are to where the point shows, good enough to say where it will be next.
//! Some of what was seen may be something else altogether: the map is what most of it agrees on.

use crate::calibration::robust::{Map, Model, Settings, solve};
use nalgebra::SVector;

/// Pairs so far, and their affine map.
#[derive(Clone, Debug)]
pub struct Follow<const D: usize> {
    src: Vec<SVector<f64, D>>,
    dst: Vec<SVector<f64, D>>,
    tolerance: f64,
}

impl<const D: usize> Follow<D> {
    /// Pairs farther than `tolerance` from the map (in the target's unit) are taken for something else.
    pub fn new(tolerance: f64) -> Self {
        Self { src: Vec::new(), dst: Vec::new(), tolerance }
    }

    /// One more pair. It may be a wrong one: a map that began from wrong pairs gives way to the right ones as they become more.
    pub fn add(&mut self, src: SVector<f64, D>, dst: SVector<f64, D>) {
        self.src.push(src);
        self.dst.push(dst);
    }

    /// The affine map that most pairs agree on; `None` while they do not span every direction.
    pub fn map(&self) -> Option<Map<D>> {
        let n = self.src.len();
        if n <= D {
            return None;
        }
        let all = vec![true; n];
        // With one pair more than the map needs, nothing tells which is wrong.
        if n < D + 3 {
            return self.least_squares(&all);
        }
        let settings = Settings { tolerance: Some(self.tolerance), ..Settings::new(Model::Affine) };
        let agreed = solve(&self.src, &self.dst, &settings).ok().map(|solution| solution.inliers);
        self.least_squares(&agreed.unwrap_or(all))
    }

    fn least_squares(&self, used: &[bool]) -> Option<Map<D>> {
        // Around the mean, which keeps the equations well conditioned.
        let mean = self.src.iter().sum::<SVector<f64, D>>() / self.src.len() as f64;
        let src: Vec<_> = self.src.iter().map(|p| p - mean).collect();
        let chosen: Vec<usize> = (0..src.len()).filter(|i| used[*i]).collect();
        let map = Model::Affine.fit(&src, &self.dst, &chosen)?.map;
        let finite = map.linear.iter().chain(map.shift.iter()).all(|v| v.is_finite());
        finite.then(|| Map { linear: map.linear, shift: map.shift - map.linear * mean })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Vector2};

    #[test]
    fn it_says_where_the_point_will_be() {
        let (linear, shift) = (Matrix2::new(3.0, 0.1, 0.2, -3.1), Vector2::new(300.0, 200.0));
        let mut follow = Follow::new(1.0);
        for (x, y) in [(5000.0, 7000.0), (5010.0, 7000.0), (5000.0, 7010.0), (5012.0, 6995.0)] {
            assert!(follow.map().is_none() || follow.src.len() > 2);
            let p = Vector2::new(x, y);
            follow.add(p, linear * p + shift);
        }
        let p = Vector2::new(4950.0, 7020.0);
        assert!((follow.map().unwrap().apply(&p) - (linear * p + shift)).norm() < 1e-6);
    }

    #[test]
    fn a_wrong_pair_among_the_first_is_outvoted() {
        let (linear, shift) = (Matrix2::new(3.0, 0.1, 0.2, -3.1), Vector2::new(300.0, 200.0));
        let mut follow = Follow::new(5.0);
        let places = [(0.0, 0.0), (12.0, 0.0), (0.0, 12.0), (30.0, -20.0), (-25.0, 14.0), (8.0, 31.0), (-9.0, -28.0)];
        for (k, (x, y)) in places.into_iter().enumerate() {
            let p = Vector2::new(x, y);
            let wrong = if k == 1 { Vector2::new(70.0, -45.0) } else { Vector2::zeros() };
            follow.add(p, linear * p + shift + wrong);
        }
        let p = Vector2::new(50.0, 20.0);
        assert!((follow.map().unwrap().apply(&p) - (linear * p + shift)).norm() < 1e-6);
    }
}
