//! Could two road users still drive into each other, and how fast?

use super::courses::{both_courses, meetings};
use crate::behavior::collision::Collision;
use crate::behavior::outcome::Outcome;
use crate::scene::Scene;

/// The relative speeds that pairs can come to are told apart by this, m/s.
const SPEED_SPACING_MPS: f64 = 2.0;

impl Collision {
    /// Relative speeds at which two could drive into each other if each goes on along a lane with -4 to 2.5 m/s² along and at most 2 m/s² across.
    pub(in crate::behavior) fn outcomes(&self, scene: &Scene, agents: [usize; 2]) -> Vec<Outcome> {
        let Some(courses) = both_courses(scene, agents, self.config().agents) else { return Vec::new() };
        let extents = agents.map(|agent_idx| scene.tracks[agent_idx].extent_or_nominal());
        // The easiest of those about as fast.
        let mut easiest: std::collections::BTreeMap<u64, Outcome> = std::collections::BTreeMap::new();
        for meeting in meetings(&courses, extents, 0.0) {
            if meeting.relative_mps < self.config().min_relative_mps {
                continue;
            }
            let outcome =
                || Outcome::default().with("relative_speed_mps", meeting.relative_mps).at_effort(meeting.effort);
            let slot = easiest.entry((meeting.relative_mps / SPEED_SPACING_MPS) as u64).or_insert_with(outcome);
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

    #[test]
    fn who_closes_in_collides_as_fast_as_the_two_can_be() {
        let found = |other: Drive| -> Vec<Outcome> {
            let drives = [Drive::straight(0.0, 0.0, 0.0, 10.0), other];
            outcomes(&Collision::default(), &drives, LaneGraph::default(), &[0, 1])
        };
        let behind = found(Drive::straight(20.0, 0.0, 0.0, 2.0));
        let coasting = behind.iter().find(|outcome| outcome.effort() == 0.0).expect("they are on a course to collide");
        assert_eq!(coasting.get("relative_speed_mps"), Some(8.0));
        // Head-on they meet at some 20 m/s, and can meet at no less than 2 m/s: both can stop.
        let head_on = found(Drive::straight(40.0, 0.0, std::f64::consts::PI, 10.0));
        assert!(head_on.iter().any(|o| o.effort() == 0.0 && o.get("relative_speed_mps") == Some(20.0)));
        assert!(found(Drive::straight(60.0, 0.0, 0.0, 20.0)).is_empty());
    }
}
