//! All views together: a graph of camera places and markers, adjusted at once on SE(3), with views left out that contradict
//! the others.
//!
//! A view says where a marker is seen from a place, with an information matrix. Unknown are the places' poses and the markers', relative to
//! the substrate's marker. As each view carries all that its pictures' edges say about the pose, the adjustment is
//! the bundle of all pictures with everything but poses eliminated beforehand (Triggs et al. 2000, §6).

mod adjust;
mod doubt;

use super::fit::difference;
use super::reject::{CoarseError, Rejected};
use super::{Degrees, MarkerId, Millimetres, Place};
use nalgebra::{Isometry3, Matrix6};
use std::collections::{BTreeMap, BTreeSet};

/// A marker's pose seen from a place.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// From where.
    pub place: Place,
    /// Which marker.
    pub marker: MarkerId,
    /// Marker to camera, mm.
    pub pose: Isometry3<f64>,
    /// Information of a nudge of `pose`, mm⁻² and rad⁻².
    pub information: Matrix6<f64>,
}

/// A marker's pose relative to the substrate's marker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerPose {
    /// Marker to substrate marker, mm.
    pub pose: Isometry3<f64>,
    /// Expected root mean square length of the position's error.
    pub position: Millimetres,
    /// Expected root mean square angle of the orientation's error.
    pub orientation: Degrees,
}

impl MarkerPose {
    /// Row by row, homogeneous, mm.
    pub fn matrix(&self) -> [[f64; 4]; 4] {
        let m = self.pose.to_homogeneous();
        std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]))
    }
}

/// What the views say.
#[derive(Clone, Debug, PartialEq)]
pub struct Registration {
    /// The marker all poses are relative to.
    pub substrate: MarkerId,
    /// Every marker that could be placed, the substrate's among them.
    pub markers: BTreeMap<MarkerId, MarkerPose>,
    /// Where the cameras stood: substrate marker to left camera, mm.
    pub places: BTreeMap<Place, Isometry3<f64>>,
    /// Views and markers left out.
    pub rejected: Vec<Rejected>,
    /// Markers that nothing links to the substrate's.
    pub unconnected: Vec<MarkerId>,
}

/// Adjusts all views at once.
///
/// # Errors
/// [`CoarseError::NoMarkers`] without views, [`CoarseError::NoSubstrate`] and [`CoarseError::SubstrateMoved`].
pub fn solve(views: &[View], substrate: MarkerId) -> Result<Registration, CoarseError> {
    if views.is_empty() {
        return Err(CoarseError::NoMarkers);
    }
    let seen: BTreeSet<MarkerId> = views.iter().map(|v| v.marker).collect();
    if !seen.contains(&substrate) {
        return Err(CoarseError::NoSubstrate { substrate, seen: seen.into_iter().collect() });
    }
    let all: Vec<&View> = views.iter().collect();
    let linked = linked(&all, substrate);
    let unconnected = seen.iter().filter(|id| !linked.0.contains(id)).copied().collect();
    let active: Vec<&View> = all.into_iter().filter(|v| linked.0.contains(&v.marker)).collect();
    let (solution, rejected) = doubt::settle(active, substrate)?;
    Ok(Registration { substrate, markers: solution.markers(substrate), places: solution.places, rejected, unconnected })
}

/// Markers and places that chains of views link to the substrate's marker.
fn linked(views: &[&View], substrate: MarkerId) -> (BTreeSet<MarkerId>, BTreeSet<Place>) {
    let mut markers = BTreeSet::from([substrate]);
    let mut places = BTreeSet::new();
    loop {
        let before = (markers.len(), places.len());
        places.extend(views.iter().filter(|v| markers.contains(&v.marker)).map(|v| v.place));
        markers.extend(views.iter().filter(|v| places.contains(&v.place)).map(|v| v.marker));
        if before == (markers.len(), places.len()) {
            return (markers, places);
        }
    }
}

/// Length and angle between two poses.
pub(super) fn apart(a: &Isometry3<f64>, b: &Isometry3<f64>) -> (Millimetres, Degrees) {
    let d = difference(a, b);
    (Millimetres(d.fixed_rows::<3>(0).norm()), Degrees(d.fixed_rows::<3>(3).norm().to_degrees()))
}
