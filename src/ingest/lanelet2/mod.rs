//! Reads Lanelet2 maps.
//!
//! Lanelet2 maps are OSM XML: nodes, ways (polylines of nodes), and relations. A relation of type `lanelet` has a left
//! and a right bound. Coordinates are meters on the plane (`.osm_xy`), meters encoded as latitude and longitude near
//! (0°, 0°) (INTERACTION's `.osm`), Autoware's `local_x` and `local_y` (if latitude and longitude are missing or zero),
//! or true WGS84 coordinates. For the last, the frame of the map is the UTM zone of its first node, with the origin at
//! that node. x points east and y north.

mod bound;
mod lanelet;
mod osm;
mod projection;
mod topology;

pub use super::map_report::MapReport;

use crate::geometry::Vec2;
use crate::ingest::error::{Error, Malformed};
use crate::ingest::plausible_lanes::plausible;
use crate::scene::LaneGraph;
use lanelet::Lanelet;
use osm::{NodePosition, Osm};
use projection::LocalUtm;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{BufRead, Read};

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
/// [`Error::Map`], naming `file` and line, when the document is not well-formed, has a document type, is beyond all
/// bounds, or when no lane remains.
pub fn read_map(reader: &mut dyn BufRead, file: &str) -> Result<(LaneGraph, MapReport), Error> {
    let error = |what: String| Error::map(file, "", what);
    let mut bytes = Vec::new();
    reader
        .take(MAX_MAP_BYTES + 1)
        .read_to_end(&mut bytes)
        .map_err(|source| error(format!("cannot be read: {source}")))?;
    if bytes.len() as u64 > MAX_MAP_BYTES {
        return Err(error(format!("is larger than {} MiB", MAX_MAP_BYTES >> 20)));
    }
    let text = decoded(&bytes).map_err(|at| {
        Error::map(file, format!("byte {at}"), "is not UTF-8 text, and does not declare to be ISO-8859-1")
    })?;

    let mut report = MapReport::default();
    let osm = osm::parse(&text, file, &mut report)?;
    let lanelets = lanelets(&osm, &mut report).map_err(|what| Error::map(file, "", what))?;
    let lanes = topology::connect(lanelets)
        .map_err(|n| error(format!("has {n} lane connections; its lanelets share too many end nodes")))?;
    let lanes = plausible(lanes, &mut report);
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

/// The text of a document in UTF-8, in UTF-16 with a byte order mark, or in ISO-8859-1 if it says so; or the first byte
/// that is none.
fn decoded(bytes: &[u8]) -> Result<Cow<'_, str>, usize> {
    let utf8 = match std::str::from_utf8(bytes) {
        Ok(text) => return Ok(text.into()),
        Err(utf8) => utf8,
    };
    let units = |bytes: &[u8], unit: fn([u8; 2]) -> u16| -> Vec<u16> {
        bytes.chunks_exact(2).map(|pair| unit([pair[0], pair[1]])).collect()
    };
    match bytes {
        [0xff, 0xfe, rest @ ..] => Ok(String::from_utf16_lossy(&units(rest, u16::from_le_bytes)).into()),
        [0xfe, 0xff, rest @ ..] => Ok(String::from_utf16_lossy(&units(rest, u16::from_be_bytes)).into()),
        _ => {
            let declaration = bytes.split(|byte| *byte == b'>').next().unwrap_or_default().to_ascii_lowercase();
            let declaration = String::from_utf8_lossy(&declaration);
            let is_declared = ["iso-8859-1", "latin1", "windows-1252"].iter().any(|name| declaration.contains(name));
            let text = || bytes.iter().copied().map(char::from).collect::<String>().into();
            if is_declared { Ok(text()) } else { Err(utf8.valid_up_to()) }
        }
    }
}

fn lanelets(osm: &Osm, report: &mut MapReport) -> Result<Vec<Lanelet>, Malformed> {
    let positions = positions(osm);
    let mut lanelets = Vec::new();
    let (mut n_points, mut n_tag_bytes) = (0, 0);
    for (id, relation) in &osm.relations {
        if relation.tags.get("type").is_none_or(|kind| kind != "lanelet") {
            continue;
        }
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

/// Where the nodes lie in the frame of the map, meters.
fn positions(osm: &Osm) -> BTreeMap<i64, Vec2> {
    if osm.is_local {
        return osm.local.clone();
    }
    let projection = osm.first_geo.map(LocalUtm::for_map);
    osm.nodes
        .iter()
        .filter_map(|(id, position)| match position {
            NodePosition::Plane(point) => Some((*id, *point)),
            NodePosition::Geo(geo) => projection.map(|projection| (*id, projection.project(*geo))),
        })
        .collect()
}

#[cfg(test)]
mod tests;
