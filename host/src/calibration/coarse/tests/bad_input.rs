//! What people get wrong, and what they are told.

use super::scene::{Rig, disc, errors, pose};
use super::*;
use crate::calibration::coarse::reject::{CoarseError, Why};

fn refusal(rig: &Rig, change: impl Fn(&mut Vec<Pair>)) -> String {
    let mut pairs = rig.pairs();
    change(&mut pairs);
    register(&pairs, &rig.camera, &rig.settings()).unwrap_err().to_string()
}

#[test]
fn exchanged_pictures_are_named() {
    let rig = Rig::new(11);
    let text = refusal(&rig, |pairs| {
        let p = &mut pairs[1];
        std::mem::swap(&mut p.left, &mut p.right);
    });
    assert!(text.contains("place 2") && text.contains("exchanged"), "{text}");
}

#[test]
fn pairs_out_of_order_are_named() {
    let rig = Rig::new(12);
    let text = refusal(&rig, |pairs| {
        let (a, b) = pairs.split_at_mut(1);
        std::mem::swap(&mut a[0].right, &mut b[0].right);
    });
    assert!(text.contains("place 1") && (text.contains("do not belong") || text.contains("exchanged")), "{text}");
}

#[test]
fn one_picture_twice_is_no_pair() {
    let text = refusal(&Rig::new(13), |pairs| pairs[1].right = pairs[1].left.clone());
    assert!(text.contains("place 2") && text.contains("mono"), "{text}");
}

#[test]
fn a_black_picture_is_named() {
    let text = refusal(&Rig::new(13), |pairs| pairs[1].left.values.fill(3.0));
    assert!(text.contains("place 2: the left picture is all one shade"), "{text}");
}

#[test]
fn a_picture_of_another_size_is_named() {
    let rig = Rig::new(13);
    let text = refusal(&rig, |pairs| {
        pairs[0].right.height -= 1;
        pairs[0].right.values.truncate(1280 * 959);
    });
    assert!(text.contains("place 1: the right picture is 1280x959"), "{text}");
}

#[test]
fn a_wrong_tag_size_is_measured() {
    let rig = Rig::new(14);
    let settings = Settings::new(25.0, MarkerId(0));
    let text = register(&rig.pairs(), &rig.camera, &settings).unwrap_err().to_string();
    assert!(text.contains("measure 2") || text.contains("measure 19.9"), "{text}");
    assert!(text.contains("25.0"), "{text}");
}

#[test]
fn without_the_substrates_marker_nothing_is_guessed() {
    let mut rig = Rig::new(15);
    rig.truth.remove(&MarkerId(0));
    let text = rig.register().unwrap_err().to_string();
    assert!(text.contains("marker 0") && text.contains("1, 2 and 3"), "{text}");
}

#[test]
fn a_mirrored_print_is_named() {
    let mut rig = Rig::new(16);
    rig.mirrored = Some(MarkerId(2));
    let text = rig.register().unwrap_err().to_string();
    assert!(text.contains("marker 2 can be read only mirrored"), "{text}");
}

#[test]
fn a_number_printed_twice_is_left_out_and_harms_no_other() {
    let mut rig = Rig::new(17);
    rig.doubles = vec![(MarkerId(1), pose(0.0, 45.0, -5.0, [0.0, 1.0, 0.0], 10.0))];
    let found = rig.register().unwrap();
    assert!(found.rejected.iter().any(|r| r.marker == MarkerId(1) && matches!(r.why, Why::Twice { .. })));
    assert!(!found.markers.contains_key(&MarkerId(1)));
    assert!(errors(&rig, &found).0.iter().all(|mm| *mm < 0.25));
}

