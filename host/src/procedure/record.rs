//! Samples, written down as they come: a CSV file that `parfocal calibrate … --samples` solves again.

use super::error::ProcedureError;
use super::point::Witness;
use crate::calibration::chain::Pixel;
use crate::calibration::samples::{CameraSample, ObjectiveSample, RegistrationSample, Seen};
use crate::rig::ManipulatorNumber;
use nalgebra::Vector3;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// One sample: where everything was, and where the point showed.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// When.
    pub time: SystemTime,
    /// The objective in use, if it was known.
    pub objective: Option<String>,
    /// The zoom in use.
    pub zoom: f64,
    /// Which point.
    pub point: String,
    /// The manipulator and P_R, µm, when it is its tip.
    pub man_um: Option<(ManipulatorNumber, Vector3<f64>)>,
    /// Position of the microscope's axes that make the picture move, µm: P_M, or the stage's when the sample moves.
    pub mic_um: Vector3<f64>,
    /// P_I, on the sensor.
    pub pixel: Pixel,
    /// Where the point is in ref, when the chain was known.
    pub ref_um: Option<Vector3<f64>>,
    /// How sure, 0 to 1.
    pub confidence: f64,
    /// Who said so.
    pub by: Witness,
}

impl Sample {
    /// As the camera's solver takes it.
    pub fn camera(&self) -> CameraSample {
        CameraSample { mic_um: self.mic_um.xy(), pixel: self.pixel }
    }

    /// As the registration's solver takes it; `None` without a manipulator.
    pub fn registration(&self) -> Option<RegistrationSample> {
        let (_, man_um) = self.man_um?;
        Some(RegistrationSample { man_um, seen: Seen::Picture { mic_um: self.mic_um, pixel: self.pixel } })
    }

    /// As the objectives' solver takes it; `None` when the objective was not known.
    pub fn objective(&self) -> Option<ObjectiveSample> {
        let objective = self.objective.clone()?;
        Some(ObjectiveSample { objective, point: self.point.clone(), mic_um: self.mic_um, pixel: self.pixel })
    }
}

/// What the samples are for: decides the file's columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// A camera's matrix, or objectives.
    Microscope,
    /// A manipulator's registration.
    Registration,
    /// Places along a shank: in ref.
    Shank,
}

const ABOUT: [&str; 4] = ["time", "objective", "zoom", "point"];
const MAN: [&str; 4] = ["manipulator", "man_x_um", "man_y_um", "man_z_um"];
const MIC: [&str; 5] = ["mic_x_um", "mic_y_um", "mic_z_um", "image_x_px", "image_y_px"];
const REF: [&str; 3] = ["ref_x_um", "ref_y_um", "ref_z_um"];
const WHO: [&str; 2] = ["confidence", "by"];

/// Keeps samples, in a file if one is wanted.
#[derive(Debug)]
pub struct Recorder {
    file: Option<(PathBuf, File)>,
    purpose: Purpose,
    samples: Vec<Sample>,
}

impl Recorder {
    /// Keeps samples in memory only.
    pub fn memory(purpose: Purpose) -> Self {
        Self { file: None, purpose, samples: Vec::new() }
    }

    /// Begins a new file. `about` are lines of comment at its top: seed, program, what a person should know.
    ///
    /// # Errors
    /// [`ProcedureError::Record`]; a file that is there already is not touched.
    pub fn file(path: &Path, purpose: Purpose, about: &[String]) -> Result<Self, ProcedureError> {
        let failed = |reason: String| ProcedureError::Record { path: path.into(), reason };
        let mut file = File::options().write(true).create_new(true).open(path).map_err(|e| {
            let there = e.kind() == std::io::ErrorKind::AlreadyExists;
            failed(if there { "it exists already; name another one with --record".into() } else { e.to_string() })
        })?;
        let mut text: String = about.iter().map(|line| format!("# {line}\n")).collect();
        text += &(columns(purpose).join(",") + "\n");
        file.write_all(text.as_bytes()).map_err(|e| failed(e.to_string()))?;
        Ok(Self { file: Some((path.into(), file)), purpose, samples: Vec::new() })
    }

    /// Goes on with a file of an earlier run. A line that the earlier run's end tore is dropped. The earlier samples are
    /// in the file only: [`crate::calibration::samples::Table`] reads them.
    ///
    /// # Errors
    /// [`ProcedureError::Record`]: it cannot be written, or holds other columns.
    pub fn resume(path: &Path, purpose: Purpose) -> Result<Self, ProcedureError> {
        let failed = |reason: String| ProcedureError::Record { path: path.into(), reason };
        let text = std::fs::read_to_string(path).map_err(|e| failed(e.to_string()))?;
        let header = text.lines().find(|line| !line.starts_with('#')).unwrap_or_default();
        if header != columns(purpose).join(",") {
            return Err(failed("its columns are not those of these samples; name another folder".into()));
        }
        let file = File::options().append(true).open(path).map_err(|e| failed(e.to_string()))?;
        let whole = text.rfind('\n').map_or(0, |end| end + 1);
        if whole < text.len() {
            file.set_len(whole as u64).map_err(|e| failed(e.to_string()))?;
        }
        Ok(Self { file: Some((path.into(), file)), purpose, samples: Vec::new() })
    }

