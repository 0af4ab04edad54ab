//! Could two road users still come close to each other?

use super::courses::{Course, Place, SPACING_S, both_courses, evasion_effort, meetings};
use crate::behavior::near_miss::{FOLLOWING_RAD, NearMiss};
use crate::behavior::outcome::Outcome;
use crate::scene::{Extent, Scene};

/// The times to collision and post-encroachment times that pairs can come to: from the least on, and their spacing, seconds.
const LEAST_S: f64 = 0.3;
const OUTCOME_SPACING_S: f64 = 0.2;
/// Two who both creep at present would have to hurry for it, m/s.
const LEAST_SPEED_MPS: f64 = 3.0;
/// Who gets into a near miss drives ordinarily until then, with no more than this share of the limits: to avoid the collision takes the rest.
const MOST_EFFORT: f64 = 0.5;

impl NearMiss {
    /// Times to collision for two who could meet, and post-encroachment times for two who could cross each other's way: their boxes reach into
    /// each other, at the same time or shortly after each other, if each goes on along a lane with half of -4 to 2.5 m/s² along and of
    /// 2 m/s² across. Empty for the others.
    pub(in crate::behavior) fn outcomes(&self, scene: &Scene, agents: [usize; 2]) -> Vec<Outcome> {
        let config = self.config();
        if config.recorded_sizes && agents.iter().any(|agent_idx| scene.tracks[*agent_idx].extent.is_none()) {
            return Vec::new();
        }
        let Some(courses) = both_courses(scene, agents, config.agents, LEAST_SPEED_MPS) else { return Vec::new() };
        let extents = agents.map(|agent_idx| scene.tracks[agent_idx].extent_or_nominal());
        let meetings = meetings(&courses, extents, -config.min_overlap_m);
        // One who closes in so fast must brake hard at this time to collision.
        let meeting = |ttc_s: f64| {
            let urgent = meetings
                .iter()
                .filter(|meeting| meeting.effort <= MOST_EFFORT && config.is_urgent(ttc_s, meeting.relative_mps));
            let least = urgent.map(|meeting| meeting.effort).reduce(f64::min)?;
            Some(Outcome::default().with("min_ttc_s", ttc_s).at_effort(least))
        };
        let [own, others] = &courses;
        let pairs = own.iter().flat_map(|one| others.iter().map(move |other| [one, other]));
        let efforts = pairs.filter_map(|pair| self.crossing_effort(pair, extents));
        let least = efforts.filter(|effort| *effort <= MOST_EFFORT).reduce(f64::min);
        let crossing = |pet_s: f64| least.map(|effort| Outcome::default().with("pet_s", pet_s).at_effort(effort));
        let spaced = |most_s: f64| {
            let n = ((most_s - LEAST_S) / OUTCOME_SPACING_S).ceil().max(0.0) as usize;
            (0..n).map(|i| LEAST_S + i as f64 * OUTCOME_SPACING_S)
        };
        spaced(config.max_ttc_s).filter_map(meeting).chain(spaced(config.max_pet_s).filter_map(crossing)).collect()
    }

    /// What it takes two agents to be where the other is shortly before or after, on courses that cross. `None` where these courses do not.
    fn crossing_effort(&self, [one, other]: [&Course; 2], extents: [Extent; 2]) -> Option<f64> {
        let config = self.config();
        let most_delay = (config.max_pet_s / SPACING_S).ceil() as usize;
        let crosses = |a: &Place, b: &Place| {
            a.along.dot(b.along) < FOLLOWING_RAD.cos()
                && a.speed_mps.min(b.speed_mps) >= config.min_speed_mps
                && evasion_effort([*a, *b], extents, -config.min_overlap_m, 0.0).is_some()
        };
        let is_shortly_after = |i: usize, j: usize| i != j && i.abs_diff(j) <= most_delay;
        let mut others = other.places.iter().enumerate();
        let is_crossed = others.any(|(j, b)| {
            let mut own = one.places.iter().enumerate().skip(j.saturating_sub(most_delay)).take(2 * most_delay + 1);
            own.any(|(i, a)| is_shortly_after(i, j) && crosses(a, b))
        });
        is_crossed.then(|| one.effort.max(other.effort))
    }
}

