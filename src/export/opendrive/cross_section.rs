//! The edges of lanes to the left and right of the reference line of their road.

use super::reference_line::ReferenceLine;
use crate::geometry::{Polyline, Vec2};

/// Records that the previous one predicts to within this are left out, meters.
const FORETOLD_M: f64 = 1e-3;
/// A boundary farther away belongs to another part of a winding road, meters.
const MAX_OFFSET_M: f64 = 30.0;

/// The edges of the lanes at a place along the reference line, from left to right, meters to the left of it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Edges {
    pub(super) s_m: f64,
    pub(super) across_m: Vec<f64>,
}

/// The edges along the line, from its start to its end; linear in between. Two at least.
pub(super) fn edges(line: &ReferenceLine, lines: &[Polyline]) -> Vec<Edges> {
    let length_m = line.length_m();
    let pieces = line.pieces.iter().map(|piece| piece.s_m);
    // Boundaries bend at their points, so these are stations, too.
    let middle =
        Polyline(line.pieces.iter().map(|piece| piece.start).chain(line.at(length_m).map(|end| end.0)).collect());
    let points = lines.iter().flat_map(|line| &line.0);
    let bends = points.filter_map(|point| Some(middle.project(*point)?.station_m));
    let mut stations: Vec<f64> =
        pieces.chain(bends).filter(|s_m| (0.0..=length_m).contains(s_m)).chain([0.0, length_m]).collect();
    stations.sort_by(f64::total_cmp);
    stations.dedup_by(|later, earlier| *later - *earlier < FORETOLD_M);
    if let Some(last) = stations.last_mut() {
        *last = length_m;
    }
    let at = |s_m: f64| {
        let (point, heading_rad) = line.at(s_m)?;
        let across_m: Option<Vec<f64>> = lines.iter().map(|line| offset_m(point, heading_rad, line)).collect();
        let mut across_m = across_m?;
        // Where boundaries cross, the lane between them has no width.
        for i in 1..across_m.len() {
            if across_m[i - 1] < across_m[i] {
                let middle_m = 0.5 * (across_m[i - 1] + across_m[i]);
                across_m[..i].iter_mut().for_each(|before| *before = before.max(middle_m));
                across_m[i] = middle_m;
                across_m[i - 1] = middle_m;
            }
        }
        Some(Edges { s_m, across_m })
    };
    let edges: Vec<Edges> = stations.into_iter().filter_map(at).collect();
    without_foretold(&edges)
}

/// The distance of a boundary to the left of a point on the reference line, straight across. The boundary continues
/// straight beyond its ends, because the ends of a lane need not be square.
fn offset_m(point: Vec2, heading_rad: f64, boundary: &Polyline) -> Option<f64> {
    let ahead = Vec2::from_angle(heading_rad);
    let last = boundary.0.len().checked_sub(2)?;
    let across = boundary.0.windows(2).enumerate().filter_map(|(i, pair)| {
        let from = (pair[0] - point).rotated(-heading_rad);
        let to = (pair[1] - point).rotated(-heading_rad);
        let (step, share) = (to.x - from.x, -from.x / (to.x - from.x));
        let is_within = (share >= 0.0 || i == 0) && (share <= 1.0 || i == last);
        (step.abs() > 1e-9 && is_within).then(|| share.mul_add(to.y - from.y, from.y))
    });
    let nearest = across.filter(|offset_m| offset_m.abs() < MAX_OFFSET_M).min_by(|a, b| a.abs().total_cmp(&b.abs()));
    // If no boundary crosses, the distance of its nearest point counts.
    nearest.or_else(|| {
        let beside = boundary.0.iter().min_by(|a, b| a.distance(point).total_cmp(&b.distance(point)))?;
        Some(ahead.cross(*beside - point))
    })
}

/// The edges without those that lie on the line between their kept neighbors.
pub(super) fn without_foretold(edges: &[Edges]) -> Vec<Edges> {
    let is_foretold = |before: &Edges, here: &Edges, after: &Edges| {
        let share = (here.s_m - before.s_m) / (after.s_m - before.s_m);
        let between = |from: f64, to: f64| share.mul_add(to - from, from);
        let lines = before.across_m.iter().zip(&after.across_m).zip(&here.across_m);
        lines.into_iter().all(|((before, after), here)| (between(*before, *after) - here).abs() < FORETOLD_M)
    };
    let mut kept = Vec::new();
    let mut last = 0;
    for (i, here) in edges.iter().enumerate() {
        let can_go = i > 0
            && edges
                .get(i + 1)
                .is_some_and(|after| edges[last + 1..=i].iter().all(|e| is_foretold(&edges[last], e, after)));
        if !can_go {
            kept.push(here.clone());
            last = i;
        }
    }
    kept
}