    /// Keeps one more sample: on the disk when this returns.
    ///
    /// # Errors
    /// [`ProcedureError::Record`].
    pub fn keep(&mut self, sample: Sample) -> Result<(), ProcedureError> {
        let text = line(&sample, self.purpose);
        if let Some((path, file)) = &mut self.file {
            let failed = |e: std::io::Error| ProcedureError::Record { path: path.clone(), reason: e.to_string() };
            file.write_all(text.as_bytes()).and_then(|()| file.sync_data()).map_err(failed)?;
        }
        self.samples.push(sample);
        Ok(())
    }

    /// The samples so far.
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// The file.
    pub fn path(&self) -> Option<&Path> {
        self.file.as_ref().map(|(path, _)| path.as_path())
    }
}

fn columns(purpose: Purpose) -> Vec<&'static str> {
    let middle: &[&str] = match purpose {
        Purpose::Microscope => &MIC,
        Purpose::Registration => &[&MAN[..], &MIC[..]].concat(),
        Purpose::Shank => &[&MIC[..], &REF[..]].concat(),
    };
    [&ABOUT[..], middle, &WHO[..]].concat()
}

/// Text in a CSV field.
fn quoted(text: &str) -> String {
    if text.contains(['"', ',', '\n', '\r']) || text.starts_with('#') {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.into()
    }
}

fn line(sample: &Sample, purpose: Purpose) -> String {
    let number = |v: f64| format!("{v:.4}");
    let three = |v: &Vector3<f64>| v.iter().map(|v| number(*v)).collect::<Vec<_>>();
    let mut fields = vec![
        humantime::format_rfc3339_millis(sample.time).to_string(),
        quoted(sample.objective.as_deref().unwrap_or("")),
        sample.zoom.to_string(),
        quoted(&sample.point),
    ];
    if purpose == Purpose::Registration {
        match &sample.man_um {
            Some((n, joints)) => {
                fields.push(n.to_string());
                fields.extend(three(joints));
            }
            None => fields.extend(vec![String::new(); 4]),
        }
    }
    fields.extend(three(&sample.mic_um));
    fields.extend([number(sample.pixel.x_px), number(sample.pixel.y_px)]);
    if purpose == Purpose::Shank {
        fields.extend(sample.ref_um.as_ref().map_or_else(|| vec![String::new(); 3], three));
    }
    fields.extend([format!("{:.3}", sample.confidence), sample.by.to_string()]);
    fields.join(",") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::samples::Table;

    fn sample(k: f64) -> Sample {
        Sample {
            time: SystemTime::UNIX_EPOCH,
            objective: Some("40x, \"water\"".into()),
            zoom: 1.0,
            point: "tip of m1".into(),
            man_um: ManipulatorNumber::new(1).map(|n| (n, Vector3::new(k, 2.0, 3.0))),
            mic_um: Vector3::new(4.0, 5.0 * k, 6.0),
            pixel: Pixel { x_px: 7.25, y_px: 8.5 },
            ref_um: Some(Vector3::new(1.0, 2.0, k)),
            confidence: 0.9,
            by: Witness::Detector,
        }
    }

    #[test]
    fn a_recorded_file_reads_as_the_samples_that_were_kept() {
        let folder = tempfile::tempdir().unwrap();
        for purpose in [Purpose::Microscope, Purpose::Registration, Purpose::Shank] {
            let path = folder.path().join(format!("{purpose:?}.csv"));
            let mut recorder = Recorder::file(&path, purpose, &["seed 3".into()]).unwrap();
            for k in [1.0, 2.0] {
                recorder.keep(sample(k)).unwrap();
            }
            let table = Table::read(&path).unwrap();
            let kept = recorder.samples();
            match purpose {
                Purpose::Microscope => {
                    assert_eq!(table.camera().unwrap(), kept.iter().map(Sample::camera).collect::<Vec<_>>());
                    let objective: Vec<_> = kept.iter().map(|s| s.objective().unwrap()).collect();
                    assert_eq!(table.objective().unwrap(), objective);
                }
                Purpose::Registration => {
                    let registration: Vec<_> = kept.iter().map(|s| s.registration().unwrap()).collect();
                    assert_eq!(table.registration().unwrap(), registration);
                }
                Purpose::Shank => assert_eq!(table.shank().unwrap()[1], Vector3::new(1.0, 2.0, 2.0)),
            }
            // What is there is never overwritten.
            let again = Recorder::file(&path, purpose, &[]).unwrap_err().to_string();
            assert!(again.contains("exists already"), "{again}");
        }
    }
}
