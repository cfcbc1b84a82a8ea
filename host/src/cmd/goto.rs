//! `parfocal goto`: the microscope, or a tip, to where a person pointed in the picture.

use super::Output;
use super::connection::Connection;
use super::guarded::MoveArguments;
use anyhow::ensure;
use parfocal::calibration::chain::{Arm, Pixel};
use parfocal::calibration::expected;
use parfocal::procedure::{Pose, ProcedureError, Window, microscope_to_pixel, tip_to_pixel};
use parfocal::rig::{ManipulatorNumber, Rig};
use parfocal_protocol::units::Micrometres;

/// Bring what is seen at a pixel to the picture's middle, or a tip to that pixel
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The pixel, of the full sensor, unbinned: 0,0 is the centre of the top-left one
    #[arg(long, value_name = "x,y", value_parser = pixel, allow_hyphen_values = true)]
    pixel: Pixel,
    /// Send this manipulator's tip there, into the focal plane, instead of the microscope
    #[arg(long, value_name = "N")]
    manipulator: Option<ManipulatorNumber>,
    /// With --manipulator: so far above the focal plane, µm
    #[arg(long, value_name = "UM", default_value_t = 0.0, allow_hyphen_values = true, requires = "manipulator")]
    above_um: f64,
    #[command(flatten)]
    moving: MoveArguments,
}

fn pixel(text: &str) -> Result<Pixel, String> {
    let numbers: Vec<f64> =
        text.split(',').filter_map(|s| s.trim().parse().ok()).filter(|v: &f64| v.is_finite()).collect();
    match numbers[..] {
        [x_px, y_px] => Ok(Pixel { x_px, y_px }),
        _ => Err(format!("'{text}' is no pixel: write x,y as in 320,240.5")),
    }
}

impl Arguments {
    /// Runs the command.
    ///
    /// # Errors
    /// What is not calibrated, off the picture, or in the way.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        ensure!(self.above_um.is_finite(), "--above-um {}: is no height", self.above_um);
        let Pixel { x_px, y_px } = self.pixel;
        let rig = super::guarded::rig_file(connection)?;
        if let Some(camera) = &rig.contents().camera {
            let window = Window::of(camera);
            ensure!(
                window.shows(self.pixel, 0.0),
                "pixel {x_px},{y_px} is not in the picture: the camera shows {}x{} px of a sensor of {}x{} (camera.width_px, height_px, crop_px)",
                window.frame_size().0,
                window.frame_size().1,
                camera.width_px,
                camera.height_px
            );
        }
        let what = match self.manipulator {
            Some(n) => {
                let by = if Arm::of(&rig, n).is_err() && Arm::coarse_of(&rig, n).is_some() {
                    ", by its marker alone: it is not registered"
                } else {
                    ""
                };
                format!("The tip of {n} to pixel {x_px}, {y_px}{by}:")
            }
            None => format!("What is seen at pixel {x_px}, {y_px} to the middle:"),
        };
        let aim = |rig: &Rig, pose: &Pose| -> Result<_, ProcedureError> {
            match self.manipulator {
                Some(n) => tip_to_pixel(rig, pose, n, self.pixel, Micrometres(self.above_um)),
                None => microscope_to_pixel(rig, pose, self.pixel),
            }
        };
        let error = |rig: &Rig, to: &Pose| match self.manipulator {
            Some(n) => expected::tip(rig, n, to.joints(n), to.microscope(rig)),
            None => expected::microscope(rig, self.pixel).ok().flatten(),
        };
        self.moving.run(connection, out, &what, &aim, &error)
    }
}
