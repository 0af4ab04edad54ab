//! Futures of everybody, drawn from the model and corrected before they are driven.

use super::Result;
use super::drivers::{Log, ahead, expected};
use super::reaction::{brake, ease, go_on, hold_places, keep_to_lanes, walk_on};
use super::rollout::{Drive, OFF_ROAD_SLACK_M};
use super::situation::Situation;
use crate::generate::{Continued, Futures};
use crate::metrics::collisions;
use crate::scene::{Scene, State, UnfitScene};

/// How far ahead, seconds, an agent of the event checks whether its plan leads into an ego that is off its own path by
/// this, meters.
const LOOKS_AHEAD_S: f64 = 2.0;
const LEFT_LOG_M: f64 = 1.0;

/// How often a part of a scenario is drawn at most until nobody drives into another or leaves the road. Traffic around
/// a planner, and that whose rates are counted, is drawn once.
const N_DRAWS: usize = 4;

impl Drive<'_> {
    /// The futures of everybody from now on, after agents of the event have given up plans that lead into the ego.
    /// Where a scenario is continued (`is_continued`), they follow their plan to its end, and if somebody drives into
    /// another within `n_steps` or leaves the road, all are drawn again; if every draw is like that, the first stays.
    ///
    /// # Errors
    /// When the device fails; that the model cannot continue the scene is a result.
    pub(super) fn sample(
        &mut self,
        futures: &Futures<'_>,
        is_continued: bool,
        n_steps: usize,
    ) -> Result<Result<Scene, UnfitScene>> {
        let (situation, now, center_idx) = (self.situation, self.world.now(), self.situation.ego_idx);
        let sizes = [futures.n_history(), futures.n_timesteps()];
        let n_ahead = sizes[1] - sizes[0];
        // What the ego of a continued scenario will do is known: who expects more of it brakes for nothing.
        let expected = match is_continued && !self.driver.answers() {
            true => ahead(&mut Log, situation, &self.world, n_ahead, |idx, timestep| {
                situation.plan(&self.world, idx, timestep).or_else(|| situation.straight_on(&self.world, idx, timestep))
            }),
            false => expected(situation, &self.world, n_ahead),
        };
        if !is_continued {
            situation.let_go(&mut self.world);
        }
        if self.driver.answers() {
            situation.keep_in_aim(&mut self.world, &expected);
        }
        if self.plan_leads_into(&expected) {
            (self.world.plan_ends, self.gave_up_plan) = (now, true);
        }
        let expected = (!self.driver.is_model()).then_some(expected.as_slice());
        let (scene, mask) = situation.window(&self.world, expected, true, sizes);
        let is_sampled = |idx: &usize| {
            let is_driven = *idx == center_idx && !self.driver.is_model();
            !is_driven && situation.plan(&self.world, *idx, now + 1).is_none()
        };
        let agents: Vec<usize> = (0..self.world.n_tracks()).filter(is_sampled).collect();
        // Whose part in the event has ended stays in the lane to which it has come.
        let settling = is_continued.then_some(situation.planned.as_slice());
        let stream = self.world.stream(futures.seed());
        let draw = |name: &str| -> Result<Result<Scene, UnfitScene>> {
            let sampled = futures.sample(&Continued { scene: &scene, mask: &mask, center_idx, name, step: now })?;
            Ok(sampled.map(|mut sampled| {
                go_on(situation, &self.world, &mut sampled, &agents);
                walk_on(situation, &mut sampled, &agents);
                keep_to_lanes(situation, &mut sampled, &agents, settling);
                if situation.holds_places {
                    hold_places(situation, &mut sampled, &agents);
                }
                ease(situation, &mut sampled, &agents);
                brake(situation, &mut sampled, &agents);
                sampled
            }))
        };
        let is_well = |sampled: &Scene| !goes_wrong(situation, sampled, &agents, n_steps);
        let first = draw(&stream)?;
        if !is_continued || first.as_ref().map_or(true, is_well) {
            return Ok(first);
        }
        for again in 1..N_DRAWS {
            if let Ok(sampled) = draw(&format!("{stream} draw {again}"))?
                && is_well(&sampled)
            {
                return Ok(Ok(sampled));
            }
        }
        Ok(first)
    }

    /// Whether an agent of the event would soon drive its front into an ego that is not where the scenario has it and
    /// goes on as `expected`.
    fn plan_leads_into(&self, expected: &[State]) -> bool {
        let (situation, world, now) = (self.situation, &self.world, self.world.now());
        let Some(ego) = world.present(situation.ego_idx).filter(|_| !situation.is_collision) else { return false };
        let logged = situation.scene.state(situation.ego_idx, now);
        if logged.is_some_and(|logged| logged.position.distance(ego.position) < LEFT_LOG_M) {
            return false;
        }
        let dt_s = situation.scene.dt_s;
        let n_ahead = (LOOKS_AHEAD_S / dt_s).round() as usize;
        situation.planned.iter().filter(|agent_idx| situation.can_touch(**agent_idx)).any(|agent_idx| {
            // After its end, the plan goes on at its last velocity.
            let mut last = world.present(*agent_idx).filter(|_| situation.plan(world, *agent_idx, now + 1).is_some());
            expected.iter().take(n_ahead).enumerate().any(|(i, then)| {
                let on = last.map(|last| State { position: last.position + last.velocity * dt_s, ..last });
                last = situation.plan(world, *agent_idx, now + 1 + i).or(on);
                let Some(other) = last else { return false };
                let place = (then.position - other.position).rotated(-other.heading_rad);
                let is_ahead = place.x > 0.0 && place.y.abs() < place.x;
                is_ahead && situation.overlap([(situation.ego_idx, then), (*agent_idx, &other)])
            })
        })
    }
}

