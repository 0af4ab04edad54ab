//! The network's inputs beside states: agent features c and lane polylines M.

use super::Normalizer;
use crate::geometry::{Polyline, Transform2, Vec2};
use crate::scene::{Lane, LaneGraph, TurnDirection};

/// Points of a polyline (paper, Appendix A).
pub const LANE_POINTS: usize = 10;
/// x, y and a padding flag for every point, then the lane's attributes.
const LANE_ATTRIBUTES: usize = 5;

/// Widths of the feature vectors that `Collator` writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FeatureLayout;

impl FeatureLayout {
    /// Features of an agent at a timestep: velocity if observed (2), observed, valid, length and width (0 if not
    /// recorded), and whether the agent is never observed.
    pub const AGENT: usize = 7;
    /// Features of a lane polyline: 10 points of (x, y, is padding), turn left, turn right, in an intersection,
    /// with traffic control, one-way.
    pub const LANE: usize = LANE_POINTS * 3 + LANE_ATTRIBUTES;
}

/// Splits centerlines into polylines of at most ten points that share their end points, in the ego frame and in
/// units of the normalizer, nearest to the ego first, at most `max_polylines`.
pub(super) fn lane_polylines(
    lanes: &LaneGraph,
    ego_from_scene: &Transform2,
    normalizer: &Normalizer,
    max_polylines: usize,
) -> Vec<[f32; FeatureLayout::LANE]> {
    let mut pieces: Vec<(f64, Vec<Vec2>, &Lane)> = Vec::new();
    for lane in lanes.lanes() {
        let points: Vec<Vec2> = lane.centerline.0.iter().map(|p| ego_from_scene.point(*p)).collect();
        for piece in split(&Polyline(points)) {
            let distance = piece.iter().map(|p| p.norm()).fold(f64::INFINITY, f64::min);
            pieces.push((distance, piece, lane));
        }
    }
    // The sort is stable and lanes are in order of their ids, so equal distances have a fixed order.
    pieces.sort_by(|a, b| a.0.total_cmp(&b.0));
    pieces.truncate(max_polylines);
    pieces.into_iter().map(|(_, points, lane)| polyline_features(&points, lane, normalizer)).collect()
}

/// Approximately equal pieces of at most `LANE_POINTS` points; neighbors share a point.
fn split(line: &Polyline) -> Vec<Vec<Vec2>> {
    let n_segments = line.0.len().saturating_sub(1);
    if n_segments == 0 {
        return Vec::new();
    }
    let n_pieces = n_segments.div_ceil(LANE_POINTS - 1);
    (0..n_pieces)
        .map(|i| {
            let (first, last) = (i * n_segments / n_pieces, (i + 1) * n_segments / n_pieces);
            line.0[first..=last].to_vec()
        })
        .collect()
}

fn polyline_features(points: &[Vec2], lane: &Lane, normalizer: &Normalizer) -> [f32; FeatureLayout::LANE] {
    let mut features = [0.0; FeatureLayout::LANE];
    for (i, slot) in features[..LANE_POINTS * 3].chunks_exact_mut(3).enumerate() {
        match points.get(i) {
            Some(point) => {
                slot[0] = (point.x / normalizer.position_unit_m) as f32;
                slot[1] = (point.y / normalizer.position_unit_m) as f32;
            }
            None => slot[2] = 1.0,
        }
    }
    let attributes = &lane.attributes;
    let flags = [
        attributes.turn == TurnDirection::Left,
        attributes.turn == TurnDirection::Right,
        attributes.is_intersection,
        attributes.has_traffic_control,
        attributes.one_way,
    ];
    for (slot, flag) in features[LANE_POINTS * 3..].iter_mut().zip(flags) {
        *slot = f32::from(u8::from(flag));
    }
    features
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_share_end_points_and_cover_the_line() {
        for n_points in [2, 10, 11, 19, 20, 47] {
            let line = Polyline((0..n_points).map(|i| Vec2::new(f64::from(i), 0.0)).collect());
            let pieces = split(&line);
            assert!(pieces.iter().all(|piece| piece.len() >= 2 && piece.len() <= LANE_POINTS));
            assert!(pieces.windows(2).all(|pair| pair[0].last() == pair[1].first()));
            assert_eq!(pieces.iter().map(|piece| piece.len() - 1).sum::<usize>() + 1, line.0.len());
            let found = (pieces[0][0], pieces.last().and_then(|p| p.last()).copied());
            assert_eq!(found, (line.0[0], line.0.last().copied()));
        }
        assert!(split(&Polyline(vec![Vec2::ZERO])).is_empty());
    }
}
