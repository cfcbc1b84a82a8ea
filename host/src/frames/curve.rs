//! A focus curve from a file, in place of a camera: to try a strategy on a curve that was measured elsewhere.

use parfocal_protocol::units::Micrometres;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// A focus curve Φ(z), linear between its points, times 1 + noise·g with g standard normal.
#[derive(Clone, Debug)]
pub struct Curve {
    points: Vec<(f64, f64)>,
    noise: f64,
    random: Pcg64,
}

/// Why a curve cannot be used.
#[derive(Debug, Error)]
pub enum CurveError {
    /// The file cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A line that is not two numbers.
    #[error("{} line {line}: {reason}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What is wrong.
        reason: String,
    },
    /// Fewer than two points.
    #[error("{}: a curve needs at least two lines below its header `z_um,phi`", .0.display())]
    TooShort(PathBuf),
    /// An option behind `?` that is not understood.
    #[error("'{0}' is no option of a curve: write curve:FILE.csv?noise=0.01&seed=1")]
    Option(String),
}

impl Curve {
    /// Reads `FILE.csv?noise=REL&seed=N`, columns `z_um,phi`; both options may be left out.
    ///
    /// # Errors
    /// [`CurveError`], with file and line.
    pub fn open(address: &str) -> Result<Self, CurveError> {
        let (file, options) = address.split_once('?').unwrap_or((address, ""));
        let (mut noise, mut seed) = (0.0, 0);
        for option in options.split('&').filter(|o| !o.is_empty()) {
            let bad = || CurveError::Option(option.into());
            match option.split_once('=').ok_or_else(bad)? {
                ("noise", value) => {
                    noise = value.parse().ok().filter(|n| (0.0..=1.0).contains(n)).ok_or_else(bad)?;
                }
                ("seed", value) => seed = value.parse().map_err(|_| bad())?,
                _ => return Err(bad()),
            }
        }
        Ok(Self { points: read(Path::new(file))?, noise, random: Pcg64::seed_from_u64(seed) })
    }

    /// z of the first and of the last point.
    pub fn extent(&self) -> (Micrometres, Micrometres) {
        (Micrometres(self.points[0].0), Micrometres(self.points[self.points.len() - 1].0))
    }

    /// The next frame's value at `z`; beyond the ends the end's value holds.
    pub fn value(&mut self, z: Micrometres) -> f64 {
        let exact = self.exact(z.0);
        if self.noise == 0.0 { exact } else { exact * (1.0 + self.noise * self.normal()) }
    }

    fn exact(&self, z: f64) -> f64 {
        let above = self.points.partition_point(|p| p.0 <= z);
        if above == 0 {
            return self.points[0].1;
        }
        let (z0, phi0) = self.points[above - 1];
        self.points.get(above).map_or(phi0, |(z1, phi1)| phi0 + (phi1 - phi0) * (z - z0) / (z1 - z0))
    }

    /// A standard normal number (Box and Muller, Ann. Math. Stat. 29, 610, 1958).
    fn normal(&mut self) -> f64 {
        let u: f64 = 1.0 - self.random.random::<f64>();
        let v: f64 = self.random.random();
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    }
}

fn read(path: &Path) -> Result<Vec<(f64, f64)>, CurveError> {
    let text = std::fs::read_to_string(path).map_err(|source| CurveError::Read { path: path.into(), source })?;
    let bad = |line: usize, reason: String| CurveError::Line { path: path.into(), line: line + 1, reason };
    let mut lines = text.lines().enumerate().map(|(n, line)| (n, line.trim())).filter(|(_, line)| !line.is_empty());
    let (n, header) = lines.next().ok_or_else(|| CurveError::TooShort(path.into()))?;
    let column = |name: &str| {
        let missing = || bad(n, format!("the header '{header}' has no column '{name}': write z_um,phi"));
        header.split(',').position(|h| h.trim() == name).ok_or_else(missing)
    };
    let (z_column, phi_column) = (column("z_um")?, column("phi")?);
    let mut points: Vec<(f64, f64)> = Vec::new();
    for (n, line) in lines {
        let fields: Vec<&str> = line.split(',').collect();
        let number = |i: usize| {
            let field = fields.get(i).map_or("", |f| f.trim());
            let value: Option<f64> = field.parse().ok().filter(|v: &f64| v.is_finite());
            value.ok_or_else(|| bad(n, format!("'{field}' is not a finite number")))
        };
        let point = (number(z_column)?, number(phi_column)?);
        if points.last().is_some_and(|last| point.0 <= last.0) {
            return Err(bad(n, format!("z_um = {} does not grow from line to line", point.0)));
        }
        points.push(point);
    }
    if points.len() < 2 { Err(CurveError::TooShort(path.into())) } else { Ok(points) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(text: &str) -> (tempfile::TempDir, String) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("c.csv");
        std::fs::write(&path, text).unwrap();
        let path = path.to_str().unwrap().to_string();
        (dir, path)
    }

    #[test]
    fn a_curve_is_linear_between_its_points_and_flat_beyond() {
        let (_dir, path) = file("z_um,phi\n0,1\n2,5\n4,3\n");
        let mut curve = Curve::open(&path).unwrap();
        assert_eq!(
            [-1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0].map(|z| curve.value(Micrometres(z))),
            [1.0, 1.0, 3.0, 5.0, 4.0, 3.0, 3.0]
        );
    }

    #[test]
    fn noise_is_relative_and_repeats_with_its_seed() {
        let (_dir, path) = file("z_um,phi\n0,100\n1,100\n");
        let run = |seed: u32| {
            let mut curve = Curve::open(&format!("{path}?noise=0.01&seed={seed}")).unwrap();
            (0..4000).map(|_| curve.value(Micrometres(0.5))).collect::<Vec<_>>()
        };
        let values = run(3);
        assert_eq!(values, run(3));
        assert_ne!(values, run(4));
        let mean = values.iter().sum::<f64>() / 4000.0;
        let sigma = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 4000.0).sqrt();
        assert!((mean - 100.0).abs() < 0.1 && (sigma - 1.0).abs() < 0.06, "{mean} {sigma}");
    }

    #[test]
    fn bad_files_are_refused_with_their_line() {
        for (text, says) in [
            ("", "at least two lines"),
            ("z,phi\n0,1\n", "no column 'z_um'"),
            ("z_um,phi\n0,1\n", "at least two lines"),
            ("z_um,phi\n0,1\n1,nan\n", "line 3: 'nan' is not a finite number"),
            ("z_um,phi\n1,1\n1,2\n", "line 3: z_um = 1 does not grow"),
            ("z_um,phi\n1\n", "line 2: '' is not"),
        ] {
            let (_dir, path) = file(text);
            let said = Curve::open(&path).unwrap_err().to_string();
            assert!(said.contains(says), "{text:?}: {said}");
        }
        assert!(Curve::open("x.csv?noise=-1").unwrap_err().to_string().contains("noise=-1"));
        assert!(Curve::open("no.csv").unwrap_err().to_string().contains("no.csv"));
    }
}
