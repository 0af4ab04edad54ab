//! Roads as described by their elements.

use super::cubic::Cubic;
use super::plan_view::{Piece, pose_at};
use crate::ingest::error::Malformed;
use crate::ingest::xml_tree::Element;

/// Types of lanes on which motor vehicles drive.
const DRIVABLE: [&str; 13] = [
    "driving",
    "entry",
    "exit",
    "onRamp",
    "offRamp",
    "connectingRamp",
    "slipLane",
    "bidirectional",
    "bus",
    "taxi",
    "HOV",
    "roadWorks",
    "mwyEntry",
];

/// Pieces of a reference line that are farther apart than this are not consecutive, meters.
const MAX_GAP_M: f64 = 1.0;

/// A road.
#[derive(Debug)]
pub(super) struct Road {
    pub(super) id: String,
    pub(super) length_m: f64,
    /// The junction that it is part of.
    pub(super) junction: Option<String>,
    /// Whether traffic keeps to the left.
    pub(super) is_left_hand: bool,
    /// The speed limit at its start, in the form of tags.
    pub(super) speed_limit_mps: Option<String>,
    pub(super) plan_view: Vec<Piece>,
    pub(super) lane_offset: Vec<Cubic>,
    pub(super) sections: Vec<Section>,
    /// The links at its start and its end.
    pub(super) links: [Option<RoadLink>; 2],
}

/// The element beyond an end of a road.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum RoadLink {
    /// A road that touches it with its start (0) or its end (1).
    Road(String, usize),
    Junction(String),
}

/// A stretch of a road with the same lanes.
#[derive(Debug)]
pub(super) struct Section {
    pub(super) start_m: f64,
    /// From left to right in the direction of the road, without the center.
    pub(super) lanes: Vec<RoadLane>,
}

/// A lane of a section.
#[derive(Debug)]
pub(super) struct RoadLane {
    /// Positive on the left of the reference line, ascending away from it.
    pub(super) id: i64,
    pub(super) kind: String,
    /// By ascending start within the section.
    pub(super) widths: Vec<Cubic>,
    /// The position of its outer edge, if no widths are given.
    pub(super) borders: Vec<Cubic>,
    /// The lanes that it is linked to at the start and at the end of the section.
    pub(super) links: [Option<i64>; 2],
}

impl RoadLane {
    pub(super) fn is_drivable(&self) -> bool {
        DRIVABLE.contains(&self.kind.as_str())
    }

    pub(super) fn is_both_ways(&self) -> bool {
        self.kind == "bidirectional"
    }
}

impl Road {
    pub(super) fn of(element: &Element) -> Result<Self, Malformed> {
        let length_m = element.float("length", None)?;
        let mut plan_view = children(element, "planView", "geometry").map(Piece::of).collect::<Result<Vec<_>, _>>()?;
        plan_view.sort_by(|a, b| a.start_m.total_cmp(&b.start_m));
        if plan_view.is_empty() {
            return Err("has no geometry".into());
        }
        let link = |name| element.find(&["link", name]).map(road_link).transpose();
        let sections = children(element, "lanes", "laneSection").map(section).collect::<Result<Vec<_>, _>>()?;
        if sections.is_empty() {
            return Err("has no <laneSection> in <lanes>".into());
        }
        Ok(Self {
            id: element.attribute("id").ok_or("has no id")?.to_owned(),
            length_m,
            junction: element.attribute("junction").filter(|junction| *junction != "-1").map(str::to_owned),
            is_left_hand: element.attribute("rule") == Some("LHT"),
            speed_limit_mps: element.find(&["type", "speed"]).and_then(speed_limit),
            plan_view,
            lane_offset: cubics(element.find(&["lanes"]), "laneOffset", "s")?,
            sections: sorted(sections),
            links: [link("predecessor")?, link("successor")?],
        })
    }

