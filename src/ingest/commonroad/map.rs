//! The lanelets of a scenario as a lane graph.

use crate::geometry::{Polyline, Vec2};
use crate::ingest::error::Malformed;
use crate::ingest::lane_topology::connect;
use crate::ingest::map_report::MapReport;
use crate::ingest::plausible_lanes::{plausible, turn_around};
use crate::ingest::vicinity::Vicinity;
use crate::ingest::xml_tree::Element;
use crate::scene::{Lane, LaneAttributes, LaneGraph, LaneId, TurnDirection};
use std::collections::{BTreeMap, BTreeSet};

/// Types of lanelets that no motor vehicle drives on.
const NOT_DRIVABLE: [&str; 4] = ["sidewalk", "crosswalk", "bicycleLane", "border"];

/// Kinds of users that motor vehicles are among.
const VEHICLES: [&str; 7] = ["vehicle", "car", "truck", "bus", "priorityVehicle", "motorcycle", "taxi"];

/// Reads the lanelets, and reports the ones left out.
pub(super) fn read(root: &Element, vicinity: Vicinity) -> (LaneGraph, MapReport) {
    let mut report = MapReport::default();
    let turns = turns(root);
    let mut lanes = Vec::new();
    for lanelet in root.all("lanelet") {
        report.n_lanelets += 1;
        if lanelet.all("laneletType").any(|kind| NOT_DRIVABLE.contains(&kind.text())) {
            report.n_not_drivable += 1;
            continue;
        }
        match lane(lanelet, &turns, vicinity, &mut report) {
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

fn lane(
    lanelet: &Element,
    turns: &BTreeMap<i64, TurnDirection>,
    vicinity: Vicinity,
    report: &mut MapReport,
) -> Result<Lane, Malformed> {
    let id = lanelet.id("id")?;
    let [mut left, mut right] = [bound(lanelet, "leftBound", vicinity)?, bound(lanelet, "rightBound", vicinity)?];
    if turn_around(&mut left, &mut right, None) {
        report.warn("lanes_turned_around", format!("lanelet {id}: its bounds ran against one another"));
    }
    // The points of both bounds correspond, including repeated ones.
    let mut center = between(&left, &right);
    [&mut left, &mut right, &mut center].into_iter().for_each(|line| line.0.dedup());
    let mut links = |name| -> Vec<LaneId> {
        let link = |link: &Element| {
            let to = link.id("ref").map(LaneId);
            to.map_err(|fault| report.warn("broken_links", format!("lanelet {id}: {fault}"))).ok()
        };
        lanelet.all(name).filter_map(link).collect()
    };
    let [successors, predecessors] = [links("successor"), links("predecessor")];
    let [left_neighbor, right_neighbor] =
        [links("adjacentLeft"), links("adjacentRight")].map(|beside| beside.first().copied());
    let is_both_ways = lanelet.all("userBidirectional").any(|user| VEHICLES.contains(&user.text()));
    let limit = lanelet.find(&["speedLimit"]).map(|limit| ("speed_limit_mps".to_owned(), limit.text().to_owned()));
    let kind = lanelet.find(&["laneletType"]).map(Element::text).unwrap_or_default().to_owned();
    let attributes = LaneAttributes {
        kind,
        turn: turns.get(&id).copied().unwrap_or_default(),
        is_intersection: turns.contains_key(&id),
        one_way: !is_both_ways,
        tags: limit.into_iter().collect(),
        ..LaneAttributes::default()
    };
    Ok(Lane {
        successors,
        predecessors,
        left_neighbor,
        right_neighbor,
        attributes: attributes.into(),
        ..Lane::unconnected(id, center, [left, right])
    })
}

fn bound(lanelet: &Element, name: &str, vicinity: Vicinity) -> Result<Polyline, Malformed> {
    let bound = lanelet.find(&[name]).ok_or_else(|| Malformed::from(format!("has no <{name}>")))?;
    Ok(Polyline(bound.all("point").map(|at| vicinity.checked(point(at)?)).collect::<Result<Vec<_>, _>>()?))
}

pub(super) fn point(element: &Element) -> Result<Vec2, Malformed> {
    Ok(Vec2::new(element.number(&["x"])?, element.number(&["y"])?))
}

/// The vicinity of the lanelets and obstacles.
pub(super) fn vicinity_of(root: &Element) -> Vicinity {
    let places = [["leftBound", "point"].as_slice(), &["initialState", "position", "point"]];
    let found = |element| places.iter().find_map(|place| Element::find(element, place));
    Vicinity::of(|| root.children().filter_map(found).filter_map(|at| point(at).ok()))
}

/// The most points of a line between bounds with different numbers of points.
const MAX_RESAMPLED: usize = 2000;

/// The line midway between the bounds: between their points one by one if they have equally many.
fn between(left: &Polyline, right: &Polyline) -> Polyline {
    let n = left.0.len().max(right.0.len()).min(MAX_RESAMPLED);
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
