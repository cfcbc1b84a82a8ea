use super::*;

fn pipette() -> Pipette {
    Pipette {
        tip_um: [3.0, -2.0, 10.0],
        azimuth_rad: 2.4,
        descent_rad: 0.6,
        opening_radius_um: 1.0,
        half_angle_rad: 0.15,
        contrast: 0.1,
    }
}

fn scene() -> Scene {
    let speck = |matter, x, z| Speck {
        matter,
        at_um: [x, 9.0, z],
        radius_um: 6.0,
        aspect: 1.4,
        azimuth_rad: 0.3,
        contrast: 0.08,
    };
    Scene {
        pipettes: vec![pipette()],
        specks: vec![speck(Matter::Cell, -20.0, 4.0), speck(Matter::Debris, 25.0, 30.0)],
        light: Light { vignetting: 0.2, slope: [0.05, -0.03] },
    }
}

const NOISY: Exposure = Exposure { level: 0.5, shot_noise: 0.01, read_noise: 0.002, seed: 5 };

#[test]
fn a_region_shows_what_the_whole_shows() {
    let view = Viewpoint::level([0.0, 0.0], 8.0, 0.32, 333, 257);
    let whole = scene().render(&view, &NOISY);
    let region = Region { x: 101, y: 67, width: 90, height: 143 };
    let part = scene().render_region(&view, &NOISY, region);
    for y in 0..region.height {
        let from = (y + region.y) * whole.width + region.x;
        assert_eq!(
            part.pixels[y * region.width..(y + 1) * region.width],
            whole.pixels[from..from + region.width],
            "row {y}"
        );
    }
    let outside = scene().render_region(&view, &NOISY, Region { x: 300, y: 300, width: 90, height: 90 });
    assert_eq!((outside.width, outside.height, outside.pixels.len()), (33, 0, 0));
}

#[test]
fn nothing_is_lost_by_looking_only_where_objects_are() {
    // The light of every pixel, worked out without blocks or skipping, against the drawn one.
    let view = Viewpoint { focus_um: 2.0, ..Viewpoint::level([0.0, 0.0], 8.0, 0.32, 320, 240) };
    let scene = Scene { light: Light::default(), ..scene() };
    let frame = scene.render(&view, &Exposure::NOISELESS);
    let objects: Vec<Box<dyn Fn([f64; 2]) -> f64>> = {
        use paint::Object;
        let pipette = pipette::Projection::new(&scene.pipettes[0], &view);
        let mut all: Vec<Box<dyn Fn([f64; 2]) -> f64>> = vec![Box::new(move |p| pipette.contrast(p))];
        for speck in &scene.specks {
            let speck = speck::Projection::new(speck, &view);
            all.push(Box::new(move |p| speck.contrast(p)));
        }
        all
    };
    for y in 0..view.height {
        for x in 0..view.width {
            let at = view.ref_um(x as f64, y as f64);
            let exact = 1.0 + objects.iter().map(|o| o(at)).sum::<f64>();
            let drawn = f64::from(frame.pixels[y * view.width + x]) / (0.5 * 65535.0);
            assert!((drawn - exact).abs() < 0.002, "{x},{y}: {drawn} for {exact}");
        }
    }
}

#[test]
fn the_tip_is_where_the_viewpoint_says() {
    let view = Viewpoint {
        matrix_um_per_px: [[0.1, 0.3], [-0.31, 0.12]],
        ..Viewpoint::level([4.0, 5.0], 10.0, 0.32, 320, 240)
    };
    let [x, y] = view.picture_px([3.0, -2.0]).unwrap();
    let back = view.ref_um(x, y);
    assert!((back[0] - 3.0).abs() < 1e-9 && (back[1] + 2.0).abs() < 1e-9);
    // Light is taken on the shank's side of the tip and none far on the other.
    let frame = scene().render(&view, &Exposure::NOISELESS);
    let [ux, uy, _] = pipette().direction();
    let grey = |along: f64| {
        let [x, y] = view.picture_px([3.0 + along * ux, -2.0 + along * uy]).unwrap();
        f64::from(frame.pixels[y.round() as usize * frame.width + x.round() as usize])
    };
    assert!(grey(-6.0) < 0.97 * grey(8.0), "{} {}", grey(-6.0), grey(8.0));
}

#[test]
fn frames_repeat_and_seeds_differ() {
    let view = Viewpoint { bits: 8, ..Viewpoint::level([0.0, 0.0], 8.0, 0.32, 64, 48) };
    let frame = scene().render(&view, &NOISY);
    assert_eq!(frame, scene().render(&view, &NOISY));
    assert!(frame.pixels.iter().all(|v| *v <= 255));
    assert_ne!(frame, scene().render(&view, &Exposure { seed: 6, ..NOISY }));
}

#[test]
fn a_singular_matrix_has_no_way_back() {
    let view = Viewpoint { matrix_um_per_px: [[1.0, 2.0], [2.0, 4.0]], ..Viewpoint::level([0.0; 2], 0.0, 1.0, 9, 9) };
    assert_eq!(view.picture_px([1.0, 1.0]), None);
}
