//! The left and right bounds of a lanelet, in driving direction.

use super::osm::{Osm, Relation};
use crate::geometry::{Polyline, Vec2};
use crate::ingest::plausible_lanes::to_turn;
use std::collections::BTreeMap;

/// One side of a lanelet.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Bound {
    /// The ways that form it, in order, and whether each runs against the direction of the bound.
    pub(super) ways: Vec<(i64, bool)>,
    pub(super) first_node: i64,
    pub(super) last_node: i64,
    /// Its points, meters.
    pub(super) line: Polyline,
}

/// Why a lanelet cannot become a lane: reason and detail.
pub(super) type Flaw = (&'static str, String);

impl Bound {
    /// The bound of `relation` in `role` (`left` or `right`), in the direction of its first way.
    pub(super) fn of(
        relation: &Relation,
        relation_id: i64,
        role: &str,
        osm: &Osm,
        positions: &BTreeMap<i64, Vec2>,
    ) -> Result<Self, Flaw> {
        let mut chain = Chain::default();
        for member in relation.members.iter().filter(|member| member.role == role) {
            if member.kind == "relation" && member.id == relation_id {
                return Err(("self_reference", format!("it is its own {role} bound")));
            }
            if member.kind != "way" {
                return Err((
                    "wrong_member",
                    format!("its {role} bound is {} {}, expected a way", member.kind, member.id),
                ));
            }
            let nodes = osm
                .ways
                .get(&member.id)
                .ok_or_else(|| ("missing_way", format!("its {role} bound, way {}, is not in the file", member.id)))?;
            chain.append(member.id, nodes).map_err(|()| {
                ("broken_bound", format!("way {} is not joined to the rest of its {role} bound", member.id))
            })?;
        }
        let (Some(first_node), Some(last_node)) = (chain.nodes.first().copied(), chain.nodes.last().copied()) else {
            return Err(("missing_bound", format!("it has no {role} bound")));
        };
        let point = |node: &i64| {
            let flaw = || match osm.misplaced.get(node) {
                Some(detail) => ("misplaced_node", format!("node {node} of its {role} bound: {detail}")),
                None => ("missing_node", format!("node {node} of its {role} bound is not in the file")),
            };
            positions.get(node).copied().ok_or_else(flaw)
        };
        let mut points = chain.nodes.iter().map(point).collect::<Result<Vec<_>, _>>()?;
        points.dedup();
        if points.len() < 2 {
            return Err(("short_bound", format!("its {role} bound has fewer than two distinct points")));
        }
        Ok(Self { ways: chain.ways, first_node, last_node, line: Polyline(points) })
    }

    fn invert(&mut self) {
        self.ways.reverse();
        for (_, inverted) in &mut self.ways {
            *inverted = !*inverted;
        }
        std::mem::swap(&mut self.first_node, &mut self.last_node);
        self.line.0.reverse();
    }
}

/// Turns both bounds into driving direction, as Lanelet2 does: ways are drawn in any direction, and the left bound must
/// lie to the left of the right one.
pub(super) fn align(left: &mut Bound, right: &mut Bound) {
    let turned = to_turn(&left.line, &right.line);
    [left, right].into_iter().zip(turned).filter(|(_, turns)| *turns).for_each(|(bound, _)| bound.invert());
}

/// Ways joined end to end.
#[derive(Default)]
struct Chain {
    ways: Vec<(i64, bool)>,
    nodes: Vec<i64>,
}

impl Chain {
    /// Joins a way to the end, in whichever direction fits; the second way also decides on the direction of the first.
    fn append(&mut self, way_id: i64, way: &[i64]) -> Result<(), ()> {
        let (Some(first), Some(last)) = (way.first(), way.last()) else { return Ok(()) };
        let mut tail = self.nodes.last();
        if self.ways.len() == 1 && tail != Some(first) && tail != Some(last) {
            self.nodes.reverse();
            self.ways[0].1 = true;
            tail = self.nodes.last();
        }
        let inverted = match tail {
            None => false,
            Some(node) if node == first => false,
            Some(node) if node == last => true,
            Some(_) => return Err(()),
        };
        let skip = usize::from(tail.is_some());
        if inverted {
            self.nodes.extend(way.iter().rev().skip(skip));
        } else {
            self.nodes.extend(way.iter().skip(skip));
        }
        self.ways.push((way_id, inverted));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bound(points: &[(f64, f64)]) -> Bound {
        let line = Polyline(points.iter().map(|(x, y)| Vec2::new(*x, *y)).collect());
        Bound { ways: vec![(1, false)], first_node: 1, last_node: 2, line }
    }

    #[test]
    fn bounds_are_turned_until_left_lies_on_the_left() {
        let (upper, lower) = (bound(&[(0.0, 4.0), (10.0, 4.0)]), bound(&[(0.0, 0.0), (10.0, 0.0)]));
        let mut upper_inverted = upper.clone();
        upper_inverted.invert();
        let mut lower_inverted = lower.clone();
        lower_inverted.invert();
        let line = Polyline(vec![Vec2::new(10.0, 0.0), Vec2::ZERO]);
        assert_eq!(lower_inverted, Bound { ways: vec![(1, true)], first_node: 2, last_node: 1, line });
        for left in [&upper, &upper_inverted] {
            for right in [&lower, &lower_inverted] {
                let (mut left, mut right) = (left.clone(), right.clone());
                align(&mut left, &mut right);
                assert_eq!((&left, &right), (&upper, &lower));
                // With the roles exchanged, traffic runs the other way.
                let (mut left, mut right) = (lower.clone(), upper.clone());
                align(&mut left, &mut right);
                assert_eq!((&left, &right), (&lower_inverted, &upper_inverted));
            }
        }
    }

    #[test]
    fn hairpins_are_aligned_by_their_middle() {
        let arc = |radius: f64| -> Vec<(f64, f64)> {
            (0..=10)
                .map(|i| f64::from(i) * std::f64::consts::PI / 10.0)
                .map(|a| (radius * a.cos(), radius * a.sin()))
                .collect()
        };
        let (mut left, mut right) = (bound(&arc(2.0)), bound(&arc(6.0)));
        right.invert();
        align(&mut left, &mut right);
        assert!(left.line.0[0].x > 0.0 && right.line.0[0].x > 0.0);
    }

    #[test]
    fn ways_are_joined_whatever_their_direction() {
        for (first, second) in [([1, 2], [2, 3]), ([1, 2], [3, 2]), ([2, 1], [2, 3]), ([2, 1], [3, 2])] {
            let mut chain = Chain::default();
            chain.append(10, &first).unwrap();
            chain.append(11, &second).unwrap();
            assert_eq!(chain.nodes, [1, 2, 3]);
            assert_eq!(chain.ways, [(10, first[0] != 1), (11, second[0] != 2)]);
            assert!(chain.append(12, &[7, 8]).is_err());
        }
    }
}
