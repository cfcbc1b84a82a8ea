//! Least squares of one smooth peak.
//!
//! Φ(v+x) = a + b·x − k·x² + d·x|x| + e·x⁴. Real peaks are lopsided (d), but a free d would cost four times the error of
//! the vertex, since x|x| looks like x; so d is held near 0 by a prior, as one more measurement. e is even: it costs the
//! vertex nothing and takes up the flanks' flattening.

use super::curve::{Cell, Curve, Place};
use super::exact::{product, quotient};
use super::noise::root;
use super::work::Slice;
use core::task::Poll;
use heapless::Vec;

/// How much the curvatures of the two sides differ, relative to their mean: standard deviation of the prior.
const LOPSIDED: f64 = 0.2;

const TERMS: usize = 5;

/// What to fit.
#[derive(Clone, Copy, Debug)]
pub struct Model {
    /// First place of the window.
    pub from: Place,
    /// Last place of the window.
    pub to: Place,
    /// Standard deviation of one frame.
    pub sigma: f64,
    /// The curvature k as far as it is known, per place², for the prior of the lopsidedness.
    pub bend: Option<f64>,
}

/// A fitted peak.
#[derive(Clone, Copy, Debug)]
pub struct Fit {
    /// Its height.
    pub top: f64,
    /// Standard error of the height.
    pub error: f64,
    /// From the assumed to the fitted vertex, in places.
    pub shift: f64,
    /// Curvature k, per place².
    pub bend: f64,
    /// χ² of what is left.
    pub misfit: f64,
    /// Its mean if the model is right.
    pub freedom: f64,
}

/// Places that a window holds at most.
pub const MOST: usize = 177;

/// What it costs to take in a place, the same again about another vertex, to solve, to conclude and judge, and to look at what
/// is left of a place.
const TAKEN_IN: i32 = 700;
const TAKEN_AGAIN: i32 = 450;
const SOLVED: i32 = 4_000;
const CONCLUDED: i32 = 7_000;
const LEFT: i32 = 100;

/// A known place of the window, in the units of the sums.
#[derive(Clone, Copy, Debug)]
struct Point {
    x: f32,
    y: f32,
}

impl Point {
    fn terms(&self) -> [f32; TERMS] {
        let (x, square) = (self.x, self.x * self.x);
        [1.0, x, square, if x < 0.0 { -square } else { square }, square * square]
    }
}

type Normal = [[f32; TERMS + 2]; TERMS];

#[derive(Clone, Debug)]
enum Stage {
    /// Sums over the places.
    TakeIn,
    /// The same about another vertex.
    TakeAgain,
    Solve,
    /// χ².
    Compare {
        solved: Normal,
        misfit: f32,
    },
    Conclude {
        solved: Normal,
        misfit: f32,
    },
}

/// Fits a peak whose vertex is near an assumed one.
#[derive(Clone, Debug)]
pub struct Fitting {
    model: Model,
    vertex: f64,
    unit: f64,
    reference: f64,
    /// Few places carry few terms.
    terms: usize,
    per_unit: f64,
    per_sigma: f64,
    /// One for each known place, in their order.
    points: Vec<Point, MOST>,
    normal: Normal,
    stage: Stage,
    /// The next place of this stage, and its point.
    next: i32,
    index: usize,
}

impl Fitting {
    /// Begins; `None` where no place of the window is known. A window has at most [`MOST`] places.
    pub fn new(curve: &Curve, model: Model, vertex: f64) -> Option<Self> {
        let unit = 0.5 * f64::from(model.to.0 - model.from.0);
        let reference = (model.from.0..=model.to.0).find_map(|p| curve.mean(Place(p)))?;
        let terms = match model.to.0 - model.from.0 {
            ..8 => 3,
            8..12 => 4,
            _ => TERMS,
        };
        Some(Self {
            model,
            vertex,
            unit,
            reference,
            terms,
            per_unit: quotient(1.0, unit),
            per_sigma: 1.0 / model.sigma,
            points: Vec::new(),
            normal: Default::default(),
            stage: Stage::TakeIn,
            next: model.from.0,
            index: 0,
        })
    }

    /// Begins again about another vertex, knowing the curvature; the values are the same.
    pub fn again(&mut self, bend: f64, vertex: f64) {
        self.model.bend = Some(bend);
        self.vertex = vertex;
        self.normal = Default::default();
        self.begin(Stage::TakeAgain);
    }

    fn begin(&mut self, stage: Stage) {
        (self.stage, self.next, self.index) = (stage, self.model.from.0, 0);
    }

