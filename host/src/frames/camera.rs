//! A camera: frames one after another, each with the time of its exposure if the camera knows it.

use crate::picture::{Picture, Roi};
use parfocal_protocol::units::HostTime;
use std::sync::Arc;
use thiserror::Error;

/// One camera frame.
#[derive(Clone, Debug)]
pub struct Frame {
    /// What it shows; shared, never copied on its way to who looks at it.
    pub picture: Arc<Picture>,
    /// Number of the frame since the camera started, gaps included when the camera dropped some.
    pub number: u64,
    /// Begin and end of the exposure by the host's clock; `None` when the camera does not tell.
    pub exposure: Option<(HostTime, HostTime)>,
    /// When the host had the whole frame.
    pub arrival: HostTime,
}

/// Which frame, and when it was exposed and came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamp {
    /// As [`Frame::number`].
    pub number: u64,
    /// As [`Frame::exposure`].
    pub exposure: Option<(HostTime, HostTime)>,
    /// As [`Frame::arrival`].
    pub arrival: HostTime,
}

impl Frame {
    /// Its number and times.
    pub fn stamp(&self) -> Stamp {
        Stamp { number: self.number, exposure: self.exposure, arrival: self.arrival }
    }
}

/// Why a camera gives no frames.
#[derive(Debug, Error)]
pub enum CameraError {
    /// It stopped delivering.
    #[error(
        "the camera {camera} delivered no frame for {millis} ms: check its cable and that no other program uses it"
    )]
    Stalled {
        /// Its name.
        camera: String,
        /// How long.
        millis: u64,
    },
    /// It was never there.
    #[error("the camera {camera} cannot be used: {reason}")]
    Unopened {
        /// Its name.
        camera: String,
        /// Why not, and what to do.
        reason: String,
    },
    /// It went away.
    #[error("the camera {camera} ended: {reason}")]
    Ended {
        /// Its name.
        camera: String,
        /// What it said last.
        reason: String,
    },
    /// Its frames changed their size.
    #[error(
        "the camera {camera} changed its frames from {from} to {to}: calibrations and regions no longer fit; restart it with the old size"
    )]
    Resized {
        /// Its name.
        camera: String,
        /// Size before.
        from: String,
        /// Size now.
        to: String,
    },
}

/// A source of frames.
pub trait Camera: Send {
    /// What it is called in messages.
    fn name(&self) -> String;

    /// Waits for the next frame, in order, until `deadline`; `None` when none came.
    ///
    /// # Errors
    /// The camera is gone.
    fn next_frame(&mut self, deadline: HostTime) -> Result<Option<Frame>, CameraError>;

    /// As [`Camera::next_frame`], when only the times matter.
    ///
    /// # Errors
    /// The camera is gone.
    fn next_stamp(&mut self, deadline: HostTime) -> Result<Option<Stamp>, CameraError> {
        Ok(self.next_frame(deadline)?.map(|frame| frame.stamp()))
    }

    /// As [`Camera::next_frame`], when only a part of the picture matters. A camera that can deliver (or draw) that part alone may do
    /// so; the second value is what remains to be cut out of the frame.
    ///
    /// # Errors
    /// The camera is gone.
    fn next_part(
        &mut self,
        deadline: HostTime,
        part: Option<Roi>,
    ) -> Result<Option<(Frame, Option<Roi>)>, CameraError> {
        Ok(self.next_frame(deadline)?.map(|frame| (frame, part)))
    }
}

impl<C: Camera + ?Sized> Camera for &mut C {
    fn name(&self) -> String {
        (**self).name()
    }

    fn next_frame(&mut self, deadline: HostTime) -> Result<Option<Frame>, CameraError> {
        (**self).next_frame(deadline)
    }

    fn next_stamp(&mut self, deadline: HostTime) -> Result<Option<Stamp>, CameraError> {
        (**self).next_stamp(deadline)
    }

    fn next_part(
        &mut self,
        deadline: HostTime,
        part: Option<Roi>,
    ) -> Result<Option<(Frame, Option<Roi>)>, CameraError> {
        (**self).next_part(deadline, part)
    }
}

impl<C: Camera + ?Sized> Camera for Box<C> {
    fn name(&self) -> String {
        (**self).name()
    }

    fn next_frame(&mut self, deadline: HostTime) -> Result<Option<Frame>, CameraError> {
        (**self).next_frame(deadline)
    }

    fn next_stamp(&mut self, deadline: HostTime) -> Result<Option<Stamp>, CameraError> {
        (**self).next_stamp(deadline)
    }

    fn next_part(
        &mut self,
        deadline: HostTime,
        part: Option<Roi>,
    ) -> Result<Option<(Frame, Option<Roi>)>, CameraError> {
        (**self).next_part(deadline, part)
    }
}
