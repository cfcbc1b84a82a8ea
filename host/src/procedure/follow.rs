//! A map learned while moving: from where axes are to where the point shows, good enough to say where it will be next.

use crate::calibration::robust::{Map, Model};
use nalgebra::SVector;

/// Pairs so far, and their affine map.
#[derive(Clone, Debug, Default)]
pub struct Follow<const D: usize> {
    src: Vec<SVector<f64, D>>,
    dst: Vec<SVector<f64, D>>,
}

impl<const D: usize> Follow<D> {
    /// One more pair.
    pub fn add(&mut self, src: SVector<f64, D>, dst: SVector<f64, D>) {
        self.src.push(src);
        self.dst.push(dst);
    }

    /// The least-squares affine map of all pairs; `None` while they do not span every direction.
    pub fn map(&self) -> Option<Map<D>> {
        if self.src.len() <= D {
            return None;
        }
        // Around the mean, which keeps the equations well conditioned.
        let mean = self.src.iter().sum::<SVector<f64, D>>() / self.src.len() as f64;
        let src: Vec<_> = self.src.iter().map(|p| p - mean).collect();
        let all: Vec<usize> = (0..src.len()).collect();
        let map = Model::Affine.fit(&src, &self.dst, &all)?.map;
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
        let mut follow = Follow::default();
        for (x, y) in [(5000.0, 7000.0), (5010.0, 7000.0), (5000.0, 7010.0), (5012.0, 6995.0)] {
            assert!(follow.map().is_none() || follow.src.len() > 2);
            let p = Vector2::new(x, y);
            follow.add(p, linear * p + shift);
        }
        let p = Vector2::new(4950.0, 7020.0);
        assert!((follow.map().unwrap().apply(&p) - (linear * p + shift)).norm() < 1e-6);
    }
}
