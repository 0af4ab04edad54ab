//! Finds lanes that continue one another by where they lie.

use crate::geometry::{Vec2, angle_difference};
use crate::scene::Lane;
use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_4;

/// Ends that meet are within this distance, meters.
const MEET_M: f64 = 0.5;

/// An end of a lane in the direction of traffic: of which lane, and whether traffic leaves it there.
pub(super) type TrafficEnd = (usize, bool);

/// The place and the direction of traffic at an end of a lane.
pub(super) fn pose_of(lane: &Lane, leaves: bool) -> Option<(Vec2, f64)> {
    let points = &lane.centerline.0;
    let n = points.len();
    let pair = if leaves { points.get(n.checked_sub(2)?..)? } else { points.get(..2)? };
    Some((pair[usize::from(leaves)], (pair[1] - pair[0]).angle()))
}

/// The ends of all lanes by place.
#[derive(Debug, Default)]
pub(super) struct EndsByPlace(BTreeMap<(i64, i64), Vec<TrafficEnd>>);

impl EndsByPlace {
    pub(super) fn of(lanes: &[Lane]) -> Self {
        let mut found = Self::default();
        for end in (0..lanes.len()).flat_map(|lane| [(lane, false), (lane, true)]) {
            if let Some((at, _)) = pose_of(&lanes[end.0], end.1) {
                found.0.entry(cell(at)).or_default().push(end);
            }
        }
        found
    }

    /// The lanes that begin where traffic leaves a lane, or end where it enters, in the same direction within 45
    /// degrees, by ascending index.
    pub(super) fn beyond(&self, lanes: &[Lane], (lane, leaves): TrafficEnd) -> Vec<usize> {
        let Some((at, heading_rad)) = pose_of(&lanes[lane], leaves) else { return Vec::new() };
        let (x, y) = cell(at);
        let cells = (x - 1..=x + 1).flat_map(|x| (y - 1..=y + 1).map(move |y| (x, y)));
        let ends = cells.filter_map(|cell| self.0.get(&cell)).flatten();
        let meets = |(other, other_leaves): &&TrafficEnd| {
            let pose = pose_of(&lanes[*other], *other_leaves);
            let is_there = |(other_at, other_rad): (Vec2, f64)| {
                other_at.distance(at) <= MEET_M && angle_difference(other_rad, heading_rad).abs() < FRAC_PI_4
            };
            *other != lane && *other_leaves != leaves && pose.is_some_and(is_there)
        };
        let mut found: Vec<usize> = ends.filter(meets).map(|(other, _)| *other).collect();
        found.sort_unstable();
        found
    }
}

fn cell(at: Vec2) -> (i64, i64) {
    ((at.x / MEET_M).floor() as i64, (at.y / MEET_M).floor() as i64)
}
