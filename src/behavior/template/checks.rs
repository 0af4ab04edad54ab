//! Checks of a template: nobody in the way, on the road, within the limits of vehicles, and different from the others.

use super::{Motion, STANDING_MPS, Template};
use crate::behavior::lane_relation::SceneLanes;
use crate::geometry::{Vec2, angle_difference};
use crate::scene::{Scene, State, Track};
use std::f64::consts::FRAC_PI_4;

/// The largest accelerations of vehicles along and across their way, m/s².
const MOST_ALONG_MPS2: f64 = 8.0;
const MOST_ACROSS_MPS2: f64 = 3.6;
/// The tightest curve of a vehicle: with its wheels at 35 degrees, and axles 0.6 of its length apart (bicycle model),
/// in units of one over its length. And the lateral acceleration that noise of positions gives a straight line, m/s².
const TIGHTEST: f64 = 1.167;
const NOISE_MPS2: f64 = 0.3;
/// The largest change of acceleration within two timesteps after the present, m/s²: as validity checks it.
const MOST_JOLT_MPS2: f64 = 2.0;
/// How long after the end agents of a template stay clear of each other at constant velocity, seconds.
const AFTER_END_S: f64 = 0.7;
/// How long after the end they stay clear of others that head the same way, at constant velocity, seconds.
const CLEAR_OF_LEADERS_S: f64 = 1.5;
/// Templates whose positions differ by less than this on average resemble each other, meters.
const ALIKE_M: f64 = 0.4;
/// Spacing of the timesteps at which a template is compared with the positions of others.
const STRIDE: usize = 2;

/// Which of the other agents can be in the way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::behavior) enum InTheWay {
    /// All agents.
    Everybody,
    /// All agents but those behind, which react to the agent that they follow.
    Ahead,
}

impl Template {
    /// Whether the agents do not collide with each other, nor would at once after the end, at the velocities then.
    pub(in crate::behavior) fn keeps_apart(&self, scene: &Scene) -> bool {
        let n_steps = self.motions.iter().map(|motion| motion.states.len()).min().unwrap_or(0);
        let footprint = |motion: &Motion, step: usize| {
            let last = motion.states[step.min(n_steps - 1)];
            let after_s = (step + 1).saturating_sub(n_steps) as f64 * scene.dt_s;
            let position = last.position + last.velocity * after_s;
            scene.tracks[motion.agent_idx].footprint(&State { position, ..last })
        };
        let n_after = if n_steps > 0 { (AFTER_END_S / scene.dt_s) as usize } else { 0 };
        self.motions.iter().enumerate().all(|(i, motion)| {
            (0..n_steps + n_after).all(|step| {
                let own = footprint(motion, step);
                self.motions[..i].iter().all(|other| !own.overlaps(&footprint(other, step)))
            })
        })
    }

    /// Whether no other agent is in the way of the agents if all others continue straight at their speed, nor will be
    /// right after the end if both head the same way.
    pub(in crate::behavior) fn is_clear(&self, scene: &Scene, in_the_way: InTheWay) -> bool {
        let present = |idx: usize| scene.state(idx, scene.current_timestep()).filter(|state| state.is_finite());
        let others = (0..scene.tracks.len()).filter(|idx| self.agents().all(|agent_idx| agent_idx != *idx));
        let others: Vec<(&Track, State)> =
            others.filter_map(|idx| Some((&scene.tracks[idx], *present(idx)?))).collect();
        self.motions.iter().all(|motion| {
            let own = &scene.tracks[motion.agent_idx];
            let reacts = |now: &State| {
                in_the_way == InTheWay::Ahead && present(motion.agent_idx).is_some_and(|own| follows(now, own))
            };
            let others: Vec<_> = others.iter().filter(|(_, now)| !reacts(now)).collect();
            let Some(last) = motion.states.last() else { return true };
            let n_steps = motion.states.len();
            let n_after = (CLEAR_OF_LEADERS_S / scene.dt_s) as usize;
            (0..n_steps + n_after).step_by(STRIDE).all(|step| {
                let elapsed_s = (step + 1) as f64 * scene.dt_s;
                let after_s = (step + 1).saturating_sub(n_steps) as f64 * scene.dt_s;
                let at = motion.states[step.min(n_steps - 1)];
                let footprint = own.footprint(&State { position: at.position + last.velocity * after_s, ..at });
                let turns_rad = |now: &State| angle_difference(now.heading_rad, last.heading_rad).abs();
                let comes_later = |now: &State| after_s > 0.0 && turns_rad(now) >= FRAC_PI_4;
                others.iter().filter(|(_, now)| !comes_later(now)).all(|(track, now)| {
                    let then = State { position: now.position + now.velocity * elapsed_s, ..*now };
                    !footprint.overlaps(&track.footprint(&then))
                })
            })
        })
    }

