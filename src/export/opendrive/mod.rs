//! OpenDRIVE 1.7: the lanes of a scenario as roads.
//!
//! Lanes that run side by side from one cross-section to another are one road ([`bundles`]), numbered from -1 on its
//! left to the right. Its reference line is the middle between its outer edges ([`reference_line`]), and the edges of
//! its lanes are those of the map ([`cross_section`]).

mod bundles;
mod cross_section;
mod links;
mod reference_line;
#[cfg(test)]
mod tests;

use super::text::number;
use super::xml::{Element, element};
use crate::scene::{Lane, LaneGraph, LaneId};
use bundles::Bundle;
use cross_section::{Edges, edges};
use links::{Links, Spot};
use reference_line::{Piece, ReferenceLine, Shape};
use std::collections::BTreeMap;

/// A value that the previous record predicts to within this needs no record of its own, meters.
const FORETOLD_M: f64 = 1e-4;
/// A fixed date, because the format requires one.
const DATE: &str = "1970-01-01T00:00:00";

/// A map as a document, and the assumptions about it.
pub(super) struct RoadNetwork {
    pub(super) root: Element,
    pub(super) assumed: Vec<(&'static str, u64)>,
}

/// Lanes that become a road, from left to right.
struct Road<'l> {
    lanes: Vec<&'l Lane>,
    line: ReferenceLine,
    edges: Vec<Edges>,
}

/// The roads of a map, in its frame; `None` if no lane has any length. Roads are numbered from 1, in the order of their
/// leftmost lanes.
pub(super) fn of(map: &LaneGraph) -> Option<RoadNetwork> {
    let mut n_nominal = 0;
    let mut roads = Vec::new();
    for Bundle { lanes, lines, is_nominal } in Bundle::all(map) {
        let (Some(left), Some(right)) = (lines.first(), lines.last()) else { continue };
        let Some(line) = ReferenceLine::between(left, right) else { continue };
        let edges = edges(&line, &lines);
        n_nominal += u64::from(is_nominal);
        roads.push(Road { lanes, line, edges });
    }
    if roads.is_empty() {
        return None;
    }
    let spots = roads.iter().enumerate().flat_map(|(i, road)| {
        let spot = move |(k, lane): (usize, &&Lane)| (lane.id, Spot { road: i + 1, lane: -(k as i32) - 1 });
        road.lanes.iter().enumerate().map(spot)
    });
    let spots: BTreeMap<LaneId, Spot> = spots.collect();
    let links = Links::of(map.lanes().iter(), &spots);
    let root = element("OpenDRIVE")
        .child(header(&roads))
        .children(roads.iter().enumerate().map(|(i, of)| road(of, i + 1, &links)))
        .children(links.junctions());
    let n_left_out = (map.lanes().len() - spots.len()) as u64;
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
    let plan = element("planView").children(of.line.pieces.iter().map(geometry));
    let offsets = records("laneOffset", "s", &of.edges, |edges| edges.across_m[0]);
    let mark = |lane: &Lane, neighbor: Option<LaneId>| {
        let kind = match neighbor {
            _ if lane.attributes.is_intersection => "none",
            Some(_) => "broken",
            None => "solid",
        };
        element("roadMark").attr("sOffset", 0).attr("type", kind).attr("color", "standard").attr("width", "0.12")
    };
    let lane = |id: i32, kind: &str| element("lane").attr("id", id).attr("type", kind).attr("level", "false");
    let middle = lane(0, "none").children(of.lanes.first().map(|lane| mark(lane, lane.left_neighbor)));
    let right = of.lanes.iter().enumerate().map(|(k, of_map)| {
        let number = -(k as i32) - 1;
        let width = move |edges: &Edges| edges.across_m[k] - edges.across_m[k + 1];
        let widths = records("width", "sOffset", &of.edges, width);
        let links = links.of_lane(Spot { road: id, lane: number });
        lane(number, kind(of_map)).child(links).children(widths).child(mark(of_map, of_map.right_neighbor))
    });
    let section = element("laneSection")
        .attr("s", 0)
        .child(element("center").child(middle))
        .child(element("right").children(right));
    let names: Vec<String> = of.lanes.iter().map(|lane| lane.id.0.to_string()).collect();
    let name = if names.len() == 1 { "lane" } else { "lanes" };
    element("road")
        .attr("name", format!("{name} {}", names.join(" ")))
        .attr("length", number(of.line.length_m()))
        .attr("id", id)
        .attr("junction", -1)
        .child(links.of_road(id))
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

/// The records of a value that is linear between the places of its edges; no record repeats the prediction of the
/// previous one.
fn records(name: &'static str, place: &'static str, edges: &[Edges], of: impl Fn(&Edges) -> f64) -> Vec<Element> {
    let mut found = Vec::new();
    // The start of the last record, its value there, and its slope.
    let mut last: Option<(f64, f64, f64)> = None;
    for pair in edges.windows(2) {
        let (from, to) = (&pair[0], &pair[1]);
        let foretold = |(s_m, value, slope): (f64, f64, f64)| {
            [from, to].into_iter().all(|at| (value + slope * (at.s_m - s_m) - of(at)).abs() < FORETOLD_M)
        };
        if last.is_some_and(foretold) {
            continue;
        }
        let slope = (of(to) - of(from)) / (to.s_m - from.s_m);
        last = Some((from.s_m, of(from), slope));
        let record = element(name).attr(place, number(from.s_m)).attr("a", number(of(from)));
        found.push(record.attr("b", number(slope)).attr("c", 0).attr("d", 0));
    }
    found
}

/// The standard's type of a lane, if the map has it.
fn kind(lane: &Lane) -> &'static str {
    match lane.attributes.kind.as_str() {
        "BIKE" | "bicycle_lane" => "biking",
        "BUS" | "bus_lane" => "bus",
        _ => "driving",
    }
}
