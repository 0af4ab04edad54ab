//! Which lanes continue in which: by the links of lanes and roads, and the connections of junctions.

use super::road::{Road, RoadLink, end_of};
use crate::ingest::error::Malformed;
use crate::ingest::xml_tree::Element;
use std::collections::BTreeMap;

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
    /// The connections of a junction.
    pub(super) fn all(junction: &Element) -> Result<Vec<Self>, Malformed> {
        let id = junction.attribute("id").unwrap_or_default();
        let connection = |element: &Element| -> Result<Option<Self>, Malformed> {
            let [incoming, connecting] = ["incomingRoad", "connectingRoad"].map(|name| element.attribute(name));
            // Direct junctions link the lanes of two roads without one between them.
            let Some((incoming, connecting)) = incoming.zip(connecting.or(element.attribute("linkedRoad"))) else {
                return Ok(None);
            };
            let lanes = element.all("laneLink").map(|link| Ok([link.id("from")?, link.id("to")?]));
            Ok(Some(Self {
                junction: id.to_owned(),
                incoming: incoming.to_owned(),
                connecting: connecting.to_owned(),
                contact: end_of(element, element.attribute("contactPoint"))?,
                lanes: lanes.collect::<Result<Vec<_>, Malformed>>()?,
            }))
        };
        junction.all("connection").filter_map(|element| connection(element).transpose()).collect()
    }
}

/// All pairs of ends of lanes that touch.
pub(super) fn touching(roads: &[Road], connections: &[Connection]) -> Vec<[LaneEnd; 2]> {
    let by_id: BTreeMap<&str, usize> = roads.iter().enumerate().map(|(idx, road)| (road.id.as_str(), idx)).collect();
    let section_at = |road: usize, end: usize| if end == 0 { 0 } else { roads[road].sections.len().saturating_sub(1) };
    let mut found = Vec::new();
    for (idx, road) in roads.iter().enumerate() {
        for (section_idx, section) in road.sections.iter().enumerate() {
            for (lane, end) in section.lanes.iter().flat_map(|lane| [0, 1].map(|end| (lane, end))) {
                let Some(linked) = lane.links[end] else { continue };
                let own = ((idx, section_idx, lane.id), end);
                let beside = if end == 0 { section_idx.checked_sub(1) } else { Some(section_idx + 1) };
                if let Some(beside) = beside.filter(|beside| *beside < road.sections.len()) {
                    found.push([own, ((idx, beside, linked), 1 - end)]);
                    continue;
                }
                let Some(RoadLink::Road(other, contact)) = &road.links[end] else { continue };
                let Some(other) = by_id.get(other.as_str()) else { continue };
                found.push([own, ((*other, section_at(*other, *contact), linked), *contact)]);
            }
        }
    }
    for connection in connections {
        let ids = [&connection.incoming, &connection.connecting].map(|id| by_id.get(id.as_str()).copied());
        let [Some(incoming), Some(connecting)] = ids else { continue };
        let at_junction = RoadLink::Junction(connection.junction.clone());
        let ends = [0, 1].into_iter().filter(|end| roads[incoming].links[*end].as_ref() == Some(&at_junction));
        for (end, [from, to]) in ends.flat_map(|end| connection.lanes.iter().map(move |lanes| (end, *lanes))) {
            let incoming = ((incoming, section_at(incoming, end), from), end);
            let connecting = ((connecting, section_at(connecting, connection.contact), to), connection.contact);
            found.push([incoming, connecting]);
        }
    }
    found
}