#[cfg(test)]
mod tests {
    use super::super::outcomes;
    use crate::behavior::{NearMiss, NearMissConfig, Outcome};
    use crate::scene::LaneGraph;
    use crate::scene::testing::Drive;

    #[test]
    fn who_can_meet_can_come_close_and_who_cannot_cannot() {
        let effort = |other: Drive| {
            let drives = [Drive::straight(0.0, 0.0, 0.0, 10.0), other];
            let found = outcomes(&NearMiss::new(NearMissConfig::default()), &drives, LaneGraph::default(), &[0, 1]);
            let is_within = |outcome: &Outcome, name: &str, most_s: f64| {
                outcome.get(name).is_some_and(|value_s| (0.3..most_s).contains(&value_s))
            };
            assert!(found.iter().all(|found| is_within(found, "min_ttc_s", 1.5) || is_within(found, "pet_s", 1.0)));
            found.iter().map(Outcome::effort).reduce(f64::min)
        };
        // Beside each other they can move 0.7 m across, of 1.75 m; to close in on each other at all, one must brake with 2 m/s². 1.2 m are too
        // many.
        assert_eq!(effort(Drive::straight(0.0, 2.0, 0.0, 10.0)), Some(0.5));
        assert_eq!(effort(Drive::straight(0.0, 2.5, 0.0, 10.0)), None);
        // On a course to collide already; when the one ahead brakes a little; only when it brakes hard; never.
        assert_eq!(effort(Drive::straight(20.0, 0.0, 0.0, 2.0)), Some(0.0));
        assert_eq!(effort(Drive::straight(16.0, 0.0, 0.0, 10.0)), Some(0.5));
        assert_eq!(effort(Drive::straight(34.0, 0.0, 0.0, 10.0)), None);
        assert_eq!(effort(Drive::straight(20.0, -20.0, std::f64::consts::FRAC_PI_2, 10.0)), Some(0.0));
        assert_eq!(effort(Drive::straight(60.0, 0.0, 0.0, 20.0)), None);
        assert_eq!(effort(Drive::straight(0.0, 30.0, 0.0, 10.0)), None);
    }

    #[test]
    fn who_closes_in_slowly_need_not_brake_hard_and_who_crosses_later_is_a_near_miss_by_time() {
        let near_miss = NearMiss::new(NearMissConfig::default());
        let found = |own_mps: f64, other: Drive, name: &str| -> Vec<f64> {
            let drives = [Drive::straight(0.0, 0.0, 0.0, own_mps), other];
            let found = outcomes(&near_miss, &drives, LaneGraph::default(), &[0, 1]);
            found.iter().filter(|outcome| outcome.effort() == 0.0).filter_map(|outcome| outcome.get(name)).collect()
        };
        let about = |found: &[f64], expected: &[f64]| {
            found.len() == expected.len() && found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9)
        };
        // Closing with 5 m/s takes a brake of 3.4 m/s² at times to collision of less than 5 / 6.8 = 0.74 s.
        let ttc_s = found(10.0, Drive::straight(15.0, 0.0, 0.0, 5.0), "min_ttc_s");
        assert!(about(&ttc_s, &[0.3, 0.5, 0.7]), "{ttc_s:?}");
        // Less than half a second behind each other across the same place: they need not do anything.
        let across = |y_m: f64| Drive::straight(20.0, y_m, std::f64::consts::FRAC_PI_2, 10.0);
        let pet_s = found(10.0, across(-28.0), "pet_s");
        assert!(about(&pet_s, &[0.3]), "{pet_s:?}");
        assert!(found(10.0, Drive::straight(15.0, 0.0, 0.0, 5.0), "pet_s").is_empty());
    }
}