#[test]
fn a_marker_that_moved_is_named_and_harms_no_other() {
    for (seed, by) in [(18, 1.0), (19, 12.0)] {
        let mut rig = Rig::new(seed);
        let moved = rig.truth[&MarkerId(2)] * pose(by, 0.0, 0.0, [1.0, 0.0, 0.0], 0.0);
        rig.otherwise.insert((Place(2), MarkerId(2)), Some(moved));
        let found = rig.register().unwrap();
        let [rejected] = &found.rejected[..] else { panic!("{:?}", found.rejected) };
        let Why::Moved { mm, .. } = &rejected.why else { panic!("{rejected}") };
        assert!(rejected.marker == MarkerId(2) && (mm.0 - by).abs() < 0.5, "{rejected}");
        assert!(!found.markers.contains_key(&MarkerId(2)) && found.markers.len() == 3);
        assert!(errors(&rig, &found).0.iter().all(|mm| *mm < 0.25));
    }
}

#[test]
fn a_moved_substrate_is_not_blamed_on_the_others() {
    let mut rig = Rig::new(20);
    rig.otherwise.insert((Place(2), MarkerId(0)), Some(pose(6.0, 0.0, 0.0, [0.0, 0.0, 1.0], 3.0)));
    let error = rig.register().unwrap_err();
    assert!(matches!(error, CoarseError::SubstrateMoved { .. }), "{error}");
}

#[test]
fn one_wrong_view_of_three_is_left_out() {
    let mut rig = Rig::new(21);
    rig.places.push(super::scene::looking([0.0, 150.0, -250.0], [0.0, -15.0, -15.0], 5.0));
    let wrong = rig.truth[&MarkerId(3)] * pose(2.0, 1.0, 0.0, [1.0, 0.0, 0.0], 6.0);
    rig.otherwise.insert((Place(2), MarkerId(3)), Some(wrong));
    let found = rig.register().unwrap();
    let [rejected] = &found.rejected[..] else { panic!("{:?}", found.rejected) };
    assert!(rejected.marker == MarkerId(3) && rejected.place == Some(Place(2)), "{rejected}");
    assert!(found.markers.contains_key(&MarkerId(3)));
    assert!(errors(&rig, &found).0.iter().all(|mm| *mm < 0.25));
}

#[test]
fn a_marker_seen_from_one_place_only_is_placed() {
    let mut rig = Rig::new(22);
    rig.otherwise.insert((Place(1), MarkerId(1)), None);
    let found = rig.register().unwrap();
    assert!(found.rejected.is_empty() && found.markers.len() == 4);
    assert!(errors(&rig, &found).0.iter().all(|mm| *mm < 0.4));
}

#[test]
fn markers_without_a_link_are_listed() {
    let mut rig = Rig::new(23);
    // A third place sees marker 7 only.
    rig.truth.insert(MarkerId(7), pose(0.0, 0.0, 0.0, [1.0, 0.0, 0.0], 0.0));
    rig.places.push(super::scene::looking([40.0, 140.0, -250.0], [0.0, 0.0, 0.0], 5.0));
    for k in 0..3 {
        for id in [0, 1, 2, 3, 7] {
            if (k == 2) != (id == 7) {
                rig.otherwise.insert((Place(k + 1), MarkerId(id)), None);
            }
        }
    }
    let found = rig.register().unwrap();
    assert_eq!(found.unconnected, [MarkerId(7)]);
    assert_eq!(found.markers.len(), 4);
}

#[test]
fn markers_partly_hidden_are_placed() {
    let mut rig = Rig::new(24);
    for (id, at) in [(1, [10.0, 3.0]), (2, [-2.0, 10.0]), (3, [7.0, 7.0])] {
        let hidden = disc(&rig, MarkerId(id), at, 2.5);
        rig.occluders.push((Place(1), hidden));
    }
    let found = rig.register().unwrap();
    assert_eq!(found.markers.len(), 4, "{:?}", found.rejected);
    let (mm, deg) = errors(&rig, &found);
    assert!(mm.iter().all(|mm| *mm < 0.3) && deg.iter().all(|deg| *deg < 0.5), "{mm:?} {deg:?}");
}
