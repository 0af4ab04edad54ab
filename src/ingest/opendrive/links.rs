//! Which ends of lanes touch: by the links of lanes and roads, and the connections of junctions.

use super::road::{Faults, Road, RoadLink, end_of};
use crate::ingest::xml_tree::Element;
use std::collections::{BTreeMap, BTreeSet};

/// A lane of a section of a road.
pub(super) type LaneKey = (usize, usize, i64);

/// An end of a lane in the direction of its road: the start (0) or the end (1).
pub(super) type LaneEnd = (LaneKey, usize);

/// Lanes of a road that continue in those of a road of a junction.
#[derive(Debug)]
pub(super) struct Connection {
    pub(super) junction: String,
    pub(super) incoming: String,
    pub(super) connecting: String,
    /// The end of the connecting road that touches the incoming one.
    contact: usize,
    /// The lanes of both, one by one.
    lanes: Vec<[i64; 2]>,
}

impl Connection {
    pub(super) fn all(junction: &Element, faults: &mut Faults<'_>) -> Vec<Self> {
        let id = junction.attribute("id").unwrap_or_default();
        let mut connection = |element: &Element| -> Option<Self> {
            let [incoming, connecting] = ["incomingRoad", "connectingRoad"].map(|name| element.attribute(name));
            // Direct junctions link the lanes of two roads without one between them.
            let (incoming, connecting) = incoming.zip(connecting.or(element.attribute("linkedRoad")))?;
            let contact = end_of(element, element.attribute("contactPoint"));
            let lane_link = |link: &Element| Ok([link.id("from")?, link.id("to")?]);
            Some(Self {
                junction: id.to_owned(),
                incoming: incoming.to_owned(),
                connecting: connecting.to_owned(),
                contact: faults.sound("broken_junctions", contact).unwrap_or_default(),
                lanes: (element.all("laneLink"))
                    .filter_map(|link| faults.sound("broken_junctions", lane_link(link)))
                    .collect(),
            })
        };
        junction.all("connection").filter_map(&mut connection).collect()
    }
}

/// The ends of lanes that touch by what a map says.
#[derive(Debug, Default)]
pub(super) struct Touching {
    pub(super) pairs: BTreeSet<[LaneEnd; 2]>,
    /// Ends with a link that cannot be followed.
    pub(super) loose: BTreeSet<LaneEnd>,
    /// Ends of an incoming and a connecting road, by index, some lanes of which touch, and the connection.
    pub(super) unnamed: Vec<([(usize, usize); 2], usize)>,
}

impl Touching {
    pub(super) fn of(roads: &[Road], connections: &[Connection]) -> Self {
        let by_id: BTreeMap<&str, usize> =
            roads.iter().enumerate().map(|(idx, road)| (road.id.as_str(), idx)).collect();
        let mut found = Self::default();
        for (idx, road) in roads.iter().enumerate() {
            for (section_idx, section) in road.sections.iter().enumerate() {
                let ends = section.lanes.iter().flat_map(|lane| [0, 1].map(|end| (lane, end)));
                for (lane, end) in ends.filter(|(lane, end)| !lane.links[*end].is_empty()) {
                    let own = ((idx, section_idx, lane.id), end);
                    let beside = road.beside(section_idx, end);
                    let other = match (&road.links[end], beside) {
                        (_, Some(beside)) => Some((idx, beside, 1 - end)),
                        (Some(RoadLink::Road(other, contact)), None) => by_id
                            .get(other.as_str())
                            .map(|other| (*other, roads[*other].section_at(*contact, lane.links[end][0]), *contact)),
                        (Some(RoadLink::Broken), None) => None,
                        (Some(RoadLink::Junction(_)) | None, None) => continue,
                    };
                    let Some((road, section, contact)) = other else {
                        found.loose.insert(own);
                        continue;
                    };
                    lane.links[end].iter().for_each(|linked| found.add(own, ((road, section, *linked), contact)));
                }
            }
        }
        for (connection_idx, connection) in connections.iter().enumerate() {
            let ids = [&connection.incoming, &connection.connecting].map(|id| by_id.get(id.as_str()).copied());
            let [Some(incoming), Some(connecting)] = ids else { continue };
            let at_junction = RoadLink::Junction(connection.junction.clone());
            let mut ends: Vec<usize> =
                [0, 1].into_iter().filter(|end| roads[incoming].links[*end].as_ref() == Some(&at_junction)).collect();
            let (is_named, is_there, contact) = (!connection.lanes.is_empty(), !ends.is_empty(), connection.contact);
            if is_there {
                // Of a loop, one end is meant.
                let apart_m =
                    |end: &usize| roads[incoming].point_at(*end).distance(roads[connecting].point_at(contact));
                ends.sort_by(|a, b| apart_m(a).total_cmp(&apart_m(b)));
                ends.truncate(1);
            } else {
                ends = vec![0, 1];
            }
            for end in ends {
                if !(is_named && is_there) {
                    found.unnamed.push(([(incoming, end), (connecting, contact)], connection_idx));
                    continue;
                }
                for [from, to] in connection.lanes.iter().copied() {
                    let incoming = ((incoming, roads[incoming].section_at(end, from), from), end);
                    found.add(incoming, ((connecting, roads[connecting].section_at(contact, to), to), contact));
                }
            }
        }
        found
    }

    fn add(&mut self, one: LaneEnd, other: LaneEnd) {
        self.pairs.insert(if one <= other { [one, other] } else { [other, one] });
    }

    /// Lets lanes that are too short to be lanes hand on what touches them: an end that touches such a lane touches
    /// what lies beyond it.
    pub(super) fn pass_on(&mut self, is_short: impl Fn(&LaneKey) -> bool) {
        let touches_short = |pair: &[LaneEnd; 2]| pair.iter().any(|(key, _)| is_short(key));
        let pairs: Vec<[LaneEnd; 2]> = self.pairs.iter().copied().filter(touches_short).collect();
        let mut beyond: BTreeMap<LaneEnd, Vec<LaneEnd>> = BTreeMap::new();
        for [one, other] in &pairs {
            self.pairs.remove(&[*one, *other]);
            beyond.entry(*one).or_default().push(*other);
            beyond.entry(*other).or_default().push(*one);
        }
        for own in beyond.keys().filter(|(key, _)| !is_short(key)) {
            let (mut open, mut seen, mut is_found) = (beyond[own].clone(), BTreeSet::new(), false);
            while let Some((key, end)) = open.pop() {
                if !is_short(&key) {
                    is_found = true;
                    self.add(*own, (key, end));
                } else if seen.insert((key, end)) {
                    open.extend(beyond.get(&(key, 1 - end)).into_iter().flatten());
                }
            }
            if !is_found {
                self.loose.insert(*own);
            }
        }
    }
}
