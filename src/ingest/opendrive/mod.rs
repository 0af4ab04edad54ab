//! Reads maps in OpenDRIVE 1.4 to 1.8: roads with reference lines, lane sections and lanes.
//!
//! Lanes on which motor vehicles drive become lanes, one for each section. They are numbered in the order of the file,
//! and have the road and the lane in their tags. Elevation, superelevation, shapes of the surface and objects are not
//! read. Coordinates are those of the file; an offset in its header is not applied.

mod cubic;
mod links;
mod outline;
mod plan_view;
mod road;
#[cfg(test)]
mod tests;

use super::assemble::MAX_COORDINATE_M;
use super::error::{Error, Malformed};
use super::lane_topology::connect;
use super::map_report::MapReport;
use super::map_text::read_text;
use super::plausible_lanes::plausible;
use super::xml_tree::Element;
use crate::geometry::{Vec2, angle_difference};
use crate::scene::{Lane, LaneAttributes, LaneGraph, TurnDirection};
use links::{Connection, LaneEnd, LaneKey, touching};
use road::{Road, RoadLane, RoadLink};
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::FRAC_PI_6;
use std::io::BufRead;

/// Maximum size of a map; towns have some megabytes.
const MAX_MAP_BYTES: u64 = 256 << 20;
/// Maximum number of points in the edges of all lanes.
const MAX_POINTS: usize = 10_000_000;
/// Distances closer than this are the same, meters: there is no room for a lane between them.
const SAME_M: f64 = 1e-6;
/// Widths below zero by less than this are rounding errors, meters.
const MAX_ROUNDING_M: f64 = 0.01;
/// Linked lanes begin within this distance of the other's end, meters.
const MAX_APART_M: f64 = 10.0;
/// Longest road, meters: the size of a file does not bound it.
const MAX_ROAD_M: f64 = 1e5;

/// Reads a map: its vehicle lanes, and a report of its defects. Roads that cannot be read are left out and reported.
///
/// # Errors
/// [`Error::Map`], naming `file`, when the document is not OpenDRIVE, exceeds a limit, or when no lane remains.
pub(super) fn read_map(reader: &mut dyn BufRead, file: &str) -> Result<(LaneGraph, MapReport), Error> {
    let error = |what: Malformed| Error::map(file, "", what);
    let text = read_text(reader, MAX_MAP_BYTES, file)?;
    let root = Element::parse(&text).map_err(error)?;
    if root.name != "OpenDRIVE" {
        return Err(error(format!("begins with <{}>, expected <OpenDRIVE>", root.name).into()));
    }
    let mut report = MapReport::default();
    if let Some(offset) = root.find(&["header", "offset"]) {
        let at = ["x", "y"].map(|name| offset.attribute(name).unwrap_or("0"));
        if at.iter().any(|at| at.parse() != Ok(0.0)) {
            report.warn("map_offsets_ignored", format!("the header has an offset of ({}, {}) m", at[0], at[1]));
        }
    }
    let mut roads: Vec<Road> = Vec::new();
    let mut ids = BTreeSet::new();
    for element in root.all("road") {
        match Road::of(element).and_then(checked) {
            Ok(road) if !ids.insert(road.id.clone()) => {
                let detail = format!("road {} on line {}: the first of this id is kept", road.id, element.line);
                report.warn("duplicate_id", detail);
            }
            Ok(road) => roads.push(road),
            Err(what) => {
                let (name, line) = (element.attribute("id").unwrap_or("without id"), element.line);
                report.warn("broken_roads", format!("road {name} on line {line}: {what}"));
            }
        }
    }
    let mut connections = Vec::new();
    for junction in root.all("junction") {
        match Connection::all(junction) {
            Ok(found) => connections.extend(found),
            Err(what) => {
                let (name, line) = (junction.attribute("id").unwrap_or("without id"), junction.line);
                report.warn("broken_junctions", format!("junction {name} on line {line}: {what}"));
            }
        }
    }
    report_gaps(&roads, &connections, &ids, &root, &mut report);
    let lanes = lanes(&roads, &connections, &mut report).map_err(error)?;
    let lanes = plausible(lanes, &mut report);
    if lanes.is_empty() {
        let detail = format!("has no vehicle lane on {} roads; {}", roads.len(), report.summary());
        return Err(error(detail.into()));
    }
    report.n_lanes = lanes.len() as u64;
    Ok((connect(lanes), report))
}

