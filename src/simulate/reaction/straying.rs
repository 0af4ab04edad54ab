//! Slow vehicles are rare in recordings of fast roads. After an event that has slowed them down, the model turns many
//! of them across the road; some of those that have changed lanes it drives on over the edge.
//! And it lets most vehicles drift aside, and many that have begun to change lanes ride on the line.

use super::{at_stations, future, replace, stations};
use crate::behavior::way_on::{CAUGHT_S, SETTLES_S, aligned_rad, way_on};
use crate::geometry::{Polyline, Vec2, angle_difference};
use crate::scene::{Scene, State};
use crate::simulate::rollout::OFF_ROAD_SLACK_M;
use crate::simulate::situation::Situation;

/// A vehicle that heads along a lane within the first angle and comes to head across all lanes around it by more than
/// the second, radians, has strayed, as has one that leaves the road. Every few timesteps are looked at.
const ALONG_RAD: f64 = 0.2;
const ACROSS_RAD: f64 = 0.4;
const STRIDE: usize = 3;
/// Who ends this close to where it would in the middle of its lane, meters, keeps that lane, if that is on the road;
/// who moves aside with more than this speed already, m/s, if it ends within the second distance.
const KEEPS_M: f64 = 1.2;
const MOVES_ASIDE_MPS: f64 = 0.3;
const KEEPS_IF_MOVING_M: f64 = 0.9;

/// Keeps those of `agents` in their lanes, as fast as they are, that stray across them in the future of this scene.
/// With agents that are `settling`, also those of them that drive along a lane, whatever they do, and everybody who
/// does not leave its own.
pub(in crate::simulate) fn keep_to_lanes(
    situation: &Situation,
    scene: &mut Scene,
    agents: &[usize],
    settling: Option<&[usize]>,
) {
    let is_along = |state: &State, most_rad: f64| situation.across_lanes_rad(state).is_none_or(|rad| rad <= most_rad);
    let is_off = |state: &State| situation.off_road_m(state).is_some_and(|off_m| off_m > OFF_ROAD_SLACK_M);
    for agent_idx in agents.iter().copied().filter(|idx| situation.scene.tracks[*idx].class.is_motorized()) {
        let own = future(scene, agent_idx);
        let Some(now) = own.first() else { continue };
        let later = || own.iter().rev().step_by(STRIDE);
        let strays = is_along(now, ALONG_RAD) && later().any(|then| !is_along(then, ACROSS_RAD))
            || !is_off(now) && later().any(is_off);
        let settles = || {
            let in_lane = is_along(now, ALONG_RAD) && situation.across_lanes_rad(now).is_some();
            in_lane && settling.is_some()
        };
        let within_s = match strays {
            true => CAUGHT_S,
            false if settles() => SETTLES_S,
            false => continue,
        };
        let Some(kept) = along_lane(scene, agent_idx, &own, within_s) else { continue };
        let aside_mps = situation.across_lanes_rad(now).map_or(0.0, |rad| now.speed_mps() * rad.sin());
        let keeps_m = if aside_mps > MOVES_ASIDE_MPS { KEEPS_IF_MOVING_M } else { KEEPS_M };
        let stays = || own.last().zip(kept.last()).is_some_and(|(a, b)| a.position.distance(b.position) < keeps_m);
        let is_on_road = || !kept.iter().any(is_off);
        if strays || settling.is_some_and(|settling| settling.contains(&agent_idx)) || stays() && is_on_road() {
            replace(scene, agent_idx, &kept);
        }
    }
}

/// These states along the lane that the agent is in at present. `None` if it is in none, or the lane ends before.
fn along_lane(scene: &Scene, agent_idx: usize, own: &[State], within_s: f64) -> Option<Vec<State>> {
    let stations = stations(own);
    let (now, driven_m) = (own.first()?, *stations.last()?);
    let past = Scene { n_timesteps: scene.n_history, ..scene.clone() };
    let ahead = way_on(&past, agent_idx, driven_m + 1.0, within_s);
    let way = Polyline(std::iter::once(now.position).chain(ahead).collect());
    if way.length_m() < driven_m {
        return None;
    }
    let slip_rad = if now.speed_mps() > 1.0 { angle_difference(now.heading_rad, now.velocity.angle()) } else { 0.0 };
    let headings = way
        .0
        .windows(2)
        .enumerate()
        .map(|(i, pair)| aligned_rad((pair[1] - pair[0]).angle(), slip_rad, i as f64 / now.speed_mps().max(1.0)));
    let points = way.0.iter().skip(1).zip(headings);
    let along = points.map(|(position, heading_rad)| State { position: *position, heading_rad, velocity: Vec2::ZERO });
    let path: Vec<State> = std::iter::once(*now).chain(along).collect();
    let on_way = super::stations(&path);
    Some(at_stations(&path, &on_way, stations.into_iter().skip(1), scene.dt_s))
}

