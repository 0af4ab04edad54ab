//! The lanes near a scenario as the features of a map.

use crate::geometry::Polyline;
use crate::ingest::womd::messages::{
    BoundarySegment, Crosswalk, FeatureData, LaneCenter, LaneNeighbor, MapFeature, MapPoint, RoadSide, StopSign,
    TrafficSignalLaneState,
};
use crate::ingest::womd::{LANE_TYPES, LIGHTS, LINE_TYPES, MPS_PER_MPH};
use crate::scene::{Lane, LaneGraph, LaneId, Scene};
use std::collections::{BTreeMap, BTreeSet};

/// What lanes are by the words of other maps.
const FREEWAYS: [&str; 3] = ["freeway", "highway", "motorway"];
const FREEWAY: i32 = 1;
const SURFACE_STREET: i32 = 2;
/// `RoadEdge.RoadEdgeType`: no traffic beyond it.
const OUTER_EDGE: i32 = 1;

/// Lanes, boundaries, stop signs and crosswalks, in the recording's frame, and what was left out or assumed.
pub(super) fn features(scene: &Scene) -> (Vec<MapFeature>, Vec<(&'static str, u64)>) {
    let graph = scene.lanes.transformed(&scene.world_from_scene);
    let lanes: Vec<&Lane> = graph.lanes().iter().filter(|lane| lane.centerline.length_m() > 0.0).collect();
    let crosswalks: BTreeMap<i64, _> = lanes.iter().flat_map(|lane| lane.attributes.crosswalks()).collect();
    let signs = stop_signs(&lanes);
    let mut features: BTreeMap<i64, FeatureData> = BTreeMap::new();
    for (id, corners) in crosswalks {
        let polygon = corners.iter().map(|at| MapPoint { x: at.x, y: at.y }).collect();
        features.insert(id, FeatureData::Crosswalk(Crosswalk { polygon }));
    }
    features.extend(signs.into_iter().map(|(id, sign)| (id, FeatureData::StopSign(sign))));
    let taken: BTreeSet<i64> = lanes.iter().map(|lane| lane.id.0).chain(features.keys().copied()).collect();
    let mut free = (1..i64::MAX).filter(|id| !taken.contains(id));
    for lane in &lanes {
        let [left, right] = [(&lane.left, "left_boundaries"), (&lane.right, "right_boundaries")].map(|(line, tag)| {
            let (segments, is_edge) = segments(lane, line, tag);
            let Some((kind, id)) = segments.first().map(|first| first.boundary_type).zip(free.next()) else {
                return Vec::new();
            };
            let side = |kind| RoadSide { kind, polyline: points(line) };
            let side =
                if is_edge { FeatureData::RoadEdge(side(OUTER_EDGE)) } else { FeatureData::RoadLine(side(kind)) };
            features.insert(id, side);
            segments.into_iter().map(|segment| BoundarySegment { boundary_feature_id: id, ..segment }).collect()
        });
        features.insert(lane.id.0, FeatureData::Lane(Box::new(center(&graph, lane, [left, right]))));
    }
    let n_left_out = (graph.lanes().len() - lanes.len()) as u64;
    let features = features.into_iter().map(|(id, data)| MapFeature { id, feature_data: Some(data) });
    (features.collect(), vec![("lane_without_extent", n_left_out)])
}

/// What the lights show at a timestep; vehicles stop at the beginning of the lane.
pub(super) fn lights(scene: &Scene, timestep: usize) -> Vec<TrafficSignalLaneState> {
    let of = |lane: &Lane| {
        let (name, _) = scene.lights(lane).find(|(_, timesteps)| timesteps.contains(&timestep))?;
        let begin =
            scene.world_from_scene.point(*lane.centerline.0.first().filter(|_| lane.centerline.length_m() > 0.0)?);
        let stop_point = Some(MapPoint { x: begin.x, y: begin.y });
        Some(TrafficSignalLaneState { lane: lane.id.0, state: number_of(&LIGHTS, name)?, stop_point })
    };
    scene.lanes.lanes().iter().filter_map(of).collect()
}

fn center(
    graph: &LaneGraph,
    lane: &Lane,
    [left_boundaries, right_boundaries]: [Vec<BoundarySegment>; 2],
) -> LaneCenter {
    let attributes = &lane.attributes;
    let ids = |ids: &[LaneId]| ids.iter().map(|id| id.0).collect();
    let is_freeway = FREEWAYS.contains(&attributes.kind.as_str());
    let usual = if is_freeway { FREEWAY } else { SURFACE_STREET };
    let limit_mps: Option<f64> = attributes.tags.get("speed_limit_mps").and_then(|limit| limit.parse().ok());
    LaneCenter {
        speed_limit_mph: limit_mps.filter(|limit| limit.is_finite()).unwrap_or_default() / MPS_PER_MPH,
        kind: number_of(&LANE_TYPES, &attributes.kind).unwrap_or(usual),
        interpolating: attributes.is_intersection,
        polyline: points(&lane.centerline),
        entry_lanes: ids(&lane.predecessors),
        exit_lanes: ids(&lane.successors),
        left_neighbors: neighbors(graph, lane, "left_neighbors", lane.left_neighbor),
        right_neighbors: neighbors(graph, lane, "right_neighbors", lane.right_neighbor),
        left_boundaries,
        right_boundaries,
    }
}

/// The lanes beside a lane, with the points from and to which they are; beside all of it if the map does not say.
fn neighbors(graph: &LaneGraph, lane: &Lane, tag: &str, beside: Option<LaneId>) -> Vec<LaneNeighbor> {
    let one = |text: &str| {
        let (id, spans) = text.split_once(':')?;
        let (own, theirs) = spans.split_once('/')?;
        let ([self_start_index, self_end_index], [neighbor_start_index, neighbor_end_index]) =
            (span(own)?, span(theirs)?);
        let feature_id = id.parse().ok().filter(|id| graph.get(LaneId(*id)).is_some())?;
        Some(LaneNeighbor { feature_id, self_start_index, self_end_index, neighbor_start_index, neighbor_end_index })
    };
    let of_map: Vec<LaneNeighbor> = parts(lane, tag).filter_map(one).collect();
    if !of_map.is_empty() {
        return of_map;
    }
    let whole = |other: &Lane| LaneNeighbor {
        feature_id: other.id.0,
        self_start_index: 0,
        self_end_index: last(&lane.centerline),
        neighbor_start_index: 0,
        neighbor_end_index: last(&other.centerline),
    };
    beside.and_then(|id| graph.get(id)).map(whole).into_iter().collect()
}

/// The parts of a lane that have this boundary, each with its type, and whether it is an edge of the road: as the map
/// says, or all of it, with a mark that is not known. None where it was assumed.
fn segments(lane: &Lane, line: &Polyline, tag: &str) -> (Vec<BoundarySegment>, bool) {
    let tags = &lane.attributes.tags;
    let is_assumed = tags.get("boundaries").is_some_and(|how| how.starts_with("assumed"));
    if line.0.len() < 2 || (is_assumed && !tags.contains_key(tag)) {
        return (Vec::new(), false);
    }
    let one = |text: &str| {
        let (_, text) = text.split_once(':')?;
        let (points, kind) = text.split_once('/')?;
        let [lane_start_index, lane_end_index] = span(points)?;
        let boundary_type = number_of(&LINE_TYPES, kind)?;
        Some(BoundarySegment { lane_start_index, lane_end_index, boundary_type, ..BoundarySegment::default() })
    };
    let of_map: Vec<BoundarySegment> = parts(lane, tag).filter_map(one).collect();
    match of_map.first().map(|first| first.boundary_type == 0) {
        Some(is_edge) => (of_map, is_edge),
        None => (vec![BoundarySegment { lane_end_index: last(&lane.centerline), ..BoundarySegment::default() }], false),
    }
}

/// The stop signs by their names, each with its lanes.
fn stop_signs(lanes: &[&Lane]) -> BTreeMap<i64, StopSign> {
    let mut signs: BTreeMap<i64, StopSign> = BTreeMap::new();
    for lane in lanes {
        for id in parts(lane, "stop_signs").filter_map(|id| id.parse().ok()) {
            let sign = signs.entry(id).or_default();
            sign.lane.push(lane.id.0);
            let begin = lane.centerline.0.first().map(|at| MapPoint { x: at.x, y: at.y });
            sign.position = sign.position.or(begin);
        }
    }
    signs
}

fn parts<'l>(lane: &'l Lane, tag: &str) -> impl Iterator<Item = &'l str> {
    lane.attributes.tags.get(tag).map_or("", String::as_str).split(';')
}

/// `0-20`.
fn span(text: &str) -> Option<[i32; 2]> {
    let (first, last) = text.split_once('-')?;
    Some([first.parse().ok()?, last.parse().ok()?])
}

fn last(line: &Polyline) -> i32 {
    i32::try_from(line.0.len().saturating_sub(1)).unwrap_or(i32::MAX)
}

fn points(line: &Polyline) -> Vec<MapPoint> {
    line.0.iter().map(|at| MapPoint { x: at.x, y: at.y }).collect()
}

fn number_of(names: &[&str], name: &str) -> Option<i32> {
    names.iter().position(|known| *known == name).and_then(|number| i32::try_from(number).ok())
}
