//! From pairs of pictures to the markers' poses.

mod pair;
mod views;

use super::camera::StereoCamera;
use super::edges::Grey;
use super::fit::Target;
use super::gamma;
use super::graph::{self, Registration};
use super::reject::CoarseError;
use super::{MarkerId, Place};
use std::collections::BTreeMap;
use views::Views;

/// Two pictures taken at the same moment from one place of the stereo camera.
#[derive(Clone, Debug)]
pub struct Pair {
    /// Which place.
    pub place: Place,
    /// The left camera's picture.
    pub left: Grey,
    /// The right camera's picture.
    pub right: Grey,
}

/// What was printed, and what all poses are relative to.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Length of the black border's outer edge, mm.
    pub tag_mm: f64,
    /// Markers of another size than `tag_mm`.
    pub tag_mm_of: BTreeMap<MarkerId, f64>,
    /// The marker on the substrate.
    pub substrate: MarkerId,
    /// The pictures are light^(1/gamma); none to estimate it.
    pub gamma: Option<f64>,
}

impl Settings {
    /// Markers of one size, the pictures' gamma estimated.
    pub fn new(tag_mm: f64, substrate: MarkerId) -> Self {
        Self { tag_mm, tag_mm_of: BTreeMap::new(), substrate, gamma: None }
    }

    fn size(&self, id: MarkerId) -> f64 {
        self.tag_mm_of.get(&id).copied().unwrap_or(self.tag_mm)
    }

    fn target(&self, id: MarkerId) -> Result<Target, CoarseError> {
        let cells = super::marker::cells(id).ok_or(CoarseError::NoSuchMarker(id))?;
        Ok(Target::new(cells, self.size(id)))
    }

    fn check(&self) -> Result<(), CoarseError> {
        let sizes = std::iter::once(&self.tag_mm).chain(self.tag_mm_of.values());
        match sizes.copied().find(|s| !(*s > 0.1 && *s < 1000.0)) {
            Some(bad) => Err(CoarseError::BadSize(bad)),
            None => self.target(self.substrate).map(drop),
        }
    }
}

/// Of markers that are placed, further views are looked for with this many rounds: a view found may place the next marker.
const GUIDED_ROUNDS: usize = 2;

/// Places all markers relative to the substrate's.
///
/// # Errors
/// Whatever makes the whole set unusable, see [`CoarseError`]; single views that cannot be used are in [`Registration::rejected`].
pub fn register(pairs: &[Pair], camera: &StereoCamera, settings: &Settings) -> Result<Registration, CoarseError> {
    settings.check()?;
    let mut views = Views::default();
    for pair in pairs {
        views.add(pair::read(pair, camera, settings)?);
    }
    views.check_sizes(settings)?;
    let gamma = match settings.gamma {
        Some(gamma) => gamma,
        None => gamma::estimate(&views.samples(pairs), camera),
    };
    tracing::debug!(gamma, "tone of the pictures");
    views.measure(pairs, camera, gamma);
    views.measure_single(pairs, camera, gamma);
    if views.found.is_empty() && views.rejected.is_empty() {
        return Err(CoarseError::NoMarkers);
    }
    for _ in 0..GUIDED_ROUNDS {
        let known = views.solve(settings.substrate)?;
        if !views.look_again(pairs, camera, settings, gamma, &known)? {
            break;
        }
    }
    views.solve(settings.substrate)
}

impl Views {
    fn solve(&self, substrate: MarkerId) -> Result<Registration, CoarseError> {
        let mut registration = match graph::solve(&self.seen, substrate) {
            Err(CoarseError::NoMarkers) => {
                return Err(CoarseError::NoSubstrate { substrate, seen: self.found.keys().copied().collect() });
            }
            other => other?,
        };
        let known = |id: MarkerId| registration.markers.contains_key(&id) || registration.unconnected.contains(&id);
        let lost: Vec<MarkerId> = self.found.keys().filter(|id| !known(**id)).copied().collect();
        registration.rejected.splice(0..0, self.rejected.iter().cloned());
        for id in lost {
            if !registration.rejected.iter().any(|r| r.marker == id) {
                registration.rejected.push(super::Rejected { marker: id, place: None, why: super::Why::Unclear });
            }
        }
        Ok(registration)
    }
}
