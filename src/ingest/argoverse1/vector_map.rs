//! Argoverse 1 maps: from the XML of a city's lane centerlines to a lane graph.
//!
//! `<node id x y/>` are points, `<way lane_id>` are centerlines of `<nd ref/>` with attributes in `<tag k v/>`.
//! Booleans are `True` and `False`, a missing neighbor is `None`, and ids may name lanes outside the file.

use crate::geometry::{Polyline, Vec2};
use crate::ingest::assemble::MAX_COORDINATE_M;
use crate::ingest::assumed_bounds::{ASSUMED_LANE_WIDTH_M, beside};
use crate::ingest::error::{Error, Malformed};
use crate::ingest::lane_topology::connect;
use crate::ingest::map_report::MapReport;
use crate::ingest::map_text::{line_at, read_text};
use crate::ingest::plausible_lanes::plausible;
use crate::scene::{Lane, LaneAttributes, LaneGraph, LaneId, TurnDirection};
use quick_xml::XmlVersion;
use quick_xml::events::{BytesStart, Event};
use quick_xml::reader::Reader;
use std::collections::HashMap;
use std::io::BufRead;

/// Larger than the map of any city; a longer file is not a map.
const MAX_MAP_BYTES: u64 = 256 << 20;

/// The city in the name of a map file: `pruned_argoverse_MIA_10316_vector_map.xml` is `MIA`.
pub(super) fn city_of(file_name: &str) -> Option<&str> {
    let stem = file_name.strip_suffix("_vector_map.xml")?;
    stem.split('_').find(|word| word.len() >= 2 && word.bytes().all(|byte| byte.is_ascii_uppercase()))
}

/// Reads a vector map and reports the lanes that it leaves out.
pub(super) fn read(file: &str, reader: &mut dyn BufRead) -> Result<(LaneGraph, MapReport), Error> {
    let text = read_text(reader, MAX_MAP_BYTES, file)?;
    let mut xml = Reader::from_str(&text);
    let mut map = VectorMap::default();
    loop {
        let event = xml.read_event();
        let done = event.map_err(Malformed::from).and_then(|event| map.take(&event)).map_err(|malformed| {
            let at = xml.error_position().max(xml.buffer_position());
            let at = usize::try_from(at).unwrap_or(text.len());
            Error::map(file, format!("line {}", line_at(text.as_bytes(), at)), malformed)
        })?;
        if done {
            break;
        }
    }
    let mut report = map.report;
    let mut lanes = plausible(map.lanes, &mut report);
    if lanes.is_empty() {
        let detail = format!("holds no lanes (`way` elements with a `lane_id`) {}", report.summary());
        return Err(Error::map(file, "", detail.trim_end()));
    }
    for lane in &mut lanes {
        lane.left = beside(&lane.centerline.0, ASSUMED_LANE_WIDTH_M / 2.0);
        lane.right = beside(&lane.centerline.0, -ASSUMED_LANE_WIDTH_M / 2.0);
    }
    report.n_lanes = lanes.len() as u64;
    Ok((connect(lanes), report))
}

#[derive(Default)]
struct VectorMap {
    /// Names of the open elements, outermost first.
    open: Vec<String>,
    nodes: HashMap<i64, Vec2>,
    way: Option<Way>,
    lanes: Vec<Lane>,
    report: MapReport,
}

#[derive(Default)]
struct Way {
    id: i64,
    /// The first flaw, for which the lane is left out.
    flaw: Option<String>,
    points: Vec<Vec2>,
    left_neighbor: Option<LaneId>,
    right_neighbor: Option<LaneId>,
    successors: Vec<LaneId>,
    predecessors: Vec<LaneId>,
    attributes: LaneAttributes,
}

impl VectorMap {
    /// Handles one event; returns `true` after the last.
    fn take(&mut self, event: &Event<'_>) -> Result<bool, Malformed> {
        match event {
            Event::Start(element) => {
                self.begin(element)?;
                self.open.push(element.name().as_ref().to_owned());
            }
            Event::Empty(element) => {
                self.begin(element)?;
                self.end(element.name().as_ref())?;
            }
            Event::End(element) => {
                self.open.pop();
                self.end(element.name().as_ref())?;
            }
            // Entities could grow without bound, and no map has any.
            Event::DocType(_) => return Err("has a document type declaration, which maps never have".into()),
            Event::Eof => {
                return match self.open.last() {
                    Some(element) => Err(format!("ends within <{element}>; the file is cut short").into()),
                    None => Ok(true),
                };
            }
            _ => {}
        }
        Ok(false)
    }

