//! When would two boxes touch if both kept their velocities and headings?

use super::footprint::Footprint;
use crate::geometry::Vec2;

/// Speeds below this do not close a gap within any time of interest, m/s.
const NO_MOTION_MPS: f64 = 1e-9;

/// Time until the boxes first touch, seconds: 0 if they overlap, `None` if they never do.
///
/// The boxes overlap while their projections onto all four of their axes overlap (separating-axis theorem). Under
/// constant velocities each of these is an interval of time, and the boxes overlap in the intersection of the four.
pub(crate) fn time_to_collision_s(a: &Footprint, velocity_a: Vec2, b: &Footprint, velocity_b: Vec2) -> Option<f64> {
    let (between, relative) = (b.center - a.center, velocity_b - velocity_a);
    let (mut enter_s, mut exit_s) = (0.0_f64, f64::INFINITY);
    for axis in [a.forward, a.forward.left(), b.forward, b.forward.left()] {
        let reach_m = a.half_extent_m(axis) + b.half_extent_m(axis);
        let (offset_m, speed_mps) = (between.dot(axis), relative.dot(axis));
        if speed_mps.abs() < NO_MOTION_MPS {
            if offset_m.abs() > reach_m {
                return None;
            }
            continue;
        }
        let (one_s, other_s) = ((-reach_m - offset_m) / speed_mps, (reach_m - offset_m) / speed_mps);
        enter_s = enter_s.max(one_s.min(other_s));
        exit_s = exit_s.min(one_s.max(other_s));
        if enter_s > exit_s {
            return None;
        }
    }
    Some(enter_s)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::OrientedBox;
    use proptest::prelude::*;

    fn car(x: f64, y: f64, heading_rad: f64) -> OrientedBox {
        OrientedBox { center: Vec2::new(x, y), heading_rad, length_m: 4.0, width_m: 2.0 }
    }

    fn ttc(a: OrientedBox, velocity_a: Vec2, b: OrientedBox, velocity_b: Vec2) -> Option<f64> {
        time_to_collision_s(&Footprint::new(&a), velocity_a, &Footprint::new(&b), velocity_b)
    }

    #[test]
    fn known_times() {
        let still = Vec2::ZERO;
        // A gap of 10 - 4 = 6 m, closed with 3 m/s.
        let rear_end = ttc(car(0.0, 0.0, 0.0), Vec2::new(8.0, 0.0), car(10.0, 0.0, 0.0), Vec2::new(5.0, 0.0));
        assert!((rear_end.expect("closing") - 2.0).abs() < 1e-12);
        // Opening, and passing in the next lane.
        assert_eq!(ttc(car(0.0, 0.0, 0.0), Vec2::new(5.0, 0.0), car(10.0, 0.0, 0.0), Vec2::new(8.0, 0.0)), None);
        assert_eq!(ttc(car(0.0, 0.0, 0.0), Vec2::new(8.0, 0.0), car(10.0, 2.5, 0.0), still), None);
        // Crossing at right angles: the front at x = 2 has 7 m to the flank at x = 9; the other crosses y = ±3 from -1
        // to 0.2 s.
        let crossing = |speed: f64| {
            let heading_rad = std::f64::consts::FRAC_PI_2;
            ttc(car(0.0, 0.0, 0.0), Vec2::new(speed, 0.0), car(10.0, 2.0, heading_rad), Vec2::new(0.0, 5.0))
        };
        assert!((crossing(70.0).expect("hits") - 0.1).abs() < 1e-12);
        assert_eq!(crossing(7.0), None);
        assert_eq!(ttc(car(0.0, 0.0, 0.0), still, car(1.0, 0.0, 0.3), still), Some(0.0));
    }

    proptest! {
        /// Moving the boxes on by the time to collision makes them touch, and by any less does not.
        #[test]
        fn boxes_touch_then_and_not_before(
            x in -15.0..15.0f64, y in -15.0..15.0f64, h in -3.0..3.0f64,
            vx in -9.0..9.0f64, vy in -9.0..9.0f64, share in 0.0..0.98f64,
        ) {
            let (a, b, velocity) = (car(0.0, 0.0, 0.3), car(x, y, h), Vec2::new(vx, vy));
            let moved = |time_s: f64| OrientedBox { center: b.center + velocity * time_s, ..b };
            match ttc(a, Vec2::ZERO, b, velocity) {
                Some(time_s) => {
                    prop_assert!(a.distance(&moved(time_s)) < 1e-6);
                    prop_assert!(time_s == 0.0 || !a.overlaps(&moved(time_s * share)));
                }
                None => prop_assert!((0..100).all(|i| !a.overlaps(&moved(0.1 * f64::from(i))))),
            }
        }
    }
}
