//! The bounds of lanes whose width the map does not store.

use crate::geometry::{Polyline, Vec2};

/// The width that Argoverse 1's official reader assumes, meters.
pub(crate) const ASSUMED_LANE_WIDTH_M: f64 = 3.8;

/// The line at `offset_m` to the left of `points`: each point moves across the mean direction of its two segments.
pub(crate) fn beside(points: &[Vec2], offset_m: f64) -> Polyline {
    let direction = |from: Vec2, to: Vec2| (to - from) * (1.0 / from.distance(to));
    let shifted = (0..points.len()).map(|i| {
        let arriving = i.checked_sub(1).map(|previous| direction(points[previous], points[i]));
        let leaving = points.get(i + 1).map(|next| direction(points[i], *next));
        let mean = arriving.unwrap_or(Vec2::ZERO) + leaving.unwrap_or(Vec2::ZERO);
        points[i] + mean.unit().left() * offset_m
    });
    Polyline(shifted.collect())
}