#[cfg(test)]
mod tests {
    use super::super::tests::DT_S;
    use super::*;
    use crate::scene::{AgentClass, Lane, LaneGraph, Trajectory};
    use crate::simulate::Situation;
    use crate::simulate::testing::record;
    use std::sync::Arc;

    /// Where and in which direction an agent ends that drives along x with 4 m/s and is sampled to turn by this,
    /// radians, on a map with these lanes.
    fn ends(lanes: &[[[f64; 2]; 2]], turn_rad: f64, settling: Option<&[usize]>) -> (Vec2, f64) {
        let lane = |(i, [a, b]): (usize, &[[f64; 2]; 2])| {
            let center = Polyline([a, b].map(|[x, y]| Vec2::new(*x, *y)).to_vec());
            Lane::unconnected(i as i64, center, [Polyline::default(), Polyline::default()])
        };
        let mut scene = record().scenario.scene;
        scene.lanes = Arc::new(LaneGraph::new(lanes.iter().enumerate().map(lane).collect()));
        scene.ego_idx = 0;
        let present = scene.current_timestep();
        let mut drive = |turn_rad: f64| {
            let mut position = Vec2::new(-4.0 * present as f64 * DT_S, 0.3);
            let states = (0..scene.n_timesteps).map(|t| {
                let heading_rad = turn_rad * (t.saturating_sub(present) as f64 / 15.0).min(1.0);
                let velocity = Vec2::from_angle(heading_rad) * 4.0;
                let state = State { position, heading_rad, velocity };
                position = position + velocity * DT_S;
                Some(state)
            });
            scene.tracks[0].trajectory = Trajectory::new(states.collect());
            scene.tracks[0].class = AgentClass::Vehicle;
            scene.clone()
        };
        let situation = Situation::without_event("lanes", drive(0.0), 0, None).unwrap();
        let mut sampled = drive(turn_rad);
        keep_to_lanes(&situation, &mut sampled, &[0], settling);
        let last = sampled.state(0, sampled.n_timesteps - 1).unwrap();
        (last.position, last.heading_rad)
    }

    #[test]
    fn who_turns_across_the_lanes_is_kept_in_its_own_and_who_takes_another_is_not() {
        let road = [[-50.0, 0.0], [100.0, 0.0]];
        let beside = [[-50.0, 3.5], [100.0, 3.5]];
        let (at, heading_rad) = ends(&[road, beside], 0.7, None);
        assert!(at.y.abs() < 0.35 && heading_rad.abs() < 0.1 && (at.x - 12.0).abs() < 0.5, "{at:?} {heading_rad}");
        // A lane that leads off, in the direction of the turn.
        let forked = [road, [[1.0, 0.0], [1.0 + 20.0 * 0.7_f64.cos(), 20.0 * 0.7_f64.sin()]]];
        let (turned, heading_rad) = ends(&forked, 0.7, Some(&[]));
        assert!(turned.y > 3.0 && (heading_rad - 0.7).abs() < 1e-9, "{turned:?}");
        // Whose part in an event has ended takes no other.
        let (settled, _) = ends(&forked, 0.7, Some(&[0]));
        assert!(settled.y.abs() < 0.35 && (settled.x - 12.0).abs() < 0.5, "{settled:?}");
        // In a continued scenario, who drifts by a meter comes back to the middle, and who takes the next lane does so.
        let drifts = |turn_rad: f64, settling| ends(&[road, beside], turn_rad, settling).0.y;
        let [drifted_m, kept_m] = [drifts(0.08, None), drifts(0.08, Some(&[]))];
        assert!(drifted_m > 0.9 && kept_m < 0.2, "{drifted_m}, {kept_m}");
        assert!((drifts(0.3, Some(&[])) - drifts(0.3, None)).abs() < 1e-9 && drifts(0.3, None) > 2.5);
    }
}
