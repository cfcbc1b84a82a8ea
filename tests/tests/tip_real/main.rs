//! The tip of a real pipette, in a focal stack taken with a 40x/0.8 W objective.

mod pasted;

use parfocal::frames::image_file;
use parfocal::picture::Picture;
use parfocal::tip::{Expect, Tip, detect};
use parfocal_tests::shared_data;

/// The planes within 5 µm of the operator's focus.
fn planes() -> Vec<(f64, Picture)> {
    let folder = shared_data("acq4_pipette_tip");
    (22..=28).map(|k| (f64::from(k), image_file::read(&folder.join(format!("z{k:03}.png"))).unwrap().0)).collect()
}

fn tips() -> Vec<(f64, Tip)> {
    let find = |p: &Picture| detect(&p.view(), &Expect::default()).expect("the tip is plain to see");
    planes().iter().map(|(plane, picture)| (*plane, find(picture))).collect()
}

#[test]
#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]
fn the_tip_is_found_near_where_the_operator_saw_it_and_points_up_the_rows() {
    for (plane, tip) in tips() {
        let away = (tip.x_px - 29.31).hypot(tip.y_px - 15.12);
        assert!(away <= 4.0, "plane {plane}: {away:.2} px from the operator's point");
        // The shank lies towards larger rows, so the tip points to smaller ones.
        assert!((tip.angle_deg + 90.0).abs() <= 3.0, "plane {plane}: {:.2} degrees", tip.angle_deg);
    }
}

#[test]
#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]
fn through_the_planes_the_tip_moves_on_a_straight_line() {
    let tips = tips();
    let n = tips.len() as f64;
    let middle = tips.iter().map(|t| t.0).sum::<f64>() / n;
    let spread: f64 = tips.iter().map(|t| (t.0 - middle).powi(2)).sum();
    let line = |of: fn(&Tip) -> f64| {
        let mean = tips.iter().map(|t| of(&t.1)).sum::<f64>() / n;
        let slope = tips.iter().map(|t| (t.0 - middle) * of(&t.1)).sum::<f64>() / spread;
        move |plane: f64| mean + slope * (plane - middle)
    };
    let (x, y) = (line(|t| t.x_px), line(|t| t.y_px));
    for (plane, tip) in &tips {
        let off = (tip.x_px - x(*plane)).hypot(tip.y_px - y(*plane));
        assert!(off <= 1.0, "plane {plane}: {off:.2} px off the line");
    }
}

#[test]
#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]
fn a_mirrored_or_turned_picture_has_a_mirrored_or_turned_tip() {
    let grey = |p: &Picture, x: usize, y: usize| p.view().get(x, y).unwrap();
    let mut errors = Vec::new();
    for (plane, picture) in planes() {
        let (w, h) = (picture.width, picture.height);
        let tip = detect(&picture.view(), &Expect::default()).unwrap();
        let mirrored: Vec<u16> = (0..w * h).map(|i| grey(&picture, w - 1 - i % w, i / w)).collect();
        let turned: Vec<u16> = (0..w * h).map(|i| grey(&picture, i / h, h - 1 - i % h)).collect();
        let right = (w - 1) as f64;
        let bottom = (h - 1) as f64;
        for (picture, x, y) in [
            (Picture::grey16(w, h, mirrored).unwrap(), right - tip.x_px, tip.y_px),
            (Picture::grey16(h, w, turned).unwrap(), bottom - tip.y_px, tip.x_px),
        ] {
            let found = detect(&picture.view(), &Expect::default()).unwrap_or_else(|| panic!("plane {plane}: no tip"));
            errors.push((found.x_px - x).hypot(found.y_px - y));
        }
    }
    errors.sort_by(f64::total_cmp);
    assert!(errors[errors.len() / 2] <= 0.7, "{errors:.2?}");
}

/// Detections of the seven planes, each shown in several ways: how far from the transformed tip, in pixels of the stack.
fn pasted_errors(scales: &[f64]) -> (Vec<f64>, Vec<String>) {
    use pasted::{Background, Pasted};
    let (mut errors, mut misses) = (Vec::new(), Vec::new());
    let backgrounds = [Background::Even, Background::Uneven, Background::Cells];
    for (plane, picture) in planes() {
        let tip = detect(&picture.view(), &Expect::default()).unwrap();
        for (i, scale) in scales.iter().enumerate() {
            for (j, background) in backgrounds.into_iter().enumerate() {
                for mirrored in [false, true] {
                    let seed = 100 * plane as u64 + 10 * i as u64 + 3 * j as u64 + u64::from(mirrored);
                    let turn_deg = (seed * 47 % 360) as f64;
                    let pasted = Pasted { turn_deg, mirrored, scale: *scale, background, seed };
                    let [x, y] = pasted.shown(&picture, [tip.x_px, tip.y_px]);
                    let expect = Expect { pixel_um: 0.323 / scale, ..Expect::default() };
                    match detect(&pasted.picture(&picture).view(), &expect) {
                        Some(found) => errors.push((found.x_px - x).hypot(found.y_px - y) / scale),
                        None => misses.push(format!("plane {plane}: {pasted:?}")),
                    }
                }
            }
        }
    }
    errors.sort_by(f64::total_cmp);
    (errors, misses)
}

#[test]
#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]
fn turned_mirrored_enlarged_and_pasted_elsewhere_the_tip_stays_where_it_is() {
    let (errors, misses) = pasted_errors(&[1.0, 1.5, 2.0, 3.0]);
    let of = errors.len() + misses.len();
    let at = |share: f64| errors[((errors.len() - 1) as f64 * share).round() as usize];
    println!("found {} of {of}; median {:.2} px, 95 % {:.2} px", errors.len(), at(0.5), at(0.95));
    assert!(errors.len() * 10 >= of * 9, "missed: {misses:#?}");
    assert!(at(0.5) <= 0.7 && at(0.95) <= 2.0, "median {:.2} px, 95 % {:.2} px", at(0.5), at(0.95));
}
