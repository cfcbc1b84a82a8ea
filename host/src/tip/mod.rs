//! Finds the tip of a micropipette in a picture.

pub mod fit;
pub mod light;
pub mod model;
pub mod pyramid;
pub mod search;

pub fn prior() -> fit::Prior {
    fit::Prior {
        mean: [0.0, 0.0, 0.0, 3f64.ln(), 0.2f64.ln(), 0.0, 0.35f64.ln()],
        deviation: [f64::INFINITY, f64::INFINITY, f64::INFINITY, 0.6, 0.4, 20.0, 0.8],
    }
}
