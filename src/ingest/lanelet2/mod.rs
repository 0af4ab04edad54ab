//! Reads Lanelet2 maps.
//!
//! Lanelet2 maps are OSM XML: nodes, ways (polylines of nodes), and relations. A relation of type `lanelet` has a left
//! and a right bound. Coordinates are meters on the plane (`.osm_xy`), meters encoded as latitude and longitude near
//! (0°, 0°) (INTERACTION's `.osm`), Autoware's `local_x` and `local_y` (if latitude and longitude are missing or zero),
//! or true WGS84 coordinates. For the last, the frame of the map is the UTM zone of the southwest corner of its lanes,
//! with the origin at that corner, and the report says so: the file does not tell. x points east and y north.

mod bound;
mod lanelet;
mod osm;
mod topology;

pub use super::map_report::MapReport;

use crate::geometry::Vec2;
use crate::ingest::error::{Error, Malformed};
use crate::ingest::map_text::read_text;
use crate::ingest::plausible_lanes::plausible;
use crate::ingest::projection::{GeoPoint, LocalUtm};
use crate::scene::{Lane, LaneGraph};
use lanelet::Lanelet;
use osm::{NodePosition, Osm, Relation};
use std::collections::{BTreeMap, BTreeSet};
use std::io::BufRead;

/// Maximum size of a map. INTERACTION's largest are below 2 MB.
const MAX_MAP_BYTES: u64 = 64 * 1024 * 1024;
/// Maximum number of points in all bounds: any number of lanelets may name one way, so the size of the file does not
/// bound the size of the lanes.
const MAX_BOUND_POINTS: usize = 2_000_000;
/// Maximum number of bytes in the tags of all lanes, for the same reason: lanelets share regulatory elements.
const MAX_TAG_BYTES: usize = 64 * 1024 * 1024;

/// Reads a Lanelet2 map: its vehicle lanes in the frame of the recordings, and a report of its defects.
///
/// Incomplete lanelets, and those that cannot be lanes, are left out and reported.
///
/// # Errors
/// [`Error::Map`], naming `file` and line, when the document is not well-formed, has a document type, exceeds a limit,
/// or when no lane remains.
pub fn read_map(reader: &mut dyn BufRead, file: &str) -> Result<(LaneGraph, MapReport), Error> {
    let error = |what: String| Error::map(file, "", what);
    let text = read_text(reader, MAX_MAP_BYTES, file)?;

    let mut of_document = MapReport::default();
    let osm = osm::parse(&text, file, &mut of_document)?;
    let corner = corner_of(&osm, relations_of_lanes(&osm));
    let (mut lanes, mut report) = lanes_within(&osm, corner, of_document.clone(), file)?;
    // One node far away, for which a lane is left out, must not move the others.
    let kept: BTreeSet<i64> = lanes.iter().map(|lane| lane.id.0).collect();
    let of_kept = corner_of(&osm, relations_of_lanes(&osm).filter(|(id, _)| kept.contains(id)));
    if of_kept != corner && !kept.is_empty() {
        (lanes, report) = lanes_within(&osm, of_kept, of_document, file)?;
    }
    if lanes.is_empty() {
        let detail = format!(
            "has no vehicle lane: {} lanelets, {} of them not for vehicles; {}",
            report.n_lanelets,
            report.n_not_drivable,
            report.summary()
        );
        return Err(error(detail));
    }
    report.n_lanes = lanes.len() as u64;
    Ok((LaneGraph::new(lanes), report))
}

/// The lanes of a map in the frame with its origin at `corner`; lanes left out of them are added to the report so far.
fn lanes_within(
    osm: &Osm,
    corner: Option<GeoPoint>,
    mut report: MapReport,
    file: &str,
) -> Result<(Vec<Lane>, MapReport), Error> {
    let error = |what: Malformed| Error::map(file, "", what);
    let lanelets = lanelets(osm, corner, &mut report).map_err(error)?;
    let lanes = topology::connect(lanelets)
        .map_err(|n| error(format!("has {n} lane connections; its lanelets share too many end nodes").into()))?;
    let lanes = plausible(lanes, &mut report);
    Ok((lanes, report))
}

