//! Which near misses can two road users still show, and how do they have to drive?

use super::NearMiss;
use crate::behavior::outcome::Outcome;
use crate::behavior::template::Template;
use crate::scene::Scene;
use std::collections::BTreeMap;

/// Values within this of each other count as equal.
const SAME: f64 = 1e-9;

impl NearMiss {
    /// The outcomes of all plans: the smallest time to collision where one of the two brakes, the post-encroachment
    /// time where they cross. Empty for pairs without a plan.
    pub(super) fn outcomes(&self, scene: &Scene, agents: [usize; 2]) -> Vec<Outcome> {
        self.plans(scene, agents).into_iter().map(|plan| plan.outcome).collect()
    }

    /// How both drive so that every `wanted` parameter lies in its range: the plan in the middle of all ranges if there
    /// is one, otherwise the `variant`-th easiest, cyclically. `None` if there is none.
    pub(super) fn solved(
        &self,
        scene: &Scene,
        agents: [usize; 2],
        wanted: &BTreeMap<String, [f64; 2]>,
        variant: usize,
    ) -> Option<Template> {
        let mut plans = self.plans(scene, agents);
        let around_middle = |[low, high]: &[f64; 2]| {
            let middle = f64::midpoint(*low, *high);
            [middle - SAME, middle + SAME]
        };
        let middles = wanted.iter().map(|(name, range)| (name.clone(), around_middle(range))).collect();
        let meant = plans.iter().position(|plan| !wanted.is_empty() && plan.outcome.is_within(&middles));
        if let Some(plan) = meant {
            return plans.swap_remove(plan).template(scene, agents);
        }
        plans.retain(|plan| plan.outcome.is_within(wanted));
        let n_plans = plans.len().max(1);
        plans.get(variant % n_plans)?.template(scene, agents)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::{Behavior, EventLabel};
    use crate::geometry::Vec2;
    use crate::scene::testing::{self, Drive};
    use crate::scene::{State, TrackId, Trajectory};
    use std::f64::consts::FRAC_PI_2;

    /// Vehicles that go straight on, without lanes, with 4 s of future at ten states a second.
    fn scene(drives: &[Drive]) -> Scene {
        let mut scene = testing::scene(drives);
        scene.lanes = crate::scene::LaneGraph::default().into();
        scene.n_timesteps = scene.n_history + 40;
        for track in &mut scene.tracks {
            let now = *track.trajectory.get(scene.n_history - 1).unwrap();
            let at = |timestep: usize| {
                let elapsed_s = (timestep as f64 - (scene.n_history - 1) as f64) * scene.dt_s;
                Some(State { position: now.position + now.velocity * elapsed_s, ..now })
            };
            track.trajectory = Trajectory::new((0..scene.n_timesteps).map(at).collect());
        }
        scene
    }

    fn outcomes(scene: &Scene) -> Vec<Outcome> {
        let mut unknown = scene.clone();
        for track in &mut unknown.tracks {
            let known = |(t, state): (usize, &Option<State>)| state.filter(|_| t < scene.n_history);
            track.trajectory = Trajectory::new(track.trajectory.entries().iter().enumerate().map(known).collect());
        }
        let found = NearMiss::default().feasible(scene, &[0, 1]);
        assert_eq!(found, NearMiss::default().feasible(&unknown, &[0, 1]), "the recorded future was looked at");
        found
    }

    fn crossing() -> Scene {
        scene(&[Drive::straight(0.0, 0.0, 0.0, 8.0), Drive::straight(20.0, -20.0, FRAC_PI_2, 8.0)])
    }

    fn toward_a_queue() -> Scene {
        scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(26.0, 0.0, 0.0, 1.0)])
    }

    #[test]
    fn the_miner_finds_the_near_miss_that_templates_were_solved_for() {
        let behavior = NearMiss::default();
        for (name, scene) in [("crossing", crossing()), ("queue", toward_a_queue())] {
            let found = outcomes(&scene);
            let n_by_time = found.iter().filter(|outcome| outcome.get("pet_s").is_some()).count();
            assert!(found.len() - n_by_time >= 3, "{name} {found:?}");
            assert_eq!(n_by_time > 0, name == "crossing");
            for outcome in &found {
                let kind = if outcome.get("pet_s").is_some() { "pet_s" } else { "min_ttc_s" };
                let value = outcome.get(kind).unwrap();
                let wanted = BTreeMap::from([(kind.to_owned(), [value - 1e-6, value + 1e-6])]);
                let template = behavior.template(&scene, &[0, 1], &wanted, 0).unwrap();
                assert_eq!(template.agents().collect::<Vec<_>>(), [0, 1]);
                let mut changed = scene.clone();
                template.apply(&mut changed);
                let event = behavior.detect(&changed).pop().unwrap_or_else(|| panic!("{name}, {outcome:?}: nothing"));
                assert_eq!(event.label, EventLabel::Positive, "{name}, {outcome:?}, {event:?}");
                assert!((event.parameters[kind] - value).abs() < 1e-6, "{name}, {outcome:?}, {event:?}");
            }
        }
    }

    #[test]
    fn who_cannot_meet_has_none() {
        let with = |other: Drive| outcomes(&scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), other])).len();
        assert_eq!(with(Drive::straight(60.0, 0.0, 0.0, 20.0)), 0);
        assert_eq!(with(Drive::straight(0.0, 3.5, 0.0, 10.0)), 0);
        assert_eq!(with(Drive::straight(20.0, 30.0, FRAC_PI_2, 10.0)), 0);
        // Two who close in on each other by 3 m/s at most stop in good time, or do not stop at all.
        assert_eq!(with(Drive::straight(10.0, 0.0, 0.0, 9.5)), 0);
    }

    #[test]
    fn who_has_somebody_in_the_way_has_none() {
        let mut scene = toward_a_queue();
        let mut blocking = scene.tracks[1].clone();
        blocking.id = TrackId("9".to_owned());
        let nearer = |state: &Option<State>| state.map(|s| State { position: s.position - Vec2::new(12.0, 0.0), ..s });
        blocking.trajectory = Trajectory::new(blocking.trajectory.entries().iter().map(nearer).collect());
        scene.tracks.push(blocking);
        assert_eq!(outcomes(&scene), []);
        assert_eq!(NearMiss::default().template(&scene, &[0, 1], &BTreeMap::new(), 0), None);
    }

    #[test]
    fn the_two_are_asked_for_as_events_name_them() {
        for behavior in [&NearMiss::default() as &dyn Behavior, &crate::behavior::Collision::default()] {
            assert_eq!(behavior.completed(&crossing(), [0, 1]), Some(vec![0, 1]));
            assert_eq!(behavior.completed(&crossing(), [1, 0]), None);
        }
    }
}