    /// The gap between pieces of the reference line, if there is one.
    pub(super) fn gap(&self) -> Option<String> {
        let mut pieces = self.plan_view.windows(2).filter_map(|pair| {
            let apart_m = pair[1].origin.distance(pose_at(&pair[..1], pair[1].start_m)?.0);
            let start_m = pair[1].start_m;
            let detail = || format!("its geometry at {start_m} m begins {apart_m:.1} m from where the one before ends");
            (apart_m > MAX_GAP_M).then(detail)
        });
        let end_m = self.plan_view.last().map_or(0.0, |last| last.start_m + last.length_m.max(0.0));
        let is_short = self.length_m - end_m > MAX_GAP_M;
        let taken_on = || format!("its geometry ends after {end_m} of {} m, and is taken on", self.length_m);
        pieces.next().or_else(|| is_short.then(taken_on))
    }

    /// The start and end of a section along the road.
    pub(super) fn range_of(&self, section: usize) -> [f64; 2] {
        let end_m = self.sections.get(section + 1).map_or(self.length_m, |next| next.start_m);
        [self.sections[section].start_m, end_m]
    }
}

fn children<'a>(element: &'a Element, group: &str, name: &'a str) -> impl Iterator<Item = &'a Element> {
    element.find(&[group]).into_iter().flat_map(move |group| group.all(name))
}

fn sorted(mut sections: Vec<Section>) -> Vec<Section> {
    sections.sort_by(|a, b| a.start_m.total_cmp(&b.start_m));
    sections
}

fn cubics(group: Option<&Element>, name: &str, start: &str) -> Result<Vec<Cubic>, Malformed> {
    let found = group.into_iter().flat_map(|group| group.all(name)).map(|element| Cubic::of(element, start));
    let mut found = found.collect::<Result<Vec<_>, _>>()?;
    found.sort_by(|a, b| a.start_m.total_cmp(&b.start_m));
    Ok(found)
}

fn road_link(element: &Element) -> Result<RoadLink, Malformed> {
    let id = element.attribute("elementId").ok_or_else(|| format!("<{}> has no elementId", element.name))?.to_owned();
    match (element.attribute("elementType"), element.attribute("contactPoint")) {
        (Some("junction"), _) => Ok(RoadLink::Junction(id)),
        (Some("road") | None, contact) => Ok(RoadLink::Road(id, end_of(element, contact)?)),
        (Some(other), _) => Err(unlisted(element, "elementType", other, "road or junction")),
    }
}

/// The end of a road that a contact point names: start (0) or end (1).
pub(super) fn end_of(element: &Element, contact: Option<&str>) -> Result<usize, Malformed> {
    match contact {
        Some("start") | None => Ok(0),
        Some("end") => Ok(1),
        Some(other) => Err(unlisted(element, "contactPoint", other, "start or end")),
    }
}

fn unlisted(element: &Element, name: &str, found: &str, expected: &str) -> Malformed {
    format!("<{}> on line {} has {name} \"{found}\", expected {expected}", element.name, element.line).into()
}

fn section(element: &Element) -> Result<Section, Malformed> {
    let sides = ["left", "right"].into_iter().filter_map(|side| element.find(&[side]));
    let mut lanes = sides.flat_map(|side| side.all("lane")).map(lane).collect::<Result<Vec<_>, _>>()?;
    lanes.sort_by_key(|lane| std::cmp::Reverse(lane.id));
    if let Some(twice) = lanes.windows(2).find(|pair| pair[0].id == pair[1].id) {
        return Err(format!("has lane {} twice in a section", twice[0].id).into());
    }
    Ok(Section { start_m: element.float("s", None)?, lanes })
}

fn lane(element: &Element) -> Result<RoadLane, Malformed> {
    let id = element.id("id")?;
    if id == 0 {
        return Err("has a lane 0 beside the center".into());
    }
    let link = |name| element.find(&["link", name]).map(|link| link.id("id")).transpose();
    Ok(RoadLane {
        id,
        kind: element.attribute("type").unwrap_or_default().to_owned(),
        widths: cubics(Some(element), "width", "sOffset")?,
        borders: cubics(Some(element), "border", "sOffset")?,
        links: [link("predecessor")?, link("successor")?],
    })
}

fn speed_limit(element: &Element) -> Option<String> {
    let limit: f64 = element.attribute("max")?.parse().ok()?;
    let factor = match element.attribute("unit") {
        Some("km/h") => 1.0 / 3.6,
        Some("mph") => 0.44704,
        _ => 1.0,
    };
    Some((limit * factor).to_string())
}
