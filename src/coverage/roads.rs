//! What the lanes around a point make up: the kind of junction, and how many lanes lie side by side.

use super::tags::REACH_M;
use crate::geometry::{Vec2, angle_difference};
use crate::scene::{Lane, LaneGraph, LaneId};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};
use std::f64::consts::PI;

/// The longest way around a roundabout, meters: a diameter of 110 m.
const MOST_AROUND_M: f64 = 350.0;
/// The least 4π · area / circumference² of a roundabout: 1 for a circle, 0.79 for a block of houses.
const LEAST_ROUNDNESS: f64 = 0.85;
/// Lanes that cross at a lesser angle become one, or part, rad.
const LEAST_CROSSING_RAD: f64 = 0.35;

/// The values of the attributes `junction` and `lanes` around a point, by their names among
/// [`ATTRIBUTES`](super::ATTRIBUTES).
pub(super) fn of(graph: &LaneGraph, center: Vec2) -> [&'static str; 2] {
    let is_near = |lane: &&Lane| lane.centerline.project(center).is_some_and(|at| at.point.distance(center) <= REACH_M);
    let near: Vec<&Lane> = graph.lanes().iter().filter(is_near).collect();
    if near.is_empty() {
        return ["unknown", "unknown"];
    }
    let junction = if near.iter().any(|lane| leads_around(graph, lane)) {
        "roundabout"
    } else if near.iter().any(|lane| lane.attributes.is_intersection) || any_cross(&near, center) {
        "intersection"
    } else if near.iter().any(|lane| takes_in(graph, lane)) {
        "merge"
    } else {
        "none"
    };
    let most = near.iter().map(|lane| n_abreast(graph, lane)).max().unwrap_or(1);
    [junction, ["1", "2", "3_or_more"][most.min(3) - 1]]
}

/// Whether a shortest way from the end of this lane back to it leads around in a circle.
fn leads_around(graph: &LaneGraph, first: &Lane) -> bool {
    // Dijkstra (1959): the shortest length to the end of each lane, micrometers, and the lane before it.
    let um = |lane: &Lane| (lane.centerline.length_m() * 1e6) as u64;
    let mut open = BinaryHeap::from([Reverse((um(first), first.id, None))]);
    let mut before: BTreeMap<LaneId, Option<LaneId>> = BTreeMap::new();
    while let Some(Reverse((length_um, id, from))) = open.pop() {
        let length_m = length_um as f64 * 1e-6;
        if length_m > MOST_AROUND_M || before.contains_key(&id) {
            continue;
        }
        before.insert(id, from);
        let Some(last) = graph.get(id) else { continue };
        if last.successors.contains(&first.id) {
            let back = std::iter::successors(Some(id), |id| before.get(id).copied().flatten());
            let mut way: Vec<LaneId> = back.collect();
            way.reverse();
            if is_circle(graph, &way, length_m) {
                return true;
            }
        }
        let next = last.successors.iter().filter_map(|id| graph.get(*id));
        open.extend(next.map(|next| Reverse((length_um + um(next), next.id, Some(id)))));
    }
    false
}

fn is_circle(graph: &LaneGraph, way: &[LaneId], length_m: f64) -> bool {
    let points: Vec<Vec2> =
        way.iter().filter_map(|id| graph.get(*id)).flat_map(|lane| lane.centerline.0.iter().copied()).collect();
    let next = points.iter().cycle().skip(1);
    let area = points.iter().zip(next).map(|(a, b)| a.cross(*b)).sum::<f64>().abs() / 2.0;
    4.0 * PI * area >= LEAST_ROUNDNESS * length_m * length_m
}

/// Whether the middles of two of these lanes cross near the point.
fn any_cross(lanes: &[&Lane], center: Vec2) -> bool {
    // Lanes that begin or end together meet there, and do not cross.
    let meet = |a: &Lane, b: &Lane| {
        let shared = |a: &[LaneId], b: &[LaneId]| a.iter().any(|id| b.contains(id));
        let (from, to) = (shared(&a.predecessors, &b.predecessors), shared(&a.successors, &b.successors));
        from || to || a.successors.contains(&b.id) || b.successors.contains(&a.id)
    };
    let pieces = |lane: &Lane| -> Vec<[Vec2; 2]> {
        let pieces = lane.centerline.0.windows(2).map(|pair| [pair[0], pair[1]]);
        // Some that are farther away are among them, but none that is near is missing.
        pieces.filter(|[a, b]| a.distance(center) <= REACH_M + a.distance(*b)).collect()
    };
    let pieces: Vec<Vec<[Vec2; 2]>> = lanes.iter().map(|lane| pieces(lane)).collect();
    let is_near = |at: Vec2| at.distance(center) <= REACH_M;
    let cross =
        |i: usize, j: usize| pieces[i].iter().any(|a| pieces[j].iter().any(|b| crossing(*a, *b).is_some_and(is_near)));
    (0..lanes.len()).any(|i| (0..i).any(|j| !meet(lanes[i], lanes[j]) && cross(i, j)))
}

