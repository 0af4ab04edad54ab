//! The map of a scenario: its lanes, with what lies beside them and what controls them.

use super::crosswalks;
use super::messages::{BoundarySegment, FeatureData, LaneCenter, LaneNeighbor, MapPoint, Scenario};
use crate::geometry::{Path, Polyline, Vec2};
use crate::ingest::assumed_bounds::{self, ASSUMED_LANE_WIDTH_M};
use crate::ingest::lane_topology::connect_one_way;
use crate::ingest::map_report::MapReport;
use crate::ingest::plausible_lanes::{Flaw, flaw};
use crate::ingest::vicinity::Vicinity;
use crate::scene::{Lane, LaneAttributes, LaneGraph, LaneId};
use std::collections::{BTreeMap, BTreeSet};

/// `LaneCenter.LaneType`.
pub(crate) const LANE_TYPES: [&str; 4] = ["undefined", "freeway", "surface_street", "bike_lane"];
/// Lanes for bicycles are left out, because no generated vehicle drives on them.
const BIKE_LANE: i32 = 3;
/// `RoadLine.RoadLineType`; edges have the first.
pub(crate) const LINE_TYPES: [&str; 9] = [
    "edge",
    "broken_single_white",
    "solid_single_white",
    "solid_double_white",
    "broken_single_yellow",
    "broken_double_yellow",
    "solid_single_yellow",
    "solid_double_yellow",
    "passing_double_yellow",
];
/// `TrafficSignalLaneState.State`.
pub(crate) const LIGHTS: [&str; 9] = [
    "unknown",
    "arrow_stop",
    "arrow_caution",
    "arrow_go",
    "stop",
    "caution",
    "go",
    "flashing_stop",
    "flashing_caution",
];
pub(crate) const MPS_PER_MPH: f64 = 0.447_04;
/// How far a boundary may be from the center line, meters: some name a line across the road.
const MAX_TO_BOUNDARY_M: f64 = 10.0;
const MIN_TO_BOUNDARY_M: f64 = 0.3;

/// Everything around the lanes, by the ids of features.
#[derive(Default)]
struct Surroundings {
    lines: BTreeMap<i64, Path>,
    stop_signs: BTreeMap<i64, Vec<i64>>,
    /// The lights of a lane: from which timestep on which one shows.
    lights: BTreeMap<i64, Vec<(usize, i32)>>,
}

/// The lanes, with the lights from a timestep of the scenario on, and a report on what is left out, also of `scenario`.
pub(super) fn read(scenario: &mut Scenario, first_step: usize) -> (LaneGraph, MapReport) {
    let mut report = MapReport::default();
    leave_out_dangling(scenario, &mut report);
    let around = Surroundings::of(scenario, first_step);
    let lanes = || lanes_of(scenario);
    let vicinity = Vicinity::of(|| lanes().filter_map(|(_, lane)| lane.polyline.first().map(point)));
    let (mut read, mut ids) = (Vec::new(), BTreeSet::new());
    for (id, lane) in lanes() {
        if lane.kind == BIKE_LANE {
            report.n_not_drivable += 1;
        } else if !ids.insert(id) {
            report.warn("lanes_of_repeated_ids", format!("lane {id}: the first of this id is kept"));
        } else {
            match around.lane(id, lane, vicinity) {
                Ok(lane) => read.push(lane),
                Err((reason, what)) => report.warn(reason, format!("lane {id}: {what}")),
            }
        }
    }
    crosswalks::tag(&mut read, scenario, vicinity, &mut report);
    report.n_lanes = read.len() as u64;
    (connect_one_way(read), report)
}

fn lanes_of(scenario: &Scenario) -> impl Iterator<Item = (i64, &LaneCenter)> {
    scenario.map_features.iter().filter_map(|feature| match &feature.feature_data {
        Some(FeatureData::Lane(lane)) => Some((feature.id, &**lane)),
        _ => None,
    })
}

