//! Whether a pipette runs into something on its way: its tip, and the axis of its shank where its direction is known. Every
//! obstacle is convex, and so is everything that a pipette can pass through between two poses; so the deepest point of the way is found by minimising a convex function, and nothing slips
//! through between samples.
//!
//! A manipulator's axes share a board and move together: a straight line of the joints is a straight line of the tip in
//! ref. Boards do not move together: against a cone that moves with the microscope, any combination of how far the
//! tip and how far the microscope has got is looked at.

use crate::calibration::frames::{Displacement, Point, Ref};
use crate::rig::{ManipulatorNumber, Obstacle};
use nalgebra::Vector3;
use thiserror::Error;

/// A tip would be inside an obstacle.
#[derive(Clone, Debug, Error, PartialEq)]
#[error(
    "the {} of {manipulator} would come {} obstacle '{obstacle}', at ({:.1}, {:.1}, {:.1}) µm of ref: nothing moved; go around it, or correct [[obstacle]] in the rig's file",
    if *.shank { "shank" } else { "tip" },
    if *.depth_um >= 0.0 { format!("{:.1} µm into", .depth_um) } else { format!("within {:.1} µm of", -.depth_um) },
    .at.coordinates.x, .at.coordinates.y, .at.coordinates.z
)]
pub struct Collision {
    /// Whose tip.
    pub manipulator: ManipulatorNumber,
    /// Not the tip itself, but the shank above it.
    pub shank: bool,
    /// The obstacle's name.
    pub obstacle: String,
    /// How deep inside, µm; below 0 when only the clearance is too small.
    pub depth_um: f64,
    /// Where that would be, in ref.
    pub at: Point<Ref>,
}

/// A tip's way, or where a tip may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Way {
    /// Where the tip is.
    pub from: Point<Ref>,
    /// Where it goes.
    pub to: Point<Ref>,
    /// How far from the line it may be, µm: overshoot of a final approach, or a tip that is not known better.
    pub around_um: f64,
    /// How far from `from` it may be now.
    pub around_now_um: f64,
    /// From the tip to the far end of the shank that is looked at, µm of ref; 0 when the pipette's direction is not known.
    pub shank: Displacement<Ref>,
}

/// The way of the objective's optical axis: where the picture's centre in focus is, in ref.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sight {
    /// Now.
    pub from: Point<Ref>,
    /// Then.
    pub to: Point<Ref>,
    /// How far beyond it may go, µm.
    pub around_um: f64,
}

/// Signed distance from an obstacle's surface, or less: below 0 inside. Convex in `p`. `sight` is where a cone stands.
fn outside(obstacle: &Obstacle, p: Vector3<f64>, sight: Vector3<f64>) -> f64 {
    match obstacle {
        Obstacle::Box { min_um, max_um, .. } => {
            (0..3).map(|k| (min_um[k] - p[k]).max(p[k] - max_um[k])).fold(f64::MIN, f64::max)
        }
        Obstacle::HalfSpace { point_um, normal, .. } => {
            let n = Vector3::from(*normal).normalize();
            n.dot(&(p - Vector3::from(*point_um)))
        }
        Obstacle::Floor { z_um, .. } => p.z - z_um,
        Obstacle::Cone { working_distance_um, front_radius_um, half_angle_deg, .. } => {
            let up = working_distance_um.signum();
            let beyond_front = up * (p.z - sight.z) - working_distance_um.abs();
            let off_axis = (p - sight).xy().norm();
            let (sin, cos) = half_angle_deg.to_radians().sin_cos();
            (-beyond_front).max((off_axis - front_radius_um) * cos - beyond_front * sin)
        }
    }
}

