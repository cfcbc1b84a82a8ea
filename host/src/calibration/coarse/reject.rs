//! What cannot be used, and why: whole sets of pictures, or single views of a marker.

use super::camera::{Side, StereoError};
use super::{Degrees, MarkerId, Millimetres, Place};
use serde::Serialize;
use thiserror::Error;

/// Lists things for a sentence: `1, 2 and 5`.
pub(super) fn list<T: std::fmt::Display>(items: &[T]) -> String {
    match items {
        [] => "none".into(),
        [one] => one.to_string(),
        [first @ .., last] => {
            let first: Vec<String> = first.iter().map(T::to_string).collect();
            format!("{} and {last}", first.join(", "))
        }
    }
}

/// Why the pictures give no registration.
#[derive(Debug, Error)]
pub enum CoarseError {
    /// The stereo camera's own numbers.
    #[error(transparent)]
    Stereo(#[from] StereoError),
    /// A picture's shape is not the stereo camera's.
    #[error(
        "place {place}: the {side} picture is {width}x{height}, the stereo camera was calibrated for {expected:?}: give pictures of that size"
    )]
    Size {
        /// Where.
        place: Place,
        /// Which picture.
        side: Side,
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Columns and rows of the calibration.
        expected: [usize; 2],
    },
    /// A picture shows nothing.
    #[error(
        "place {place}: the {side} picture is all one shade: take off the lens cap, and set exposure and light so that markers show"
    )]
    Blank {
        /// Which place.
        place: Place,
        /// Which picture.
        side: Side,
    },
    /// Left and right are one picture.
    #[error(
        "place {0}: left and right are the same picture: a single (mono) picture gives no depth, take one with each camera"
    )]
    SamePicture(Place),
    /// Left and right were exchanged.
    #[error("place {0}: the markers lie behind the camera: left and right pictures are exchanged")]
    Swapped(Place),
    /// Left and right do not belong together.
    #[error(
        "place {place}: left and right do not belong together, rays to the same corner pass {px:.0} px from each other: check the order of the pairs, and that nothing moved between the two pictures"
    )]
    OutOfOrder {
        /// Where.
        place: Place,
        /// Median distance of the corners from where the other picture allows them.
        px: f64,
    },
    /// Markers are not of the size given.
    #[error(
        "the markers measure {measured:.1} mm in the pictures, --tag-mm says {given:.1}: give the length of the black border's outer edge"
    )]
    TagSize {
        /// What triangulation gives.
        measured: f64,
        /// What was said.
        given: f64,
    },
    /// A mirrored print or picture.
    #[error(
        "place {place}: in the {side} picture marker {} can be read only mirrored: print the sheet unmirrored, and save pictures unflipped",
        list(ids)
    )]
    Mirrored {
        /// Where.
        place: Place,
        /// Which picture.
        side: Side,
        /// The markers.
        ids: Vec<MarkerId>,
    },
    /// Nothing found at all.
    #[error("no marker was found in any picture: light them evenly, and let each be at least 40 px wide")]
    NoMarkers,
    /// No substrate marker.
    #[error(
        "the substrate's marker {substrate} is in no pair of pictures (seen: {}): put it in view, or name another with --substrate",
        list(seen)
    )]
    NoSubstrate {
        /// The one asked for.
        substrate: MarkerId,
        /// Those there are.
        seen: Vec<MarkerId>,
    },
    /// The substrate's marker is there twice.
    #[error(
        "place {place}: the substrate's marker {substrate} is twice in the {side} picture: cover or remove one of the two prints"
    )]
    SubstrateTwice {
        /// The marker.
        substrate: MarkerId,
        /// Where.
        place: Place,
        /// Which picture.
        side: Side,
    },
    /// The substrate moved against everything else.
    #[error(
        "the substrate's marker {substrate} moved relative to the other markers between places {}: fix it and take the pictures again",
        list(places)
    )]
    SubstrateMoved {
        /// The marker.
        substrate: MarkerId,
        /// Places that contradict each other.
        places: Vec<Place>,
    },
    /// A number that is no size.
    #[error("a marker's size of {0} mm cannot be: give the length of the black border's outer edge")]
    BadSize(f64),
    /// A marker outside the family.
    #[error("marker {0} is not in the family tag36h11: ids go from 0 to 586")]
    NoSuchMarker(MarkerId),
    /// The detector's library refuses the picture.
    #[error("the marker detector refuses the picture: {0}")]
    Detector(String),
}

/// Why one view of a marker, or the marker, was left out.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "reason")]
pub enum Why {
    /// Two prints with the same number.
    Twice {
        /// The picture that shows both.
        side: Side,
    },
    /// Two places give different poses, and there is no third to tell which is right.
    Moved {
        /// By how much, mm.
        mm: Millimetres,
        /// By how much, degrees.
        deg: Degrees,
        /// The places that contradict each other.
        places: Vec<Place>,
    },
    /// One view against several.
    WrongPose {
        /// Distance from what the others say.
        mm: Millimetres,
        /// Turn from what the others say.
        deg: Degrees,
    },
    /// Left and right picture contradict each other.
    NoStereoMatch {
        /// Distance of the corners from where the other picture allows them, px.
        px: f64,
    },
    /// This marker alone is of another size.
    TagSize {
        /// What triangulation gives.
        measured_mm: Millimetres,
    },
    /// Found, but its edges cannot be measured, or only one picture shows it and no other place tells its pose.
    Unclear,
}

/// A view of a marker, or a whole marker, left out.
#[derive(Clone, Debug, PartialEq)]
pub struct Rejected {
    /// Which.
    pub marker: MarkerId,
    /// Where; none when the whole marker is left out.
    pub place: Option<Place>,
    /// Why.
    pub why: Why,
}

impl Serialize for Rejected {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Row<'a> {
            marker: MarkerId,
            place: Option<Place>,
            #[serde(flatten)]
            why: &'a Why,
            text: String,
        }
        Row { marker: self.marker, place: self.place, why: &self.why, text: self.to_string() }.serialize(serializer)
    }
}

impl std::fmt::Display for Rejected {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "marker {}", self.marker)?;
        if let Some(place) = self.place {
            write!(f, ", place {place}")?;
        }
        match &self.why {
            Why::Twice { side } => {
                write!(f, ": seen twice with the same id in the {side} picture; remove one of the two prints")
            }
            Why::Moved { mm, deg, places } => {
                write!(
                    f,
                    ": moved by {mm} and {deg} between places {}; fix it and take the pictures again",
                    list(places)
                )
            }
            Why::WrongPose { mm, deg } => {
                write!(f, ": {mm} and {deg} from where the other views have it; this view is left out")
            }
            Why::NoStereoMatch { px } => {
                write!(f, ": left and right contradict each other by {px:.1} px; this view is left out")
            }
            Why::TagSize { measured_mm } => {
                write!(f, ": measures {measured_mm} across, another size than given; give its own with --tag-mm-of")
            }
            Why::Unclear => {
                f.write_str(": found in one picture only, or its edges cannot be measured; this view is left out")
            }
        }
    }
}
