//! The surroundings of each agent of a row: lanes around its path, and its attributes.

use super::lane_pieces::{LanePiece, LanePieces, PIECE_FLAGS, PIECE_POINTS, turn_rad};
use crate::geometry::{Vec2, angle_difference};
use crate::scene::{AgentClass, Extent, LaneGraph, Track};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Pieces farther than this from an agent's reference path are left out unless the agent can reach them, meters.
const NEAR_M: f64 = 20.0;
/// An agent is in a lane within this distance of its centerline, meters, …
const IN_LANE_M: f64 = 2.5;
/// … and within this angle of its direction, radians.
const ALONG_LANE_RAD: f64 = std::f64::consts::FRAC_PI_4;
/// The cost of a lane change on the way to a piece, meters.
const LANE_CHANGE_M: f64 = 10.0;
/// Meters per unit of coordinates in an agent's frame.
const POSITION_M: f32 = 10.0;
/// Meters per unit of distances to the edges of the road.
const EDGE_M: f32 = 5.0;
/// Meters per unit of distances along the road.
const REACH_M: f32 = 20.0;

/// Widths of the features of `Surroundings`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SurroundingsLayout;

impl SurroundingsLayout {
    /// Features of a piece of a lane in an agent's frame: x, y and the distances to both edges at ten points, whether
    /// edges are known, whether it can be reached and how far that is, how much it turns, its length, and its
    /// attributes.
    pub const PIECE: usize = PIECE_POINTS * 4 + 5 + PIECE_FLAGS;
    /// Attributes of an agent: whether its size is recorded, and its class, one of eight.
    pub const AGENT: usize = 1 + AgentClass::ALL.len();
}

/// A piece of a lane as one agent sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeenPiece {
    /// Its place among the pieces of the row.
    pub piece: u32,
    /// Distance along the road from the agent to the start of the piece, meters; `None` if the agent cannot get there
    /// by following and changing lanes.
    pub reach_m: Option<f32>,
}

/// The surroundings and attributes of one agent.
#[derive(Debug, Clone, PartialEq)]
pub struct AgentSurroundings {
    /// Half of its length and of its width, recorded or nominal, meters.
    pub half_size_m: [f32; 2],
    /// Whether it walks or rides a bicycle.
    pub is_vulnerable: bool,
    /// The lanes around its reference path.
    pub lanes: Vec<SeenPiece>,
}

/// The surroundings of the agents of one row, in its ego frame.
#[derive(Debug, Clone, PartialEq)]
pub struct RowSurroundings {
    /// The pieces of all lanes.
    pub pieces: Vec<LanePiece>,
    /// Surroundings for each agent of the row.
    pub agents: Vec<AgentSurroundings>,
    /// Time between timesteps, seconds.
    pub dt_s: f32,
}

/// An agent while its surroundings are looked up: its pose at the present and its reference path, in the row's ego
/// frame.
pub(super) struct AgentPath<'a> {
    pub(super) track: &'a Track,
    pub(super) origin: Vec2,
    pub(super) heading_rad: f64,
    pub(super) speed_mps: f64,
    /// Positions along the reference path.
    pub(super) path: Vec<Vec2>,
}

impl RowSurroundings {
    /// Looks up at most `n_lanes` pieces for each of `agents` among `lanes`, which are in the row's ego frame.
    /// `horizon_s` is the time in which an agent can reach a piece.
    pub(super) fn new(lanes: &LaneGraph, agents: &[AgentPath<'_>], n_lanes: usize, dt_s: f64, horizon_s: f64) -> Self {
        let pieces = LanePieces::new(lanes);
        let surroundings = |agent: &AgentPath<'_>| {
            let Extent { length_m, width_m } = agent.track.extent_or_nominal();
            AgentSurroundings {
                half_size_m: [length_m / 2.0, width_m / 2.0].map(|half| half as f32),
                is_vulnerable: agent.track.class.is_vulnerable(),
                lanes: pieces.seen_by(agent, n_lanes, horizon_s),
            }
        };
        let agents = agents.iter().map(surroundings).collect();
        Self { pieces: pieces.pieces, agents, dt_s: dt_s as f32 }
    }

