//! Tips in random scenes: a part of what `cargo xtask bench tips` draws from the same file.

use parfocal::picture::Picture;
use parfocal::tip::{Expect, Tip, detect};
use parfocal_simulator::scene::{Drawn, Ranges, Show};

fn ranges() -> Ranges {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../benches/tips.toml");
    toml::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn find(drawn: &Drawn) -> Option<Tip> {
    let frame = drawn.scene.render(&drawn.view, &drawn.exposure);
    let picture = Picture::grey16(frame.width, frame.height, frame.pixels).unwrap();
    detect(&picture.view(), &Expect::default())
}

#[test]
fn tips_are_found_where_they_are() {
    let ranges = ranges();
    let mut errors: Vec<f64> = Vec::new();
    let scenes = 60;
    for seed in 20_000..20_000 + scenes {
        let drawn = ranges.draw(Show::Tip, seed);
        let [x, y] = drawn.seen[0].tip_px;
        errors.extend(find(&drawn).map(|tip| (tip.x_px - x).hypot(tip.y_px - y)));
    }
    errors.sort_by(f64::total_cmp);
    let found = errors.len();
    assert!(found as u64 * 10 >= scenes * 3, "{found} of {scenes}");
    assert!(errors[found / 2] <= 3.0 && errors[found * 19 / 20] <= 10.0, "{errors:.1?}");
}

#[test]
fn where_there_is_no_tip_none_is_found() {
    let ranges = ranges();
    for seed in 20_000..20_030 {
        for show in [Show::Nothing, Show::ShankOnly] {
            let tip = find(&ranges.draw(show, seed));
            assert!(tip.is_none(), "{show:?} {seed}: {tip:?}");
        }
    }
}
