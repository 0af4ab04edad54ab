//! Near miss: do two road users come dangerously close without touching?

mod body;
mod config;
mod drive;
mod plan;
#[cfg(test)]
mod plan_tests;

pub use config::NearMiss;

use self::body::Body;
use super::maneuver::Maneuver;
use super::swept_boxes::SweptBoxes;
use super::time_to_collision::time_to_collision_s;
use super::{Behavior, BehaviorEvent, EventLabel};
use crate::geometry::angle_difference;
use crate::scene::{AgentClass, Scene};
use std::ops::RangeInclusive;

/// Name of the behavior in configs and tables.
pub(super) const ID: &str = "near_miss";
/// The two road users, in the order of tracks.
pub(super) const ROLES: &[&str] = &["first", "second"];
/// The parameters of events; [`NearMiss`] has the definitions.
pub(super) const PARAMETERS: &[&str] = &[
    "min_distance_m",
    "min_ttc_s",
    "pet_s",
    "relative_speed_mps",
    "first_speed_mps",
    "second_speed_mps",
    "heading_difference_rad",
];

/// Times to collision beyond this are meaningless, seconds: nobody keeps course and speed for that long.
const MAX_TTC_S: f64 = 10.0;
/// One timestep at which two agents are close by the limits of hard negatives.
struct Encounter {
    timestep: usize,
    distance_m: f64,
    relative_mps: f64,
    ttc_s: Option<f64>,
    /// The longer of the time to collision and the one along the paths. `None` if either exceeds all limits.
    conflict_s: Option<f64>,
}

impl NearMiss {
    fn detect_pair(&self, scene: &Scene, first: &Body<'_>, second: &Body<'_>) -> Option<BehaviorEvent> {
        let encounters = self.encounters(scene, first, second)?;
        let span = |is_meant: &dyn Fn(&Encounter) -> bool| {
            let mut hits = encounters.iter().filter(|e| is_meant(e)).map(|e| e.timestep);
            let start = hits.next()?;
            Some(start..=hits.next_back().unwrap_or(start))
        };
        let are_sized = first.track.extent.is_some() && second.track.extent.is_some();
        let passes = |e: &Encounter| {
            are_sized && e.distance_m < self.max_distance_m && e.relative_mps >= config::MIN_PASSING_MPS
        };
        let known_s = first.last_timestep()?.min(second.last_timestep()?) as f64 * scene.dt_s;
        let escapes = |e: &Encounter| {
            e.conflict_s.is_some_and(|time_s| {
                e.timestep as f64 * scene.dt_s + time_s <= known_s && self.is_urgent(time_s, e.relative_mps)
            })
        };
        let close = span(&|e| passes(e) || escapes(e));
        let crossing = self.crossing(scene, first, second);
        let both = close.clone().zip(crossing.clone());
        let joined = both.map(|(a, b)| *a.start().min(b.start())..=*a.end().max(b.end()));
        let positive = joined.or(close).or(crossing).map(|span| (EventLabel::Positive, span));
        let is_near = |e: &Encounter| {
            e.distance_m < self.negative_distance_m()
                || e.conflict_s.is_some_and(|time_s| time_s < self.negative_ttc_s())
        };
        let negative = || span(&is_near).map(|span| (EventLabel::Negative, span));
        let (label, timesteps) = positive.or_else(negative)?;
        let (min_distance_m, closest) = first.outer.min_distance_m(&second.outer, 0..scene.n_timesteps)?;
        let [one, other] = [first, second].map(|body| body.state(closest).copied().unwrap_or_default());
        let pair = [first.agent_idx, second.agent_idx];
        let event = BehaviorEvent::new((ID, ROLES), scene, label, &pair, timesteps)
            .with("min_distance_m", min_distance_m)
            .with("min_ttc_s", encounters.iter().filter_map(|e| e.ttc_s).reduce(f64::min))
            .with("pet_s", post_encroachment_s(scene, &first.outer, &second.outer))
            .with("relative_speed_mps", (one.velocity - other.velocity).norm())
            .with("first_speed_mps", one.speed_mps())
            .with("second_speed_mps", other.speed_mps())
            .with("heading_difference_rad", angle_difference(one.heading_rad, other.heading_rad).abs());
        Some(event)
    }