    /// Goes on; `None` where the places do not determine a peak.
    pub fn step(&mut self, curve: &Curve, slice: &mut Slice) -> Poll<Option<Fit>> {
        loop {
            if let Stage::Solve = self.stage {
                if !slice.affords(SOLVED) {
                    return Poll::Pending;
                }
                let Some(solved) = self.solve() else { return Poll::Ready(None) };
                self.begin(Stage::Compare { solved, misfit: 0.0 });
            }
            if let Stage::Conclude { solved, misfit } = &self.stage {
                if !slice.affords(CONCLUDED) {
                    return Poll::Pending;
                }
                return Poll::Ready(Some(self.conclude(solved, *misfit)));
            }
            let cell = curve.at(Place(self.next));
            let cost = match &self.stage {
                Stage::TakeIn if cell.is_some() => TAKEN_IN,
                Stage::TakeAgain if cell.is_some() => TAKEN_AGAIN,
                _ => LEFT,
            };
            if !slice.affords(cost) {
                return Poll::Pending;
            }
            if let Some(cell) = cell {
                self.take(&cell);
                self.index += 1;
            }
            self.next += 1;
            if self.next > self.model.to.0 {
                self.stage = match &self.stage {
                    Stage::Compare { solved, misfit } => Stage::Conclude { solved: *solved, misfit: *misfit },
                    _ => Stage::Solve,
                };
            }
        }
    }

    /// Takes a place in, as the stage has it.
    fn take(&mut self, cell: &Cell) {
        // Differences in f64; then the sums in f32, which the board's FPU has.
        let x = || product(cell.x - self.vertex, self.per_unit) as f32;
        match &mut self.stage {
            Stage::TakeIn => {
                let y = product(cell.mean - self.reference, self.per_sigma) as f32;
                let point = Point { x: x(), y };
                // There is room for every place of a window.
                let _ = self.points.push(point);
                self.sum(point, cell.frames);
            }
            Stage::TakeAgain => {
                let x = x();
                if let Some(point) = self.points.get_mut(self.index) {
                    point.x = x;
                    let point = *point;
                    self.sum(point, cell.frames);
                }
            }
            Stage::Solve | Stage::Conclude { .. } => {}
            Stage::Compare { solved, misfit } => {
                if let Some(point) = self.points.get(self.index) {
                    let f = point.terms();
                    let left = (0..TERMS).fold(point.y, |left, i| left - f[i] * fitted(solved, i, self.terms));
                    *misfit += f32::from(cell.frames) * left * left;
                }
            }
        }
    }

    fn sum(&mut self, point: Point, frames: u16) {
        let (weight, f) = (f32::from(frames), point.terms());
        for (i, row) in self.normal.iter_mut().enumerate().take(self.terms) {
            let w = weight * f[i];
            for (sum, term) in row[i..self.terms].iter_mut().zip(&f[i..self.terms]) {
                *sum += w * term;
            }
            row[TERMS] += w * point.y;
        }
    }

    fn solve(&self) -> Option<Normal> {
        let mut normal = self.normal;
        for (i, row) in normal.iter_mut().enumerate().take(self.terms) {
            for (j, value) in row.iter_mut().enumerate().take(i) {
                *value = self.normal[j][i];
            }
        }
        if self.is_lopsided() {
            let bend = self.model.bend.map_or(1.0, |b| b * self.unit * self.unit / self.model.sigma);
            normal[3][3] += (1.0 / (LOPSIDED * bend * LOPSIDED * bend)) as f32;
        }
        // A second right-hand side gives the first element of the inverse: the variance of a.
        normal[0][TERMS + 1] = 1.0;
        eliminate(normal, self.terms)
    }

    fn is_lopsided(&self) -> bool {
        self.terms > 3
    }

    fn conclude(&self, solved: &Normal, misfit: f32) -> Fit {
        let Model { sigma, .. } = self.model;
        let [height, slope, bend] = [0, 1, 2].map(|i| f64::from(fitted(solved, i, self.terms)));
        let bend = -bend;
        let places = self.points.len() as f64;
        Fit {
            top: self.reference + sigma * (height + if bend > 0.0 { 0.25 * slope * slope / bend } else { 0.0 }),
            error: sigma * root(f64::from(solved[0][TERMS + 1])),
            shift: if bend == 0.0 { 0.0 } else { 0.5 * slope / bend * self.unit },
            bend: bend * sigma / (self.unit * self.unit),
            misfit: f64::from(misfit),
            // The vertex was looked for, too; the prior gives most of its own term back.
            freedom: places - self.terms as f64 - 1.0 + if self.is_lopsided() { 0.8 } else { 0.0 },
        }
    }
}

/// The coefficient of a term; 0 for one that was left out.
fn fitted(solved: &Normal, term: usize, terms: usize) -> f32 {
    if term < terms { solved[term][TERMS] } else { 0.0 }
}

/// Gauss-Jordan on the normal equations; `None` where they are singular.
fn eliminate(mut m: Normal, terms: usize) -> Option<Normal> {
    for i in 0..terms {
        if m[i][i] <= 1e-6 {
            return None;
        }
        let inverse = 1.0 / m[i][i];
        for value in &mut m[i][i..] {
            *value *= inverse;
        }
        let pivot = m[i];
        for (r, row) in m.iter_mut().enumerate().take(terms) {
            if r != i {
                let factor = row[i];
                for (value, p) in row[i..].iter_mut().zip(&pivot[i..]) {
                    *value -= factor * p;
                }
            }
        }
    }
    Some(m)
}
