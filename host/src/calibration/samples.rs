//! Recorded samples: CSV files with a header. Columns may stand in any order, further ones are ignored.

use super::chain::{Pixel, Sensor};
use super::error::CalibrationError;
use nalgebra::{Vector2, Vector3};
use std::path::Path;

/// A CSV file's rows.
#[derive(Clone, Debug)]
pub struct Table {
    headers: Vec<String>,
    rows: Vec<csv::StringRecord>,
}

/// A fixed point seen from a microscope position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraSample {
    /// P_M, µm.
    pub mic_um: Vector2<f64>,
    /// Where the point showed.
    pub pixel: Pixel,
}

/// A tip in focus at a manipulator position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegistrationSample {
    /// P_R, µm.
    pub man_um: Vector3<f64>,
    /// Where the tip was.
    pub seen: Seen,
}

/// Where a tip was: in ref, or in the picture at a microscope position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Seen {
    /// In ref, µm.
    Ref(Vector3<f64>),
    /// At a pixel with the microscope at P_M, µm.
    Picture {
        /// P_M.
        mic_um: Vector3<f64>,
        /// Where it showed.
        pixel: Pixel,
    },
}

/// A point in focus through an objective.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectiveSample {
    /// The objective's name.
    pub objective: String,
    /// Which point.
    pub point: String,
    /// P_M, µm.
    pub mic_um: Vector3<f64>,
    /// Where it showed.
    pub pixel: Pixel,
}

const MIC: [&str; 3] = ["mic_x_um", "mic_y_um", "mic_z_um"];
const PIXEL: [&str; 2] = ["image_x_px", "image_y_px"];
const MAN: [&str; 3] = ["man_x_um", "man_y_um", "man_z_um"];
const REF: [&str; 3] = ["ref_x_um", "ref_y_um", "ref_z_um"];
/// Other programs' names for the same.
const STAGE: [&str; 3] = ["stage_x_um", "stage_y_um", "stage_z_um"];
const GLOBAL: [&str; 3] = ["global_x_um", "global_y_um", "global_z_um"];

impl Table {
    /// Reads a file.
    ///
    /// # Errors
    /// [`CalibrationError::Read`] when it is not there or a row has another number of fields than the header.
    pub fn read(path: &Path) -> Result<Self, CalibrationError> {
        let failed = |source| CalibrationError::Read { path: path.into(), source };
        let reader = csv::ReaderBuilder::new().trim(csv::Trim::All).comment(Some(b'#')).from_path(path);
        Self::from_reader(reader.map_err(failed)?).map_err(failed)
    }

