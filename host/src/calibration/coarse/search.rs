//! Tip into view: where to look for a tip whose place is known only coarsely.
//!
//! The search knows no stage and no camera. It is asked where to look next, told what was seen there, and ends with the tip
//! found or every place within its bounds looked at. Looks go around the expected place in a square spiral, one height after the other,
//! the expected height first, and never below the floor.

use super::Millimetres;
use thiserror::Error;

/// A place to look at, in ref, µm, z up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spot {
    /// x, y and z, µm.
    pub um: [f64; 3],
}

/// Within what to search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Where the tip is expected.
    pub expected: Spot,
    /// Expected root mean square error of that.
    pub uncertainty: Millimetres,
    /// Width and height of what the camera sees, µm.
    pub field_um: [f64; 2],
    /// Nominal magnification of the objective.
    pub magnification: f64,
    /// A tip this far above or below the focus is still noticed, µm.
    pub notice_um: f64,
    /// Nothing is looked at, and no tip brought, lower than this, µm.
    pub floor_um: f64,
}

/// What a look showed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sighting {
    /// No pipette.
    Nothing,
    /// A pipette's shank that leaves the picture: the tip lies this way, a vector in ref's x and y of any length.
    Shank([f64; 2]),
    /// The tip, this far from the picture's centre in ref's x and y, µm.
    Tip([f64; 2]),
}

/// What to do next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Action {
    /// Bring this spot to the centre of the picture and say what is seen.
    Look(Spot),
    /// The tip is here.
    Found(Spot),
    /// Every spot within the bounds was looked at.
    GaveUp {
        /// How many.
        looks: usize,
    },
}

/// Why a search cannot start.
#[derive(Debug, Error, PartialEq)]
pub enum SearchError {
    /// The field is too small.
    #[error(
        "a coarse position, good to {uncertainty}, is searched for at 4x or less, not at {magnification}x: change the objective"
    )]
    Magnification {
        /// Of the objective.
        magnification: f64,
        /// Of the expected position.
        uncertainty: Millimetres,
    },
    /// The expected spot is below the floor by more than its uncertainty.
    #[error(
        "the tip is expected at z = {z_um:.0} µm, below the floor at {floor_um:.0} µm by more than its uncertainty: check the coarse registration and the floor"
    )]
    BelowFloor {
        /// Expected height.
        z_um: f64,
        /// The floor.
        floor_um: f64,
    },
    /// A bound that is no number, or not above 0.
    #[error("the search's {0} has to be a number above 0")]
    Bound(&'static str),
}

/// Standard deviations that the search covers.
const REACH: f64 = 3.0;
/// Share of the field by which neighbouring looks overlap.
const OVERLAP: f64 = 0.25;
/// Greatest magnification whose field holds a coarse error.
const MAGNIFICATION: f64 = 4.0;
/// Steps along a shank before it is taken for dirt.
const SHANK_STEPS: usize = 12;

/// A search under way.
#[derive(Clone, Debug)]
pub struct Search {
    bounds: Bounds,
    /// Spots still to look at, the next one last.
    spots: Vec<Spot>,
    looking: Option<Spot>,
    along_shank: usize,
    looks: usize,
}

