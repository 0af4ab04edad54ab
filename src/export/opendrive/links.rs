//! Links and junctions of roads with one lane each.
//!
//! A road can name one successor. For forks and merges, the standard has junctions; those of the type `direct` connect
//! roads that meet in one place, without further roads between them.

use crate::export::xml::{Element, element};
use crate::scene::{Lane, LaneId};
use std::collections::BTreeMap;

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
    /// The connections of roads.
    pairs: Vec<(usize, usize)>,
}

impl Links {
    /// The links of lanes whose roads have these numbers.
    pub(super) fn of<'l>(lanes: impl Iterator<Item = &'l Lane>, numbers: &BTreeMap<LaneId, usize>) -> Self {
        let pairs = lanes.flat_map(|lane| {
            let from = numbers.get(&lane.id);
            lane.successors.iter().filter_map(move |to| Some((*from?, *numbers.get(to)?)))
        });
        let mut links =
            Self { nodes: Vec::new(), at_end: BTreeMap::new(), at_start: BTreeMap::new(), pairs: pairs.collect() };
        for (from, to) in links.pairs.clone() {
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

    /// The link elements of a road and of its lane.
    pub(super) fn of_road(&self, road: usize) -> (Element, Element) {
        let (mut of_road, mut of_lane) = (element("link"), element("link"));
        let ends = [("predecessor", self.at_start.get(&road), "end"), ("successor", self.at_end.get(&road), "start")];
        for (name, node, contact) in ends {
            let Some(node) = node else { continue };
            let there = &self.nodes[*node];
            let others = if name == "predecessor" { &there.ending } else { &there.beginning };
            let link = element(name);
            if let (true, Some(other)) = (there.is_plain(), others.first()) {
                of_road = of_road
                    .child(link.attr("elementType", "road").attr("elementId", other).attr("contactPoint", contact));
                of_lane = of_lane.child(element(name).attr("id", -1));
            } else {
                of_road = of_road.child(link.attr("elementType", "junction").attr("elementId", junction_id(*node)));
            }
        }
        (of_road, of_lane)
    }

    /// The junctions, in order.
    pub(super) fn junctions(&self) -> Vec<Element> {
        let forks = self.nodes.iter().enumerate().filter(|(_, node)| !node.ending.is_empty() && !node.is_plain());
        let junction = |(node, _): (usize, &Node)| {
            let pairs = self.pairs.iter().filter(|(from, _)| self.at_end.get(from) == Some(&node));
            let connection = |(i, (from, to)): (usize, &(usize, usize))| {
                element("connection")
                    .attr("id", i)
                    .attr("incomingRoad", from)
                    .attr("linkedRoad", to)
                    // For readers without direct junctions, such as SUMO's.
                    .attr("connectingRoad", to)
                    .attr("contactPoint", "start")
                    .child(element("laneLink").attr("from", -1).attr("to", -1))
            };
            let id = junction_id(node);
            element("junction")
                .attr("id", id)
                .attr("name", format!("junction {id}"))
                .attr("type", "direct")
                .children(pairs.enumerate().map(connection))
        };
        forks.map(junction).collect()
    }
}

/// Counted from 1, as roads are.
const fn junction_id(node: usize) -> usize {
    node + 1
}
