//! Focus measures on real stacks: against curves computed elsewhere, and against the known focus.

use parfocal::focus::compare::{Recommendation, Row, compare, recommend};
use parfocal::focus::quality::Quality;
use parfocal::focus::region::sharpest_tile;
use parfocal::focus::{Measure, measure};
use parfocal::frames::stack::Stack;
use parfocal::picture::{Picture, Roi};
use parfocal_protocol::units::Micrometres;
use parfocal_tests::shared_data;

/// A column of the stack's `focus_curves.csv`: one value a plane.
fn reference(stack: &str, column: &str) -> Vec<f64> {
    let text = std::fs::read_to_string(shared_data(stack).join("focus_curves.csv")).unwrap();
    let mut lines = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let at = lines.next().unwrap().iter().position(|name| *name == column).expect("such a column");
    lines.map(|line| line[at].parse().unwrap()).collect()
}

fn curve(stack: &Stack, roi: Option<Roi>, m: Measure) -> Vec<f64> {
    let value = |p: &Picture| measure(roi.map_or(p.view(), |roi| p.view().crop(roi).unwrap()), m).unwrap().0;
    stack.planes.iter().map(value).collect()
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len() as f64;
    let (ma, mb) = (a.iter().sum::<f64>() / n, b.iter().sum::<f64>() / n);
    let sum = |f: &dyn Fn(f64, f64) -> f64| a.iter().zip(b).map(|(&x, &y)| f(x - ma, y - mb)).sum::<f64>();
    sum(&|x, y| x * y) / (sum(&|x, _| x * x) * sum(&|_, y| y * y)).sqrt()
}

fn best(curve: &[f64]) -> usize {
    (0..curve.len()).max_by(|&a, &b| curve[a].total_cmp(&curve[b])).unwrap()
}

#[test]
#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]
fn curves_agree_with_those_computed_elsewhere() {
    // The reference invents a border by reflection, ours leaves it out: the same curve but for the outermost pixels.
    for (folder, suffix) in [("dfnn_mitochondria", ""), ("acq4_pipette_tip", "_roi")] {
        let stack = Stack::open(&shared_data(folder)).unwrap();
        for (column, m) in [
            ("tenengrad", Measure::Tenengrad),
            ("var_lap", Measure::VarianceOfLaplacian),
            ("norm_var", Measure::NormalisedVariance),
            ("brenner", Measure::Brenner),
        ] {
            let theirs = reference(folder, &format!("{column}{suffix}"));
            let ours = curve(&stack, stack.roi(), m);
            assert_eq!(best(&ours), best(&theirs), "{folder}: plane of the largest {m}");
            let r = correlation(&ours, &theirs);
            assert!(r > 0.99, "{folder}: {m} correlates with the reference by {r}");
        }
    }
}

fn compared(folder: &str, roi: Option<Roi>) -> (Vec<Row>, Recommendation) {
    let stack = Stack::open(&shared_data(folder)).unwrap();
    let roi = roi.or(stack.roi());
    let planes: Vec<_> = stack.planes.iter().map(|p| roi.map_or(p.view(), |roi| p.view().crop(roi).unwrap())).collect();
    let z: Vec<_> = (0..planes.len()).map(|k| stack.z(k)).collect();
    let truth = stack.about.truth.as_ref().and_then(|t| t.plane).map(|k| stack.z(k));
    let rows = compare(&planes, &z, truth).unwrap();
    let recommendation = recommend(&rows, Micrometres(stack.about.z_step_um), truth);
    (rows, recommendation)
}

fn error_um(rows: &[Row], m: Measure) -> f64 {
    rows.iter().find(|row| row.measure == m).and_then(|row| row.error_um).expect("a peak and a truth")
}

#[test]
#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]
fn the_recommended_measure_ends_within_a_plane_of_the_known_focus() {
    let (rows, recommendation) = compared("acq4_pipette_tip", None);
    assert!(error_um(&rows, recommendation.measure.unwrap()) <= 1.6, "{}", recommendation.words);
    assert!(error_um(&rows, Measure::Tenengrad) <= 1.6);

    let (rows, recommendation) = compared("dfnn_mitochondria", None);
    assert!(error_um(&rows, recommendation.measure.unwrap()) <= 0.051, "{}", recommendation.words);
}

#[test]
#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]
fn stacks_without_a_peak_in_focus_are_told() {
    let (_, recommendation) = compared("bfdc_edge_peak", None);
    assert_eq!(recommendation.measure, None, "{}", recommendation.words);

    // An unstained cell: two lobes, the focus between them.
    let (_, recommendation) = compared("bfautofocus_yeast", None);
    assert!(recommendation.words.contains("valley between two lobes is at 4.50 µm"), "{}", recommendation.words);

    // The whole picture peaks on the shank, too deep.
    let (_, recommendation) = compared("acq4_pipette_tip", Some(Roi { x: 0, y: 0, width: 64, height: 129 }));
    assert!(recommendation.words.contains("choose a region"), "{}", recommendation.words);
}

#[test]
#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]
fn real_pictures_are_fit_for_focusing_and_have_a_textured_tile() {
    for folder in ["acq4_pipette_tip", "bfautofocus_yeast", "bfdc_edge_peak", "dfnn_mitochondria", "focusstack_pcb"] {
        let stack = Stack::open(&shared_data(folder)).unwrap();
        for (k, plane) in stack.planes.iter().enumerate() {
            let quality = Quality::of(plane.view());
            assert_eq!(quality.fault(), None, "{folder} plane {k}: {quality:?}");
        }
        let middle = stack.planes[stack.planes.len() / 2].view();
        assert!(sharpest_tile(middle, 32).is_some(), "{folder}");
    }
}