/// Leaves out neighbors and boundaries from and to points that lanes do not have, and lights of lanes that are none.
fn leave_out_dangling(scenario: &mut Scenario, report: &mut MapReport) {
    let n_points: BTreeMap<i64, usize> = lanes_of(scenario).map(|(id, lane)| (id, lane.polyline.len())).collect();
    let mut keep = |lane: i64, what: &str, id: i64, ends: &[(i32, i32, usize)]| {
        let is_part = |(start, end, n): &(i32, i32, usize)| (0..=*end).contains(start) && (*end as usize) < *n;
        let is_kept = ends.iter().all(is_part);
        if !is_kept {
            let detail = format!("lane {lane}: {what} {id} is beside points that are not there");
            report.warn("indices_out_of_range", detail);
        }
        is_kept
    };
    for feature in &mut scenario.map_features {
        let Some(FeatureData::Lane(lane)) = &mut feature.feature_data else { continue };
        let n = lane.polyline.len();
        for neighbors in [&mut lane.left_neighbors, &mut lane.right_neighbors] {
            neighbors.retain(|of| {
                let own = (of.self_start_index, of.self_end_index, n);
                let n_there = n_points.get(&of.feature_id);
                let there = n_there.map(|n| (of.neighbor_start_index, of.neighbor_end_index, *n));
                keep(feature.id, "neighbor", of.feature_id, &[own, there.unwrap_or(own)])
            });
        }
        for boundaries in [&mut lane.left_boundaries, &mut lane.right_boundaries] {
            boundaries.retain(|of| {
                keep(feature.id, "boundary", of.boundary_feature_id, &[(of.lane_start_index, of.lane_end_index, n)])
            });
        }
    }
    let mut unknown = BTreeSet::new();
    for at in &mut scenario.dynamic_map_states {
        let (known, others): (Vec<_>, Vec<_>) =
            std::mem::take(&mut at.lane_states).into_iter().partition(|light| n_points.contains_key(&light.lane));
        unknown.extend(others.iter().map(|light| light.lane));
        at.lane_states = known;
    }
    unknown.into_iter().for_each(|lane| report.warn("lights_of_unknown_lanes", format!("lane {lane}")));
}

impl Surroundings {
    fn of(scenario: &Scenario, first_step: usize) -> Self {
        let mut around = Self::default();
        for feature in &scenario.map_features {
            match &feature.feature_data {
                Some(FeatureData::RoadLine(side) | FeatureData::RoadEdge(side)) => {
                    around.lines.insert(feature.id, Path::new(line(&side.polyline)));
                }
                Some(FeatureData::StopSign(sign)) => {
                    sign.lane.iter().for_each(|lane| around.stop_signs.entry(*lane).or_default().push(feature.id));
                }
                Some(FeatureData::Lane(_) | FeatureData::Crosswalk(_)) | None => {}
            }
        }
        // Also those after the scene: what goes on from it meets the same lights.
        let shown = scenario.dynamic_map_states.iter().skip(first_step).enumerate();
        for (timestep, light) in shown.flat_map(|(timestep, at)| at.lane_states.iter().map(move |of| (timestep, of))) {
            around.lights.entry(light.lane).or_default().push((timestep, light.state));
        }
        around
    }

    fn lane(&self, id: i64, lane: &LaneCenter, vicinity: Vicinity) -> Result<Lane, Flaw> {
        for at in &lane.polyline {
            vicinity.checked(point(at)).map_err(|what| ("broken_lanes", what.to_string()))?;
        }
        let center = line(&lane.polyline);
        let (bounded, n_assumed) = self.bounded(id, &center, lane)?;
        let ids = |ids: &[i64]| ids.iter().copied().map(LaneId).collect();
        let mut tags = BTreeMap::new();
        let mut tag = |name: &str, value: String| (!value.is_empty()).then(|| tags.insert(name.to_owned(), value));
        if lane.speed_limit_mph > 0.0 && lane.speed_limit_mph.is_finite() {
            tag("speed_limit_mps", format!("{:.3}", lane.speed_limit_mph * MPS_PER_MPH));
        }
        tag("left_neighbors", joined(&lane.left_neighbors, neighbor));
        tag("right_neighbors", joined(&lane.right_neighbors, neighbor));
        tag("left_boundaries", joined(&lane.left_boundaries, boundary));
        tag("right_boundaries", joined(&lane.right_boundaries, boundary));
        tag("stop_signs", self.stop_signs.get(&id).map_or(String::new(), |signs| joined(signs, i64::to_string)));
        tag(LaneAttributes::LIGHT, self.lights.get(&id).map_or(String::new(), |shown| lights(shown)));
        if n_assumed > 0 {
            let n = 2 * center.0.len();
            tag("boundaries", format!("assumed:{ASSUMED_LANE_WIDTH_M}_m_wide at {n_assumed} of {n} points"));
        }
        let attributes = LaneAttributes {
            kind: named(&LANE_TYPES, lane.kind).to_owned(),
            // Only there have lanes no boundaries.
            is_intersection: lane.interpolating || lane.left_boundaries.len() + lane.right_boundaries.len() == 0,
            has_traffic_control: self.stop_signs.contains_key(&id) || self.lights.contains_key(&id),
            one_way: true,
            tags,
            ..LaneAttributes::default()
        };
        Ok(Lane {
            successors: ids(&lane.exit_lanes),
            predecessors: ids(&lane.entry_lanes),
            left_neighbor: longest(&lane.left_neighbors),
            right_neighbor: longest(&lane.right_neighbors),
            attributes: attributes.into(),
            ..bounded
        })
    }

