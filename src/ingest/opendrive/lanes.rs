//! The lanes of roads, and what they continue in.

use super::links::{Connection, LaneEnd, LaneKey, Touching};
use super::outline;
use super::place::{EndsByPlace, TrafficEnd, pose_of};
use super::road::Road;
use super::section::RoadLane;
use super::{MAX_ROUNDING_M, outline::Edges};
use crate::geometry::{Vec2, angle_difference};
use crate::ingest::error::Malformed;
use crate::ingest::map_report::MapReport;
use crate::ingest::vicinity::Vicinity;
use crate::scene::{Lane, LaneAttributes, TurnDirection};
use crate::settings::in_words;
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::FRAC_PI_6;

/// Maximum number of points in the edges of all lanes.
const MAX_POINTS: usize = 10_000_000;
/// Lanes that are not longer than this are none, meters; what they connect is connected without them.
const MAX_SHORT_M: f64 = 0.01;
/// Linked lanes begin within this distance of the other's end, meters.
const MAX_APART_M: f64 = 10.0;
/// Lanes that begin farther from the end of the one before than this, meters, do not end closer to it.
const NEAR_M: f64 = 1.0;

/// The lanes of all roads, with their connections.
pub(super) fn lanes(
    roads: &[Road],
    connections: &[Connection],
    report: &mut MapReport,
) -> Result<Vec<Lane>, Malformed> {
    let vicinity = Vicinity::of(|| roads.iter().filter_map(|road| road.plan_view.first()).map(|piece| piece.origin));
    let (lanes, index_of, short) = (Vec::new(), BTreeMap::new(), BTreeSet::new());
    let mut map = Lanes { roads, vicinity, lanes, index_of, short, n_points: 0 };
    for (road_idx, road) in roads.iter().enumerate() {
        for section_idx in 0..road.sections.len() {
            map.add_section((road_idx, section_idx), report)?;
        }
    }
    map.connect(connections, report);
    Ok(map.lanes)
}

/// The lanes found so far.
struct Lanes<'r> {
    roads: &'r [Road],
    vicinity: Vicinity,
    lanes: Vec<Lane>,
    index_of: BTreeMap<LaneKey, usize>,
    /// Those too short to be lanes.
    short: BTreeSet<LaneKey>,
    n_points: usize,
}

