//! The nodes, ways and relations of an OSM XML document.
//!
//! Only elements that Lanelet2 uses are read. Documents with a document type are refused, so there are no entities to
//! expand, and size, depth and attributes are bounded, so that no document can exhaust memory or time.

use crate::geometry::Vec2;
use crate::ingest::error::{Error, Malformed};
use crate::ingest::map_report::MapReport;
use crate::ingest::map_text::line_at;
use crate::ingest::projection::{GeoPoint, MAX_LATITUDE_DEG, MAX_LONGITUDE_DEG};
use quick_xml::XmlVersion;
use quick_xml::events::{BytesStart, Event};
use std::collections::BTreeMap;

/// OSM documents are three elements deep: `osm`, `relation`, `member`.
const MAX_DEPTH: usize = 16;
/// The largest coordinate on the plane, meters.
const EARTH_M: f64 = 2.1e7;
/// OSM elements have about ten attributes.
const MAX_ATTRIBUTES: usize = 64;

/// The elements of a document by their ids. Elements that an editor marked as deleted are left out.
#[derive(Debug, Default)]
pub(super) struct Osm {
    pub(super) nodes: BTreeMap<i64, NodePosition>,
    /// Nodes without a usable position, and what is wrong with their coordinates.
    pub(super) misplaced: BTreeMap<i64, String>,
    /// Positions of nodes by Autoware's `local_x` and `local_y`, meters.
    pub(super) local: BTreeMap<i64, Vec2>,
    /// Whether these are the positions of the nodes: whether a node has no other.
    pub(super) is_local: bool,
    /// Polylines: the nodes in order.
    pub(super) ways: BTreeMap<i64, Vec<i64>>,
    /// Lanelets, regulatory elements, areas.
    pub(super) relations: BTreeMap<i64, Relation>,
}

/// A node is given on the ellipsoid (`.osm`) or on the plane (`.osm_xy`).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum NodePosition {
    Geo(GeoPoint),
    Plane(Vec2),
}

#[derive(Debug, Default)]
pub(super) struct Relation {
    pub(super) tags: BTreeMap<String, String>,
    pub(super) members: Vec<Member>,
}

#[derive(Debug)]
pub(super) struct Member {
    /// `node`, `way` or `relation`.
    pub(super) kind: String,
    pub(super) id: i64,
    pub(super) role: String,
}

/// Reads the document in `file`; nodes without a usable position are left out and reported.
pub(super) fn parse(text: &str, file: &str, report: &mut MapReport) -> Result<Osm, Error> {
    let mut reader = quick_xml::Reader::from_str(text);
    let mut document = Document { osm: Osm::default(), open: Open::Nothing, report };
    let (mut depth, mut is_empty) = (0, true);
    loop {
        let at = usize::try_from(reader.buffer_position()).unwrap_or(text.len());
        let line = |at: usize| format!("line {}", line_at(text.as_bytes(), at));
        let malformed = |what: Malformed| Error::map(file, line(at), what);
        let event = reader.read_event();
        is_empty &= !matches!(event, Ok(Event::Start(_) | Event::Empty(_)));
        match event {
            Ok(Event::Start(element)) => {
                depth += 1;
                if depth > MAX_DEPTH {
                    return Err(malformed(format!("elements are nested deeper than {MAX_DEPTH}").into()));
                }
                document.begin(&element, depth).map_err(malformed)?;
            }
            Ok(Event::Empty(element)) => {
                document.begin(&element, depth + 1).map_err(malformed)?;
                document.end(depth + 1);
            }
            Ok(Event::End(_)) => {
                document.end(depth);
                depth -= 1;
            }
            Ok(Event::DocType(_)) => {
                return Err(malformed("document types and entities are not accepted; remove `<!DOCTYPE …>`".into()));
            }
            Ok(Event::GeneralRef(entity)) => {
                return Err(malformed(format!("unexpected reference `&{};`", &*entity).into()));
            }
            Ok(Event::Eof) if depth > 0 => return Err(malformed("the document ends within an element".into())),
            Ok(Event::Eof) if is_empty => return Err(Error::map(file, "line 1", "holds no element, and is no XML")),
            Ok(Event::Eof) => return Ok(document.osm),
            Ok(_) => {}
            Err(error) => {
                let at = usize::try_from(reader.error_position()).unwrap_or(text.len());
                return Err(Error::map(file, line(at), error));
            }
        }
    }
}

