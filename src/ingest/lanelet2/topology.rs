//! Successors and neighbors of lanes.

use super::lanelet::Lanelet;
use crate::scene::{Lane, LaneId};
use std::collections::BTreeMap;

/// Maximum number of connections, far more than any map has, so that no map exhausts memory.
const MAX_CONNECTIONS: usize = 1_000_000;

/// The lanes with their connections, or the number of connections if there are too many.
///
/// A lane succeeds another if both its bounds begin at the nodes at which the other's end. Lanes are neighbors if the
/// same ways bound them, in the same direction.
pub(super) fn connect(lanelets: Vec<Lanelet>) -> Result<Vec<Lane>, usize> {
    let mut beginning_at: BTreeMap<(i64, i64), Vec<LaneId>> = BTreeMap::new();
    let mut ending_at: BTreeMap<(i64, i64), Vec<LaneId>> = BTreeMap::new();
    let mut right_of: BTreeMap<Vec<(i64, bool)>, LaneId> = BTreeMap::new();
    let mut left_of: BTreeMap<Vec<(i64, bool)>, LaneId> = BTreeMap::new();
    for lanelet in &lanelets {
        let id = LaneId(lanelet.id);
        beginning_at.entry(first_nodes(lanelet)).or_default().push(id);
        ending_at.entry(last_nodes(lanelet)).or_default().push(id);
        // If several lanes share a bound on the same side, the one with the lowest id is the neighbor.
        right_of.entry(lanelet.left.ways.clone()).or_insert(id);
        left_of.entry(lanelet.right.ways.clone()).or_insert(id);
    }
    let n_connections =
        ending_at.iter().map(|(nodes, ids)| ids.len() * beginning_at.get(nodes).map_or(0, Vec::len)).sum::<usize>();
    if n_connections > MAX_CONNECTIONS {
        return Err(n_connections);
    }

    let lane = |lanelet: Lanelet| {
        let id = LaneId(lanelet.id);
        let others = |ids: Option<&Vec<LaneId>>| -> Vec<LaneId> {
            ids.into_iter().flatten().copied().filter(|other| *other != id).collect()
        };
        Lane {
            id,
            successors: others(beginning_at.get(&last_nodes(&lanelet))),
            predecessors: others(ending_at.get(&first_nodes(&lanelet))),
            left_neighbor: left_of.get(&lanelet.left.ways).copied().filter(|other| *other != id),
            right_neighbor: right_of.get(&lanelet.right.ways).copied().filter(|other| *other != id),
            centerline: lanelet.centerline,
            left: lanelet.left.line,
            right: lanelet.right.line,
            attributes: lanelet.attributes.into(),
        }
    };
    Ok(lanelets.into_iter().map(lane).collect())
}

const fn first_nodes(lanelet: &Lanelet) -> (i64, i64) {
    (lanelet.left.first_node, lanelet.right.first_node)
}

const fn last_nodes(lanelet: &Lanelet) -> (i64, i64) {
    (lanelet.left.last_node, lanelet.right.last_node)
}
