//! Roads as described by their elements. What is bad in one is left out and told; the rest of the road is read.

use super::cubic::Cubic;
use super::plan_view::{Piece, pose_at};
use super::section::{Section, Side, cubics, sections};
use crate::geometry::Vec2;
use crate::ingest::error::Malformed;
use crate::ingest::map_report::MapReport;
use crate::ingest::xml_tree::Element;

/// Pieces of a reference line that are farther apart than this are not consecutive, meters.
const MAX_GAP_M: f64 = 1.0;

/// Tells what is left out of an element.
pub(super) struct Faults<'r> {
    pub(super) report: &'r mut MapReport,
    /// The element in messages, such as `road 7`.
    pub(super) of: String,
}

impl Faults<'_> {
    pub(super) fn tell(&mut self, what: &'static str, detail: impl std::fmt::Display) {
        self.report.warn(what, format!("{}: {detail}", self.of));
    }

    /// What was found, unless it is bad.
    pub(super) fn sound<T>(&mut self, what: &'static str, found: Result<T, Malformed>) -> Option<T> {
        found.map_err(|fault| self.tell(what, fault)).ok()
    }
}

/// A road.
#[derive(Debug)]
pub(super) struct Road {
    pub(super) id: String,
    pub(super) length_m: f64,
    pub(super) junction: Option<String>,
    /// Whether traffic keeps to the left.
    pub(super) is_left_hand: bool,
    /// The speed limit at its start, in the form of tags.
    pub(super) speed_limit_mps: Option<String>,
    pub(super) plan_view: Vec<Piece>,
    pub(super) lane_offset: Vec<Cubic>,
    /// By ascending start.
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
    /// A link that cannot be read.
    Broken,
}

impl Road {
    pub(super) fn of(element: &Element, report: &mut MapReport) -> Result<Self, Malformed> {
        let id = element.attribute("id").ok_or("has no id")?.to_owned();
        let mut plan_view = children(element, "planView", "geometry").map(Piece::of).collect::<Result<Vec<_>, _>>()?;
        plan_view.sort_by(|a, b| a.start_m.total_cmp(&b.start_m));
        let Some(last) = plan_view.last() else { return Err("has no geometry".into()) };
        let faults = &mut Faults { report, of: format!("road {id} on line {}", element.line) };
        let length_m = faults.sound("broken_lengths", element.float("length", None));
        let length_m = length_m.unwrap_or(last.start_m + last.length_m);
        if length_m == 0.0 {
            faults.tell("roads_without_length", "is 0 m long, expected more than 0");
        }
        let sections = sections(children(element, "lanes", "laneSection"), length_m, faults);
        if sections.is_empty() {
            return Err("has no <laneSection> in <lanes>".into());
        }
        let link = |name: &str, faults: &mut Faults<'_>| {
            let link = element.find(&["link", name])?;
            Some(faults.sound("broken_links", road_link(link)).unwrap_or(RoadLink::Broken))
        };
        Ok(Self {
            length_m,
            junction: element.attribute("junction").filter(|junction| *junction != "-1").map(str::to_owned),
            is_left_hand: element.attribute("rule") == Some("LHT"),
            speed_limit_mps: element.find(&["type", "speed"]).and_then(speed_limit),
            plan_view,
            lane_offset: cubics(element.find(&["lanes"]), "laneOffset", "s", faults),
            sections,
            links: ["predecessor", "successor"].map(|name| link(name, faults)),
            id,
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

    /// Where its reference line starts (0) or ends (1).
    pub(super) fn point_at(&self, end: usize) -> Vec2 {
        pose_at(&self.plan_view, self.length_m * end as f64).map_or(Vec2::ZERO, |(point, _)| point)
    }

    /// The section that a section touches with its start (0) or its end (1).
    pub(super) fn beside(&self, section: usize, end: usize) -> Option<usize> {
        let is_beside = |idx: &usize| self.sections[*idx].side == self.sections[section].side;
        if end == 0 { (0..section).rev().find(is_beside) } else { (section + 1..self.sections.len()).find(is_beside) }
    }

    /// The section of a lane at the start (0) or at the end (1) of the road.
    pub(super) fn section_at(&self, end: usize, lane: i64) -> usize {
        let has_side = |section: &Section| section.side.is_none_or(|side| side == Side::of_lane(lane));
        let at_end = |idx: Option<usize>| idx.unwrap_or(self.sections.len());
        at_end(if end == 0 {
            self.sections.iter().position(has_side)
        } else {
            self.sections.iter().rposition(has_side)
        })
    }
}

fn children<'a>(element: &'a Element, group: &str, name: &'a str) -> impl Iterator<Item = &'a Element> + Clone {
    element.find(&[group]).into_iter().flat_map(move |group| group.all(name))
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

pub(super) fn unlisted(element: &Element, name: &str, found: &str, expected: &str) -> Malformed {
    format!("<{}> on line {} has {name} \"{found}\", expected {expected}", element.name, element.line).into()
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
