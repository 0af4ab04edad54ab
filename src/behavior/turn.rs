//! Turning by a large angle in a small space: the common part of left and right turns.

use super::lane_relation::SceneLanes;
use super::{BehaviorEvent, EventLabel};
use crate::geometry::{Vec2, angle_difference};
use crate::scene::{Lane, Scene, Track};
use std::cell::OnceCell;
use std::f64::consts::{FRAC_PI_3, FRAC_PI_4, FRAC_PI_6};

/// The role of a turn.
pub(crate) const ROLES: &[&str] = &["agent"];
/// Names of the parameters of its events, defined at [`LeftTurn`](super::LeftTurn).
pub(super) const PARAMETERS: &[&str] =
    &["heading_change_rad", "radius_m", "path_m", "duration_s", "mean_speed_mps", "lateral_acceleration_mps2"];

/// A turn begins and ends when these shares of its change of heading are reached.
const START_SHARE: f64 = 0.1;
const END_SHARE: f64 = 0.9;
/// An agent is only in lanes whose direction differs from its heading by less than this, radians.
const MAX_HEADING_DIFFERENCE_RAD: f64 = FRAC_PI_4;

/// Smallest change of heading of a turn, radians (60 degrees); one of at least 30 degrees is a hard negative.
const MIN_HEADING_CHANGE_RAD: f64 = FRAC_PI_3;
const NEGATIVE_HEADING_CHANGE_RAD: f64 = FRAC_PI_6;
/// Largest mean radius of a turn, meters; a wider one is a bend of the road and a hard negative.
const MAX_RADIUS_M: f64 = 50.0;
/// Smallest mean radius of a turn, meters; less is tighter than a vehicle can steer, so the heading is noise.
const MIN_RADIUS_M: f64 = 3.0;
/// Lanes that lead back to themselves within this length are a roundabout, meters; the way around a block of houses is
/// longer.
const MAX_ROUNDABOUT_M: f64 = 250.0;
/// Shortest path between start and end, meters; less is noise of the heading at low speed.
const MIN_PATH_M: f64 = 3.0;

/// Which way a turn goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum TurnSide {
    Left,
    Right,
}

impl TurnSide {
    /// The sign of a change of heading to this side.
    pub(super) const fn sign(self) -> f64 {
        match self {
            Self::Left => 1.0,
            Self::Right => -1.0,
        }
    }
}

/// The turns of all agents to `side`, in the order of tracks: at most one an agent.
pub(crate) fn turns(id: &str, side: TurnSide, scene: &Scene) -> Vec<BehaviorEvent> {
    let considered = scene.tracks.iter().enumerate().filter(|(_, track)| track.class.is_motorized());
    let lanes = OnceCell::new();
    let is_at_roundabout = |pose: &TurnedPose| {
        let lanes = lanes.get_or_init(|| SceneLanes::new(&scene.lanes));
        is_at_roundabout(lanes, pose.position, pose.heading_rad)
    };
    considered.filter_map(|(agent_idx, track)| turn((id, side), scene, agent_idx, track, &is_at_roundabout)).collect()
}

/// Whether an agent with this pose is in a lane of a roundabout, or in one that leads to such a lane or comes from it.
pub(super) fn is_at_roundabout(lanes: &SceneLanes<'_>, position: Vec2, heading_rad: f64) -> bool {
    let is_along = |lane_rad: f64| angle_difference(lane_rad, heading_rad).abs() < MAX_HEADING_DIFFERENCE_RAD;
    // The outer lane of a roundabout may lead only to exits; the lane beside it leads around.
    let is_of_roundabout = |lane: &Lane| {
        let beside = [lane.left_neighbor, lane.right_neighbor].into_iter().flatten();
        let beside = beside.filter_map(|id| lanes.get(id)).map(|lane| lane.lane);
        beside.chain([lane]).any(|lane| lanes.is_on_loop(lane, MAX_ROUNDABOUT_M))
    };
    let mut along = lanes.lanes_at(position).filter(|(_, place)| is_along(place.heading_rad));
    along.any(|(lane, _)| {
        let near = lane.lane.successors.iter().chain(&lane.lane.predecessors).filter_map(|id| lanes.get(*id));
        near.chain([lane]).any(|lane| is_of_roundabout(lane.lane))
    })
}

fn turn(
    (id, side): (&str, TurnSide),
    scene: &Scene,
    agent_idx: usize,
    track: &Track,
    is_at_roundabout: &dyn Fn(&TurnedPose) -> bool,
) -> Option<BehaviorEvent> {
    let poses = poses_turned(track, side);
    let turned_rad = poses.last()?.turned_rad;
    if turned_rad < NEGATIVE_HEADING_CHANGE_RAD {
        return None;
    }
    let end = poses.iter().position(|pose| pose.turned_rad >= END_SHARE * turned_rad)?;
    let start = poses[..end].iter().rposition(|pose| pose.turned_rad < START_SHARE * turned_rad).map_or(0, |i| i + 1);
    let (first, last) = (&poses[start], &poses[end]);
    let path_m: f64 = poses[start..=end].windows(2).map(|pair| pair[0].position.distance(pair[1].position)).sum();
    let radius_m = path_m / (last.turned_rad - first.turned_rad);
    if path_m < MIN_PATH_M || radius_m < MIN_RADIUS_M {
        return None;
    }
    let halfway = (start..=end).find(|at| 2.0 * poses[*at].turned_rad >= turned_rad).unwrap_or(end);
    // An agent may reach a roundabout after the turn, or may have left it before.
    let looked_at = [0, start, halfway, end, poses.len() - 1];
    let is_turn = turned_rad >= MIN_HEADING_CHANGE_RAD
        && radius_m <= MAX_RADIUS_M
        && !looked_at.iter().any(|at| is_at_roundabout(&poses[*at]));
    let label = if is_turn { EventLabel::Positive } else { EventLabel::Negative };
    let duration_s = (last.timestep - first.timestep) as f64 * scene.dt_s;
    let mean_speed_mps = path_m / duration_s;
    Some(
        BehaviorEvent::new((id, ROLES), scene, label, &[agent_idx], first.timestep..=last.timestep)
            .with("heading_change_rad", side.sign() * turned_rad)
            .with("radius_m", radius_m)
            .with("path_m", path_m)
            .with("duration_s", duration_s)
            .with("mean_speed_mps", mean_speed_mps)
            .with("lateral_acceleration_mps2", mean_speed_mps * mean_speed_mps / radius_m),
    )
}

struct TurnedPose {
    timestep: usize,
    position: Vec2,
    heading_rad: f64,
    /// Unwrapped change of heading since the first tracked timestep, positive toward `side`.
    turned_rad: f64,
}

fn poses_turned(track: &Track, side: TurnSide) -> Vec<TurnedPose> {
    let mut turned_rad = 0.0;
    let mut previous_rad = None;
    let states = track.trajectory.valid().filter(|(_, state)| state.is_finite());
    states
        .map(|(timestep, state)| {
            turned_rad += side.sign() * previous_rad.map_or(0.0, |angle| angle_difference(state.heading_rad, angle));
            previous_rad = Some(state.heading_rad);
            TurnedPose { timestep, position: state.position, heading_rad: state.heading_rad, turned_rad }
        })
        .collect()
}
