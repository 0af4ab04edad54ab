//! The lanelets of a map that are lanes, with their attributes.

use super::bound::{Bound, Flaw, align};
use super::osm::{Osm, Relation};
use crate::geometry::{Polyline, Vec2};
use crate::ingest::map_report::MapReport;
use crate::scene::{LaneAttributes, TurnDirection};
use std::collections::BTreeMap;

/// Distance between the points of a centerline, meters.
const CENTERLINE_SPACING_M: f64 = 2.0;
/// Maximum number of points of a centerline.
const MAX_CENTERLINE_POINTS: usize = 500;

/// Subtypes of lanelets for vehicles. Lanelets without a subtype count, as maps drawn by hand lack it.
const DRIVABLE_SUBTYPES: [&str; 7] = ["", "road", "highway", "play_street", "bus_lane", "emergency_lane", "exit"];

/// A lanelet with both bounds in driving direction.
#[derive(Debug)]
pub(super) struct Lanelet {
    pub(super) id: i64,
    pub(super) left: Bound,
    pub(super) right: Bound,
    pub(super) centerline: Polyline,
    pub(super) attributes: LaneAttributes,
}

/// Whether vehicles drive on this lanelet: `participant:…` tags overrule the subtype, as in Lanelet2's traffic rules.
pub(super) fn is_drivable(relation: &Relation) -> bool {
    let mut participants = relation.tags.iter().filter(|(key, _)| key.starts_with("participant:")).peekable();
    if participants.peek().is_some() {
        return participants.any(|(key, value)| key.starts_with("participant:vehicle") && is_true(value));
    }
    DRIVABLE_SUBTYPES.contains(&tag(relation, "subtype"))
}

impl Lanelet {
    /// Builds the lanelet `relation`.
    pub(super) fn of(
        relation: &Relation,
        id: i64,
        osm: &Osm,
        positions: &BTreeMap<i64, Vec2>,
        report: &mut MapReport,
    ) -> Result<Self, Flaw> {
        let mut left = Bound::of(relation, id, "left", osm, positions)?;
        let mut right = Bound::of(relation, id, "right", osm, positions)?;
        align(&mut left, &mut right);
        let centerline = centerline(&left.line, &right.line);
        if centerline.length_m() < 1e-3 {
            return Err(("no_length", "its centerline has no length".to_owned()));
        }
        let attributes = attributes(relation, id, osm, report);
        Ok(Self { id, left, right, centerline, attributes })
    }
}

/// The mean of both bounds at equal shares of their lengths, about every 2 m.
fn centerline(left: &Polyline, right: &Polyline) -> Polyline {
    let mean_length_m = f64::midpoint(left.length_m(), right.length_m());
    // The slack makes a length of exactly 10 m the same number of points in both encodings of a map. The cast
    // saturates, so absurd lengths end at the cap.
    let n_segments = (mean_length_m / CENTERLINE_SPACING_M - 1e-3).ceil() as usize;
    let n_points = (n_segments.saturating_add(1)).clamp(2, MAX_CENTERLINE_POINTS);
    let (left, right) = (left.resampled(n_points), right.resampled(n_points));
    Polyline(left.0.iter().zip(&right.0).map(|(l, r)| l.lerp(*r, 0.5)).collect())
}

fn attributes(relation: &Relation, id: i64, osm: &Osm, report: &mut MapReport) -> LaneAttributes {
    let mut attributes = LaneAttributes {
        kind: tag(relation, "subtype").to_owned(),
        turn: match tag(relation, "turn_direction") {
            "left" => TurnDirection::Left,
            "right" => TurnDirection::Right,
            _ => TurnDirection::None,
        },
        // Lanes for vehicles are one-way unless the map tags them otherwise.
        one_way: relation.tags.get("one_way").is_none_or(|value| is_true(value)),
        tags: relation
            .tags
            .iter()
            .filter(|(key, _)| !matches!(key.as_str(), "type" | "subtype" | "one_way"))
            .map(|(key, value)| (key.clone(), value.clone()))
            .collect(),
        ..LaneAttributes::default()
    };
    for member in relation.members.iter().filter(|member| member.role == "regulatory_element") {
        if member.id == id {
            report.warn("self_reference", format!("lanelet {id}: it is its own regulatory element"));
            continue;
        }
        let Some(rule) = osm.relations.get(&member.id).filter(|_| member.kind == "relation") else {
            let detail = format!("lanelet {id}: its regulatory element {} is not in the file", member.id);
            report.warn("missing_regulatory_element", detail);
            continue;
        };
        attributes.has_traffic_control |=
            matches!(tag(rule, "subtype"), "traffic_light" | "right_of_way" | "all_way_stop");
        // The roles in the rule tell who has the right of way and who yields.
        let named = rule.members.iter().find(|named| named.kind == "relation" && named.id == id);
        let role = named.map(|named| format!("{}={}", LaneAttributes::ROLE, named.role));
        let tags = rule.tags.iter().map(|(key, value)| format!("{key}={value}"));
        let joined = role.into_iter().chain(tags).collect::<Vec<_>>().join(";");
        attributes.tags.insert(format!("{}{}", LaneAttributes::REGULATORY, member.id), joined);
    }
    attributes
}

fn tag<'a>(relation: &'a Relation, key: &str) -> &'a str {
    relation.tags.get(key).map_or("", String::as_str)
}

fn is_true(value: &str) -> bool {
    matches!(value, "yes" | "true" | "1")
}
