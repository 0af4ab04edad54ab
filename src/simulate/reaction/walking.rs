//! The model knows few pedestrians who cross in front of somebody, and freezes them there or has them run.

use super::{at_stations, future, replace, stations};
use crate::behavior::may_walk;
use crate::scene::{Scene, State};
use crate::simulate::situation::Situation;

/// A pedestrian of the event who crosses the road at least this fast, m/s, walks on; nobody on foot who walks begins to
/// run, which is faster than this, m/s.
const CROSSES_MPS: f64 = 0.3;
const WALKS_UP_TO_MPS: f64 = 2.2;

/// Makes pedestrians of the event that are on the road walk on across it as they walk, and keeps all of `agents` on
/// foot from running in the future of this scene: the model knows few who cross in front of somebody, and freezes them
/// there.
pub(in crate::simulate) fn walk_on(situation: &Situation, scene: &mut Scene, agents: &[usize]) {
    for agent_idx in agents.iter().copied() {
        let (own, class) = (future(scene, agent_idx), situation.scene.tracks[agent_idx].class);
        let Some(now) = own.first().copied().filter(|now| may_walk(class, now)) else { continue };
        let is_on_road = situation.off_road_m(&now).is_some_and(|off_m| off_m <= 0.0);
        let crosses = is_on_road && now.speed_mps() >= CROSSES_MPS && situation.planned.contains(&agent_idx);
        let most_mps = now.speed_mps().max(WALKS_UP_TO_MPS);
        let walked: Vec<State> = match crosses {
            true => (0..own.len())
                .map(|i| State { position: now.position + now.velocity * (i as f64 * scene.dt_s), ..now })
                .collect(),
            false => held_to(&own, most_mps, scene.dt_s),
        };
        if walked != own {
            replace(scene, agent_idx, &walked);
        }
    }
}

/// The path of these states, no faster than `most_mps`.
fn held_to(states: &[State], most_mps: f64, dt_s: f64) -> Vec<State> {
    let stations = stations(states);
    let is_slow = |pair: &[f64]| pair[1] - pair[0] <= most_mps * dt_s + 1e-9;
    if stations.windows(2).all(is_slow) {
        return states.to_vec();
    }
    let mut station_m = 0.0_f64;
    let then = stations.iter().skip(1).map(|driven_m| {
        station_m = (station_m + most_mps * dt_s).min(*driven_m);
        station_m
    });
    at_stations(states, &stations, then, dt_s)
}

#[cfg(test)]
mod tests {
    use super::super::tests::DT_S;
    use super::*;
    use crate::geometry::Vec2;
    use crate::scene::Trajectory;
    use crate::simulate::testing::{record, situation};

    #[test]
    fn who_is_on_the_road_on_foot_walks_on_and_nobody_begins_to_run() {
        let mut situation = situation(&record());
        let (ego, walker) = (situation.ego_idx, situation.planned[0]);
        let at = situation.scene.state(ego, situation.scene.current_timestep()).unwrap().position;
        let present = situation.scene.current_timestep();
        situation.scene.tracks[walker].class = crate::scene::AgentClass::PedestrianOrCyclist;
        let sampled = |speed_mps: f64, then_mps: f64| {
            let mut scene = situation.scene.clone();
            let states = (0..scene.n_timesteps).map(|t| {
                let since_s = (t as f64 - present as f64) * DT_S;
                let mps = if t > present { then_mps } else { speed_mps };
                let (position, velocity) = (at + Vec2::new(mps * since_s, 0.0), Vec2::new(mps, 0.0));
                Some(State { position, heading_rad: 0.0, velocity })
            });
            scene.tracks[walker].trajectory = Trajectory::new(states.collect());
            scene
        };
        let moved_m = |situation: &Situation, speed_mps: f64, then_mps: f64| {
            let mut scene = sampled(speed_mps, then_mps);
            walk_on(situation, &mut scene, &[walker]);
            scene.state(walker, present + 10).unwrap().position.x - at.x
        };
        // Of the event and on the road, it walks on, whatever the model has it do.
        for then_mps in [0.0, 1.4, 3.2] {
            assert!((moved_m(&situation, 1.4, then_mps) - 1.4).abs() < 1e-9);
        }
        // Others do as sampled, but do not run.
        situation.planned.clear();
        let moved = [0.0, 1.4, 3.2].map(|then_mps| moved_m(&situation, 1.4, then_mps));
        assert!(moved.iter().zip([0.0, 1.4, 2.2]).all(|(a, b)| (a - b).abs() < 1e-6), "{moved:?}");
    }
}