    /// Reads text.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn parse(text: &str) -> Result<Self, CalibrationError> {
        let reader = csv::ReaderBuilder::new().trim(csv::Trim::All).comment(Some(b'#')).from_reader(text.as_bytes());
        Self::from_reader(reader).map_err(|source| CalibrationError::Read { path: "the text".into(), source })
    }

    fn from_reader<R: std::io::Read>(mut reader: csv::Reader<R>) -> Result<Self, csv::Error> {
        let headers = reader.headers()?.iter().map(|h| h.trim_start_matches('\u{feff}').to_owned()).collect();
        Ok(Self { headers, rows: reader.records().collect::<Result<_, _>>()? })
    }

    fn has(&self, columns: &[&str]) -> bool {
        columns.iter().all(|column| self.headers.iter().any(|h| h == column))
    }

    fn column(&self, name: &str, needed: &[&str]) -> Result<usize, CalibrationError> {
        self.headers
            .iter()
            .position(|h| h == name)
            .ok_or_else(|| CalibrationError::Column { missing: name.into(), needed: needed.join(",") })
    }

    /// The rows' numbers in the given columns.
    fn numbers<const N: usize>(&self, columns: [&str; N]) -> Result<Vec<[f64; N]>, CalibrationError> {
        let mut places = [0; N];
        for (place, column) in places.iter_mut().zip(columns) {
            *place = self.column(column, &columns)?;
        }
        let number = |row: usize, k: usize| {
            let text = self.rows[row].get(places[k]).unwrap_or_default();
            text.parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(|| CalibrationError::Number {
                row: row + 1,
                column: columns[k].into(),
                text: text.into(),
            })
        };
        (0..self.rows.len())
            .map(|row| {
                let mut values = [0.0; N];
                for (k, value) in values.iter_mut().enumerate() {
                    *value = number(row, k)?;
                }
                Ok(values)
            })
            .collect()
    }

    /// Samples for the camera: `mic_x_um,mic_y_um,image_x_px,image_y_px`.
    ///
    /// # Errors
    /// A missing column, or a field that is not a number.
    pub fn camera(&self) -> Result<Vec<CameraSample>, CalibrationError> {
        let rows = self.numbers([MIC[0], MIC[1], PIXEL[0], PIXEL[1]])?;
        Ok(rows.iter().map(|&[x, y, u, v]| CameraSample { mic_um: Vector2::new(x, y), pixel: px(u, v) }).collect())
    }

    /// Samples for a registration: `man_*_um` with `mic_*_um,image_*_px`, or with `ref_*_um`; `stage_*_um,global_*_um`
    /// is read as man and ref.
    ///
    /// # Errors
    /// A missing column, or a field that is not a number.
    pub fn registration(&self) -> Result<Vec<RegistrationSample>, CalibrationError> {
        let man = if !self.has(&MAN) && self.has(&STAGE) { STAGE } else { MAN };
        let place = [REF, GLOBAL].into_iter().find(|columns| self.has(columns));
        if let Some(place) = place {
            let rows = self.numbers([man[0], man[1], man[2], place[0], place[1], place[2]])?;
            return Ok(rows
                .iter()
                .map(|&[x, y, z, a, b, c]| RegistrationSample {
                    man_um: Vector3::new(x, y, z),
                    seen: Seen::Ref(Vector3::new(a, b, c)),
                })
                .collect());
        }
        let rows = self.numbers([man[0], man[1], man[2], MIC[0], MIC[1], MIC[2], PIXEL[0], PIXEL[1]])?;
        Ok(rows
            .iter()
            .map(|&[x, y, z, a, b, c, u, v]| RegistrationSample {
                man_um: Vector3::new(x, y, z),
                seen: Seen::Picture { mic_um: Vector3::new(a, b, c), pixel: px(u, v) },
            })
            .collect())
    }

    /// Samples for objectives: `objective,image_x_px,image_y_px,mic_x_um,mic_y_um,mic_z_um,point`.
    ///
    /// # Errors
    /// A missing column, or a field that is not a number.
    pub fn objective(&self) -> Result<Vec<ObjectiveSample>, CalibrationError> {
        let needed = ["objective", PIXEL[0], PIXEL[1], MIC[0], MIC[1], MIC[2], "point"];
        let (objective, point) = (self.column("objective", &needed)?, self.column("point", &needed)?);
        let rows = self.numbers([PIXEL[0], PIXEL[1], MIC[0], MIC[1], MIC[2]])?;
        let text = |row: usize, column: usize| self.rows[row].get(column).unwrap_or_default().to_owned();
        Ok(rows
            .iter()
            .enumerate()
            .map(|(row, &[u, v, x, y, z])| ObjectiveSample {
                objective: text(row, objective),
                point: text(row, point),
                mic_um: Vector3::new(x, y, z),
                pixel: px(u, v),
            })
            .collect())
    }

    /// Points along a pipette's shank in ref: `ref_x_um,ref_y_um,ref_z_um`.
    ///
    /// # Errors
    /// A missing column, or a field that is not a number.
    pub fn shank(&self) -> Result<Vec<Vector3<f64>>, CalibrationError> {
        Ok(self.numbers(REF)?.into_iter().map(Vector3::from).collect())
    }
}

fn px(x_px: f64, y_px: f64) -> Pixel {
    Pixel { x_px, y_px }
}

/// Refuses pixels that are not on the sensor: µm in a px column look like that.
pub(super) fn on_sensor(sensor: Sensor, pixels: impl IntoIterator<Item = Pixel>) -> Result<(), CalibrationError> {
    match pixels.into_iter().enumerate().find(|(_, pixel)| !sensor.holds(*pixel)) {
        None => Ok(()),
        Some((i, Pixel { x_px, y_px })) => Err(CalibrationError::OffSensor {
            row: i + 1,
            x_px,
            y_px,
            width: sensor.width_px,
            height: sensor.height_px,
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_may_stand_in_any_order_and_carry_other_names() {
        let table = Table::parse("note, image_y_px,image_x_px,mic_y_um,mic_x_um\na,1,2,3,4\n").unwrap();
        assert_eq!(table.camera().unwrap(), [CameraSample { mic_um: Vector2::new(4.0, 3.0), pixel: px(2.0, 1.0) }]);
        let table = Table::parse("stage_x_um,stage_y_um,stage_z_um,global_x_um,global_y_um,global_z_um\n1,2,3,4,5,6\n");
        let sample = table.unwrap().registration().unwrap()[0];
        assert_eq!((sample.man_um.z, sample.seen), (3.0, Seen::Ref(Vector3::new(4.0, 5.0, 6.0))));
    }

    #[test]
    fn what_is_no_number_is_refused_by_row_and_column() {
        for text in ["x", "NaN", "inf", ""] {
            let csv = format!("mic_x_um,mic_y_um,image_x_px,image_y_px\n1,2,3,4\n1,2,{text},4\n");
            let error = Table::parse(&csv).unwrap().camera().unwrap_err().to_string();
            assert!(error.contains("row 2") && error.contains("image_x_px"), "{error}");
        }
        let error = Table::parse("mic_x_um,mic_y_um\n1,2\n").unwrap().camera().unwrap_err().to_string();
        assert!(error.contains("image_x_px"), "{error}");
        assert!(Table::parse("a,b\n1,2,3\n").is_err());
    }
}