/// Where two segments cross, if they do at more than a small angle.
fn crossing([a, b]: [Vec2; 2], [c, d]: [Vec2; 2]) -> Option<Vec2> {
    let (along, across) = (b - a, d - c);
    let is_on = |share: f64| 0.0 < share && share < 1.0;
    let [on_first, on_second] = [across, along].map(|way| (c - a).cross(way) / along.cross(across));
    if !is_on(on_first) || !is_on(on_second) {
        return None;
    }
    let between_rad = angle_difference(along.angle(), across.angle()).abs();
    (between_rad.min(PI - between_rad) >= LEAST_CROSSING_RAD).then(|| a.lerp(b, on_first))
}

/// Whether another lane goes over into this one, or it ends beside one that goes on.
fn takes_in(graph: &LaneGraph, lane: &Lane) -> bool {
    let goes_on = |id: &LaneId| graph.get(*id).is_some_and(|beside| !beside.successors.is_empty());
    let beside = [lane.left_neighbor, lane.right_neighbor];
    lane.predecessors.len() >= 2 || lane.successors.is_empty() && beside.iter().flatten().any(goes_on)
}

/// How many lanes lie side by side with this one, with itself.
fn n_abreast(graph: &LaneGraph, lane: &Lane) -> usize {
    let mut known = BTreeSet::from([lane.id]);
    for side in [|lane: &Lane| lane.left_neighbor, |lane: &Lane| lane.right_neighbor] {
        let mut next = side(lane);
        while let Some(id) = next.filter(|id| known.insert(*id)) {
            next = graph.get(id).and_then(side);
        }
    }
    known.len()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Polyline;

    /// A lane: its id, the points of its middle, and the lanes that follow on from it.
    type Drawn<'a> = (i64, &'a [[f64; 2]], &'a [i64]);

    fn graph(lanes: &[Drawn<'_>]) -> LaneGraph {
        let lane = |(id, points, successors): &Drawn<'_>| {
            let line = Polyline(points.iter().map(|[x, y]| Vec2::new(*x, *y)).collect());
            let mut lane = Lane::unconnected(*id, line, Default::default());
            lane.successors = successors.iter().map(|id| LaneId(*id)).collect();
            let leads_here = |(_, _, after): &&Drawn<'_>| after.contains(id);
            lane.predecessors = lanes.iter().filter(leads_here).map(|(id, ..)| LaneId(*id)).collect();
            lane
        };
        LaneGraph::new(lanes.iter().map(lane).collect())
    }

    /// Four lanes around the origin, each a quarter of a way through the points that `at` gives for 0 to 4 quarters.
    fn around(at: impl Fn(f64) -> [f64; 2]) -> LaneGraph {
        let quarter = |q: i64| (0..=10).map(|i| at(q as f64 + f64::from(i) / 10.0)).collect::<Vec<_>>();
        let quarters = [0, 1, 2, 3].map(quarter);
        let ends: Vec<[[f64; 2]; 2]> = quarters.iter().map(|way| [way[10], way[10].map(|x| 3.0 * x)]).collect();
        let next = [[1, 10], [2, 11], [3, 12], [0, 13]];
        let ring = (0..4).map(|q| (q as i64, &quarters[q][..], &next[q][..]));
        let exits = (0..4).map(|q| (10 + q as i64, &ends[q][..], &[][..]));
        graph(&ring.chain(exits).collect::<Vec<_>>())
    }

    #[test]
    fn junctions_are_told_by_how_lanes_lie() {
        let junction = |graph: &LaneGraph, x: f64| of(graph, Vec2::new(x, 0.0))[0];
        let circle = |radius_m: f64| {
            around(move |quarters| {
                let (sin, cos) = (quarters * PI / 2.0).sin_cos();
                [radius_m * cos, radius_m * sin]
            })
        };
        assert_eq!([junction(&circle(15.0), 30.0), junction(&circle(50.0), 0.0)], ["roundabout"; 2]);
        assert_eq!(junction(&circle(15.0), 100.0), "unknown", "nothing is within 50 m");
        assert_eq!(junction(&circle(60.0), 60.0), "none", "its circumference is 377 m");
        // Around a block of houses: by the sides of a square.
        let block = around(|quarters| {
            let (side, along) = ((quarters % 4.0).floor(), quarters.fract() * 80.0);
            let (x, y) = (along - 40.0, -40.0);
            let (sin, cos) = (side * PI / 2.0).sin_cos();
            [x * cos - y * sin, x * sin + y * cos]
        });
        assert_ne!(junction(&block, 30.0), "roundabout");

        let straight = [[-60.0, 0.0], [60.0, 0.0]];
        let crossing = [[0.0, -60.0], [0.0, 60.0]];
        assert_eq!(junction(&graph(&[(1, &straight, &[]), (2, &crossing, &[])]), -40.0), "intersection");
        assert_eq!(junction(&graph(&[(1, &straight, &[]), (2, &crossing, &[])]), -58.0), "none", "it is 58 m away");
        let beside = [[-60.0, 3.5], [60.0, -1.0]];
        let found = junction(&graph(&[(1, &straight, &[]), (2, &beside, &[])]), 0.0);
        assert_eq!(found, "none", "their angle is 2 degrees");
        let (before, ramp, after) =
            ([[-60.0, 0.0], [0.0, 0.0]], [[-60.0, -20.0], [0.0, 0.0]], [[0.0, 0.0], [60.0, 0.0]]);
        assert_eq!(junction(&graph(&[(1, &before, &[3]), (2, &ramp, &[3]), (3, &after, &[])]), 0.0), "merge");
        assert_eq!(junction(&graph(&[(1, &before, &[3]), (3, &after, &[])]), 0.0), "none");
        assert_eq!(of(&LaneGraph::default(), Vec2::default()), ["unknown"; 2]);
        // Of streets every 10 m there are more ways of 350 m than could be followed.
        let n = 12;
        let at = |x: i64, y: i64| x * n + y;
        let street =
            |x: i64, y: i64| [[10.0 * x as f64, 10.0 * y as f64], [10.0 * x as f64 + 7.0, 10.0 * y as f64 + 7.0]];
        let corners: Vec<(i64, i64)> = (0..n).flat_map(|x| (0..n).map(move |y| (x, y))).collect();
        let lines: Vec<[[f64; 2]; 2]> = corners.iter().map(|(x, y)| street(*x, *y)).collect();
        let beside = |x: i64, y: i64| {
            let all = [(x + 1, y), (x, y + 1), (x - 1, y), (x, y - 1)].into_iter();
            all.filter(|(x, y)| (0..n).contains(x) && (0..n).contains(y)).map(|(x, y)| at(x, y)).collect::<Vec<i64>>()
        };
        let next: Vec<Vec<i64>> = corners.iter().map(|(x, y)| beside(*x, *y)).collect();
        let lanes =
            corners.iter().zip(&lines).zip(&next).map(|(((x, y), line), next)| (at(*x, *y), &line[..], &next[..]));
        assert_eq!(junction(&graph(&lanes.collect::<Vec<_>>()), 50.0), "merge");
    }

    #[test]
    fn lanes_are_counted_side_by_side_and_one_that_ends_there_merges() {
        let side_by_side = |n: i64, goes_on: &[i64]| {
            let lines: Vec<[[f64; 2]; 2]> = (0..n).map(|i| [[-60.0, 3.5 * i as f64], [0.0, 3.5 * i as f64]]).collect();
            let after = [[0.0, 0.0], [60.0, 0.0]];
            let lanes = lines.iter().zip(0..).map(|(line, id)| {
                let next: &[i64] = if goes_on.contains(&id) { &[9] } else { &[] };
                (id, &line[..], next)
            });
            let graph = graph(&lanes.chain([(9, &after[..], &[][..])]).collect::<Vec<_>>());
            let mut lanes = graph.lanes().to_vec();
            for lane in lanes.iter_mut().filter(|lane| lane.id.0 < n) {
                lane.left_neighbor = (lane.id.0 + 1 < n).then(|| LaneId(lane.id.0 + 1));
                lane.right_neighbor = (lane.id.0 > 0).then(|| LaneId(lane.id.0 - 1));
            }
            LaneGraph::new(lanes)
        };
        let at = |graph: &LaneGraph| of(graph, Vec2::new(-20.0, 0.0));
        assert_eq!(at(&side_by_side(1, &[0])), ["none", "1"]);
        assert_eq!(at(&side_by_side(2, &[0])), ["merge", "2"], "the left one ends");
        assert_eq!(at(&side_by_side(4, &[])), ["none", "3_or_more"], "the map ends");
    }
}
