//! A lens: pinhole with radial and tangential distortion (Brown 1966), as most calibration programs state it.

/// Focal lengths, principal point (px) and distortion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Focal length along x, px.
    pub fx: f64,
    /// Focal length along y, px.
    pub fy: f64,
    /// Principal point's column, px.
    pub cx: f64,
    /// Principal point's row, px.
    pub cy: f64,
    /// Radial distortion k1, k2, then tangential p1, p2.
    pub distortion: [f64; 4],
}

impl Lens {
    /// The pixel of the direction (x, y, 1).
    pub fn pixel(&self, d: [f64; 2]) -> [f64; 2] {
        let [x, y] = self.bend(d);
        [self.fx * x + self.cx, self.fy * y + self.cy]
    }

    /// The direction (x, y, 1) that a pixel looks in: [`Lens::pixel`] undone by Newton's method.
    pub fn ray(&self, px: [f64; 2]) -> [f64; 2] {
        let goal = [(px[0] - self.cx) / self.fx, (px[1] - self.cy) / self.fy];
        let mut d = goal;
        for _ in 0..4 {
            let step = 1e-6;
            let at = self.bend(d);
            let (along_x, along_y) = (self.bend([d[0] + step, d[1]]), self.bend([d[0], d[1] + step]));
            let slope = |p: [f64; 2], k: usize| (p[k] - at[k]) / step;
            let (a, b, c, e) = (slope(along_x, 0), slope(along_y, 0), slope(along_x, 1), slope(along_y, 1));
            let (u, v) = (goal[0] - at[0], goal[1] - at[1]);
            let whole = a * e - b * c;
            d = [d[0] + (u * e - v * b) / whole, d[1] + (v * a - u * c) / whole];
        }
        d
    }

    fn bend(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [k1, k2, p1, p2] = self.distortion;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * k2);
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ]
    }
}
