//! Cut-ins that are solved for a gap and a relative speed: the other follows its lane and comes over to the path of the ego.

use super::CutIn;
use super::feasible::{Pair, Plan};
use crate::behavior::kept_lane::KeptLane;
use crate::behavior::template::{QUINTIC_PEAK, Template, quintic, quintic_inverse};
use crate::geometry::{Vec2, angle_difference};
use crate::scene::Scene;
use std::collections::BTreeMap;

/// Lane changes that have the time for it take no more than this across, m/s².
const COMFORTABLE_MPS2: f64 = 1.5;
/// None takes more, m/s².
const MOST_MPS2: f64 = 3.0;
/// Spacing of the times at which the box is looked for in the path, seconds, and how often its coming is corrected.
const STEP_S: f64 = 0.02;
const N_CORRECTIONS: usize = 2;
/// How much of the comfortable time it may take who is in a hurry.
const HURRIES: [f64; 3] = [1.0, 0.85, 0.7];
/// The other is in the lane by so long before the scene ends, seconds.
const IN_LANE_S: f64 = 0.2;
/// Nobody drives farther beside the center line in the end, meters.
const MOST_OFFSET_M: f64 = 0.6;
/// Below this nobody has to come over, meters.
const NOTHING_M: f64 = 0.01;

impl CutIn {
    /// The `variant`-th easiest way, counted around, in which `other` cuts in before `ego` so that every parameter of the outcome that is `wanted` lies in its
    /// range, nobody being in the way. `None` where there is none.
    pub(super) fn solved(
        &self,
        scene: &Scene,
        [ego_idx, other_idx]: [usize; 2],
        wanted: &BTreeMap<String, [f64; 2]>,
        variant: usize,
    ) -> Option<Template> {
        let pair = self.pair(scene, ego_idx, other_idx)?;
        let mut plans = self.plans(&pair)?;
        plans.retain(|plan| {
            let is_in = |(name, [least, most]): (&String, &[f64; 2])| {
                plan.outcome.get(name).is_none_or(|value| (*least..=*most).contains(&value))
            };
            wanted.iter().all(is_in)
        });
        plans.sort_by(|a, b| a.outcome.effort().total_cmp(&b.outcome.effort()));
        let templates = plans.iter().filter_map(|plan| {
            let over = pair.coming_over(plan)?;
            let template = Template::new(scene, other_idx, |elapsed_s| pair.place(plan, over, elapsed_s))?;
            template.is_clear(scene, (ego_idx, plan.time_s)).then_some(template)
        });
        let clear: Vec<Template> = templates.collect();
        let n_clear = clear.len().max(1);
        clear.into_iter().nth(variant % n_clear)
    }
}

/// When the other comes over, seconds after the present.
#[derive(Clone, Copy)]
struct ComingOver {
    begins_s: f64,
    takes_s: f64,
}

impl Pair {
    /// When the other comes over so that its box is in the ego's path at the time of the plan, and its center in the lane before the scene
    /// ends: comfortably, but for what it needs for that. `None` where that is too hard.
    fn coming_over(&self, plan: &Plan) -> Option<ComingOver> {
        let aside_m = self.aside_m(plan);
        if plan.aside_m.min(aside_m) < NOTHING_M {
            return Some(ComingOver { begins_s: 0.0, takes_s: plan.time_s });
        }
        let share = quintic_inverse((plan.shift_m / aside_m).min(1.0));
        let most_s = if share > 0.0 { plan.time_s / share } else { f64::INFINITY };
        let comfortable_s = (QUINTIC_PEAK * aside_m / COMFORTABLE_MPS2).sqrt();
        HURRIES.into_iter().find_map(|hurry| {
            let takes_s = most_s.min(comfortable_s * hurry);
            if QUINTIC_PEAK * aside_m / (takes_s * takes_s) > MOST_MPS2 {
                return None;
            }
            // Who comes over is turned, so that a corner of its box is there first.
            let mut over = ComingOver { begins_s: plan.time_s - share * takes_s, takes_s };
            for _ in 0..N_CORRECTIONS {
                over.begins_s = (over.begins_s + plan.time_s - self.intrusion_s(plan, over)?).max(0.0);
            }
            let end = self.place(plan, over, self.horizon_s - IN_LANE_S)?;
            (self.lane.beyond_m(end, self.side)? < 0.0).then_some(over)
        })
    }

    /// How far the other comes over in all, meters.
    fn aside_m(&self, plan: &Plan) -> f64 {
        plan.aside_m + self.side * (self.own_offset_m - self.kept_offset_m())
    }

    /// Where the other drives in the end beside the center line of the lane, meters: as the ego, where that is well within the lane.
    fn kept_offset_m(&self) -> f64 {
        self.own_offset_m.clamp(-MOST_OFFSET_M, MOST_OFFSET_M)
    }

    /// When the other's box first is in the path of the ego.
    fn intrusion_s(&self, plan: &Plan, over: ComingOver) -> Option<f64> {
        let is_in_path = |elapsed_s: f64| {
            let (at, soon) = (self.place(plan, over, elapsed_s)?, self.place(plan, over, elapsed_s + STEP_S)?);
            let place = self.lane.project(at)?;
            let (sin, cos) = angle_difference((soon - at).angle(), place.heading_rad).sin_cos();
            let half_across_m = (self.lengths_m[1] * sin.abs() + self.widths_m[1] * cos.abs()) / 2.0;
            Some((place.offset_m - self.own_offset_m).abs() <= self.widths_m[0] / 2.0 + half_across_m)
        };
        let n_steps = (2.0 * plan.time_s / STEP_S) as usize;
        (0..n_steps).map(|step| step as f64 * STEP_S).find(|elapsed_s| is_in_path(*elapsed_s) == Some(true))
    }

