//! The lanes nearest to a noisy agent, and its pose relative to them.

use super::{Pose, SPEED_MPS};
use crate::tensor::{LanePoint, PIECE_POINTS, RowSurroundings};

/// Features of a lane.
pub(in crate::model) const LANE: usize = 13;

/// A lane that points away counts as this many meters farther, per unit of 1 - cos of the angle.
const AWAY_M: f32 = 2.0;
/// Points of a lane ahead, over which its turning is measured: about six meters.
const PREVIEW_POINTS: usize = 3;

/// The nearest piece of each of the `n` nearest lanes among those that the agent sees.
pub(super) fn nearest_lanes(pose: &Pose, row: &RowSurroundings, agent: usize, n: usize) -> Vec<[f32; LANE]> {
    let around = &row.agents[agent];
    // The best place of each lane: (cost, piece, point).
    let mut best: Vec<(f32, u32, usize, usize)> = Vec::with_capacity(around.lanes.len());
    for (seen_idx, seen) in around.lanes.iter().enumerate() {
        let piece = &row.pieces[seen.piece as usize];
        let mut nearest = (f32::INFINITY, 0);
        for (k, point) in piece.points.iter().enumerate() {
            let squared = (pose.x - point.x).powi(2) + (pose.y - point.y).powi(2);
            if squared < nearest.0 {
                nearest = (squared, k);
            }
        }
        let point = &piece.points[nearest.1];
        let (sin, cos) = point.heading_rad.sin_cos();
        let cost = nearest.0.sqrt() + AWAY_M * (1.0 - (cos * pose.cos + sin * pose.sin));
        match best.iter_mut().find(|(_, lane, _, _)| *lane == piece.lane) {
            Some(known) if cost < known.0 => *known = (cost, piece.lane, seen_idx, nearest.1),
            Some(_) => {}
            None => best.push((cost, piece.lane, seen_idx, nearest.1)),
        }
    }
    best.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
    best.truncate(n);
    best.into_iter()
        .map(|(_, _, seen_idx, k)| {
            let seen = around.lanes[seen_idx];
            let piece = &row.pieces[seen.piece as usize];
            let reach_m = seen.reach_m.map(|reach| reach + piece.length_m * k as f32 / (PIECE_POINTS - 1) as f32);
            lane_features(pose, around.half_size_m[1], &piece.points, k, reach_m)
        })
        .collect()
}

fn lane_features(
    pose: &Pose,
    half_width_m: f32,
    points: &[LanePoint; PIECE_POINTS],
    k: usize,
    reach_m: Option<f32>,
) -> [f32; LANE] {
    let point = &points[k];
    let (sin, cos) = point.heading_rad.sin_cos();
    let (dx, dy) = (pose.x - point.x, pose.y - point.y);
    let (along, offset) = (dx * cos + dy * sin, dy * cos - dx * sin);
    let ahead = &points[(k + PREVIEW_POINTS).min(PIECE_POINTS - 1)];
    let turn = ahead.heading_rad - point.heading_rad;
    let turn = turn.sin().atan2(turn.cos());
    // Clearances of the agent's sides, not of its center.
    let clear = point.edges_m.map(|[left, right]| [left - offset - half_width_m, right + offset - half_width_m]);
    let [left, right] = clear.map_or([0.0; 2], |sides| sides.map(|side| (side / 2.0).tanh()));
    [
        offset.tanh(),
        (offset / 5.0).clamp(-4.0, 4.0),
        (along / 5.0).clamp(-4.0, 4.0),
        pose.cos * cos + pose.sin * sin,
        pose.sin * cos - pose.cos * sin,
        left,
        right,
        f32::from(u8::from(clear.is_some())),
        turn,
        f32::from(u8::from(reach_m.is_some())),
        reach_m.unwrap_or_default() / 20.0,
        (pose.vx * cos + pose.vy * sin) / SPEED_MPS,
        (pose.vy * cos - pose.vx * sin) / SPEED_MPS,
    ]
}

#[cfg(test)]
mod tests {
    use super::super::testing::{car, pose};
    use super::*;
    use crate::tensor::{AgentSurroundings, LanePiece, PIECE_FLAGS, SeenPiece};

    #[test]
    fn the_nearest_lanes_are_those_that_lead_the_agents_way() {
        let piece = |lane: u32, y: f32, heading_rad: f32| LanePiece {
            points: std::array::from_fn(|i| LanePoint { x: 2.0 * i as f32 - 9.0, y, heading_rad, edges_m: None }),
            lane,
            length_m: 18.0,
            flags: [false; PIECE_FLAGS],
        };
        // An oncoming lane 1 m to the left counts 5 m; two pieces of one lane count once.
        let pieces =
            vec![piece(7, 1.0, std::f32::consts::PI), piece(8, -3.0, 0.0), piece(8, -2.0, 0.0), piece(9, 4.5, 0.0)];
        let lanes = (0..4).map(|piece| SeenPiece { piece, reach_m: None }).collect();
        let row = RowSurroundings { pieces, agents: vec![AgentSurroundings { lanes, ..car() }], dt_s: 0.1 };
        let found = nearest_lanes(&pose(0.0, 0.0, 0.0), &row, 0, 3);
        let offsets: Vec<f32> = found.iter().map(|features| features[1] * 5.0).collect();
        for (found, expected) in offsets.iter().zip([2.0, -4.5, 1.0]) {
            assert!((found - expected).abs() < 1e-5, "{offsets:?}");
        }
        assert_eq!(nearest_lanes(&pose(0.0, 0.0, 0.0), &row, 0, 2).len(), 2);
        assert!(nearest_lanes(&pose(0.0, 0.0, 0.0), &row, 0, 9).len() == 3);
    }

    #[test]
    fn a_lane_tells_offset_clearance_and_turning() {
        let point = |i: usize| LanePoint {
            x: i as f32 * 2.0,
            y: 0.0,
            heading_rad: 0.1 * i as f32,
            edges_m: Some([1.75, 5.25]),
        };
        let points: [LanePoint; PIECE_POINTS] = std::array::from_fn(point);
        let features = lane_features(&pose(0.0, 0.5, 0.0), 1.0, &points, 0, Some(8.0));
        let expected =
            [0.5f32.tanh(), 0.1, 0.0, 1.0, 0.0, 0.125f32.tanh(), 2.375f32.tanh(), 1.0, 0.3, 1.0, 0.4, 0.0, 0.0];
        assert!(features.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{features:?}");
    }
}