/// Least value of a convex function on [0, 1], and where: golden section, ends included.
fn least(mut f: impl FnMut(f64) -> f64) -> (f64, f64) {
    const RATIO: f64 = 0.618_033_988_749_894_9;
    let (mut low, mut high) = (0.0, 1.0);
    let (mut a, mut b) = (high - RATIO, low + RATIO);
    let (mut fa, mut fb) = (f(a), f(b));
    // 0.618^48 < 1e-10 of the way.
    for _ in 0..48 {
        if fa <= fb {
            (high, b, fb) = (b, a, fa);
            a = high - RATIO * (high - low);
            fa = f(a);
        } else {
            (low, a, fa) = (a, b, fb);
            b = low + RATIO * (high - low);
            fb = f(b);
        }
    }
    let middle = 0.5 * (low + high);
    [0.0, 1.0, middle]
        .into_iter()
        .map(|s| (f(s), s))
        .fold((f64::MAX, 0.0), |best, new| if new.0 < best.0 { new } else { best })
}

/// A pipette's deepest point in an obstacle along its way.
struct Deepest {
    /// Outside by so much, µm; below 0: inside.
    distance: f64,
    at: Point<Ref>,
    /// Share of the shank from the tip.
    up: f64,
}

fn deepest(obstacle: &Obstacle, way: &Way, sight: &Sight) -> Deepest {
    let line = |from: Point<Ref>, to: Point<Ref>, s: f64| from.coordinates + s * (to.coordinates - from.coordinates);
    let part = |up: f64, s: f64| line(way.from, way.to, s) + up * way.shank.coordinates;
    let at_sight = |t: f64, up: f64, s: f64| outside(obstacle, part(up, s), line(sight.from, sight.to, t));
    // Least over everything but the first: convex in what is left.
    let along = |t: f64, up: f64| least(|s| at_sight(t, up, s));
    let up_along = |t: f64| match way.shank.coordinates == Vector3::zeros() {
        true => (along(t, 0.0).0, 0.0),
        false => least(|up| along(t, up).0),
    };
    let (t, around) = if matches!(obstacle, Obstacle::Cone { .. }) {
        (least(|t| up_along(t).0).1, way.around_um + sight.around_um)
    } else {
        (0.0, way.around_um)
    };
    let up = up_along(t).1;
    let (distance, s) = along(t, up);
    Deepest { distance: distance - around, at: part(up, s).into(), up }
}

/// Slack for what a step rounds away, µm.
const ROUNDING_UM: f64 = 0.1;

/// What is nearer to the tip than this is called the tip, µm.
const TIP_UM: f64 = 1.0;