    fn begin(&mut self, element: &BytesStart<'_>) -> Result<(), Malformed> {
        let name = element.name();
        match (name.as_ref(), &mut self.way) {
            ("ArgoverseVectorMap", _) if self.open.is_empty() => {}
            (root, _) if self.open.is_empty() => {
                return Err(format!("begins with <{root}>, expected <ArgoverseVectorMap>").into());
            }
            ("node", _) => {
                let id = integer("node id", &attribute(element, "id")?)?;
                match coordinate(element, "x").and_then(|x| Ok(Vec2::new(x, coordinate(element, "y")?))) {
                    Ok(position) => drop(self.nodes.insert(id, position)),
                    Err(what) => self.report.warn("nodes_without_position", format!("node {id}: {what}")),
                }
            }
            ("way", None) => {
                let id = integer("lane_id", &attribute(element, "lane_id")?)?;
                self.way = Some(Way { id, ..Way::default() });
            }
            ("way", Some(way)) => return Err(format!("way {} holds another way", way.id).into()),
            ("nd", Some(way)) => {
                let node = integer("node reference", &attribute(element, "ref")?)?;
                match self.nodes.get(&node) {
                    Some(point) => way.points.push(*point),
                    None => way.fault(format!("refers to missing node {node}")),
                }
            }
            ("tag", Some(way)) => {
                let (key, value) = (attribute(element, "k")?, attribute(element, "v")?);
                way.tag(&key, &value).unwrap_or_else(|malformed| way.fault(malformed.to_string()));
            }
            _ => {}
        }
        Ok(())
    }

    fn end(&mut self, name: &str) -> Result<(), Malformed> {
        if name == "way"
            && let Some(way) = self.way.take()
        {
            match &way.flaw {
                Some(flaw) => self.report.warn("broken_lanes", format!("way {}: {flaw}", way.id)),
                None => self.lanes.push(way.into_lane()),
            }
        }
        Ok(())
    }
}

impl Way {
    fn tag(&mut self, key: &str, value: &str) -> Result<(), Malformed> {
        match key {
            "has_traffic_control" => self.attributes.has_traffic_control = boolean(key, value)?,
            "is_intersection" => self.attributes.is_intersection = boolean(key, value)?,
            "turn_direction" => {
                self.attributes.turn = match value {
                    "LEFT" => TurnDirection::Left,
                    "RIGHT" => TurnDirection::Right,
                    "NONE" | "None" => TurnDirection::None,
                    _ => return Err(format!("turn_direction is `{value}`, expected LEFT, RIGHT or NONE").into()),
                }
            }
            "l_neighbor_id" => self.left_neighbor = lane_id(key, value)?,
            "r_neighbor_id" => self.right_neighbor = lane_id(key, value)?,
            "predecessor" => self.predecessors.extend(lane_id(key, value)?),
            "successor" => self.successors.extend(lane_id(key, value)?),
            _ => {
                self.attributes.tags.insert(key.to_owned(), value.to_owned());
            }
        }
        Ok(())
    }

    fn fault(&mut self, what: String) {
        self.flaw.get_or_insert(what);
    }

    /// The lane, without bounds.
    fn into_lane(self) -> Lane {
        let mut points = self.points;
        points.dedup();
        let mut attributes = self.attributes;
        attributes.one_way = true;
        attributes.tags.insert("boundaries".to_owned(), format!("assumed:{ASSUMED_LANE_WIDTH_M}_m_wide"));
        Lane {
            id: LaneId(self.id),
            left: Polyline::default(),
            right: Polyline::default(),
            centerline: Polyline(points),
            successors: self.successors,
            predecessors: self.predecessors,
            left_neighbor: self.left_neighbor,
            right_neighbor: self.right_neighbor,
            attributes: attributes.into(),
        }
    }
}

fn attribute(element: &BytesStart<'_>, name: &str) -> Result<String, Malformed> {
    let tag = element.name();
    let attribute = element.try_get_attribute(name)?;
    let attribute = attribute.ok_or_else(|| format!("<{}> has no attribute `{name}`", tag.as_ref()))?;
    Ok(attribute.normalized_value(XmlVersion::Implicit1_0)?.into_owned())
}