impl Search {
    /// A search around the expected spot.
    ///
    /// # Errors
    /// [`SearchError`].
    pub fn new(bounds: Bounds) -> Result<Self, SearchError> {
        let positive = [
            ("uncertainty", bounds.uncertainty.0),
            ("field's width", bounds.field_um[0]),
            ("field's height", bounds.field_um[1]),
            ("depth of notice", bounds.notice_um),
            ("magnification", bounds.magnification),
        ];
        if let Some((name, _)) = positive.into_iter().find(|(_, v)| !(v.is_finite() && *v > 0.0)) {
            return Err(SearchError::Bound(name));
        }
        if bounds.magnification > MAGNIFICATION {
            let Bounds { magnification, uncertainty, .. } = bounds;
            return Err(SearchError::Magnification { magnification, uncertainty });
        }
        let reach = REACH * bounds.uncertainty.0 * 1000.0;
        let z = bounds.expected.um[2];
        if z + reach < bounds.floor_um {
            return Err(SearchError::BelowFloor { z_um: z, floor_um: bounds.floor_um });
        }
        let mut spots = Vec::new();
        for height in heights(z, reach, bounds.notice_um, bounds.floor_um) {
            let around = spiral(bounds.field_um.map(|f| f * (1.0 - OVERLAP)), reach);
            let at = |[x, y]: [f64; 2]| Spot { um: [bounds.expected.um[0] + x, bounds.expected.um[1] + y, height] };
            spots.extend(around.into_iter().map(at));
        }
        spots.reverse();
        Ok(Self { bounds, spots, looking: None, along_shank: 0, looks: 0 })
    }

    /// How many spots are left to look at, should nothing be seen.
    pub fn left(&self) -> usize {
        self.spots.len()
    }

    /// What to do after the last look showed `seen`; the first call's is ignored.
    pub fn next(&mut self, seen: Sighting) -> Action {
        match (self.looking, seen) {
            (Some(at), Sighting::Tip([x, y])) => {
                self.looking = None;
                return Action::Found(Spot { um: [at.um[0] + x, at.um[1] + y, at.um[2]] });
            }
            (Some(at), Sighting::Shank(way)) if self.along_shank < SHANK_STEPS => {
                if let Some(further) = self.further(at, way) {
                    self.along_shank += 1;
                    return self.look(further);
                }
            }
            _ => {}
        }
        self.along_shank = 0;
        match self.spots.pop() {
            Some(spot) => self.look(spot),
            None => {
                self.looking = None;
                Action::GaveUp { looks: self.looks }
            }
        }
    }

    fn look(&mut self, spot: Spot) -> Action {
        self.looking = Some(spot);
        self.looks += 1;
        Action::Look(spot)
    }

    /// Half a field along the shank, as long as that stays within what is searched.
    fn further(&self, at: Spot, way: [f64; 2]) -> Option<Spot> {
        let length = way[0].hypot(way[1]);
        let step = self.bounds.field_um[0].min(self.bounds.field_um[1]) / 2.0;
        if !(length.is_finite() && length > 0.0) {
            return None;
        }
        let um = [at.um[0] + way[0] / length * step, at.um[1] + way[1] / length * step, at.um[2]];
        let reach = REACH * self.bounds.uncertainty.0 * 1000.0 + step;
        (0..2).all(|k| (um[k] - self.bounds.expected.um[k]).abs() <= reach).then_some(Spot { um })
    }
}

/// Heights to look at: the expected one, or the floor above it, then above and below in turn, none below the floor.
fn heights(expected: f64, reach: f64, notice: f64, floor: f64) -> Vec<f64> {
    let step = 2.0 * notice * (1.0 - OVERLAP);
    let middle = expected.max(floor);
    let mut all = vec![middle];
    let rounds = ((reach - notice).max(0.0) / step).ceil() as usize;
    for k in 1..=rounds {
        let away = step * k as f64;
        let below = (middle - away).max(floor);
        all.push(middle + away);
        if all.iter().all(|z| (z - below).abs() > 1e-9) {
            all.push(below);
        }
    }
    all
}

