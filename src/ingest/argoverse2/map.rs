//! Argoverse 2 maps: from the JSON of a scenario's surroundings to a lane graph.

use crate::geometry::{Polyline, Vec2};
use crate::ingest::error::Malformed;
use crate::ingest::lane_topology::connect;
use crate::ingest::map_report::MapReport;
use crate::ingest::plausible_lanes::{plausible, turn_around};
use crate::scene::{Lane, LaneAttributes, LaneGraph, LaneId};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Lanes for bicycles are left out, because no generated vehicle drives on them.
const DRIVING_LANES: [&str; 2] = ["VEHICLE", "BUS"];

/// Points of a centerline that is computed from the boundaries, as in the official reader.
const N_CENTERLINE_POINTS: usize = 10;

#[derive(Deserialize)]
struct MapJson<Segment> {
    lane_segments: BTreeMap<String, Segment>,
}

#[derive(Deserialize)]
struct LaneSegment {
    id: i64,
    lane_type: String,
    is_intersection: bool,
    left_lane_boundary: Vec<Point>,
    right_lane_boundary: Vec<Point>,
    centerline: Option<Vec<Point>>,
    #[serde(default)]
    successors: Vec<i64>,
    #[serde(default)]
    predecessors: Vec<i64>,
    left_neighbor_id: Option<i64>,
    right_neighbor_id: Option<i64>,
    left_lane_mark_type: Option<String>,
    right_lane_mark_type: Option<String>,
}

#[derive(Deserialize)]
struct Point {
    x: f64,
    y: f64,
}

/// Reads a map and reports the lanes that it leaves out.
pub(super) fn parse(json: &[u8]) -> Result<(LaneGraph, MapReport), Malformed> {
    let mut report = MapReport::default();
    let segments = segments(json, &mut report)?;
    let driving = segments.into_iter().filter(|lane| DRIVING_LANES.contains(&lane.lane_type.as_str()));
    let lanes = driving.map(|lane| lane.into_lane(&mut report)).collect();
    let lanes = plausible(lanes, &mut report);
    if lanes.is_empty() && !report.warnings.is_empty() {
        return Err(format!("has no lane that can be used: {}", report.summary()).into());
    }
    report.n_lanes = lanes.len() as u64;
    Ok((connect(lanes), report))
}

/// The lanes of all types. Incomplete ones are left out, one by one.
fn segments(json: &[u8], report: &mut MapReport) -> Result<Vec<LaneSegment>, Malformed> {
    if let Ok(map) = serde_json::from_slice::<MapJson<LaneSegment>>(json) {
        return Ok(map.lane_segments.into_values().collect());
    }
    let json = without_nan(json);
    let map: MapJson<serde_json::Value> = serde_json::from_slice(&json)?;
    let mut whole = Vec::new();
    for (key, segment) in map.lane_segments {
        match serde_json::from_value(segment) {
            Ok(segment) => whole.push(segment),
            Err(what) => report.warn("broken_lanes", format!("lane {key}: {what}")),
        }
    }
    Ok(whole)
}

/// The JSON without a byte order mark, and with `null` in place of Python's `NaN` and `Infinity`.
fn without_nan(json: &[u8]) -> Vec<u8> {
    let mut rest = json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(json);
    let mut plain = Vec::with_capacity(rest.len());
    let (mut is_text, mut is_escaped) = (false, false);
    while let Some((byte, after)) = rest.split_first() {
        let number = [&b"NaN"[..], b"Infinity", b"-Infinity"].into_iter().find(|number| rest.starts_with(number));
        if let Some(number) = number.filter(|_| !is_text) {
            plain.extend(b"null");
            rest = &rest[number.len()..];
            continue;
        }
        is_text ^= *byte == b'"' && !is_escaped;
        is_escaped = is_text && *byte == b'\\' && !is_escaped;
        plain.push(*byte);
        rest = after;
    }
    plain
}

