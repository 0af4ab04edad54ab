//! OpenDRIVE 1.7: the lanes of a scenario as roads.
//!
//! Each lane is a road of its own, because maps of lanes do not tell which of them run side by side throughout. A road
//! has the lane's number -1, its reference line is the middle of the lane ([`reference_line`]), and its edges are those
//! of the lane ([`cross_section`]).

mod cross_section;
mod links;
mod reference_line;
#[cfg(test)]
mod tests;

use super::lane_bounds::LaneBounds;
use super::text::number;
use super::xml::{Element, element};
use crate::scene::{Lane, LaneGraph, LaneId};
use cross_section::{Edges, edges};
use links::Links;
use reference_line::{Piece, ReferenceLine, Shape};
use std::collections::BTreeMap;

/// A fixed date, because the format requires one.
const DATE: &str = "1970-01-01T00:00:00";

/// A map as a document, and what was assumed about it.
pub(super) struct RoadNetwork {
    pub(super) root: Element,
    pub(super) assumed: Vec<(&'static str, u64)>,
}

/// A lane that becomes a road.
struct Road<'l> {
    lane: &'l Lane,
    line: ReferenceLine,
    edges: Vec<Edges>,
}

/// The roads of a map, in its frame; `None` if no lane has any length. Roads are numbered from 1, in the order of the lanes.
pub(super) fn of(map: &LaneGraph) -> Option<RoadNetwork> {
    let mut n_nominal = 0;
    let mut roads = Vec::new();
    for lane in map.lanes() {
        let Some(bounds) = LaneBounds::of(lane) else { continue };
        let (left, right) = bounds.paired();
        let middle: Vec<_> = left.iter().zip(&right).map(|(left, right)| left.lerp(*right, 0.5)).collect();
        let Some(line) = ReferenceLine::along(&middle) else { continue };
        let edges = edges(&line, &bounds);
        n_nominal += u64::from(bounds.is_nominal);
        roads.push(Road { lane, line, edges });
    }
    if roads.is_empty() {
        return None;
    }
    let numbers: BTreeMap<LaneId, usize> = roads.iter().enumerate().map(|(i, road)| (road.lane.id, i + 1)).collect();
    let links = Links::of(roads.iter().map(|road| road.lane), &numbers);
    let root = element("OpenDRIVE")
        .child(header(&roads))
        .children(roads.iter().enumerate().map(|(i, of)| road(of, i + 1, &links)))
        .children(links.junctions());
    let n_left_out = (map.lanes().len() - roads.len()) as u64;
    Some(RoadNetwork { root, assumed: vec![("nominal_lane_width", n_nominal), ("lane_without_extent", n_left_out)] })
}

fn header(roads: &[Road<'_>]) -> Element {
    let starts = || roads.iter().flat_map(|road| road.line.pieces.iter().map(|piece| piece.start));
    let extreme = |pick: fn(f64, f64) -> f64, of: fn(crate::geometry::Vec2) -> f64| {
        number(starts().map(of).reduce(pick).unwrap_or_default())
    };
    element("header")
        .attr("revMajor", 1)
        .attr("revMinor", 7)
        .attr("name", "lanes of a scenario")
        .attr("date", DATE)
        .attr("north", extreme(f64::max, |point| point.y))
        .attr("south", extreme(f64::min, |point| point.y))
        .attr("east", extreme(f64::max, |point| point.x))
        .attr("west", extreme(f64::min, |point| point.x))
        .attr("vendor", "djinn")
}

fn road(of: &Road<'_>, id: usize, links: &Links) -> Element {
    let (of_road, of_lane) = links.of_road(id);
    let plan = element("planView").children(of.line.pieces.iter().map(geometry));
    let pairs = || of.edges.windows(2);
    let offsets = pairs().map(|pair| record("laneOffset", "s", pair, |edges| edges.left_m));
    let widths = pairs().map(|pair| record("width", "sOffset", pair, |edges| edges.left_m - edges.right_m));
    let attributes = &of.lane.attributes;
    let mark = |neighbor: Option<LaneId>| {
        let kind = match neighbor {
            _ if attributes.is_intersection => "none",
            Some(_) => "broken",
            None => "solid",
        };
        element("roadMark").attr("sOffset", 0).attr("type", kind).attr("color", "standard").attr("width", "0.12")
    };
    let lane = |id: i32, kind: &str| element("lane").attr("id", id).attr("type", kind).attr("level", "false");
    let middle = lane(0, "none").child(mark(of.lane.left_neighbor));
    let right = lane(-1, kind(of.lane)).child(of_lane).children(widths).child(mark(of.lane.right_neighbor));
    let section =
        element("laneSection").attr("s", 0).child(element("center").child(middle)).child(element("right").child(right));
    element("road")
        .attr("name", format!("lane {}", of.lane.id.0))
        .attr("length", number(of.line.length_m()))
        .attr("id", id)
        .attr("junction", -1)
        .child(of_road)
        .child(plan)
        .child(element("lanes").children(offsets).child(section))
}

fn geometry(piece: &Piece) -> Element {
    let shape = match piece.shape {
        Shape::Line => element("line"),
        Shape::Parabola { along_m, u_m, v_m } => element("paramPoly3")
            .attr("aU", 0)
            .attr("bU", number(along_m))
            .attr("cU", number(u_m))
            .attr("dU", 0)
            .attr("aV", 0)
            .attr("bV", 0)
            .attr("cV", number(v_m))
            .attr("dV", 0)
            .attr("pRange", "normalized"),
    };
    element("geometry")
        .attr("s", number(piece.s_m))
        .attr("x", number(piece.start.x))
        .attr("y", number(piece.start.y))
        .attr("hdg", number(piece.heading_rad))
        .attr("length", number(piece.length_m))
        .child(shape)
}

/// A value that is linear between two places.
fn record(name: &'static str, place: &'static str, pair: &[Edges], of: fn(&Edges) -> f64) -> Element {
    let (from, to) = (&pair[0], &pair[1]);
    let slope = (of(to) - of(from)) / (to.s_m - from.s_m);
    element(name)
        .attr(place, number(from.s_m))
        .attr("a", number(of(from)))
        .attr("b", number(slope))
        .attr("c", 0)
        .attr("d", 0)
}

/// The standard's type of a lane, if the map has it.
fn kind(lane: &Lane) -> &'static str {
    match lane.attributes.kind.as_str() {
        "BIKE" | "bicycle_lane" => "biking",
        "BUS" | "bus_lane" => "bus",
        _ => "driving",
    }
}