/// Whether one of `agents` drives into another within `n_steps` in this future, or leaves the road that it is on.
fn goes_wrong(situation: &Situation, sampled: &Scene, agents: &[usize], n_steps: usize) -> bool {
    let present = sampled.current_timestep();
    let end = (present + n_steps).min(sampled.n_timesteps - 1);
    let is_off = |agent_idx: usize, timestep: usize| {
        let off_m = sampled.state(agent_idx, timestep).and_then(|state| situation.off_road_m(state));
        off_m.is_some_and(|off_m| off_m > OFF_ROAD_SLACK_M)
    };
    let leaves =
        |idx: &usize| situation.scene.tracks[*idx].class.is_motorized() && !is_off(*idx, present) && is_off(*idx, end);
    let hits = |pair: [usize; 2]| pair.iter().any(|idx| agents.contains(idx));
    agents.iter().any(leaves) || collisions(sampled).iter().any(|found| found.timestep <= end && hits(found.pair))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vec2;
    use crate::scene::Trajectory;
    use crate::simulate::testing::{record, situation};

    #[test]
    fn a_future_goes_wrong_where_somebody_drives_into_another_or_leaves_the_road() {
        let situation = situation(&record());
        let mut quiet = situation.scene.clone();
        let (present, n) = (quiet.current_timestep(), quiet.n_timesteps);
        let at = *quiet.state(quiet.ego_idx, present).unwrap();
        let stands = State { velocity: Vec2::ZERO, ..at };
        quiet.tracks.truncate(2);
        quiet.tracks[0].trajectory = Trajectory::new(vec![Some(stands); n]);
        quiet.tracks[1].trajectory = Trajectory::new(vec![None; n]);
        // From 60 m ahead, or from the same place, with 30 m/s in some direction.
        let driving = |from_m: f64, direction_rad: f64| {
            let (along, way) = (Vec2::from_angle(at.heading_rad), Vec2::from_angle(at.heading_rad + direction_rad));
            let states = (0..n).map(|timestep| {
                let driven_m = 30.0 * (timestep as f64 - present as f64) * quiet.dt_s;
                let position = at.position + along * from_m + way * driven_m.max(0.0);
                Some(State { position, heading_rad: way.angle(), velocity: way * 30.0 })
            });
            states.collect()
        };
        let with = |idx: usize, states: Vec<Option<State>>| {
            let mut scene = quiet.clone();
            scene.tracks[idx].trajectory = Trajectory::new(states);
            scene
        };
        let wrong = |scene: &Scene, agents: &[usize], n_steps: usize| goes_wrong(&situation, scene, agents, n_steps);
        assert!(!wrong(&quiet, &[0, 1], n));
        let head_on = with(1, driving(60.0, std::f64::consts::PI));
        assert!(wrong(&head_on, &[0], n) && wrong(&head_on, &[1], n));
        assert!(!wrong(&head_on, &[], n), "those that are not sampled do as planned");
        assert!(!wrong(&head_on, &[0, 1], 5), "what comes after this plan is planned anew");
        assert!(wrong(&with(0, driving(0.0, std::f64::consts::FRAC_PI_2)), &[0], n), "90 m aside is no road");
    }
}
