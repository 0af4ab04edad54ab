//! Reads maps in OpenDRIVE 1.4 to 1.8: roads with reference lines, lane sections and lanes.
//!
//! Lanes on which motor vehicles drive become lanes, one for each section. They are numbered in the order of the file,
//! and have the road and the lane in their tags. Elevation, superelevation, shapes of the surface and objects are not
//! read. Coordinates are those of the file; an offset in its header is not applied.

mod cubic;
mod lanes;
mod links;
mod outline;
mod place;
mod plan_view;
mod road;
mod section;
#[cfg(test)]
mod tests;

use super::error::{Error, Malformed};
use super::lane_topology::connect;
use super::map_report::MapReport;
use super::map_text::read_text;
use super::plausible_lanes::plausible;
use super::xml_tree::Element;
use crate::scene::LaneGraph;
use lanes::lanes;
use links::Connection;
use road::{Faults, Road, RoadLink};
use std::collections::BTreeSet;
use std::io::BufRead;

/// Maximum size of a map; towns have some megabytes.
const MAX_MAP_BYTES: u64 = 256 << 20;
/// Distances closer than this are the same, meters: there is no room for a lane between them.
const SAME_M: f64 = 1e-6;
/// Widths below zero by less than this are rounding errors, meters.
const MAX_ROUNDING_M: f64 = 0.01;
/// Longest road, meters: the size of a file does not bound it.
const MAX_ROAD_M: f64 = 1e5;

/// Reads a map: its vehicle lanes, and a report of its defects. Roads that cannot be read are left out and reported.
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
        match road(element, &mut report) {
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
        let (name, line) = (junction.attribute("id").unwrap_or("without id"), junction.line);
        let of = format!("junction {name} on line {line}");
        connections.extend(Connection::all(junction, &mut Faults { report: &mut report, of }));
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
                RoadLink::Broken => continue,
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

/// The road of an element, if it has a length that can be.
fn road(element: &Element, report: &mut MapReport) -> Result<Road, Malformed> {
    let road = Road::of(element, report)?;
    match (0.0..=MAX_ROAD_M).contains(&road.length_m) {
        true => Ok(road),
        false => Err(format!("is {} m long, expected more than 0, at most {MAX_ROAD_M}", road.length_m).into()),
    }
}