    /// The features of the piece that agent `slot` sees as its `i`-th, in the frame with this origin and heading.
    pub(super) fn piece_features(&self, slot: usize, i: usize, origin: Vec2, heading_rad: f64) -> Option<Vec<f32>> {
        let seen = self.agents[slot].lanes.get(i)?;
        let piece = &self.pieces[seen.piece as usize];
        let mut features = Vec::with_capacity(SurroundingsLayout::PIECE);
        for point in &piece.points {
            let offset = (Vec2::new(f64::from(point.x), f64::from(point.y)) - origin).rotated(-heading_rad);
            features.extend([offset.x as f32 / POSITION_M, offset.y as f32 / POSITION_M]);
            features.extend(point.edges_m.unwrap_or_default().map(|edge| edge / EDGE_M));
        }
        let bit = |flag: bool| f32::from(u8::from(flag));
        features.push(bit(piece.points[0].edges_m.is_some()));
        features.push(bit(seen.reach_m.is_some()));
        features.push(seen.reach_m.unwrap_or_default() / REACH_M);
        features.push(turn_rad(piece.points[PIECE_POINTS - 1].heading_rad, piece.points[0].heading_rad));
        features.push(piece.length_m / REACH_M);
        features.extend(piece.flags.map(bit));
        Some(features)
    }
}

pub(super) fn agent_attributes(track: &Track) -> [f32; SurroundingsLayout::AGENT] {
    let mut attributes = [0.0; SurroundingsLayout::AGENT];
    attributes[0] = f32::from(u8::from(track.extent.is_some()));
    if let Some(class) = AgentClass::ALL.iter().position(|class| *class == track.class) {
        attributes[1 + class] = 1.0;
    }
    attributes
}

impl LanePieces {
    /// The pieces for an agent: those it can reach in time, nearest along the road first, and then those nearest to its
    /// reference path; a third of the places are reserved for the latter.
    fn seen_by(&self, agent: &AgentPath<'_>, n_lanes: usize, horizon_s: f64) -> Vec<SeenPiece> {
        let in_reach_m = agent.speed_mps * horizon_s * 1.3 + NEAR_M;
        let reach = self.reach(agent, in_reach_m);
        let distance = |piece: &LanePiece| {
            let to = |point: &Vec2| {
                let each = piece.points.iter().map(|p| Vec2::new(f64::from(p.x), f64::from(p.y)) - *point);
                each.map(Vec2::norm_squared).fold(f64::INFINITY, f64::min)
            };
            agent.path.iter().map(to).fold(f64::INFINITY, f64::min).sqrt()
        };
        let mut reached: Vec<(f64, u32)> =
            reach.iter().enumerate().filter_map(|(i, reach)| Some(((*reach)?, i as u32))).collect();
        reached.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        reached.truncate(n_lanes - n_lanes / 3);
        let mut near: Vec<(f64, u32)> = (self.pieces.iter().enumerate())
            .filter(|(i, _)| !reached.iter().any(|(_, piece)| *piece == *i as u32))
            .map(|(i, piece)| (distance(piece), i as u32))
            .filter(|(distance, _)| *distance <= NEAR_M)
            .collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        near.truncate(n_lanes - reached.len());
        let seen = |(_, piece): &(f64, u32)| SeenPiece {
            piece: *piece,
            reach_m: reach[*piece as usize].map(|reach| reach as f32),
        };
        reached.iter().chain(&near).map(seen).collect()
    }