fn coordinate(element: &BytesStart<'_>, name: &str) -> Result<f64, Malformed> {
    let text = attribute(element, name)?;
    let value = text.trim().parse::<f64>().ok().filter(|value| value.abs() <= MAX_COORDINATE_M);
    let expected = format!("a number from -{MAX_COORDINATE_M} to {MAX_COORDINATE_M} m");
    value.ok_or_else(|| format!("node coordinate {name} is `{text}`, expected {expected}").into())
}

fn integer(what: &str, text: &str) -> Result<i64, Malformed> {
    text.trim().parse().map_err(|_| format!("{what} is `{text}`, expected an integer").into())
}

fn lane_id(key: &str, value: &str) -> Result<Option<LaneId>, Malformed> {
    if value == "None" { Ok(None) } else { integer(key, value).map(|id| Some(LaneId(id))) }
}

fn boolean(key: &str, value: &str) -> Result<bool, Malformed> {
    match value {
        "True" => Ok(true),
        "False" => Ok(false),
        _ => Err(format!("{key} is `{value}`, expected True or False").into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WAYS: &str = r#"
        <node id="0" x="0" y="0"/> <node id="1" x="10" y="0" height="3.5"/> <node id="2" x="20" y="0"/>
        <node id="3" x="20" y="3.8"/> <node id="4" x="0" y="3.8"/>
        <way lane_id="100">
          <tag k="has_traffic_control" v="True"/> <tag k="turn_direction" v="LEFT"/> <tag k="is_intersection" v="False"/>
          <tag k="l_neighbor_id" v="102"/> <tag k="r_neighbor_id" v="None"/> <tag k="surface" v="gravel"/>
          <nd ref="0"/> <nd ref="1"/> <tag k="successor" v="101"/> <tag k="successor" v="999"/>
        </way>
        <way lane_id="101"><nd ref="1"/><nd ref="2"/><tag k="r_neighbor_id" v="777"/></way>
        <way lane_id="102"><nd ref="3"/><nd ref="4"/><tag k="l_neighbor_id" v="100"/></way>"#;

    fn read_whole(text: &str) -> Result<(LaneGraph, MapReport), Error> {
        read("m_MIA_1_vector_map.xml", &mut text.as_bytes())
    }

    fn read_ways(ways: &str) -> Result<(LaneGraph, MapReport), Error> {
        read_whole(&format!("<ArgoverseVectorMap>{ways}</ArgoverseVectorMap>"))
    }

    fn message(ways: &str) -> String {
        read_ways(ways).expect_err("the map is faulty").to_string()
    }

    #[test]
    fn lanes_have_attributes_links_and_assumed_boundaries() {
        let (graph, report) = read_ways(WAYS).expect("well formed");
        assert_eq!(report.summary(), "");
        let lane = graph.get(LaneId(100)).expect("listed");
        assert!(lane.attributes.has_traffic_control && !lane.attributes.is_intersection && lane.attributes.one_way);
        assert_eq!(lane.attributes.turn, TurnDirection::Left);
        assert_eq!(lane.successors, [LaneId(101)]);
        assert_eq!(graph.get(LaneId(101)).expect("listed").predecessors, [LaneId(100)]);
        assert_eq!(lane.left_neighbor, None, "the neighbor drives the other way");
        assert_eq!(lane.attributes.tags["opposite_left_neighbor"], "102");
        assert_eq!(lane.attributes.tags["surface"], "gravel", "what we have no field for is kept");
        assert!(lane.left.0[0].distance(Vec2::new(0.0, 1.9)) < 1e-12);
        assert!(lane.right.0[1].distance(Vec2::new(10.0, -1.9)) < 1e-12);
        assert!(lane.attributes.tags["boundaries"].starts_with("assumed"));
    }

    #[test]
    fn boundaries_of_a_bend_keep_their_distance() {
        let arc: Vec<Vec2> = (0..10).map(|i| Vec2::from_angle(i as f64 * 0.1) * 20.0).collect();
        for (point, left) in arc.iter().zip(beside(&arc, 1.9).0).skip(1).take(8) {
            assert!((left.norm() - 18.1).abs() < 1e-9 && (point.distance(left) - 1.9).abs() < 1e-9);
        }
    }

    #[test]
    fn cities_come_from_file_names() {
        assert_eq!(city_of("pruned_argoverse_MIA_10316_vector_map.xml"), Some("MIA"));
        assert_eq!(city_of("pruned_argoverse_PIT_10314_vector_map.xml"), Some("PIT"));
        assert_eq!(city_of("MIA_10316_driveable_area.npy"), None);
        assert_eq!(city_of("my_vector_map.xml"), None);
    }

    #[test]
    fn faults_name_the_file_the_place_and_the_element() {
        assert!(message(&WAYS.replace(r#"ref="9"#, r#"ref="x"#).replace(r#"ref="2"#, r#"ref="y"#)).contains(", line "));
        assert!(message("").contains("no lanes"));
        assert!(message(r#"<way lane_id="7"><nd ref="1"/></way>"#).contains("way 7: refers to missing node 1"));
        assert!(message("<way><nd ref=\"1\"/></way>").contains("lane_id"));
        assert!(message(r#"<way lane_id="1"><way lane_id="2"/></way>"#).contains("another way"));
    }

    #[test]
    fn one_bad_lane_does_not_cost_the_map() {
        for (fault, n_lanes, expected) in [
            (WAYS.replace(r#"<nd ref="2"/>"#, r#"<nd ref="9"/>"#), 2, "way 101: refers to missing node 9"),
            (WAYS.replace("20", "NaN"), 1, "node coordinate x is `NaN`, expected a number"),
            (WAYS.replace("20", "1e8"), 1, "node coordinate x is `1e8`, expected a number"),
            (WAYS.replace("\"True\"", "\"yes\""), 2, "way 100: has_traffic_control is `yes`"),
            (WAYS.replace(r#"<nd ref="3"/>"#, ""), 2, "lane 102: its centerline has fewer than 2 distinct points"),
            (WAYS.replace("lane_id=\"102", "lane_id=\"100"), 2, "lane 100: the first of this id is kept"),
        ] {
            let (graph, report) = read_ways(&fault).expect("the other lanes are whole");
            assert_eq!(graph.lanes().len(), n_lanes, "{fault}");
            assert!(report.summary().contains(expected), "{}", report.summary());
        }
    }

    #[test]
    fn cut_or_foreign_files_are_refused() {
        let whole = format!("<ArgoverseVectorMap>{WAYS}</ArgoverseVectorMap>");
        for cut in [whole.len() - 5, whole.len() / 2, 30] {
            assert!(read_whole(&whole[..cut]).is_err(), "cut at {cut}");
        }
        assert!(read_whole("<osm/>").expect_err("foreign").to_string().contains("<osm>"));
        assert!(read_whole("").is_err());
        assert!(read_whole("no map at all").is_err());
    }

    #[test]
    fn maps_are_read_in_the_encoding_they_declare() {
        let ways = WAYS.replace("gravel", "Stra\u{df}e");
        let whole = |declaration: &str| format!("{declaration}<ArgoverseVectorMap>{ways}</ArgoverseVectorMap>");
        let (expected, _) = read_whole(&whole("")).expect("in UTF-8");
        assert_eq!(expected.get(LaneId(100)).expect("listed").attributes.tags["surface"], "Stra\u{df}e");
        assert_eq!(read_whole(&whole("\u{feff}")).expect("with a byte order mark").0, expected);
        let latin1 = |declaration: &str| {
            let bytes: Vec<u8> = whole(declaration).chars().map(|c| c as u8).collect();
            read("m_MIA_1_vector_map.xml", &mut bytes.as_slice())
        };
        assert_eq!(latin1(r#"<?xml version="1.0" encoding="ISO-8859-1"?>"#).expect("declared").0, expected);
        assert!(latin1("").expect_err("no UTF-8").to_string().contains("does not declare to be ISO-8859-1"));
    }

    #[test]
    fn entities_are_refused_before_they_grow() {
        let bomb =
            r#"<!DOCTYPE m [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]><ArgoverseVectorMap>&b;</ArgoverseVectorMap>"#;
        assert!(read_whole(bomb).expect_err("bomb").to_string().contains("document type"));
        assert!(message(r#"<node id="&b;" x="0" y="0"/>"#).contains(", line 1"));
    }
}