fn lanelets(osm: &Osm, corner: Option<GeoPoint>, report: &mut MapReport) -> Result<Vec<Lanelet>, Malformed> {
    let positions = positions(osm, corner, report);
    let mut lanelets = Vec::new();
    let (mut n_points, mut n_tag_bytes) = (0, 0);
    for (id, relation) in relations_of_lanelets(osm) {
        report.n_lanelets += 1;
        if !lanelet::is_drivable(relation) {
            report.n_not_drivable += 1;
            continue;
        }
        n_points += relation.members.iter().filter_map(|member| osm.ways.get(&member.id)).map(Vec::len).sum::<usize>();
        if n_points > MAX_BOUND_POINTS {
            return Err(format!("its lanelets have more than {MAX_BOUND_POINTS} points together").into());
        }
        match Lanelet::of(relation, *id, osm, &positions, report) {
            Ok(lanelet) => {
                n_tag_bytes += lanelet.attributes.tags.values().map(String::len).sum::<usize>();
                lanelets.push(lanelet);
            }
            Err((reason, detail)) => report.warn(reason, format!("lanelet {id}: {detail}")),
        }
        if n_tag_bytes > MAX_TAG_BYTES {
            return Err(format!("its lanelets have more than {} MiB of tags together", MAX_TAG_BYTES >> 20).into());
        }
    }
    Ok(lanelets)
}

fn relations_of_lanelets(osm: &Osm) -> impl Iterator<Item = (&i64, &Relation)> {
    osm.relations.iter().filter(|(_, relation)| relation.tags.get("type").is_some_and(|kind| kind == "lanelet"))
}

/// The positions of the nodes in the frame of the map, meters.
fn positions(osm: &Osm, corner: Option<GeoPoint>, report: &mut MapReport) -> BTreeMap<i64, Vec2> {
    if osm.is_local {
        return osm.local.clone();
    }
    let corner = corner.unwrap_or(GeoPoint::NOWHERE);
    let (projection, is_assumed) = LocalUtm::for_map(corner);
    if is_assumed {
        let GeoPoint { latitude_deg, longitude_deg } = corner;
        let detail = format!(
            "latitude {latitude_deg} and longitude {longitude_deg}, the southwest corner of its lanes, are taken for \
             (0, 0); tracks must be given from there"
        );
        report.warn("maps_of_assumed_origin", detail);
    }
    osm.nodes
        .iter()
        .map(|(id, position)| match position {
            NodePosition::Plane(point) => (*id, *point),
            NodePosition::Geo(geo) => (*id, projection.project(*geo)),
        })
        .collect()
}

fn relations_of_lanes(osm: &Osm) -> impl Iterator<Item = (&i64, &Relation)> {
    relations_of_lanelets(osm).filter(|(_, relation)| lanelet::is_drivable(relation))
}

/// The southwest corner of the nodes that bound these lanes. It depends neither on the order of a document nor on
/// elements other than lanes: editors change both.
fn corner_of<'a>(osm: &Osm, lanes: impl Iterator<Item = (&'a i64, &'a Relation)>) -> Option<GeoPoint> {
    let members = lanes.flat_map(|(_, relation)| &relation.members);
    let bounds = members.filter(|member| member.kind == "way" && matches!(member.role.as_str(), "left" | "right"));
    // Many lanelets may name one way.
    let ways: BTreeSet<i64> = bounds.map(|member| member.id).collect();
    let nodes = ways.iter().filter_map(|id| osm.ways.get(id)).flatten().filter_map(|id| osm.nodes.get(id));
    GeoPoint::southwest_of(nodes.filter_map(|position| match position {
        NodePosition::Geo(geo) if *geo != GeoPoint::NOWHERE => Some(*geo),
        _ => None,
    }))
}

#[cfg(test)]
mod tests;