    /// The timesteps at which the pair could meet the limits of hard negatives. `None` if the boxes ever overlap.
    fn encounters(&self, scene: &Scene, first: &Body<'_>, second: &Body<'_>) -> Option<Vec<Encounter>> {
        let wide_distance_m = self.negative_distance_m();
        let wide_ttc_s = self.negative_ttc_s();
        let mut encounters = Vec::new();
        for (timestep, one, other) in first.outer.both_at(&second.outer, 0..scene.n_timesteps) {
            let (Some(a), Some(b)) = (first.state(timestep), second.state(timestep)) else { continue };
            let relative_mps = (a.velocity - b.velocity).norm();
            if one.distance_lower_bound_m(other) > wide_distance_m.max(relative_mps * wide_ttc_s) {
                continue;
            }
            if one.overlaps(other) {
                return None;
            }
            if a.speed_mps().max(b.speed_mps()) >= config::MIN_SPEED_MPS {
                let ttc_s = time_to_collision_s(one, a.velocity, other, b.velocity).filter(|ttc| *ttc <= MAX_TTC_S);
                let reaches_in = || {
                    let inner = first.inner.at(timestep).zip(second.inner.at(timestep));
                    inner.is_some_and(|(one, other)| time_to_collision_s(one, a.velocity, other, b.velocity).is_some())
                };
                let conflict_s = ttc_s
                    .filter(|ttc_s| *ttc_s < wide_ttc_s && reaches_in())
                    .and_then(|ttc_s| Some(ttc_s.max(first.time_along_paths_s(second, timestep, wide_ttc_s)?)));
                let distance_m = one.distance_m(other);
                encounters.push(Encounter { timestep, distance_m, relative_mps, ttc_s, conflict_s });
            }
        }
        Some(encounters)
    }

    /// The timesteps at which one leaves and the other reaches a place that both cover within the longest allowed time,
    /// on different courses.
    fn crossing(&self, scene: &Scene, first: &Body<'_>, second: &Body<'_>) -> Option<RangeInclusive<usize>> {
        if !first.inner.may_come_within(&second.inner, 0.0) {
            return None;
        }
        let moves = |body: &Body<'_>, timestep: usize| {
            body.state(timestep).is_some_and(|state| state.speed_mps() >= config::MIN_SPEED_MPS)
        };
        // Delays that are a whole number of timesteps up to rounding are excluded.
        let max_delay = (self.max_pet_s / scene.dt_s - 1e-6).floor().max(0.0) as usize;
        let found = |t: usize, u: usize| {
            [(first, second), (second, first)]
                .into_iter()
                .any(|(one, other)| moves(one, t) && moves(other, u) && one.crosses(t, other, u))
        };
        let timesteps = 0..scene.n_timesteps;
        (0..=max_delay).find_map(|delay| timesteps.clone().find(|t| found(*t, t + delay)).map(|t| t..=t + delay))
    }

    /// Agents that stay farther apart than this over the whole scene have no encounter.
    fn reach_m(&self, scene: &Scene) -> f64 {
        let states = scene.tracks.iter().flat_map(|track| track.trajectory.valid());
        let max_speed_mps = states.map(|(_, state)| state.speed_mps()).filter(|v| v.is_finite()).fold(0.0, f64::max);
        let wide_ttc_s = self.negative_ttc_s();
        self.negative_distance_m().max(2.0 * max_speed_mps * wide_ttc_s)
    }
}

