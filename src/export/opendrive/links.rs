//! Links and junctions of roads and of their lanes.
//!
//! A road can name one successor. For forks and merges, the standard has junctions; those of the type `direct` connect
//! roads that meet in one place, without further roads between them.

use crate::export::xml::{Element, element};
use crate::scene::{Lane, LaneId};
use std::collections::BTreeMap;

/// A lane of a road, by the numbers of both.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Spot {
    pub(super) road: usize,
    pub(super) lane: i32,
}

/// A meeting place of roads: those that end there, and those that begin there, by their numbers.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
struct Node {
    ending: Vec<usize>,
    beginning: Vec<usize>,
}

impl Node {
    fn is_plain(&self) -> bool {
        self.ending.len() == 1 && self.beginning.len() == 1
    }
}

/// The meeting places of roads; a road has one at its start and at its end if it continues there.
pub(super) struct Links {
    nodes: Vec<Node>,
    at_end: BTreeMap<usize, usize>,
    at_start: BTreeMap<usize, usize>,
    /// The connections of lanes.
    pairs: Vec<(Spot, Spot)>,
}

impl Links {
    /// The links of lanes that are at these spots.
    pub(super) fn of<'l>(lanes: impl Iterator<Item = &'l Lane>, spots: &BTreeMap<LaneId, Spot>) -> Self {
        let pairs = lanes.flat_map(|lane| {
            let from = spots.get(&lane.id);
            lane.successors.iter().filter_map(move |to| Some((*from?, *spots.get(to)?)))
        });
        let mut links =
            Self { nodes: Vec::new(), at_end: BTreeMap::new(), at_start: BTreeMap::new(), pairs: pairs.collect() };
        for (from, to) in links.pairs.clone() {
            let (from, to) = (from.road, to.road);
            let node = match (links.at_end.get(&from).copied(), links.at_start.get(&to).copied()) {
                (Some(of_end), Some(of_start)) if of_end != of_start => links.merge(of_end, of_start),
                (Some(node), _) | (None, Some(node)) => node,
                (None, None) => {
                    links.nodes.push(Node::default());
                    links.nodes.len() - 1
                }
            };
            if links.at_end.insert(from, node).is_none() {
                links.nodes[node].ending.push(from);
            }
            if links.at_start.insert(to, node).is_none() {
                links.nodes[node].beginning.push(to);
            }
        }
        links
    }

    /// Moves all roads of `gone` to `stays`, which is returned; `gone` stays empty.
    fn merge(&mut self, stays: usize, gone: usize) -> usize {
        let Node { ending, beginning } = std::mem::take(&mut self.nodes[gone]);
        self.at_end.extend(ending.iter().map(|road| (*road, stays)));
        self.at_start.extend(beginning.iter().map(|road| (*road, stays)));
        self.nodes[stays].ending.extend(ending);
        self.nodes[stays].beginning.extend(beginning);
        stays
    }

    pub(super) fn of_road(&self, road: usize) -> Element {
        let ends = [("predecessor", self.at_start.get(&road), "end"), ("successor", self.at_end.get(&road), "start")];
        let links = ends.into_iter().filter_map(|(name, node, contact)| {
            let (link, there) = (element(name), self.nodes.get(*node?)?);
            let others = if name == "predecessor" { &there.ending } else { &there.beginning };
            Some(match others.first().filter(|_| there.is_plain()) {
                Some(other) => link.attr("elementType", "road").attr("elementId", other).attr("contactPoint", contact),
                None => link.attr("elementType", "junction").attr("elementId", junction_id(*node?)),
            })
        });
        element("link").children(links)
    }

    /// The link element of a lane; lanes that lead into a junction or come from one have no links there.
    pub(super) fn of_lane(&self, spot: Spot) -> Element {
        let is_plain = |node: Option<&usize>| node.is_some_and(|node| self.nodes[*node].is_plain());
        let link = |name: &'static str, lane: i32| element(name).attr("id", lane);
        let before = self.pairs.iter().filter(|(_, to)| *to == spot && is_plain(self.at_start.get(&spot.road)));
        let after = self.pairs.iter().filter(|(from, _)| *from == spot && is_plain(self.at_end.get(&spot.road)));
        element("link")
            .children(before.map(|(from, _)| link("predecessor", from.lane)))
            .children(after.map(|(_, to)| link("successor", to.lane)))
    }

    /// The junctions, in order. Two roads have one connection, with all links of their lanes.
    pub(super) fn junctions(&self) -> Vec<Element> {
        let forks = self.nodes.iter().enumerate().filter(|(_, node)| !node.ending.is_empty() && !node.is_plain());
        let junction = |(node, _): (usize, &Node)| {
            let mut connections: Vec<((usize, usize), Vec<Element>)> = Vec::new();
            for (from, to) in self.pairs.iter().filter(|(from, _)| self.at_end.get(&from.road) == Some(&node)) {
                let (roads, link) =
                    ((from.road, to.road), element("laneLink").attr("from", from.lane).attr("to", to.lane));
                match connections.iter_mut().find(|(known, _)| *known == roads) {
                    Some((_, links)) => links.push(link),
                    None => connections.push((roads, vec![link])),
                }
            }
            let n_to = |road: usize| connections.iter().filter(|((_, to), _)| *to == road).count();
            // For readers without direct junctions, such as SUMO's. Only one connection may name a road in this way.
            let connecting: Vec<bool> = connections.iter().map(|((_, to), _)| n_to(*to) == 1).collect();
            let connection = |(i, ((from, to), links)): (usize, ((usize, usize), Vec<Element>))| {
                let of_roads = element("connection").attr("id", i).attr("incomingRoad", from).attr("linkedRoad", to);
                let of_roads = if connecting[i] { of_roads.attr("connectingRoad", to) } else { of_roads };
                of_roads.attr("contactPoint", "start").children(links)
            };
            let id = junction_id(node);
            element("junction")
                .attr("id", id)
                .attr("name", format!("junction {id}"))
                .attr("type", "direct")
                .children(connections.into_iter().enumerate().map(connection))
        };
        forks.map(junction).collect()
    }
}

/// Counted from 1, as roads are.
const fn junction_id(node: usize) -> usize {
    node + 1
}