impl LaneSegment {
    fn into_lane(self, report: &mut MapReport) -> Lane {
        let (mut left, mut right) = (line(&self.left_lane_boundary), line(&self.right_lane_boundary));
        let mut given = self.centerline.as_deref().map(line);
        if turn_around(&mut left, &mut right, given.as_mut()) {
            report.warn("lanes_turned_around", format!("lane {}: its lines ran against one another", self.id));
        }
        let centerline = given.unwrap_or_else(|| between(&left, &right));
        let marks = [("left_mark", self.left_lane_mark_type), ("right_mark", self.right_lane_mark_type)];
        let tags = marks.into_iter().filter_map(|(name, mark)| mark.map(|mark| (name.to_owned(), mark))).collect();
        let ids = |ids: Vec<i64>| ids.into_iter().map(LaneId).collect();
        Lane {
            id: LaneId(self.id),
            centerline,
            left,
            right,
            successors: ids(self.successors),
            predecessors: ids(self.predecessors),
            left_neighbor: self.left_neighbor_id.map(LaneId),
            right_neighbor: self.right_neighbor_id.map(LaneId),
            attributes: Arc::new(LaneAttributes {
                kind: self.lane_type,
                is_intersection: self.is_intersection,
                one_way: true,
                tags,
                ..LaneAttributes::default()
            }),
        }
    }
}

/// The points of a line, without repetitions.
fn line(points: &[Point]) -> Polyline {
    let mut points: Vec<Vec2> = points.iter().map(|point| Vec2::new(point.x, point.y)).collect();
    points.dedup();
    Polyline(points)
}