/// Refuses a way that leads a tip into an obstacle. A tip that already is inside one may go out, not deeper.
///
/// `in_use` is the objective in the light path: cones of other objectives are out of the way.
///
/// # Errors
/// The deepest [`Collision`] with the first obstacle that is in the way.
pub fn check(
    obstacles: &[Obstacle],
    in_use: Option<&str>,
    manipulator: ManipulatorNumber,
    way: &Way,
    sight: &Sight,
) -> Result<(), Collision> {
    for obstacle in obstacles {
        if matches!(obstacle, Obstacle::Cone { objective, .. } if Some(objective.as_str()) != in_use) {
            continue;
        }
        let Deepest { distance, at, up } = deepest(obstacle, way, sight);
        if distance >= 0.0 {
            continue;
        }
        let standing = Way { to: way.from, around_um: 0.0, ..*way };
        let here = Sight { to: sight.from, around_um: 0.0, ..*sight };
        let now = deepest(obstacle, &standing, &here).distance - way.around_now_um;
        if distance < now - ROUNDING_UM || now >= 0.0 {
            let obstacle = obstacle.name().to_owned();
            let shank = up * way.shank.coordinates.norm() > TIP_UM;
            return Err(Collision { manipulator, shank, obstacle, depth_um: -(distance + way.around_um), at });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn m1() -> ManipulatorNumber {
        ManipulatorNumber::new(1).unwrap()
    }

    fn still(at: [f64; 3]) -> Sight {
        Sight { from: Vector3::from(at).into(), to: Vector3::from(at).into(), around_um: 0.0 }
    }

    fn way(from: [f64; 3], to: [f64; 3]) -> Way {
        Way {
            from: Vector3::from(from).into(),
            to: Vector3::from(to).into(),
            around_um: 0.0,
            around_now_um: 0.0,
            shank: Displacement::new(0.0, 0.0, 0.0),
        }
    }

    fn cone(working_distance_um: f64) -> Obstacle {
        Obstacle::Cone {
            name: "lens".into(),
            objective: "40x".into(),
            working_distance_um,
            front_radius_um: 500.0,
            half_angle_deg: 40.0,
        }
    }

    fn passes(obstacle: &Obstacle, way: &Way, sight: &Sight) -> bool {
        check(std::slice::from_ref(obstacle), Some("40x"), m1(), way, sight).is_ok()
    }

    fn coordinate() -> impl Strategy<Value = [f64; 3]> {
        proptest::array::uniform3(-2000.0..2000.0f64)
    }

    /// Whether a point is inside, straight from each shape's definition.
    fn inside(obstacle: &Obstacle, p: [f64; 3], sight: [f64; 3]) -> bool {
        match obstacle {
            Obstacle::Box { min_um, max_um, .. } => (0..3).all(|k| p[k] > min_um[k] && p[k] < max_um[k]),
            Obstacle::HalfSpace { point_um, normal, .. } => {
                (0..3).map(|k| normal[k] * (p[k] - point_um[k])).sum::<f64>() < 0.0
            }
            Obstacle::Floor { z_um, .. } => p[2] < *z_um,
            Obstacle::Cone { working_distance_um, front_radius_um, half_angle_deg, .. } => {
                let height = (p[2] - sight[2]) * working_distance_um.signum() - working_distance_um.abs();
                let radius = front_radius_um + height * half_angle_deg.to_radians().tan();
                height > 0.0 && (p[0] - sight[0]).hypot(p[1] - sight[1]) < radius
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]
        /// Against many points of the way, the microscope being anywhere on its own.
        #[test]
        fn no_point_of_a_way_that_passes_is_inside(
            from in coordinate(), to in coordinate(), sight_from in coordinate(), sight_to in coordinate(),
            a in coordinate(), b in coordinate(), kind in 0..4,
        ) {
            let name = String::from("it");
            let obstacle = match kind {
                0 => Obstacle::Box {
                    name,
                    min_um: std::array::from_fn(|k| a[k].min(b[k])),
                    max_um: std::array::from_fn(|k| a[k].max(b[k]) + 1.0),
                },
                1 => Obstacle::HalfSpace { name, point_um: a, normal: b },
                2 => Obstacle::Floor { name, z_um: a[0] },
                _ => cone(a[0] + if a[0] < 0.0 { -1.0 } else { 1.0 }),
            };
            let sight = Sight { from: Vector3::from(sight_from).into(), to: Vector3::from(sight_to).into(), around_um: 0.0 };
            let mix = |p: [f64; 3], q: [f64; 3], s: f64| std::array::from_fn(|k| p[k] + s * (q[k] - p[k]));
            let mut hit = false;
            for i in 0..=40 {
                for j in 0..=40 {
                    hit |= inside(&obstacle, mix(from, to, f64::from(i) / 40.0), mix(sight_from, sight_to, f64::from(j) / 40.0));
                }
            }
            let starts_inside = inside(&obstacle, from, sight_from);
            if !starts_inside && hit {
                prop_assert!(!passes(&obstacle, &way(from, to), &sight), "{obstacle:?}");
            }
            // What is refused is inside at the place that the refusal names, or deeper than at the start.
            if let Err(collision) = check(std::slice::from_ref(&obstacle), Some("40x"), m1(), &way(from, to), &sight) {
                prop_assert!(collision.depth_um > 0.0);
            }
        }
    }

    #[test]
    fn a_wall_between_two_free_ends_is_seen_however_thin() {
        let wall = Obstacle::Box { name: "wall".into(), min_um: [0.0, -900.0, -900.0], max_um: [0.2, 900.0, 900.0] };
        assert!(!passes(&wall, &way([-500.0, 0.0, 0.0], [700.0, 3.0, 0.0]), &still([0.0; 3])));
        assert!(passes(&wall, &way([-500.0, 0.0, 0.0], [-1.0, 3.0, 0.0]), &still([0.0; 3])));
    }

    #[test]
    fn the_objectives_cone_moves_with_it_and_counts_only_in_use() {
        let lens = cone(3000.0);
        let high = way([0.0, 0.0, 2900.0], [0.0, 0.0, 2900.0]);
        assert!(passes(&lens, &high, &still([0.0; 3])));
        let lowered = Sight { to: Vector3::new(0.0, 0.0, -200.0).into(), ..still([0.0; 3]) };
        assert!(!passes(&lens, &high, &lowered));
        assert!(check(&[lens], Some("4x"), m1(), &high, &lowered).is_ok());
    }

    #[test]
    fn two_moves_that_are_safe_together_are_refused_when_one_may_come_first() {
        // The lens goes down by as much as the tip does: safe only if the tip goes first.
        let lens = cone(1000.0);
        let down = Sight { to: Vector3::new(0.0, 0.0, -800.0).into(), ..still([0.0; 3]) };
        assert!(!passes(&lens, &way([0.0, 0.0, 900.0], [0.0, 0.0, 100.0]), &down));
    }

    #[test]
    fn a_tip_inside_may_leave_but_not_go_deeper() {
        let floor = Obstacle::Floor { name: "dish".into(), z_um: 0.0 };
        let sight = still([0.0; 3]);
        assert!(passes(&floor, &way([0.0, 0.0, -5.0], [0.0, 0.0, 50.0]), &sight));
        assert!(!passes(&floor, &way([0.0, 0.0, -5.0], [0.0, 0.0, -6.0]), &sight));
        let around = Way { around_um: 10.0, ..way([0.0, 0.0, 100.0], [0.0, 0.0, 8.0]) };
        let error = check(std::slice::from_ref(&floor), None, m1(), &around, &sight).unwrap_err().to_string();
        assert!(error.contains("within 8.0 µm of obstacle 'dish'") && error.contains("m1"), "{error}");
        // Known to be free now, but nobody knows which way it will go.
        let unknown = Way { around_um: 10.0, ..way([0.0, 0.0, 8.0], [0.0, 0.0, 8.0]) };
        assert!(check(&[floor], None, m1(), &unknown, &sight).is_err());
    }

    #[test]
    fn the_shank_is_looked_at_as_well_as_the_tip() {
        // A pipette that descends by 45° towards x: its shank lies behind it, at negative x, as high as far.
        let shank = Displacement::new(-1000.0, 0.0, 1000.0);
        let leaning = |from, to| Way { shank, ..way(from, to) };
        let block =
            Obstacle::Box { name: "block".into(), min_um: [-700.0, -50.0, 400.0], max_um: [-500.0, 50.0, 550.0] };
        let sight = still([0.0; 3]);
        let refused = |way: &Way| check(std::slice::from_ref(&block), None, m1(), way, &sight).unwrap_err();
        // From the side: the tip passes far below the block, the shank goes through it.
        let side = leaning([0.0, 300.0, 0.0], [0.0, 0.0, 0.0]);
        let collision = refused(&side);
        assert!(collision.shank && collision.to_string().contains("the shank of m1"), "{collision}");
        assert!(passes(&block, &Way { shank: Displacement::new(0.0, 0.0, 0.0), ..side }, &sight));
        // On the other side of it, and back out of it.
        assert!(passes(&block, &leaning([0.0, 300.0, 0.0], [0.0, 100.0, 0.0]), &sight));
        assert!(passes(&block, &leaning([0.0, 20.0, 0.0], [0.0, 300.0, 0.0]), &sight));
        // The lens comes down onto a shank whose tip it would not touch.
        let lens = cone(100.0);
        let down = |to| Sight { to: Vector3::from(to).into(), ..still([-600.0, 0.0, 2000.0]) };
        let rest = leaning([300.0, 0.0, 0.0], [300.0, 0.0, 0.0]);
        assert!(check(std::slice::from_ref(&lens), Some("40x"), m1(), &rest, &down([-600.0, 0.0, 1200.0])).is_ok());
        assert!(
            check(std::slice::from_ref(&lens), Some("40x"), m1(), &rest, &down([-600.0, 0.0, 100.0]))
                .unwrap_err()
                .shank
        );
    }
}
