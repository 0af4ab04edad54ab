//! Lanes that run side by side from one cross-section to another: the lanes of one road.

use crate::export::lane_bounds::LaneBounds;
use crate::geometry::{Polyline, Vec2};
use crate::scene::{Lane, LaneGraph, LaneId};
use std::collections::{BTreeMap, BTreeSet};

/// The edges of neighbors are one line if they are never farther apart than this, meters.
const SAME_EDGE_M: f64 = 0.05;
/// The lanes of a road end in one cross-section: the ends of their edges are this close to a line, meters. If one lane
/// ends alone, its edges must still meet those of the next road.
const SAME_END_M: f64 = 0.005;

/// The lanes of a road, from left to right, with the lines between and beside them: one more than lanes.
pub(super) struct Bundle<'l> {
    pub(super) lanes: Vec<&'l Lane>,
    pub(super) lines: Vec<Polyline>,
    /// Whether the map has no boundaries and the nominal width was used.
    pub(super) is_nominal: bool,
}

impl<'l> Bundle<'l> {
    /// The roads of a map, each in the place of its leftmost lane, and each lane in one road. Lanes without extent are
    /// left out.
    pub(super) fn all(map: &'l LaneGraph) -> Vec<Self> {
        let bounds: BTreeMap<LaneId, LaneBounds> =
            map.lanes().iter().filter_map(|lane| Some((lane.id, LaneBounds::of(lane)?))).collect();
        let mut taken: BTreeSet<LaneId> = BTreeSet::new();
        let mut bundles = Vec::new();
        // Lanes without a left neighbor come first; others only remain if neighbors do not fit.
        let (mut leftmost, others): (Vec<&Lane>, Vec<&Lane>) =
            map.lanes().iter().partition(|lane| lane.left_neighbor.is_none());
        leftmost.extend(others);
        for lane in leftmost {
            let Some(own) = bounds.get(&lane.id).filter(|_| taken.insert(lane.id)) else { continue };
            let mut bundle = Self {
                lanes: vec![lane],
                lines: vec![own.left.clone(), own.right.clone()],
                is_nominal: own.is_nominal,
            };
            while let Some((next, right)) = bundle.next(map, &bounds).filter(|(next, _)| taken.insert(next.id)) {
                bundle.lanes.push(next);
                bundle.lines.push(right);
            }
            bundles.push(bundle);
        }
        bundles.sort_by_key(|bundle| bundle.lanes.first().map(|lane| lane.id));
        bundles
    }

    /// The lane that continues the road to the right, and its right edge.
    fn next(&self, map: &'l LaneGraph, bounds: &BTreeMap<LaneId, LaneBounds>) -> Option<(&'l Lane, Polyline)> {
        let (last, edge) = (self.lanes.last()?, self.lines.last()?);
        let next = map.get(last.right_neighbor?).filter(|next| next.left_neighbor == Some(last.id))?;
        let (own, theirs) = (bounds.get(&last.id)?, bounds.get(&next.id)?);
        let is_same_edge = !own.is_nominal && !theirs.is_nominal && are_one(edge, &theirs.left);
        let ends = |pick: fn(&Polyline) -> Option<&Vec2>| -> Option<bool> {
            let (first, new) = (pick(self.lines.first()?)?, pick(&theirs.right)?);
            let across = (*new - *first) * (1.0 / new.distance(*first).max(f64::MIN_POSITIVE));
            let off_m = |line: &Polyline| pick(line).map_or(f64::INFINITY, |end| across.cross(*end - *first).abs());
            Some(self.lines.iter().skip(1).map(off_m).all(|off_m| off_m < SAME_END_M))
        };
        let ends_together = ends(|line| line.0.first())? && ends(|line| line.0.last())?;
        (is_same_edge && ends_together).then(|| (next, theirs.right.clone()))
    }
}

/// Whether two lines are one, with the same ends.
fn are_one(a: &Polyline, b: &Polyline) -> bool {
    let near = |points: &[Vec2], line: &Polyline| {
        points.iter().all(|point| line.project(*point).is_some_and(|p| p.point.distance(*point) < SAME_EDGE_M))
    };
    let same_end = |a: Option<&Vec2>, b: Option<&Vec2>| a.zip(b).is_some_and(|(a, b)| a.distance(*b) < SAME_END_M);
    same_end(a.0.first(), b.0.first()) && same_end(a.0.last(), b.0.last()) && near(&a.0, b) && near(&b.0, a)
}