impl Lanes<'_> {
    /// Adds the lanes of a section, and makes adjacent ones neighbors.
    fn add_section(
        &mut self,
        (road_idx, section_idx): (usize, usize),
        report: &mut MapReport,
    ) -> Result<(), Malformed> {
        let road = &self.roads[road_idx];
        let section = &road.sections[section_idx];
        let of_section = &section.lanes;
        let key = |lane: &RoadLane| (road_idx, section_idx, lane.id);
        let mut edges = outline::edges(road, section).unwrap_or_default().into_iter();
        for lane in of_section {
            let edges = edges.next();
            report.n_lanelets += 1;
            let is_drivable = lane.is_drivable();
            report.n_not_drivable += u64::from(!is_drivable);
            let mut warn = |what: &'static str, detail: &str| {
                let start_m = section.start_m;
                if is_drivable {
                    report.warn(what, format!("road {}, lane {} from {start_m} m on: {detail}", road.id, lane.id));
                }
            };
            let length_m = edges.as_ref().map_or(0.0, |edges| edges.middle().length_m());
            if length_m <= MAX_SHORT_M {
                let detail = format!("is {} m long; the lanes before and behind it are connected", in_words(length_m));
                warn("lanes_without_length", &detail);
                self.short.insert(key(lane));
                continue;
            }
            let Some(edges) = edges.filter(|_| is_drivable) else { continue };
            if let Some(below) = lane.widths.iter().find(|width| width.coefficients[0] < -MAX_ROUNDING_M) {
                warn("widths_below_zero", &format!("is {} m wide, taken as 0", below.coefficients[0]));
            }
            let mut points = edges.left.0.iter().chain(&edges.right.0);
            if let Some(fault) = points.find_map(|point| self.vicinity.checked(*point).err()) {
                warn("broken_lanes", &fault.to_string());
                continue;
            }
            let Some(edges) = edges.open() else {
                warn("lanes_without_width", "is 0 m wide");
                continue;
            };
            self.add_lane(key(lane), lane, edges)?;
        }
        let at = |place: Option<usize>| {
            let lane = of_section.get(place?)?;
            self.index_of.get(&key(lane)).copied()
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

    fn add_lane(&mut self, key: LaneKey, lane: &RoadLane, edges: Edges) -> Result<(), Malformed> {
        let road = &self.roads[key.0];
        let mut outline = edges.in_direction(is_along(road, lane));
        outline.iter_mut().for_each(|line| line.0.dedup());
        let [center, left, right] = outline;
        self.n_points += 3 * center.0.len();
        if self.n_points > MAX_POINTS {
            return Err(format!("its lanes have more than {MAX_POINTS} points together").into());
        }
        self.index_of.insert(key, self.lanes.len());
        let attributes = attributes(road, lane, &center.0).into();
        let id = self.lanes.len() as i64 + 1;
        self.lanes.push(Lane { attributes, ..Lane::unconnected(id, center, [left, right]) });
        Ok(())
    }

    /// Connects lanes as the map says. Where that contradicts their places, lanes continue in those that begin where
    /// they end.
    fn connect(&mut self, connections: &[Connection], report: &mut MapReport) {
        let mut touching = Touching::of(self.roads, connections);
        touching.pass_on(|key| self.short.contains(key));
        let mut open = Vec::new();
        for ends in &touching.pairs {
            if let Err(contradiction) = self.join(*ends) {
                open.push((ends.to_vec(), Some(contradiction)));
            }
        }
        open.extend(touching.loose.into_iter().map(|end| (vec![end], None)));
        if open.is_empty() && touching.unnamed.is_empty() {
            return;
        }
        let by_place = EndsByPlace::of(&self.lanes);
        for (ends, contradiction) in open {
            let ends: Vec<TrafficEnd> = ends.into_iter().filter_map(|end| self.traffic_end(end)).collect();
            let found: Vec<[usize; 2]> =
                ends.into_iter().flat_map(|end| self.add_beyond(end, &by_place, |_| true)).collect();
            match (found.first(), contradiction) {
                (None, Some((what, detail))) => report.warn(what, detail),
                (None, None) => {}
                (Some([from, to]), contradiction) => {
                    let [from, to] = [from, to].map(|lane| lane_name(&self.lanes[*lane]));
                    let why = contradiction.map_or_else(|| "its link cannot be followed".to_owned(), |(_, why)| why);
                    report.warn("lane_links_by_place", format!("{why}; {from} continues in {to}, which begins there"));
                }
            }
        }
        for (ends, connection) in touching.unnamed {
            self.connect_by_place(ends, &connections[connection], &by_place, report);
        }
    }

    /// Connects the lanes of two roads of a connection that does not name them.
    fn connect_by_place(
        &mut self,
        [(incoming, end), (connecting, contact)]: [(usize, usize); 2],
        connection: &Connection,
        by_place: &EndsByPlace,
        report: &mut MapReport,
    ) {
        let road = &self.roads[incoming];
        let lanes =
            road.sections.iter().flat_map(|section| &section.lanes).map(|lane| lane.id).collect::<BTreeSet<_>>();
        let ends = lanes.into_iter().map(|lane| ((incoming, road.section_at(end, lane), lane), end));
        let ends: Vec<TrafficEnd> = ends.filter_map(|end| self.traffic_end(end)).collect();
        let other = &self.roads[connecting];
        let others = self
            .index_of
            .iter()
            .filter(|((road, section, lane), _)| *road == connecting && *section == other.section_at(contact, *lane));
        let others: BTreeSet<usize> = others.map(|(_, lane)| *lane).collect();
        let found: Vec<[usize; 2]> =
            ends.into_iter().flat_map(|end| self.add_beyond(end, by_place, |lane| others.contains(&lane))).collect();
        if let Some([from, to]) = found.first() {
            let [from, to] = [from, to].map(|lane| lane_name(&self.lanes[*lane]));
            let Connection { junction, incoming, connecting, .. } = connection;
            let detail = format!(
                "junction {junction} connects roads {incoming} and {connecting} without naming lanes at an end; {from} \
                 continues in {to}, which begins there"
            );
            report.warn("connections_by_place", detail);
        }
    }

    /// Connects a lane at an end to lanes that lie beyond it, and returns the new connections.
    fn add_beyond(
        &mut self,
        end: TrafficEnd,
        by_place: &EndsByPlace,
        is_wanted: impl Fn(usize) -> bool,
    ) -> Vec<[usize; 2]> {
        let (lane, leaves) = end;
        let beyond = by_place.beyond(&self.lanes, end).into_iter().filter(|other| is_wanted(*other));
        let pairs = beyond.map(|other| if leaves { [lane, other] } else { [other, lane] });
        pairs.filter(|[from, to]| self.add_link(*from, *to)).collect()
    }

    /// Adds a link unless it is there.
    fn add_link(&mut self, from: usize, to: usize) -> bool {
        let id = self.lanes[to].id;
        let is_new = !self.lanes[from].successors.contains(&id);
        if is_new {
            self.lanes[from].successors.push(id);
        }
        is_new
    }

    fn road_lane(&self, (road, section, lane): LaneKey) -> Option<&RoadLane> {
        self.roads[road].sections.get(section)?.lanes.iter().find(|found| found.id == lane)
    }

    /// An end of a lane in the direction of traffic, if it is a lane.
    fn traffic_end(&self, (key, end): LaneEnd) -> Option<TrafficEnd> {
        let index = *self.index_of.get(&key)?;
        Some((index, (end == 1) == is_along(&self.roads[key.0], self.road_lane(key)?)))
    }

    /// Connects the lane that ends at one of these ends to the lane that begins at the other.
    ///
    /// # Errors
    /// When that contradicts where they lie, or one of them is not in the file.
    fn join(&mut self, ends: [LaneEnd; 2]) -> Result<(), (&'static str, String)> {
        let [Some((one, one_leaves)), Some((other, other_leaves))] = ends.map(|end| self.traffic_end(end)) else {
            let keys = ends.map(|(key, _)| key);
            let Some(missing) = keys.iter().position(|key| self.road_lane(*key).is_none()) else { return Ok(()) };
            let [(road, _, lane), (from_road, _, from)] = [keys[missing], keys[1 - missing]];
            let [road, from_road] = [road, from_road].map(|road| &self.roads[road].id);
            let detail =
                format!("lane {from} of road {from_road} is linked to lane {lane} of road {road}, which is not there");
            return Err(("links_to_nowhere", detail));
        };
        let names = || [one, other].map(|index| lane_name(&self.lanes[index]));
        if one_leaves == other_leaves {
            // Lanes for both ways have one direction here, in which they may not continue one another.
            if [one, other].iter().any(|lane| !self.lanes[*lane].attributes.one_way) {
                return Ok(());
            }
            let [one, other] = names();
            return Err(("lane_links_against_traffic", format!("{one} and {other} meet head on")));
        }
        let (from, to) = if one_leaves { (one, other) } else { (other, one) };
        let pose = |lane: usize, leaves: bool| pose_of(&self.lanes[lane], leaves).map(|(at, _)| at);
        if let (Some(end), Some(start), Some(far)) = (pose(from, true), pose(to, false), pose(to, true)) {
            let apart_m = end.distance(start);
            if apart_m > MAX_APART_M || apart_m > NEAR_M && end.distance(far) < apart_m {
                let [one, other] = names();
                return Err(("lane_links_apart", format!("{one} and {other} are linked, but {apart_m:.1} m apart")));
            }
        }
        self.add_link(from, to);
        Ok(())
    }
}

fn lane_name(lane: &Lane) -> String {
    let tag = |name: &str| lane.attributes.tags.get(name).map_or("", String::as_str);
    format!("lane {} of road {}", tag("lane"), tag("road"))
}

/// Whether traffic on a lane runs in the direction of its road.
const fn is_along(road: &Road, lane: &RoadLane) -> bool {
    ((lane.id < 0) != road.is_left_hand) != lane.is_reversed
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
        one_way: !lane.is_both_ways,
        tags,
    }
}
