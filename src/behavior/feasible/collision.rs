//! Can two road users still drive into each other, and how fast?

use super::courses::{both_courses, meetings};
use crate::behavior::collision::Collision;
use crate::behavior::outcome::Outcome;
use crate::scene::Scene;
use std::collections::BTreeMap;

/// Smallest speed of the faster one at present, m/s: two creeping agents cannot collide seriously.
const LEAST_SPEED_MPS: f64 = 1.5;
/// Resolution of outcomes: m/s of the relative speed, and radians of the angle.
const SPEED_SPACING_MPS: f64 = 2.0;
const ANGLE_SPACING_RAD: f64 = 0.5;

impl Collision {
    /// Relative speeds and angles at which two agents could collide if each continues along a lane with -4 to 2.5 m/s²
    /// along it and at most 2 m/s² across.
    pub(in crate::behavior) fn outcomes(&self, scene: &Scene, agents: [usize; 2]) -> Vec<Outcome> {
        let Some(courses) = both_courses(scene, agents, self.config().agents, LEAST_SPEED_MPS) else {
            return Vec::new();
        };
        let extents = agents.map(|agent_idx| scene.tracks[agent_idx].extent_or_nominal());
        // The easiest of similar outcomes.
        let mut easiest: BTreeMap<(u64, u64), Outcome> = BTreeMap::new();
        for meeting in meetings(&courses, extents, 0.0) {
            if meeting.relative_mps < self.config().min_relative_mps {
                continue;
            }
            let (speed_mps, angle_rad) = (meeting.relative_mps, meeting.heading_difference_rad);
            let outcome = || {
                let collision = Outcome::default().with("relative_speed_mps", speed_mps);
                collision.with("heading_difference_rad", angle_rad).at_effort(meeting.effort)
            };
            let alike = ((speed_mps / SPEED_SPACING_MPS) as u64, (angle_rad / ANGLE_SPACING_RAD) as u64);
            let slot = easiest.entry(alike).or_insert_with(outcome);
            if meeting.effort < slot.effort() {
                *slot = outcome();
            }
        }
        easiest.into_values().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::outcomes;
    use crate::behavior::{Collision, Outcome};
    use crate::scene::LaneGraph;
    use crate::scene::testing::Drive;
    use std::f64::consts::PI;

    #[test]
    fn who_closes_in_collides_as_fast_as_the_two_can_be() {
        let found = |other: Drive| -> Vec<Outcome> {
            let drives = [Drive::straight(0.0, 0.0, 0.0, 10.0), other];
            outcomes(&Collision::default(), &drives, LaneGraph::default(), &[0, 1])
        };
        let behind = found(Drive::straight(20.0, 0.0, 0.0, 2.0));
        let coasting = behind.iter().find(|outcome| outcome.effort() == 0.0).expect("they are on a course to collide");
        assert_eq!(coasting.get("relative_speed_mps"), Some(8.0));
        assert!(behind.iter().all(|outcome| outcome.get("heading_difference_rad") == Some(0.0)));
        // Head-on they meet at some 20 m/s, and can meet at no less than 2 m/s: both can stop.
        let head_on = found(Drive::straight(40.0, 0.0, PI, 10.0));
        assert!(head_on.iter().any(|o| o.effort() == 0.0 && o.get("relative_speed_mps") == Some(20.0)));
        assert!(
            head_on
                .iter()
                .all(|o| o.get("heading_difference_rad").is_some_and(|angle_rad| (angle_rad - PI).abs() < 1e-6))
        );
        assert!(found(Drive::straight(60.0, 0.0, 0.0, 20.0)).is_empty());
        let creeping = [Drive::straight(0.0, 0.0, 0.0, 1.0), Drive::straight(6.0, 0.0, 0.0, 0.0)];
        assert!(outcomes(&Collision::default(), &creeping, LaneGraph::default(), &[0, 1]).is_empty());
    }
}