/// Reports reference lines that break off, and links to missing elements.
fn report_gaps(
    roads: &[Road],
    connections: &[Connection],
    ids: &BTreeSet<String>,
    root: &Element,
    report: &mut MapReport,
) {
    let junctions: BTreeSet<&str> = root.all("junction").filter_map(|junction| junction.attribute("id")).collect();
    for road in roads {
        if let Some(gap) = road.gap() {
            report.warn("broken_reference_lines", format!("road {}: {gap}", road.id));
        }
        for link in road.links.iter().flatten() {
            let (what, to, is_there) = match link {
                RoadLink::Road(to, _) => ("road", to, ids.contains(to)),
                RoadLink::Junction(to) => ("junction", to, junctions.contains(to.as_str())),
            };
            if !is_there {
                report
                    .warn("links_to_nowhere", format!("road {} is linked to {what} {to}, which is not read", road.id));
            }
        }
    }
    for Connection { junction, incoming, connecting, .. } in connections {
        if let Some(road) = [incoming, connecting].into_iter().find(|road| !ids.contains(*road)) {
            report.warn("links_to_nowhere", format!("junction {junction} connects road {road}, which is not read"));
        }
    }
}

fn checked(road: Road) -> Result<Road, Malformed> {
    let length_m = road.length_m;
    if !(SAME_M..=MAX_ROAD_M).contains(&length_m) {
        return Err(format!("is {length_m} m long, expected more than 0 and at most {MAX_ROAD_M}").into());
    }
    match road.sections.iter().find(|section| section.start_m > length_m + SAME_M) {
        Some(beyond) => Err(format!("has lanes from {} m on, but is {length_m} m long", beyond.start_m).into()),
        None => Ok(road),
    }
}

fn lanes(roads: &[Road], connections: &[Connection], report: &mut MapReport) -> Result<Vec<Lane>, Malformed> {
    let mut map = Lanes::default();
    for (road_idx, road) in roads.iter().enumerate() {
        for section_idx in 0..road.sections.len() {
            map.add_section(road, (road_idx, section_idx), report)?;
        }
    }
    for ends in touching(roads, connections) {
        map.join(roads, ends, report);
    }
    Ok(map.lanes)
}

/// The lanes found so far.
#[derive(Default)]
struct Lanes {
    lanes: Vec<Lane>,
    index_of: BTreeMap<LaneKey, usize>,
    n_points: usize,
}

impl Lanes {
    /// Adds the lanes of a section, and makes adjacent ones neighbors.
    fn add_section(
        &mut self,
        road: &Road,
        (road_idx, section_idx): (usize, usize),
        report: &mut MapReport,
    ) -> Result<(), Malformed> {
        let Some(edges) = outline::edges(road, section_idx) else { return Ok(()) };
        let of_section = &road.sections[section_idx].lanes;
        for (lane, edges) in of_section.iter().zip(edges) {
            report.n_lanelets += 1;
            if !lane.is_drivable() {
                report.n_not_drivable += 1;
                continue;
            }
            if let Some(below) = lane.widths.iter().find(|width| width.coefficients[0] < -MAX_ROUNDING_M) {
                let detail =
                    format!("road {}, lane {}: is {} m wide, taken as 0", road.id, lane.id, below.coefficients[0]);
                report.warn("widths_below_zero", detail);
            }
            let mut outline = edges.in_direction(is_along(road, lane));
            outline.iter_mut().for_each(|line| line.0.dedup());
            let [center, left, right] = outline;
            self.n_points += 3 * center.0.len();
            if self.n_points > MAX_POINTS {
                return Err(format!("its lanes have more than {MAX_POINTS} points together").into());
            }
            let is_beyond = |point: &Vec2| !point.is_finite() || point.x.abs().max(point.y.abs()) > MAX_COORDINATE_M;
            if center.0.iter().any(is_beyond) {
                let detail = format!("road {}, lane {}: lies beyond {MAX_COORDINATE_M} m", road.id, lane.id);
                report.warn("broken_lanes", detail);
                continue;
            }
            self.index_of.insert((road_idx, section_idx, lane.id), self.lanes.len());
            let attributes = attributes(road, lane, &center.0).into();
            let id = self.lanes.len() as i64 + 1;
            self.lanes.push(Lane { attributes, ..Lane::unconnected(id, center, [left, right]) });
        }
        let at = |place: Option<usize>| {
            let lane = of_section.get(place?)?;
            self.index_of.get(&(road_idx, section_idx, lane.id)).copied()
        };
        for (place, lane) in of_section.iter().enumerate() {
            let Some(index) = at(Some(place)) else { continue };
            let beside =
                [at(place.checked_sub(1)), at(Some(place + 1))].map(|index| index.map(|index| self.lanes[index].id));
            let [left, right] = if is_along(road, lane) { beside } else { [beside[1], beside[0]] };
            (self.lanes[index].left_neighbor, self.lanes[index].right_neighbor) = (left, right);
        }
        Ok(())
    }