/// Offsets in a square spiral from the centre outwards, none whose field lies beyond `reach`.
fn spiral(pitch: [f64; 2], reach: f64) -> Vec<[f64; 2]> {
    let rings = pitch.map(|p| ((reach - p / 2.0).max(0.0) / p).ceil() as i64);
    let mut all = Vec::new();
    let (mut x, mut y, mut dx, mut dy) = (0i64, 0i64, 0i64, -1i64);
    let most = rings[0].max(rings[1]);
    for _ in 0..(2 * most + 1).pow(2) {
        if x.abs() <= rings[0] && y.abs() <= rings[1] {
            all.push([x as f64 * pitch[0], y as f64 * pitch[1]]);
        }
        // Corners of the spiral: turn left, one step later at the lower right.
        if x == y || (x < 0 && x == -y) || (x > 0 && x == 1 - y) {
            (dx, dy) = (-dy, dx);
        }
        (x, y) = (x + dx, y + dy);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn bounds() -> Bounds {
        Bounds {
            expected: Spot { um: [100.0, -50.0, 400.0] },
            uncertainty: Millimetres(0.5),
            field_um: [2200.0, 1650.0],
            magnification: 4.0,
            notice_um: 300.0,
            floor_um: 0.0,
        }
    }

    proptest! {
        /// A camera that notices tips in its field and depth finds every tip within the bounds, never below the floor.
        #[test]
        fn every_tip_within_reach_is_found(dx in -1.0..1.0f64, dy in -1.0..1.0f64, dz in -1.0..1.0f64, mm in 0.1..2.0f64) {
            let bounds = Bounds { uncertainty: Millimetres(mm), ..bounds() };
            let reach = 3000.0 * mm;
            let [x, y, z] = bounds.expected.um;
            let tip = [x + dx * reach, y + dy * reach, (z + dz * reach).max(bounds.floor_um)];
            let mut search = Search::new(bounds).unwrap();
            let most = search.left();
            let mut seen = Sighting::Nothing;
            for _ in 0..=most {
                match search.next(seen) {
                    Action::Look(Spot { um }) => {
                        prop_assert!(um[2] >= bounds.floor_um);
                        let off = [tip[0] - um[0], tip[1] - um[1]];
                        let inside = (0..2).all(|k| off[k].abs() <= bounds.field_um[k] / 2.0);
                        let noticed = inside && (tip[2] - um[2]).abs() <= bounds.notice_um;
                        seen = if noticed { Sighting::Tip(off) } else { Sighting::Nothing };
                    }
                    Action::Found(Spot { um }) => {
                        prop_assert!((um[0] - tip[0]).abs() < 1e-9 && (um[1] - tip[1]).abs() < 1e-9);
                        return Ok(());
                    }
                    Action::GaveUp { .. } => prop_assert!(false, "gave up on {:?}", tip),
                }
            }
            prop_assert!(false, "ran out");
        }
    }

    #[test]
    fn it_gives_up_after_a_bounded_number_of_looks() {
        let mut search = Search::new(bounds()).unwrap();
        let most = search.left();
        assert_eq!(search.next(Sighting::Nothing), Action::Look(bounds().expected));
        for _ in 1..most {
            assert!(matches!(search.next(Sighting::Nothing), Action::Look(_)));
        }
        assert_eq!(search.next(Sighting::Nothing), Action::GaveUp { looks: most });
    }

    #[test]
    fn a_shank_is_followed_towards_its_tip_but_not_for_ever() {
        let mut search = Search::new(bounds()).unwrap();
        search.next(Sighting::Nothing);
        assert_eq!(search.next(Sighting::Shank([3.0, 0.0])), Action::Look(Spot { um: [925.0, -50.0, 400.0] }));
        let mut looks = 0;
        while let Action::Look(_) = search.next(Sighting::Shank([1.0, 1.0])) {
            looks += 1;
            assert!(looks < 2000);
        }
    }

    #[test]
    fn small_fields_and_sunken_tips_are_refused() {
        let small = Bounds { magnification: 40.0, ..bounds() };
        assert!(matches!(Search::new(small), Err(SearchError::Magnification { .. })));
        let sunken = Bounds { floor_um: 2000.0, ..bounds() };
        assert!(matches!(Search::new(sunken), Err(SearchError::BelowFloor { .. })));
        let blind = Bounds { notice_um: f64::NAN, ..bounds() };
        assert_eq!(Search::new(blind).unwrap_err(), SearchError::Bound("depth of notice"));
    }
}
