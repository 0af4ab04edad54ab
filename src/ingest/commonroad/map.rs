//! The lanelets of a scenario as a lane graph.

use crate::geometry::{Polyline, Vec2};
use crate::ingest::assemble::MAX_COORDINATE_M;
use crate::ingest::error::Malformed;
use crate::ingest::lane_topology::connect;
use crate::ingest::map_report::MapReport;
use crate::ingest::plausible_lanes::{plausible, turn_around};
use crate::ingest::xml_tree::Element;
use crate::scene::{Lane, LaneAttributes, LaneGraph, LaneId, TurnDirection};
use std::collections::{BTreeMap, BTreeSet};

/// Types of lanelets that no motor vehicle drives on.
const NOT_DRIVABLE: [&str; 4] = ["sidewalk", "crosswalk", "bicycleLane", "border"];

/// Reads the lanelets, and reports the ones left out.
pub(super) fn read(root: &Element) -> (LaneGraph, MapReport) {
    let mut report = MapReport::default();
    let turns = turns(root);
    let mut lanes = Vec::new();
    for lanelet in root.all("lanelet") {
        report.n_lanelets += 1;
        if lanelet.all("laneletType").any(|kind| NOT_DRIVABLE.contains(&kind.text())) {
            report.n_not_drivable += 1;
            continue;
        }
        match lane(lanelet, &turns, &mut report) {
            Ok(lane) => lanes.push(lane),
            Err(what) => {
                let (name, line) = (lanelet.attribute("id").unwrap_or("without id"), lanelet.line);
                report.warn("broken_lanes", format!("lanelet {name} on line {line}: {what}"));
            }
        }
    }
    report_links(root, &lanes, &mut report);
    let lanes = plausible(lanes, &mut report);
    report.n_lanes = lanes.len() as u64;
    (connect(lanes), report)
}

/// Reports links to lanelets that the file lacks.
fn report_links(root: &Element, lanes: &[Lane], report: &mut MapReport) {
    let ids: BTreeSet<LaneId> = root.all("lanelet").filter_map(|lanelet| lanelet.id("id").ok().map(LaneId)).collect();
    for lane in lanes {
        let beside = [lane.left_neighbor, lane.right_neighbor];
        let links = lane.successors.iter().chain(&lane.predecessors).chain(beside.iter().flatten());
        for to in links.filter(|to| !ids.contains(to)) {
            let detail = format!("lanelet {} is linked to lanelet {}, which is not there", lane.id.0, to.0);
            report.warn("links_to_nowhere", detail);
        }
    }
}

fn lane(lanelet: &Element, turns: &BTreeMap<i64, TurnDirection>, report: &mut MapReport) -> Result<Lane, Malformed> {
    let id = lanelet.id("id")?;
    let (mut left, mut right) = (bound(lanelet, "leftBound")?, bound(lanelet, "rightBound")?);
    if turn_around(&mut left, &mut right, None) {
        report.warn("lanes_turned_around", format!("lanelet {id}: its bounds ran against one another"));
    }
    // The points of both bounds correspond, including repeated ones.
    let mut center = between(&left, &right);
    [&mut left, &mut right, &mut center].into_iter().for_each(|line| line.0.dedup());
    let links = |name| lanelet.all(name).map(|link| link.id("ref").map(LaneId)).collect::<Result<Vec<_>, _>>();
    let neighbor = |name| lanelet.find(&[name]).map(|link| link.id("ref").map(LaneId)).transpose();
    let limit = lanelet.find(&["speedLimit"]).map(|limit| ("speed_limit_mps".to_owned(), limit.text().to_owned()));
    let kind = lanelet.find(&["laneletType"]).map(Element::text).unwrap_or_default().to_owned();
    let attributes = LaneAttributes {
        kind,
        turn: turns.get(&id).copied().unwrap_or_default(),
        is_intersection: turns.contains_key(&id),
        one_way: true,
        tags: limit.into_iter().collect(),
        ..LaneAttributes::default()
    };
    Ok(Lane {
        successors: links("successor")?,
        predecessors: links("predecessor")?,
        left_neighbor: neighbor("adjacentLeft")?,
        right_neighbor: neighbor("adjacentRight")?,
        attributes: attributes.into(),
        ..Lane::unconnected(id, center, [left, right])
    })
}

fn bound(lanelet: &Element, name: &str) -> Result<Polyline, Malformed> {
    let bound = lanelet.find(&[name]).ok_or_else(|| Malformed::from(format!("has no <{name}>")))?;
    Ok(Polyline(bound.all("point").map(point).collect::<Result<Vec<_>, _>>()?))
}

/// A point within the bounds of coordinates.
pub(super) fn point(element: &Element) -> Result<Vec2, Malformed> {
    let at = Vec2::new(element.number(&["x"])?, element.number(&["y"])?);
    match at.x.abs().max(at.y.abs()) <= MAX_COORDINATE_M {
        true => Ok(at),
        false => Err(format!("lies at ({}, {}), expected at most {MAX_COORDINATE_M} m", at.x, at.y).into()),
    }
}

/// The line midway between the bounds: between their points one by one if they have equally many.
fn between(left: &Polyline, right: &Polyline) -> Polyline {
    let n = left.0.len().max(right.0.len());
    let (left, right) = if left.0.len() == right.0.len() {
        (left.clone(), right.clone())
    } else {
        (left.resampled(n), right.resampled(n))
    };
    Polyline(left.0.into_iter().zip(right.0).map(|(left, right)| left.lerp(right, 0.5)).collect())
}

/// The lanelets within intersections, with their turns.
fn turns(root: &Element) -> BTreeMap<i64, TurnDirection> {
    let kinds = [
        ("successorsRight", TurnDirection::Right),
        ("successorsStraight", TurnDirection::None),
        ("successorsLeft", TurnDirection::Left),
    ];
    let incoming = root.all("intersection").flat_map(|intersection| intersection.all("incoming"));
    let links = incoming.flat_map(|incoming| incoming.children());
    let turn = |link: &Element| {
        let (_, turn) = kinds.iter().find(|(name, _)| *name == link.name)?;
        Some((link.id("ref").ok()?, *turn))
    };
    links.filter_map(turn).collect()
}