    /// Whether all agents that are in a lane at present stay in lanes.
    pub(in crate::behavior) fn keeps_road(&self, scene: &Scene, lanes: &SceneLanes<'_>) -> bool {
        let is_on_road = |state: &State| lanes.is_road(state.position);
        self.motions.iter().all(|Motion { agent_idx, states }| {
            let is_bound = scene.state(*agent_idx, scene.current_timestep()).is_some_and(is_on_road);
            !is_bound || states.iter().step_by(STRIDE).chain(states.last()).all(is_on_road)
        })
    }

    /// Whether no agent accelerates harder along or across its way than vehicles do, turns tighter than they can, or
    /// begins with a jolt. This excludes agents that leave a roundabout but would continue around it, and fast bends.
    pub(in crate::behavior) fn is_drivable(&self, scene: &Scene) -> bool {
        self.motions.iter().all(|Motion { agent_idx, states }| {
            if jolt_mps2(scene, *agent_idx, states).is_some_and(|jolt_mps2| jolt_mps2 > MOST_JOLT_MPS2) {
                return false;
            }
            let now = scene.state(*agent_idx, scene.current_timestep());
            let velocities: Vec<Vec2> = now.into_iter().chain(states).map(|state| state.velocity).collect();
            let track = &scene.tracks[*agent_idx];
            let tightest_1pm =
                if track.class.is_motorized() { TIGHTEST / track.extent_or_nominal().length_m } else { f64::INFINITY };
            velocities.windows(2).all(|pair| {
                let (change, mean) = (pair[1] - pair[0], pair[0] + pair[1]);
                let along = mean * (1.0 / mean.norm().max(f64::MIN_POSITIVE));
                // What moves a standing vehicle aside is an error of the tracker.
                let is_standing = mean.norm() / 2.0 < STANDING_MPS;
                let turning_mps2 =
                    if is_standing { f64::INFINITY } else { tightest_1pm * mean.dot(mean) / 4.0 + NOISE_MPS2 };
                change.dot(along).abs() <= MOST_ALONG_MPS2 * scene.dt_s
                    && along.cross(change).abs() <= MOST_ACROSS_MPS2.min(turning_mps2) * scene.dt_s
            })
        })
    }

    /// The mean distance, over agents and timesteps, to the positions of another template of the same agents, meters.
    fn distance_m(&self, other: &Self) -> f64 {
        let positions = |template: &Self| -> Vec<Vec2> {
            template.motions.iter().flat_map(|motion| &motion.states).map(|state| state.position).collect()
        };
        let (own, others) = (positions(self), positions(other));
        own.iter().zip(&others).map(|(a, b)| a.distance(*b)).sum::<f64>() / own.len().max(1) as f64
    }
}

/// How much the acceleration of a vehicle changes from the last three observed positions to the first positions after
/// them, m/s². `None` if it was not observed for that long.
fn jolt_mps2(scene: &Scene, agent_idx: usize, states: &[State]) -> Option<f64> {
    let first = scene.n_history.checked_sub(3).filter(|_| scene.tracks[agent_idx].class.is_motorized())?;
    let observed: Option<Vec<Vec2>> =
        (first..scene.n_history).map(|t| scene.state(agent_idx, t).map(|state| state.position)).collect();
    let mut course = observed?;
    course.extend(states.iter().take(2).map(|state| state.position));
    let bends: Vec<Vec2> = course.windows(3).map(|at| at[0] - at[1] * 2.0 + at[2]).collect();
    let changes = bends.iter().skip(1).map(|bend| bend.distance(bends[0]) / (scene.dt_s * scene.dt_s));
    changes.reduce(f64::max)
}

/// The templates without those that resemble an earlier one.
pub(in crate::behavior) fn distinct(templates: impl IntoIterator<Item = Template>) -> Vec<Template> {
    let mut kept: Vec<Template> = Vec::new();
    for template in templates {
        if kept.iter().all(|other| template.distance_m(other) >= ALIKE_M) {
            kept.push(template);
        }
    }
    kept
}