    /// Connects the lane that ends at one of these ends to the lane that begins at the other.
    fn join(&mut self, roads: &[Road], ends: [LaneEnd; 2], report: &mut MapReport) {
        let found = ends.map(|(key, end)| {
            let (road, section, lane) = key;
            let index = *self.index_of.get(&key)?;
            let lane = roads[road].sections.get(section)?.lanes.iter().find(|found| found.id == lane)?;
            Some((index, (end == 1) == is_along(&roads[road], lane)))
        });
        let [Some((one, one_ends)), Some((other, other_ends))] = found else {
            let [one, other] = ends.map(|((road, section, lane), _)| (&roads[road], section, lane));
            let is_there = |(road, section, lane): &(&Road, usize, i64)| {
                road.sections.get(*section).is_some_and(|section| section.lanes.iter().any(|found| found.id == *lane))
            };
            let missing = [(one, other), (other, one)].into_iter().find(|(lane, _)| !is_there(lane));
            if let Some(((road, _, lane), (from_road, _, from))) = missing {
                let detail = format!(
                    "lane {from} of road {} is linked to lane {lane} of road {}, which is not there",
                    from_road.id, road.id
                );
                report.warn("links_to_nowhere", detail);
            }
            return;
        };
        if one_ends == other_ends {
            let [one, other] = [one, other].map(|index| lane_name(&self.lanes[index]));
            report.warn("lane_links_against_traffic", format!("{one} and {other} meet head on"));
            return;
        }
        let (from, to) = if one_ends { (one, other) } else { (other, one) };
        let id = self.lanes[to].id;
        let meet = [self.lanes[from].centerline.0.last(), self.lanes[to].centerline.0.first()];
        if let [Some(end), Some(start)] = meet
            && end.distance(*start) > MAX_APART_M
        {
            let [one, other] = [one, other].map(|index| lane_name(&self.lanes[index]));
            let apart_m = end.distance(*start);
            report.warn("lane_links_apart", format!("{one} and {other} are linked, but {apart_m:.1} m apart"));
            return;
        }
        self.lanes[from].successors.push(id);
    }
}

/// The name of a lane in the file.
fn lane_name(lane: &Lane) -> String {
    let tag = |name: &str| lane.attributes.tags.get(name).map_or("", String::as_str);
    format!("lane {} of road {}", tag("lane"), tag("road"))
}

/// Whether traffic on a lane runs in the direction of its road.
const fn is_along(road: &Road, lane: &RoadLane) -> bool {
    (lane.id < 0) != road.is_left_hand
}

fn attributes(road: &Road, lane: &RoadLane, center: &[Vec2]) -> LaneAttributes {
    let direction = |pair: &[Vec2]| (pair[1] - pair[0]).angle();
    let ends = center.windows(2).next().zip(center.windows(2).last());
    let turned_rad = ends.map_or(0.0, |(first, last)| angle_difference(direction(last), direction(first)));
    let is_intersection = road.junction.is_some();
    let mut tags = BTreeMap::from([("road".to_owned(), road.id.clone()), ("lane".to_owned(), lane.id.to_string())]);
    tags.extend(road.speed_limit_mps.clone().map(|limit| ("speed_limit_mps".to_owned(), limit)));
    LaneAttributes {
        kind: lane.kind.clone(),
        turn: match turned_rad {
            turned_rad if !is_intersection || turned_rad.abs() < FRAC_PI_6 => TurnDirection::None,
            turned_rad if turned_rad > 0.0 => TurnDirection::Left,
            _ => TurnDirection::Right,
        },
        is_intersection,
        has_traffic_control: false,
        one_way: !lane.is_both_ways(),
        tags,
    }
}