    /// A lane with the boundaries that the map names, or else, as in narrow bends, with assumed ones, or with none, and
    /// the number of their points that are assumed.
    fn bounded(&self, id: i64, center: &Polyline, lane: &LaneCenter) -> Result<(Lane, usize), Flaw> {
        let with = |left: &[BoundarySegment], right: &[BoundarySegment]| {
            let [(left, n_left), (right, n_right)] = [self.side(center, left, 1.0), self.side(center, right, -1.0)];
            (Lane::unconnected(id, center.clone(), [left, right]), n_left + n_right)
        };
        // Indices count points that are repeated, too.
        let named =
            (center.0.len() == lane.polyline.len()).then(|| with(&lane.left_boundaries, &lane.right_boundaries));
        if let Some(named) = named.filter(|(lane, _)| flaw(lane).is_ok()) {
            return Ok(named);
        }
        let assumed = with(&[], &[]);
        if flaw(&assumed.0).is_ok() {
            return Ok(assumed);
        }
        let bare = Lane::unconnected(id, center.clone(), Default::default());
        flaw(&bare).map(|()| (bare, 0))
    }

    /// The boundary on a side of a lane (left 1, right -1): for each point of the center line the nearest of the line
    /// that the map names there, or one at the distance of half an assumed width, and how many of these there are.
    fn side(&self, center: &Polyline, boundaries: &[BoundarySegment], side: f64) -> (Polyline, usize) {
        let mut points = assumed_bounds::beside(&center.0, side * ASSUMED_LANE_WIDTH_M / 2.0).0;
        let mut is_assumed = vec![true; points.len()];
        for BoundarySegment { lane_start_index, lane_end_index, boundary_feature_id, .. } in boundaries {
            let Some(path) = self.lines.get(boundary_feature_id) else { continue };
            for idx in *lane_start_index as usize..=*lane_end_index as usize {
                let Some(nearest) = path.project(center.0[idx]) else { break };
                let to_side = nearest.point - center.0[idx];
                let is_on_side = (points[idx] - center.0[idx]).dot(to_side) > 0.0;
                if is_assumed[idx] && is_on_side && (MIN_TO_BOUNDARY_M..=MAX_TO_BOUNDARY_M).contains(&to_side.norm()) {
                    (points[idx], is_assumed[idx]) = (nearest.point, false);
                }
            }
        }
        points.dedup();
        (Polyline(points), is_assumed.into_iter().filter(|is_assumed| *is_assumed).count())
    }
}

pub(super) fn point(at: &MapPoint) -> Vec2 {
    Vec2::new(at.x, at.y)
}

/// The points of a line, without repetitions.
fn line(points: &[MapPoint]) -> Polyline {
    let mut points: Vec<Vec2> = points.iter().map(point).collect();
    points.dedup();
    Polyline(points)
}

/// Of the lanes beside a lane, the one that is there for longest: a lane has one neighbor on each side.
fn longest(neighbors: &[LaneNeighbor]) -> Option<LaneId> {
    let n_points = |of: &&LaneNeighbor| i64::from(of.self_end_index) - i64::from(of.self_start_index);
    neighbors.iter().rev().max_by_key(n_points).map(|of| LaneId(of.feature_id))
}

/// `7:0-20/5-25`: lane 7, from point to point of this lane and of that one.
fn neighbor(of: &LaneNeighbor) -> String {
    let LaneNeighbor { feature_id, self_start_index, self_end_index, neighbor_start_index, neighbor_end_index } = of;
    format!("{feature_id}:{self_start_index}-{self_end_index}/{neighbor_start_index}-{neighbor_end_index}")
}

/// `9:0-20/solid_single_white`: feature 9, from point to point of this lane, and its type.
fn boundary(of: &BoundarySegment) -> String {
    let BoundarySegment { lane_start_index, lane_end_index, boundary_feature_id, boundary_type } = of;
    format!("{boundary_feature_id}:{lane_start_index}-{lane_end_index}/{}", named(&LINE_TYPES, *boundary_type))
}

/// The tag of lights of a lane.
fn lights(shown: &[(usize, i32)]) -> String {
    let runs = shown.chunk_by(|(step, light), (next_step, next)| light == next && *next_step <= step + 1);
    let one = |run: &[(usize, i32)]| {
        let ends = run.first().zip(run.last());
        ends.map_or(String::new(), |((first, light), (last, _))| format!("{}:{first}-{last}", named(&LIGHTS, *light)))
    };
    runs.map(one).collect::<Vec<_>>().join(";")
}

fn joined<T>(all: &[T], one: impl Fn(&T) -> String) -> String {
    all.iter().map(one).collect::<Vec<_>>().join(";")
}

/// The name of a value of an enumeration; the first one's if the format does not list it.
fn named(names: &[&'static str], value: i32) -> &'static str {
    usize::try_from(value).ok().and_then(|value| names.get(value)).unwrap_or(&names[0])
}