/// The element that is being read.
enum Open {
    Nothing,
    Node {
        id: i64,
        position: Result<NodePosition, Malformed>,
        /// Autoware's `local_x` and `local_y`, meters.
        local: [Option<f64>; 2],
    },
    Way {
        id: i64,
        nodes: Vec<i64>,
    },
    Relation {
        id: i64,
        relation: Relation,
    },
    Deleted,
}

struct Document<'a> {
    osm: Osm,
    open: Open,
    report: &'a mut MapReport,
}

impl Document<'_> {
    /// Handles an element at `depth` (1 is the root).
    fn begin(&mut self, element: &BytesStart<'_>, depth: usize) -> Result<(), Malformed> {
        let name = element.name();
        let name: &str = name.as_ref();
        let attributes = Attributes::read(element)?;
        match (depth, name, &mut self.open) {
            (1, "osm", _) => {}
            (1, ..) => {
                return Err(format!("is not an OSM document: the root element is `<{name}>`, expected `<osm>`").into());
            }
            // JOSM and Lanelet2 keep deleted elements in the file.
            (2, "node" | "way" | "relation", _) if attributes.get("action") == Some("delete") => {
                self.open = Open::Deleted;
            }
            (2, "node", _) => {
                let (id, position) = (attributes.id("id", name)?, attributes.position());
                self.open = Open::Node { id, position, local: [None; 2] };
            }
            (2, "way", _) => self.open = Open::Way { id: attributes.id("id", name)?, nodes: Vec::new() },
            (2, "relation", _) => {
                self.open = Open::Relation { id: attributes.id("id", name)?, relation: Relation::default() };
            }
            (3, "nd", Open::Way { nodes, .. }) => nodes.push(attributes.id("ref", name)?),
            (3, "member", Open::Relation { relation, .. }) => relation.members.push(Member {
                kind: attributes.get("type").unwrap_or_default().to_owned(),
                id: attributes.id("ref", name)?,
                role: attributes.get("role").unwrap_or_default().to_owned(),
            }),
            (3, "tag", Open::Node { local, .. }) => {
                let axis = ["local_x", "local_y"].iter().position(|axis| attributes.get("k") == Some(axis));
                if let Some(axis) = axis {
                    local[axis] = attributes.coordinate("v", EARTH_M, "m").ok();
                }
            }
            (3, "tag", Open::Relation { relation, .. }) => {
                if let (Some(key), Some(value)) = (attributes.get("k"), attributes.get("v")) {
                    relation.tags.insert(key.to_owned(), value.to_owned());
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// Closes the element at `depth`.
    fn end(&mut self, depth: usize) {
        if depth != 2 {
            return;
        }
        let duplicate = match std::mem::replace(&mut self.open, Open::Nothing) {
            Open::Way { id, nodes } => insert_new(&mut self.osm.ways, id, nodes).then_some(("way", id)),
            Open::Relation { id, relation } => {
                insert_new(&mut self.osm.relations, id, relation).then_some(("relation", id))
            }
            Open::Node { id, position, local } => self.add_node(id, position, local).then_some(("node", id)),
            Open::Nothing | Open::Deleted => None,
        };
        if let Some((kind, id)) = duplicate {
            self.report.warn("duplicate_id", format!("{kind} {id}: the first of this id is kept"));
        }
    }

    /// Adds a node, and returns whether there was one with this id.
    fn add_node(&mut self, id: i64, position: Result<NodePosition, Malformed>, local: [Option<f64>; 2]) -> bool {
        let is_nowhere = match &position {
            Ok(position) => *position == NodePosition::Geo(GeoPoint::NOWHERE),
            Err(_) => true,
        };
        if let [Some(x), Some(y)] = local {
            self.osm.local.entry(id).or_insert(Vec2::new(x, y));
            self.osm.is_local |= is_nowhere;
        }
        match position {
            Ok(position) => insert_new(&mut self.osm.nodes, id, position),
            Err(_) if self.osm.local.contains_key(&id) => false,
            Err(what) => {
                self.report.warn("node_without_position", format!("node {id}: {what}"));
                insert_new(&mut self.osm.misplaced, id, what.to_string());
                false
            }
        }
    }
}

/// Inserts unless the key exists, and returns whether it did.
fn insert_new<T>(elements: &mut BTreeMap<i64, T>, id: i64, element: T) -> bool {
    let taken = elements.contains_key(&id);
    if !taken {
        elements.insert(id, element);
    }
    taken
}

struct Attributes(Vec<(String, String)>);

impl Attributes {
    fn read(element: &BytesStart<'_>) -> Result<Self, Malformed> {
        let mut pairs = Vec::new();
        // The library's check for duplicates takes quadratic time; here the first attribute with a name counts.
        for attribute in element.attributes().with_checks(false) {
            let attribute = attribute?;
            if pairs.len() == MAX_ATTRIBUTES {
                return Err(format!("an element has more than {MAX_ATTRIBUTES} attributes").into());
            }
            // Resolves the five predefined entities and character references, and refuses all others.
            let value =
                attribute.normalized_value(XmlVersion::Implicit1_0).map_err(|error| format!("attribute: {error}"))?;
            pairs.push((AsRef::<str>::as_ref(&attribute.key).to_owned(), value.into_owned()));
        }
        Ok(Self(pairs))
    }

    fn get(&self, key: &str) -> Option<&str> {
        self.0.iter().find(|(k, _)| k == key).map(|(_, value)| value.as_str())
    }

    fn id(&self, key: &str, element: &str) -> Result<i64, Malformed> {
        let text = self.get(key).ok_or_else(|| format!("`<{element}>` without `{key}`"))?;
        text.parse().map_err(|_| format!("`<{element}>`: `{key}` is \"{text}\", expected a whole number").into())
    }

    /// `x` and `y` if given, otherwise `lat` and `lon`; or what is wrong with them.
    fn position(&self) -> Result<NodePosition, Malformed> {
        let is_number = |key| self.get(key).is_some_and(|text| text.trim().parse::<f64>().is_ok());
        let has = |key| self.get(key).is_some();
        if (is_number("x") && is_number("y")) || (has("x") && has("y") && !(has("lat") && has("lon"))) {
            let point = Vec2::new(self.coordinate("x", EARTH_M, "m")?, self.coordinate("y", EARTH_M, "m")?);
            return Ok(NodePosition::Plane(point));
        }
        if !(has("lat") && has("lon")) {
            return Err("has no position; it needs `lat` and `lon`, or `x` and `y`".into());
        }
        let latitude_deg = self.coordinate("lat", MAX_LATITUDE_DEG, "degrees")?;
        let longitude_deg = self.coordinate("lon", MAX_LONGITUDE_DEG, "degrees")?;
        Ok(NodePosition::Geo(GeoPoint { latitude_deg, longitude_deg }))
    }

    /// The number in attribute `key`, whose absolute value must not exceed `limit`.
    fn coordinate(&self, key: &str, limit: f64, unit: &str) -> Result<f64, Malformed> {
        let text = self.get(key).unwrap_or_default();
        let number = text.trim().parse::<f64>().ok().filter(|number| number.abs() <= limit);
        number.ok_or_else(|| format!("`{key}` is \"{text}\", expected a number from -{limit} to {limit} {unit}").into())
    }
}
