//! The lane sections of a road and their lanes.

use super::SAME_M;
use super::cubic::Cubic;
use super::road::{Faults, unlisted};
use crate::ingest::error::Malformed;
use crate::ingest::xml_tree::Element;
use std::collections::BTreeSet;

/// A stretch of a road with the same lanes.
#[derive(Debug)]
pub(super) struct Section {
    pub(super) start_m: f64,
    pub(super) end_m: f64,
    /// Of a road with sections for one side alone: the side of this one. Those of a side follow one another.
    pub(super) side: Option<Side>,
    /// From left to right in the direction of the road, without the center.
    pub(super) lanes: Vec<RoadLane>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    Left,
    Right,
}

impl Side {
    pub(super) const fn of_lane(id: i64) -> Self {
        if id > 0 { Self::Left } else { Self::Right }
    }
}

/// A lane of a section.
#[derive(Debug)]
pub(super) struct RoadLane {
    /// Positive on the left of the reference line, ascending away from it.
    pub(super) id: i64,
    pub(super) kind: String,
    /// Whether traffic runs against the side's usual direction.
    pub(super) is_reversed: bool,
    /// Whether traffic runs in both directions.
    pub(super) is_both_ways: bool,
    /// By ascending start within the section.
    pub(super) widths: Vec<Cubic>,
    /// The position of its outer edge, if no widths are given.
    pub(super) borders: Vec<Cubic>,
    /// The lanes that it is linked to at the start and at the end of the section.
    pub(super) links: [Vec<i64>; 2],
}

impl RoadLane {
    pub(super) fn is_drivable(&self) -> bool {
        is_drivable(&self.kind) == Some(true)
    }
}

/// Whether motor vehicles drive on lanes of a type; `None` for those that are not listed.
fn is_drivable(kind: &str) -> Option<bool> {
    match kind {
        "driving" | "entry" | "exit" | "onRamp" | "offRamp" | "connectingRamp" | "slipLane" | "bidirectional"
        | "bus" | "taxi" | "HOV" | "roadWorks" | "mwyEntry" | "mwyExit" => Some(true),
        "shoulder" | "border" | "stop" | "none" | "restricted" | "parking" | "median" | "biking" | "sidewalk"
        | "walking" | "curb" | "tram" | "rail" => Some(false),
        _ => None,
    }
}

/// The sections of a road by ascending start, each up to the next one of its side. One that begins beyond the end of
/// the road has no length.
pub(super) fn sections<'a>(
    elements: impl Iterator<Item = &'a Element> + Clone,
    length_m: f64,
    faults: &mut Faults<'_>,
) -> Vec<Section> {
    let is_single = |element: &Element| element.attribute("singleSide") == Some("true");
    let is_split = elements.clone().any(is_single);
    let mut sections = Vec::new();
    for element in elements {
        let Some(start_m) = faults.sound("broken_sections", element.float("s", None)) else { continue };
        if start_m > length_m + SAME_M {
            let detail = format!("has lanes from {start_m} m on, but is {length_m} m long");
            faults.tell("sections_beyond_their_road", detail);
        }
        let (start_m, end_m, mut lanes) = (start_m.min(length_m), length_m, lanes(element, faults));
        if !is_split {
            sections.push(Section { start_m, end_m, side: None, lanes });
            continue;
        }
        let right = lanes.split_off(lanes.partition_point(|lane| lane.id > 0));
        for (side, lanes) in [(Side::Left, lanes), (Side::Right, right)] {
            if !(is_single(element) && lanes.is_empty()) {
                sections.push(Section { start_m, end_m, side: Some(side), lanes });
            }
        }
    }
    sections.sort_by(|a, b| a.start_m.total_cmp(&b.start_m));
    let mut next_m = [length_m; 2];
    for section in sections.iter_mut().rev() {
        let next_m = &mut next_m[usize::from(section.side == Some(Side::Left))];
        section.end_m = std::mem::replace(next_m, section.start_m);
    }
    sections
}

/// The lanes of a section from left to right. A lane lies beside the one within it, so that one without a place costs
/// those beyond it, too.
fn lanes(section: &Element, faults: &mut Faults<'_>) -> Vec<RoadLane> {
    let mut lanes: Vec<RoadLane> = Vec::new();
    // The innermost lanes without a place, on the left and on the right.
    let mut lost = [u64::MAX; 2];
    let mut ids = BTreeSet::new();
    for side in section.children().filter(|side| ["left", "right"].contains(&side.name.as_str())) {
        for element in side.all("lane") {
            let (found, lane) = match element.id("id") {
                Ok(0) => (None, Err("has a lane 0 beside the center".into())),
                Ok(id) if !ids.insert(id) => (Some(id), Err(format!("has lane {id} twice in a section").into())),
                Ok(id) => (Some(id), lane(element, id, faults)),
                Err(fault) => (None, Err(fault)),
            };
            match lane {
                Ok(lane) => lanes.push(lane),
                Err(fault) => {
                    faults.tell("broken_lanes", format!("{fault}; it and the lanes beyond it are left out"));
                    let id = found.unwrap_or(if side.name == "left" { 1 } else { -1 });
                    let lost = &mut lost[usize::from(id < 0)];
                    // The first one of an id has a place.
                    let is_first = lanes.iter().any(|lane| lane.id == id);
                    *lost = (*lost).min(id.unsigned_abs() + u64::from(is_first));
                }
            }
        }
    }
    lanes.retain(|lane| lane.id.unsigned_abs() < lost[usize::from(lane.id < 0)]);
    lanes.sort_by_key(|lane| std::cmp::Reverse(lane.id));
    lanes
}

fn lane(element: &Element, id: i64, faults: &mut Faults<'_>) -> Result<RoadLane, Malformed> {
    let [widths, borders] = ["width", "border"].map(|name| cubics(Some(element), name, "sOffset", faults));
    let has_start = |functions: &Vec<Cubic>| functions.first().is_some_and(|first| first.start_m <= SAME_M);
    let n_elements = element.all("width").chain(element.all("border")).count();
    if widths.len() + borders.len() < n_elements && ![&widths, &borders].into_iter().any(has_start) {
        return Err(format!("lane {id} on line {} has no width where it begins", element.line).into());
    }
    let mut links = |name| {
        let links = element.all("link").flat_map(|link| link.all(name));
        links.filter_map(|link| faults.sound("broken_links", link.id("id"))).collect()
    };
    let links = [links("predecessor"), links("successor")];
    let direction = element.attribute("direction").unwrap_or("standard");
    if !["standard", "reversed", "both"].contains(&direction) {
        faults.tell("broken_directions", unlisted(element, "direction", direction, "standard, reversed or both"));
    }
    let kind = element.attribute("type").unwrap_or_default().to_owned();
    if is_drivable(&kind).is_none() {
        faults.tell("lanes_of_other_types", unlisted(element, "type", &kind, "one such as driving; it is left out"));
    }
    Ok(RoadLane {
        id,
        is_reversed: direction == "reversed",
        is_both_ways: direction == "both" || kind == "bidirectional",
        kind,
        widths,
        borders,
        links,
    })
}

/// The functions of a group that can be read, by ascending start.
pub(super) fn cubics(group: Option<&Element>, name: &str, start: &str, faults: &mut Faults<'_>) -> Vec<Cubic> {
    let elements = group.into_iter().flat_map(|group| group.all(name));
    let mut found: Vec<Cubic> =
        elements.filter_map(|element| faults.sound("broken_widths", Cubic::of(element, start))).collect();
    found.sort_by(|a, b| a.start_m.total_cmp(&b.start_m));
    found
}