/// Whether `follower` is behind `leader` and heads the same way.
pub(in crate::behavior) fn follows(follower: &State, leader: &State) -> bool {
    let forward = Vec2::from_angle(leader.heading_rad);
    let is_behind = (follower.position - leader.position).dot(forward) < 0.0;
    is_behind && Vec2::from_angle(follower.heading_rad).dot(forward) > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{self, Drive};
    use crate::scene::{Extent, Trajectory};
    use std::f64::consts::PI;

    #[test]
    fn a_long_vehicle_does_not_turn_as_tightly_as_a_car() {
        let mut scene = testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 3.0)]);
        let now = *scene.state(0, scene.current_timestep()).unwrap();
        // A circle of 5.5 m, at 1.6 m/s² across.
        let circle = |t: f64| {
            let turned = 3.0 * t / 5.5;
            Some(now.position + Vec2::new(turned.sin(), 1.0 - turned.cos()) * 5.5)
        };
        for (length_m, expected) in [(4.5, true), (12.0, false)] {
            scene.tracks[0].extent = Some(Extent { length_m, width_m: 2.0 });
            let template = Template::empty().with(&scene, 0, circle).unwrap();
            assert_eq!(template.is_drivable(&scene), expected, "{length_m} m");
        }
    }

    #[test]
    fn the_jolt_is_the_change_of_acceleration_at_the_present() {
        let scene = testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0)]);
        let now = *scene.state(0, scene.current_timestep()).unwrap();
        let braking = |mps2: f64| -> Vec<State> {
            let at = |t_s: f64| now.position + Vec2::new(10.0 * t_s - mps2 * t_s * t_s / 2.0, 0.0);
            (1..=2).map(|i| State { position: at(f64::from(i) * scene.dt_s), ..now }).collect()
        };
        for mps2 in [0.0, 1.0, 4.0] {
            let found = jolt_mps2(&scene, 0, &braking(mps2)).unwrap();
            assert!((found - mps2).abs() < 1e-6, "{found} instead of {mps2}");
        }
    }

    #[test]
    fn errors_of_a_tracker_do_not_move_a_standing_vehicle_aside() {
        let mut scene = testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0)]);
        let now = State { velocity: Vec2::new(0.05, 0.15), ..State::default() };
        let past = (0..scene.n_timesteps).map(|t| {
            let since_s = (t as f64 - scene.current_timestep() as f64) * scene.dt_s;
            Some(State { position: now.velocity * since_s, ..now })
        });
        scene.tracks[0].trajectory = Trajectory::new(past.collect());
        for mps2 in [0.0, 1.25] {
            let place = |t_s: f64| Some(Vec2::new(mps2 * t_s * t_s / 2.0, 0.0));
            let template = Template::empty().with(&scene, 0, place).unwrap();
            assert!(template.is_drivable(&scene), "{mps2} m/s²");
            let aside_m = template.positions(&scene, 0).unwrap().iter().map(|at| at.y.abs()).fold(0.0, f64::max);
            assert!(aside_m < 0.01, "{mps2} m/s²: {aside_m} m");
        }
    }

    #[test]
    fn nobody_ends_about_to_run_into_a_leader() {
        // The bumpers are 6 m apart at the end.
        for (leader_mps, heading_rad, expected) in [(8.0, 0.0, true), (4.0, 0.0, false), (8.0, PI, true)] {
            let mut scene = testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0)]);
            let future_s = (scene.n_timesteps - scene.n_history) as f64 * scene.dt_s;
            let length_m = scene.tracks[0].extent_or_nominal().length_m;
            let forward_mps = leader_mps * f64::cos(heading_rad);
            let now = *scene.state(0, scene.current_timestep()).unwrap();
            let ahead = now.position.x + (10.0 - forward_mps) * future_s + length_m + 6.0;
            scene.tracks.push(scene.tracks[0].clone());
            let state = State {
                position: Vec2::new(ahead, now.position.y),
                heading_rad,
                velocity: Vec2::new(forward_mps, 0.0),
            };
            scene.tracks[1].trajectory = Trajectory::new(vec![Some(state); scene.n_timesteps]);
            let place = |t_s: f64| Some(now.position + Vec2::new(10.0 * t_s, 0.0));
            let template = Template::empty().with(&scene, 0, place).unwrap();
            assert_eq!(template.is_clear(&scene, InTheWay::Everybody), expected, "{leader_mps} m/s, {heading_rad}");
        }
    }
}
