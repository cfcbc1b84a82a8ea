//! Places to look at around one that is known only coarsely, the likeliest first.

/// Heights from −`reach` to `reach`, `step` apart, the likeliest first.
pub(super) fn outwards(reach: f64, step: f64) -> Vec<f64> {
    if reach <= step / 2.0 {
        return vec![0.0];
    }
    let count = (reach / step).ceil().max(0.0) as i32;
    let mut all: Vec<f64> = (-count..=count).map(|k| f64::from(k) * step).collect();
    all.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    all
}

/// Places of a square grid within `reach` (and half a step) of the middle, from there outwards.
pub(super) fn spiral(reach: f64, step: f64) -> Vec<[f64; 2]> {
    let count = (reach / step).ceil() as i32;
    let mut all: Vec<[f64; 2]> = (-count..=count)
        .flat_map(|x| (-count..=count).map(move |y| [f64::from(x) * step, f64::from(y) * step]))
        .filter(|[x, y]| x.hypot(*y) <= reach + step / 2.0)
        .collect();
    all.sort_by(|a, b| a[0].hypot(a[1]).total_cmp(&b[0].hypot(b[1])));
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_search_begins_in_the_middle_and_covers_its_reach() {
        let places = spiral(300.0, 120.0);
        assert_eq!(places[0], [0.0, 0.0]);
        assert!(places.iter().all(|[x, y]| x.hypot(*y) <= 360.0));
        // Every place within reach is within half a step of one looked at, in x and y.
        for k in 0..200 {
            let (r, a) = (300.0 * f64::from(k) / 200.0, f64::from(k) * 2.4);
            let [x, y] = [r * a.cos(), r * a.sin()];
            assert!(places.iter().any(|p| (p[0] - x).abs() <= 60.1 && (p[1] - y).abs() <= 60.1), "{x} {y}");
        }
        assert_eq!(spiral(10.0, 500.0)[0], [0.0, 0.0]);
        let heights = outwards(100.0, 40.0);
        assert_eq!(heights[0], 0.0);
        assert!(heights.contains(&120.0) && heights.contains(&-120.0) && heights.len() == 7);
        assert_eq!(outwards(10.0, 40.0), [0.0]);
    }
}
