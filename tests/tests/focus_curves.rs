//! The board's scans on the focus curves of real stacks.

use parfocal_firmware::autofocus::{Ask, Scan, Summary};
use parfocal_protocol::autofocus::{Mode, Outcome, ScanId, ScanParameters, ScanRefusal, Strategy, Subject};
use parfocal_protocol::units::{Axis, FocusValue, MicrometresPerSecond, Milliseconds, Nanometres};
use parfocal_tests::shared_data;

/// One column of a stack's focus curve, by z in nm.
struct Column {
    planes: Vec<(f64, f64)>,
}

impl Column {
    /// Reads a column; planes are `step` nm apart where the file does not say.
    fn read(stack: &str, column: &str, step: f64) -> Self {
        let text = std::fs::read_to_string(shared_data(stack).join("focus_curves.csv")).unwrap();
        let mut lines = text.lines();
        let at = lines.next().unwrap().split(',').position(|name| name == column).unwrap();
        let plane = |(i, line): (usize, &str)| {
            let cells: Vec<&str> = line.split(',').collect();
            (cells[1].parse::<f64>().map_or(i as f64 * step, |um| um * 1000.0), cells[at].parse().unwrap())
        };
        Self { planes: lines.enumerate().map(plane).collect() }
    }

    fn ends(&self) -> (f64, f64) {
        (self.planes[0].0, self.planes.last().unwrap().0)
    }

    /// Φ at z, linear between planes.
    fn phi(&self, z: f64) -> f64 {
        let i = self.planes.partition_point(|p| p.0 <= z).clamp(1, self.planes.len() - 1);
        let (a, b) = (self.planes[i - 1], self.planes[i]);
        a.1 + (b.1 - a.1) * (z - a.0) / (b.0 - a.0)
    }

    /// z of a plane, µm.
    fn z_um(&self, plane: usize) -> f64 {
        self.planes[plane].0 / 1000.0
    }

    fn scan(&self, start_nm: f64, step_nm: i32, strategy: Strategy, subject: Subject) -> (Outcome, Summary) {
        let (low, high) = self.ends();
        let parameters = ScanParameters {
            scan: ScanId(1),
            axis: Axis(2),
            strategy,
            mode: Mode::Step,
            subject,
            low: Nanometres(low as i32),
            high: Nanometres(high as i32),
            sample_step: Nanometres(step_nm),
            trap: Nanometres(10_000),
            probe: Nanometres(5_000),
            speed: MicrometresPerSecond(0.0),
            sample_timeout: Milliseconds(1_000),
            verify: true,
        };
        let (mut scan, mut ask) = Scan::begin(&parameters, Nanometres(start_nm as i32)).unwrap();
        loop {
            ask = match ask {
                Ask::Sample { z } => scan.sample(z, Ok(FocusValue(self.phi(f64::from(z.0))))),
                Ask::Go { z } => scan.arrived(z),
                Ask::Think => scan.think(),
                Ask::Ended(outcome) => return (outcome, scan.summary()),
                Ask::Sweep { .. } | Ask::Wait => unreachable!("a stepwise scan"),
            };
        }
    }

    fn starts(&self, n: usize) -> impl Iterator<Item = f64> {
        let (low, high) = self.ends();
        (0..n).map(move |i| low + (high - low) * (i as f64 + 0.5) / n as f64)
    }
}

#[test]
#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]
fn the_tip_is_found_from_anywhere_with_little_travel() {
    for measure in ["tenengrad_roi", "brenner_roi"] {
        let curve = Column::read("acq4_pipette_tip", measure, 0.0);
        let mut excess: Vec<f64> = curve
            .starts(50)
            .map(|start| {
                let (outcome, found) = curve.scan(start, 500, Strategy::Climb, Subject::Peak);
                let z = f64::from(found.best.0) / 1000.0;
                assert_eq!(outcome, Outcome::Focused, "{measure} from {start} nm");
                assert!(z > curve.z_um(24) - 1.6 && z < curve.z_um(25) + 1.6, "{measure} from {start} nm: {z} µm");
                f64::from(found.travel.0) / 1000.0 - (curve.z_um(24) - start / 1000.0).abs() - 5.0
            })
            .collect();
        excess.sort_by(f64::total_cmp);
        println!("{measure}: J − J_min median {:.1}, p95 {:.1}, greatest {:.1} µm", excess[25], excess[47], excess[49]);
        assert!(excess[25] <= 25.0 && excess[47] <= 45.0, "{measure}: {excess:?}");
    }
}

#[test]
#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]
fn a_range_shorter_than_the_trap_radius_is_simply_scanned() {
    let curve = Column::read("dfnn_mitochondria", "tenengrad", 0.0);
    for start in curve.starts(12) {
        let (outcome, found) = curve.scan(start, 50, Strategy::Climb, Subject::Peak);
        assert_eq!(outcome, Outcome::Focused, "from {start} nm");
        assert!(f64::from(found.best.0).abs() <= 100.0, "from {start} nm: {:?}", found.best);
    }
}

#[test]
#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]
fn a_peak_at_the_edge_is_refused() {
    for measure in ["tenengrad", "brenner", "var_lap"] {
        let curve = Column::read("bfdc_edge_peak", measure, 100.0);
        for strategy in [Strategy::Climb, Strategy::Scan] {
            for start in curve.starts(7) {
                let (outcome, _) = curve.scan(start, 100, strategy, Subject::Peak);
                assert_eq!(outcome, Outcome::Refused(ScanRefusal::PeakAtEdge), "{measure} from {start} nm");
            }
        }
    }
}

#[test]
#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]
fn an_unstained_cell_is_refused_as_a_peak_and_found_as_a_phase_object() {
    for measure in ["tenengrad", "brenner", "norm_var"] {
        let curve = Column::read("bfautofocus_yeast", measure, 0.0);
        for start in curve.starts(9) {
            if measure != "norm_var" {
                let (outcome, _) = curve.scan(start, 300, Strategy::Climb, Subject::Peak);
                assert_eq!(outcome, Outcome::Refused(ScanRefusal::PhaseObject), "{measure} from {start} nm");
            }
            let (outcome, found) = curve.scan(start, 300, Strategy::Climb, Subject::PhaseObject);
            assert_eq!(outcome, Outcome::Focused, "{measure} from {start} nm");
            let off = f64::from(found.best.0) / 1000.0 - curve.z_um(15);
            assert!(off.abs() < 0.3, "{measure} from {start} nm: {off} µm from plane 15");
        }
    }
}