impl Behavior for NearMiss {
    fn id(&self) -> &'static str {
        ID
    }

    fn admits(&self, class: AgentClass) -> bool {
        class.is_road_user()
    }

    /// Events name the two agents in the order of tracks, so requests must do the same.
    fn completed(&self, _scene: &Scene, pair: [usize; 2]) -> Option<Vec<usize>> {
        (pair[0] < pair[1]).then(|| pair.to_vec())
    }

    fn template_parameters(&self) -> &'static [&'static str] {
        &["min_ttc_s", "pet_s", "heading_difference_rad"]
    }

    fn maneuvers(&self, scene: &Scene, agents: &[usize]) -> Vec<Maneuver> {
        agents.try_into().map_or_else(|_| Vec::new(), |pair| self.drafts(scene, pair))
    }

    fn needs_sizes(&self) -> bool {
        self.recorded_sizes
    }

    /// At most one event a pair, in the order of tracks.
    fn detect(&self, scene: &Scene) -> Vec<BehaviorEvent> {
        let reach_m = self.reach_m(scene);
        let bodies: Vec<Body<'_>> =
            (0..scene.tracks.len()).filter_map(|agent_idx| Body::new(scene, agent_idx, self)).collect();
        let mut events = Vec::new();
        for (i, first) in bodies.iter().enumerate() {
            for second in &bodies[i + 1..] {
                if first.outer.may_come_within(&second.outer, reach_m) {
                    events.extend(self.detect_pair(scene, first, second));
                }
            }
        }
        events
    }
}

/// The shortest time between one agent and the other covering the same place, seconds. `None` if they never do.
fn post_encroachment_s(scene: &Scene, first: &SweptBoxes, second: &SweptBoxes) -> Option<f64> {
    let timesteps = 0..scene.n_timesteps;
    if !first.may_come_within(second, 0.0) {
        return None;
    }
    let meets = |one: &SweptBoxes, other: &SweptBoxes, delay: usize| {
        timesteps.clone().any(|t| one.at(t).zip(other.at(t + delay)).is_some_and(|(a, b)| a.overlaps(b)))
    };
    let delay = timesteps.clone().find(|delay| meets(first, second, *delay) || meets(second, first, *delay))?;
    Some(delay as f64 * scene.dt_s)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::testing::SceneSpec;

    /// Events found with sizes, without them by the default definition, and without them if sizes need not be recorded.
    fn events(second: &str) -> [Vec<EventLabel>; 3] {
        let spec: Result<SceneSpec, _> = toml::from_str(&format!(
            "agents = [{{ id = \"a\", start = {{ x_m = 0, y_m = 0, speed_mps = 10 }} }}, {{ id = \"b\", {second} }}]"
        ));
        let sized = spec.expect("valid").build("near");
        let mut unsized_ = sized.clone();
        unsized_.tracks.iter_mut().for_each(|track| track.extent = None);
        // With boxes half as large, gaps are longer.
        let lenient = NearMiss { recorded_sizes: false, max_pet_s: 1.0, ..NearMiss::default() };
        let labels = |behavior: &NearMiss, scene| behavior.detect(scene).iter().map(|event| event.label).collect();
        let strict = NearMiss::default();
        [labels(&strict, &sized), labels(&strict, &unsized_), labels(&lenient, &unsized_)]
    }

    #[test]
    fn whose_size_is_not_recorded_takes_part_only_where_asked() {
        use EventLabel::{Negative, Positive};
        // A car stands 0.1 m beside the way of the other.
        let parked = events("start = { x_m = 20, y_m = 1.9, speed_mps = 0 }");
        assert_eq!(parked, [vec![Positive], vec![], vec![Negative]]);
        // Crossing closely behind each other.
        let crossing = events("start = { x_m = 20, y_m = -28, heading_deg = 90, speed_mps = 10 }");
        assert_eq!(crossing, [vec![Positive], vec![], vec![Positive]]);
    }

    #[test]
    fn what_would_come_after_the_last_state_is_not_known() {
        // At the end of the scene, after 3.9 s, the first is at 39 m, 7.5 m or 0.75 s from a standing one.
        let at_the_end = events("start = { x_m = 51, y_m = 0, speed_mps = 0 }");
        assert_eq!(at_the_end[0], [EventLabel::Negative]);
    }
}