    /// Where the other is by the plan, `elapsed_s` after the present.
    fn place(&self, plan: &Plan, over: ComingOver, elapsed_s: f64) -> Option<Vec2> {
        // Its speed changes smoothly, by as much and over as long a way as if it changed evenly.
        let (until_s, changed_mps) = (elapsed_s.min(plan.time_s), plan.then_mps - self.their_mps);
        let u = until_s / plan.time_s;
        let driven_m = self.their_mps * until_s
            + changed_mps * plan.time_s * u * u * u * (1.0 - u / 2.0)
            + plan.then_mps * (elapsed_s - until_s);
        let on_own = beside(&self.their_lane, self.their_station_m + driven_m, self.their_offset_m)?;
        let station_m = self.lane.project(on_own)?.station_m;
        let on_egos = beside(&self.lane, station_m, self.kept_offset_m())?;
        Some(on_own.lerp(on_egos, quintic((elapsed_s - over.begins_s) / over.takes_s)))
    }
}

/// The point so far along a lane and beside its center line.
fn beside(lane: &KeptLane, station_m: f64, offset_m: f64) -> Option<Vec2> {
    let point = lane.point_at(station_m)?;
    let heading_rad = lane.project(point)?.heading_rad;
    Some(point + Vec2::from_angle(heading_rad).rotated(std::f64::consts::FRAC_PI_2) * offset_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::testing::lane_graph;
    use crate::behavior::{Behavior, BehaviorEvent, CutInConfig, EventLabel, Outcome};
    use crate::scene::Trajectory;
    use crate::scene::testing::{Drive, scene};

    /// Two lanes; the ego in one, another car ahead in the other, with 4 s of future.
    fn two_lanes(other: Drive) -> Scene {
        let road = lane_graph(
            "lanes = [
                { id = 1, centerline = [[-100, 0], [200, 0]], width_m = 3.5 },
                { id = 2, centerline = [[-100, 3.5], [200, 3.5]], width_m = 3.5 },
            ]",
        );
        let mut recorded = scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), other]);
        recorded.lanes = road.into();
        let (n_history, step_s) = (recorded.n_history, 0.1);
        // The same drive at ten states a second.
        recorded.dt_s = step_s;
        recorded.n_timesteps = n_history + 40;
        for track in &mut recorded.tracks {
            let now = *track.trajectory.get(n_history - 1).unwrap();
            let at = |timestep: usize| {
                let elapsed_s = (timestep as f64 - (n_history - 1) as f64) * step_s;
                Some(crate::scene::State { position: now.position + now.velocity * elapsed_s, ..now })
            };
            track.trajectory = Trajectory::new((0..recorded.n_timesteps).map(at).collect());
        }
        recorded
    }

    #[test]
    fn the_miner_finds_the_cut_in_that_a_template_was_solved_for() {
        let behavior = CutIn::new(CutInConfig::default());
        let scene = two_lanes(Drive::straight(16.0, 3.5, 0.0, 9.0));
        let outcomes = behavior.feasible(&scene, &[0, 1]);
        let mut n_found = 0;
        // An ego that does not react would drive into who comes in too slowly, too near.
        let is_harmless =
            |outcome: &&Outcome| outcome.effort() < 0.8 && outcome.get("ttc_s").is_none_or(|ttc_s| ttc_s > 1.5);
        for outcome in outcomes.iter().filter(is_harmless) {
            let around = |name: &str, half: f64| {
                (name.to_owned(), [outcome.get(name).unwrap() - half, outcome.get(name).unwrap() + half])
            };
            let wanted = BTreeMap::from([around("gap_m", 0.5), around("relative_speed_mps", 0.25)]);
            let [template] = &behavior.templates(&scene, &[0, 1], &wanted, 0)[..] else { continue };
            let mut changed = scene.clone();
            template.apply(&mut changed);
            let events = behavior.detect(&changed);
            let is_of_other = |event: &&BehaviorEvent| {
                event.roles.iter().any(|(role, track)| role == "other" && *track == scene.tracks[1].id)
            };
            let event = events.iter().filter(|event| event.label == EventLabel::Positive).find(is_of_other);
            let event = event.unwrap_or_else(|| panic!("nothing is found for {wanted:?}"));
            for (name, [least, most]) in &wanted {
                let found = event.parameters[name];
                assert!((least - 0.6..=most + 0.6).contains(&found), "{name} is {found}, wanted {least} to {most}");
            }
            n_found += 1;
        }
        assert!(n_found >= 3, "{n_found} of {} outcomes have a template", outcomes.len());
    }

    #[test]
    fn who_would_drive_into_somebody_has_no_template() {
        let behavior = CutIn::new(CutInConfig::default());
        let free = two_lanes(Drive::straight(12.0, 3.5, 0.0, 10.0));
        assert_eq!(behavior.templates(&free, &[0, 1], &BTreeMap::new(), 0).len(), 1);
        let mut taken = free.clone();
        // A queue in the lane of the ego, just ahead of it.
        for i in 0..8u32 {
            let mut track = taken.tracks[0].clone();
            track.id = crate::scene::TrackId(format!("{}", 10 + i));
            let moved = track.trajectory.entries().iter().map(|state| {
                state
                    .map(|s| crate::scene::State { position: s.position + Vec2::new(6.0 * f64::from(i + 1), 0.0), ..s })
            });
            track.trajectory = Trajectory::new(moved.collect());
            taken.tracks.push(track);
        }
        assert_eq!(behavior.templates(&taken, &[0, 1], &BTreeMap::new(), 0), []);
        let impossible = BTreeMap::from([("gap_m".to_owned(), [200.0, 300.0])]);
        assert_eq!(behavior.templates(&free, &[0, 1], &impossible, 0), []);
    }
}
