//! Collisions by the rule of INTERACTION's benchmark, in which an agent is a row of circles.

use crate::geometry::Vec2;
use crate::scene::{Extent, State, Track};

/// Agents of at least these lengths have three and five circles; shorter ones have two. Meters.
const THREE_FROM_M: f64 = 4.0;
const FIVE_FROM_M: f64 = 8.0;

/// Whether a circle of one agent is too close to one of the other: centers less than (w₁ + w₂) / √3.8 apart.
pub(super) fn collide(first: (&Track, &State), second: (&Track, &State)) -> bool {
    let (one, other) = (first.0.extent_or_nominal(), second.0.extent_or_nominal());
    let limit_m = (one.width_m + other.width_m) / 3.8_f64.sqrt();
    // Centers of circles are within half a length of the agent's center.
    let reach_m = limit_m + (one.length_m + one.width_m + other.length_m + other.width_m) / 2.0;
    first.1.position.distance(second.1.position) < reach_m
        && centers(one, first.1).any(|a| centers(other, second.1).any(|b| a.distance(b) < limit_m))
}

/// The centers of the circles of an agent.
fn centers(extent: Extent, state: &State) -> impl Iterator<Item = Vec2> {
    let end_m = (extent.length_m - extent.width_m) / 2.0;
    let shares: &[f64] = match extent.length_m {
        length_m if length_m < THREE_FROM_M => &[-1.0, 1.0],
        length_m if length_m < FIVE_FROM_M => &[0.0, -1.0, 1.0],
        _ => &[0.0, -1.0, 1.0, -0.5, 0.5],
    };
    let (position, forward) = (state.position, Vec2::from_angle(state.heading_rad));
    shares.iter().map(move |share| position + forward * (share * end_m))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{self, Drive};

    fn agent(length_m: f64, x: f64, y: f64, heading_rad: f64) -> (Track, State) {
        let track = testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 0.0)]).tracks.remove(0);
        let extent = Some(Extent { length_m, width_m: 1.9 });
        (Track { extent, ..track }, State { position: Vec2::new(x, y), heading_rad, ..State::default() })
    }

    fn hit(a: &(Track, State), b: &(Track, State)) -> bool {
        collide((&a.0, &a.1), (&b.0, &b.1))
    }

    #[test]
    fn circles_by_hand() {
        // Two widths of 1.9 m: circles closer than 3.8 / √3.8 = √3.8 = 1.949 m.
        let still = agent(3.9, 0.0, 0.0, 0.0);
        // Ends are at ±1 m, so those of two short cars in a row touch at 2 + 1.949 m.
        assert!(hit(&still, &agent(3.9, 3.94, 0.0, 0.0)) && !hit(&still, &agent(3.9, 3.96, 0.0, 0.0)));
        assert!(hit(&still, &agent(3.9, 0.0, 1.94, 0.0)) && !hit(&still, &agent(3.9, 0.0, 1.96, 0.0)));
        // Across, the end of one points at the middle of the other: between ends at ±1 m, √(1 + d²) < 1.949 for
        // d < 1.673.
        let across = |length_m: f64, d: f64| {
            let other = agent(3.9, 0.0, 1.0 + d, std::f64::consts::FRAC_PI_2);
            hit(&agent(length_m, 0.0, 0.0, 0.0), &other)
        };
        assert!(across(3.9, 1.66) && !across(3.9, 1.68));
        // From 4 m on there is a circle in the middle.
        assert!(across(4.0, 1.94) && !across(4.0, 1.96));
    }

    #[test]
    fn long_agents_have_no_gaps() {
        // Ends at ±5.05 m, halves at ±2.525 m. Beside the half, where the nearest of three circles would be 2.525 m
        // off.
        let bus = agent(12.0, 0.0, 0.0, 0.0);
        let beside = |y: f64| agent(1.9, 2.525, y, 0.0);
        assert!(hit(&bus, &beside(1.94)) && hit(&beside(1.94), &bus) && !hit(&bus, &beside(1.96)));
    }
}