    /// The distance along the road from the agent to the start of each piece, up to `limit_m` (Dijkstra's algorithm).
    fn reach(&self, agent: &AgentPath<'_>, limit_m: f64) -> Vec<Option<f64>> {
        let mut reach: Vec<Option<f64>> = vec![None; self.pieces.len()];
        // Distances in millimeters, so that the heap has a total order.
        let mut open: BinaryHeap<Reverse<(i64, u32)>> = BinaryHeap::new();
        for (i, piece) in self.pieces.iter().enumerate() {
            let nearest = piece.points.iter().enumerate().map(|(k, p)| {
                let position = Vec2::new(f64::from(p.x), f64::from(p.y));
                let along = angle_difference(f64::from(p.heading_rad), agent.heading_rad).abs() <= ALONG_LANE_RAD;
                (if along { position.distance(agent.origin) } else { f64::INFINITY }, k)
            });
            let (distance, k) =
                nearest.fold((f64::INFINITY, 0), |best, this| if this.0 < best.0 { this } else { best });
            // Points of a piece are up to two meters apart.
            if distance <= IN_LANE_M {
                let station_m = f64::from(piece.length_m) * k as f64 / (PIECE_POINTS - 1) as f64;
                open.push(Reverse(((-station_m * 1e3) as i64, i as u32)));
            }
        }
        while let Some(Reverse((at_mm, i))) = open.pop() {
            let (at_m, i) = (at_mm as f64 * 1e-3, i as usize);
            if at_m > limit_m || reach[i].is_some() {
                continue;
            }
            reach[i] = Some(at_m);
            let after = at_mm + (f64::from(self.pieces[i].length_m) * 1e3) as i64;
            open.extend(self.next[i].iter().map(|piece| Reverse((after, *piece))));
            let aside = at_mm + (LANE_CHANGE_M * 1e3) as i64;
            open.extend(self.beside[i].iter().map(|piece| Reverse((aside, *piece))));
        }
        reach
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Polyline;
    use crate::scene::testing::{Drive, scene};
    use crate::scene::{Lane, LaneId};

    /// A lane of 36 m: two pieces.
    fn lane(id: i64, from: Vec2, to: Vec2) -> Lane {
        Lane::unconnected(id, Polyline(vec![from, to]), Default::default())
    }

    /// A lane along x with a successor, a neighbor, an oncoming lane on the far side, and a lane far away.
    fn road() -> LaneGraph {
        let at = Vec2::new;
        let mut first = lane(1, at(0.0, 0.0), at(36.0, 0.0));
        first.successors = vec![LaneId(2)];
        first.left_neighbor = Some(LaneId(3));
        LaneGraph::new(vec![
            first,
            lane(2, at(36.0, 0.0), at(72.0, 0.0)),
            lane(3, at(0.0, 3.5), at(36.0, 3.5)),
            lane(4, at(36.0, 7.0), at(0.0, 7.0)),
            lane(5, at(0.0, 90.0), at(36.0, 90.0)),
        ])
    }

    /// By lane and place in it, the pieces for an agent at (8, 0) that drives along x at 10 m/s, with its reach.
    fn shown(n_lanes: usize, horizon_s: f64) -> Vec<(u32, f32, Option<f32>)> {
        let track = &scene(&[Drive::straight(8.0, 0.0, 0.0, 10.0)]).tracks[0];
        let path = (0..=4).map(|i| Vec2::new(8.0 + 7.0 * f64::from(i), 0.0)).collect();
        let agent = AgentPath { track, origin: Vec2::new(8.0, 0.0), heading_rad: 0.0, speed_mps: 10.0, path };
        let row = RowSurroundings::new(&road(), &[agent], n_lanes, 0.1, horizon_s);
        let shown = |seen: &SeenPiece| {
            let piece = &row.pieces[seen.piece as usize];
            (piece.lane, piece.points[0].x.round(), seen.reach_m.map(f32::round))
        };
        row.agents[0].lanes.iter().map(shown).collect()
    }

    #[test]
    fn lanes_that_can_be_reached_come_first_with_the_way_to_them() {
        let all = shown(9, 3.0);
        let reached: Vec<_> = all.iter().take_while(|(_, _, reach)| reach.is_some()).copied().collect();
        // Six of nine places are for reachable ones; a change of lanes counts 10 m. The oncoming lane is near, and
        // cannot be reached.
        let found = &reached[..4];
        assert_eq!(found, [(0, 0.0, Some(-8.0)), (2, 0.0, Some(2.0)), (0, 18.0, Some(10.0)), (2, 18.0, Some(20.0))]);
        assert_eq!(reached[4..], [(1, 36.0, Some(28.0)), (1, 54.0, Some(46.0))]);
        assert_eq!(all[6..], [(3, 36.0, None), (3, 18.0, None)]);
        // 10 m/s for a second and a half, and then some, end before 46 m: there, but out of reach.
        assert!(shown(9, 1.5).contains(&(1, 54.0, None)));
    }

    #[test]
    fn a_third_of_the_places_is_kept_for_what_is_near() {
        let few = shown(3, 3.0);
        assert_eq!((few[0].2, few[1].2), (Some(-8.0), Some(2.0)));
        // The nearest of the rest, reached or not: the next piece of the agent's own lane.
        assert_eq!(few[2..], [(0, 18.0, Some(10.0))]);
    }
}