/// The line half way between two boundaries.
fn between(left: &Polyline, right: &Polyline) -> Polyline {
    let pairs = left.resampled(N_CENTERLINE_POINTS).0.into_iter().zip(right.resampled(N_CENTERLINE_POINTS).0);
    Polyline(pairs.map(|(left, right)| left.lerp(right, 0.5)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn segment(id: i64, kind: &str, more: &str) -> String {
        format!(
            r#""{id}": {{"id": {id}, "is_intersection": false, "lane_type": "{kind}",
            "left_lane_boundary": [{{"x": 0, "y": 2, "z": 1}}, {{"x": 10, "y": 2, "z": 1}}],
            "right_lane_boundary": [{{"x": 0, "y": -2, "z": 1}}, {{"x": 5, "y": -2, "z": 1}}, {{"x": 10, "y": -2, "z": 1}}],
            "left_lane_mark_type": "NONE", "right_lane_mark_type": "SOLID_WHITE", {more}
            "successors": [7, 8], "predecessors": []}}"#
        )
    }

    fn map(segments: &[String]) -> String {
        format!(
            r#"{{"drivable_areas": {{}}, "pedestrian_crossings": {{}}, "lane_segments": {{{}}}}}"#,
            segments.join(",")
        )
    }

    #[test]
    fn driving_lanes_are_kept_and_connected() {
        let none = r#""left_neighbor_id": null, "right_neighbor_id": 9,"#;
        let text = map(&[segment(6, "VEHICLE", none), segment(7, "BUS", ""), segment(9, "BIKE", none)]);
        let (graph, report) = parse(text.as_bytes()).expect("well formed");
        assert_eq!(report.summary(), "");
        assert_eq!(graph.lanes().iter().map(|lane| lane.id.0).collect::<Vec<_>>(), [6, 7]);
        let first = &graph.lanes()[0];
        assert_eq!((first.successors.as_slice(), first.right_neighbor), ([LaneId(7)].as_slice(), None));
        assert_eq!(graph.lanes()[1].predecessors, [LaneId(6)]);
        assert_eq!(first.attributes.tags["right_mark"], "SOLID_WHITE");
    }

    #[test]
    fn centerlines_are_read_or_computed() {
        let given = r#""centerline": [{"x": 0, "y": 0.5, "z": 0}, {"x": 10, "y": 0.5, "z": 0}],"#;
        let (graph, _) =
            parse(map(&[segment(1, "VEHICLE", given), segment(2, "VEHICLE", "")]).as_bytes()).expect("well formed");
        assert_eq!(graph.lanes()[0].centerline.0, [Vec2::new(0.0, 0.5), Vec2::new(10.0, 0.5)]);
        let computed = &graph.lanes()[1].centerline;
        assert_eq!(computed.0.len(), N_CENTERLINE_POINTS);
        assert!(computed.0.iter().all(|point| point.y.abs() < 1e-12));
        assert!((computed.length_m() - 10.0).abs() < 1e-12);
    }

    #[test]
    fn one_bad_lane_does_not_cost_the_map() {
        let whole = segment(1, "VEHICLE", "");
        for (fault, reason, expected) in [
            (
                segment(2, "VEHICLE", "").replace("\"x\": 10", "\"x\": 0"),
                "lanes_without_length",
                "lane 2: its left bound",
            ),
            (segment(1, "VEHICLE", "").replacen("\"1\"", "\"2\"", 1), "lanes_of_repeated_ids", "lane 1: "),
            (segment(2, "VEHICLE", "").replace("successors", "successor"), "", ""),
            (segment(2, "VEHICLE", "").replace("lane_type", "type"), "broken_lanes", "lane 2: missing field"),
        ] {
            let (graph, report) = parse(map(&[whole.clone(), fault]).as_bytes()).expect("a lane is whole");
            assert_eq!(graph.lanes().len(), 1 + usize::from(reason.is_empty()), "{expected}");
            let found = report.warnings.get(reason).map_or("", |found| found.examples[0].as_str());
            assert!(found.starts_with(expected), "{}", report.summary());
        }
    }

    #[test]
    fn what_python_writes_is_read() {
        let whole = map(&[segment(1, "VEHICLE", "\"note\": \"a \\\"NaN\","), segment(2, "VEHICLE", "")]);
        let graph =
            |text: &str| parse(text.as_bytes()).map(|(graph, report)| (graph.lanes().len(), report.warnings.len()));
        let found = graph(&format!("\u{feff}{}", whole.replace("\"z\": 1", "\"z\": NaN"))).expect("z is not used");
        assert_eq!(found, (2, 0));
        assert_eq!(graph(&whole.replace("\"z\": 1", "\"z\": -Infinity")).expect("z is not used"), (2, 0));
        assert_eq!(graph(&whole.replacen("\"x\": 5", "\"x\": NaN", 1)).expect("a lane is whole"), (1, 1));
    }

    #[test]
    fn lines_against_their_lane_are_turned() {
        let left = r#"[{"x": 0, "y": 2, "z": 1}, {"x": 10, "y": 2, "z": 1}]"#;
        let turned = segment(1, "VEHICLE", "").replace(left, r#"[{"x": 10, "y": 2}, {"x": 0, "y": 2}]"#);
        let given = r#""centerline": [{"x": 10, "y": 0}, {"x": 0, "y": 0}],"#;
        for faulty in [turned, segment(1, "VEHICLE", given)] {
            let (graph, report) = parse(map(&[faulty]).as_bytes()).expect("it can be mended");
            let lane = &graph.lanes()[0];
            assert!((lane.left.0[0].x, lane.centerline.0[0].x) == (0.0, 0.0), "{lane:?}");
            assert!((lane.centerline.length_m() - 10.0).abs() < 1e-9);
            assert_eq!(report.warnings["lanes_turned_around"].count, 1);
        }
    }

    #[test]
    fn faulty_maps_are_refused() {
        let whole = map(&[segment(1, "VEHICLE", "")]);
        assert!(parse(&whole.as_bytes()[..whole.len() / 2]).expect_err("cut").to_string().contains("line"));
        assert!(parse(b"[]").is_err() && parse(b"").is_err());
        assert!(parse(whole.replace("\"x\": 10", "\"x\": 1e999").as_bytes()).is_err());
        assert!(
            parse(whole.replace("\"x\": 10", "\"x\": 0").as_bytes())
                .expect_err("a point")
                .to_string()
                .contains("lane 1")
        );
        let deep = format!("{{\"lane_segments\": {}", "[".repeat(100_000));
        assert!(parse(deep.as_bytes()).is_err());
    }
}
