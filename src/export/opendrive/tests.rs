//! OpenDRIVE: does an evaluation of a file by the standard's formulas find the lanes in their places?

use super::cross_section::without_foretold;
use super::*;
use crate::export::testing::{self, Node};
use crate::geometry::{Polyline, Vec2};
use std::f64::consts::FRAC_PI_2;

/// How far a lane may be from its road, meters.
const NEAR_M: f64 = 0.03;

fn document(lanes: Vec<Lane>) -> Node {
    let network = of(&LaneGraph::new(lanes)).unwrap();
    let mut bytes = Vec::new();
    network.root.write_document(&mut bytes).unwrap();
    Node::parse(&String::from_utf8(bytes).unwrap())
}

fn lane(id: i64, left: Vec<Vec2>, right: Vec<Vec2>) -> Lane {
    Lane { left: Polyline(left), right: Polyline(right), ..testing::lane(id) }
}

/// The value of the last of these records that begins at or before `s`.
fn polynomial(records: &[&Node], place: &str, s: f64) -> f64 {
    let record = records.iter().rev().find(|record| record.attr_number(place) <= s + 1e-9).unwrap();
    let ds = s - record.attr_number(place);
    ["d", "c", "b", "a"].iter().fold(0.0, |sum, name| sum * ds + record.attr_number(name))
}

/// Left edge, middle and right edge of the road's lane at `s`, by sections 9 (geometry) and 11 (lanes) of the standard.
fn across(road: &Node, s: f64) -> [Vec2; 3] {
    let pieces = road.at("planView").all("geometry");
    let piece = pieces.iter().rev().find(|piece| piece.attr_number("s") <= s + 1e-9).unwrap();
    let ds = s - piece.attr_number("s");
    let (mut u, mut v, mut slope) = (ds, 0.0, 0.0);
    for poly in piece.all("paramPoly3") {
        assert_eq!(poly.attr("pRange"), "normalized");
        let p = ds / piece.attr_number("length");
        let value = |of: &str| {
            let [a, b, c, d] = ["a", "b", "c", "d"].map(|name| poly.attr_number(&format!("{name}{of}")));
            (a + p * (b + p * (c + p * d)), b + p * (2.0 * c + p * 3.0 * d))
        };
        let ((at_u, du), (at_v, dv)) = (value("U"), value("V"));
        (u, v, slope) = (at_u, at_v, dv.atan2(du));
    }
    let heading = piece.attr_number("hdg");
    let start = Vec2::new(piece.attr_number("x"), piece.attr_number("y"));
    let middle = start + Vec2::new(u, v).rotated(heading);
    let to_left = Vec2::from_angle(heading + slope + FRAC_PI_2);
    let lanes = road.at("lanes");
    let offset = polynomial(&lanes.all("laneOffset"), "s", s);
    let lane = lanes.at("laneSection").at("right").at("lane");
    assert_eq!(lane.attr("id"), "-1");
    let width = polynomial(&lane.all("width"), "sOffset", s);
    assert!(width >= 0.0);
    [offset, offset - 0.5 * width, offset - width].map(|t| middle + to_left * t)
}

/// The largest distance from points along `line` to one of the three lines along the road. Roads end square and lanes
/// need not: edges are looked at from `from_end_m` off their ends on.
fn largest_distance(road: &Node, which: usize, line: &Polyline, from_end_m: f64) -> f64 {
    let length = road.attr_number("length");
    let n = (length / 0.01).ceil();
    let drawn = Polyline((0..=n as usize).map(|i| across(road, length * i as f64 / n)[which]).collect());
    let distance = |point: Vec2| drawn.project(point).unwrap().point.distance(point);
    let n_skipped = (200.0 * from_end_m / line.length_m()).ceil() as usize;
    let inner = line.resampled(201).0.into_iter().skip(n_skipped).take(201 - 2 * n_skipped);
    inner.map(distance).fold(0.0, f64::max)
}

/// An arc about the origin, of `n` chords.
fn arc(radius_m: f64, n: usize) -> Vec<Vec2> {
    (0..=n).map(|i| Vec2::from_angle(FRAC_PI_2 * i as f64 / n as f64) * radius_m).collect()
}

#[test]
fn points_along_lanes_lie_on_their_roads_within_centimeters() {
    let point = |x: f64, y: f64| Vec2::new(x, y);
    let turn = lane(1, arc(10.0, 24), arc(13.5, 31));
    // A lane that narrows to nothing, one with oblique ends, and one whose boundaries have corners in different places.
    let tapered =
        lane(2, vec![point(0.0, 3.0), point(50.0, 3.0), point(80.0, 0.0)], vec![point(0.0, 0.0), point(80.0, 0.0)]);
    let oblique = lane(3, vec![point(2.0, 3.5), point(42.0, 3.5)], vec![point(0.0, 0.0), point(40.0, 0.0)]);
    let bent = lane(
        4,
        vec![point(0.0, 3.0), point(20.0, 3.0), point(40.0, 4.0), point(60.0, 4.0)],
        vec![point(0.0, -1.0), point(25.0, -1.0), point(45.0, 0.5), point(60.0, 0.5)],
    );
    let lanes = vec![turn, tapered, oblique, bent];
    let root = document(lanes.clone());
    for (road, lane) in root.all("road").into_iter().zip(&lanes) {
        let name = road.attr("name");
        assert_eq!(name, format!("lane {}", lane.id.0));
        let middle: Vec<Vec2> = (0..=100)
            .map(|i| {
                let at = |line: &Polyline| line.point_at(line.length_m() * f64::from(i) / 100.0).unwrap();
                at(&lane.left).lerp(at(&lane.right), 0.5)
            })
            .collect();
        let cut_m = if lane.id.0 == 3 { 1.1 } else { 0.2 };
        for (which, line, cut_m) in [(0, &lane.left, cut_m), (1, &Polyline(middle), 0.0), (2, &lane.right, cut_m)] {
            let distance = largest_distance(road, which, line, cut_m);
            assert!(distance < NEAR_M, "{name}, line {which}: {distance} m");
        }
    }
    // As long as the arc between its boundaries.
    let length = root.all("road")[0].attr_number("length");
    assert!((length - 11.75 * FRAC_PI_2).abs() < 0.02, "{length}");
    // Where its edges have crossed, a lane is a line halfway between them.
    let edges = [[point(0.0, 3.0), point(80.0, -1.0)], [point(0.0, 0.0), point(80.0, 0.0)]].map(Vec::from);
    let crossed = document(vec![lane(1, edges[0].clone(), edges[1].clone())]);
    let road = crossed.at("road");
    for at in across(road, road.attr_number("length") - 0.01) {
        assert!(at.distance(point(80.0, -0.5)) < 0.05, "{at:?}");
    }
}

#[test]
fn what_neighbors_foretell_is_left_out() {
    let at = |s_m: f64, left_m: f64| Edges { s_m, across_m: vec![left_m, 0.0] };
    let edges = [at(0.0, 3.0), at(4.0, 3.2), at(10.0, 3.5), at(20.0, 3.5)];
    assert_eq!(without_foretold(&edges), [0, 2, 3].map(|i| edges[i].clone()));
    assert_eq!(records("width", "sOffset", &edges, |edges| edges.across_m[0]).len(), 2);
}

#[test]
fn roads_follow_each_other_and_fork_in_junctions() {
    let mut lanes: Vec<Lane> = (1..=6).map(testing::lane).collect();
    // 1 → 2; 2 → 3 and 4; 4 and 5 → 6.
    for (from, to) in [(0, 1), (1, 2), (1, 3), (3, 5), (4, 5)] {
        let id = lanes[to].id;
        lanes[from].successors.push(id);
    }
    lanes[0].left_neighbor = Some(LaneId(5));
    let root = document(lanes);
    let roads = root.all("road");
    let link = |i: usize, end: &str| {
        let found = roads[i].at("link").all(end);
        found.first().map(|link| (link.attr("elementType").to_owned(), link.attr("elementId").to_owned()))
    };
    let to = |kind: &str, id: &str| Some((kind.to_owned(), id.to_owned()));
    assert_eq!((link(0, "predecessor"), link(0, "successor")), (None, to("road", "2")));
    assert_eq!(roads[0].at("link").at("successor").attr("contactPoint"), "start");
    assert_eq!(link(1, "predecessor"), to("road", "1"));
    assert_eq!(roads[1].at("link").at("predecessor").attr("contactPoint"), "end");
    let (fork, join) = (link(1, "successor"), link(5, "predecessor"));
    let seen = [&fork, &fork, &join, &join];
    assert_eq!(seen, [&link(2, "predecessor"), &link(3, "predecessor"), &link(3, "successor"), &link(4, "successor")]);
    let connections = |junction: &Node| -> Vec<(String, String)> {
        assert_eq!(junction.attr("type"), "direct");
        let pair = |node: &&Node| {
            // If several roads lead into one, none may be its only connection.
            let named = node.attributes.iter().find(|(name, _)| name == "connectingRoad");
            assert!(named.is_none_or(|(_, road)| road == node.attr("linkedRoad")));
            (node.attr("incomingRoad").to_owned(), node.attr("linkedRoad").to_owned())
        };
        junction.all("connection").iter().map(pair).collect()
    };
    let junctions = root.all("junction");
    let pair = |from: &str, to: &str| (from.to_owned(), to.to_owned());
    assert_eq!(connections(junctions[0]), [pair("2", "3"), pair("2", "4")]);
    assert_eq!(connections(junctions[1]), [pair("4", "6"), pair("5", "6")]);
    assert_eq!(fork, to("junction", junctions[0].attr("id")));
    assert_eq!(join, to("junction", junctions[1].attr("id")));
    // A lane beside: a line that may be crossed.
    let lanes = roads[0].at("lanes").at("laneSection");
    let mark = |side: &str| lanes.at(side).at("lane").at("roadMark").attr("type").to_owned();
    assert_eq!((mark("center"), mark("right")), ("broken".to_owned(), "solid".to_owned()));
    assert_eq!(lanes.at("right").at("lane").at("link").at("successor").attr("id"), "-1");
}

#[test]
fn lanes_of_no_length_are_left_out_and_told() {
    let point = Lane { left: Polyline::default(), centerline: Polyline::default(), ..testing::lane(2) };
    let center = Lane { left: Polyline::default(), ..testing::lane(3) };
    assert!(of(&LaneGraph::new(vec![point.clone()])).is_none());
    let network = of(&LaneGraph::new(vec![testing::lane(1), point, center])).unwrap();
    assert_eq!(network.assumed, [("nominal_lane_width", 1), ("lane_without_extent", 1)]);
}

/// Two lanes between three lines, from left to right, each the neighbor of the other.
fn side_by_side(ids: [i64; 2], lines: [Vec<Vec2>; 3]) -> Vec<Lane> {
    let [left, middle, right] = lines;
    let mut lanes = vec![lane(ids[0], left, middle.clone()), lane(ids[1], middle, right)];
    (lanes[0].right_neighbor, lanes[1].left_neighbor) = (Some(lanes[1].id), Some(lanes[0].id));
    lanes
}

#[test]
fn lanes_side_by_side_are_one_road_in_which_lanes_can_be_changed() {
    let line = |x: f64, y: f64| vec![Vec2::new(x, y), Vec2::new(x + 40.0, y)];
    let mut lanes = side_by_side([1, 2], [line(0.0, 3.5), line(0.0, 0.0), line(0.0, -3.0)]);
    lanes.extend(side_by_side([3, 4], [line(40.0, 3.5), line(40.0, 0.0), line(40.0, -3.0)]));
    lanes.push(lane(5, line(40.0, 0.0), vec![Vec2::new(40.0, -3.0), Vec2::new(80.0, -9.0)]));
    for (from, to) in [(0, 2), (1, 3), (1, 4)] {
        let id = lanes[to].id;
        lanes[from].successors.push(id);
    }
    let root = document(lanes.clone());
    let roads = root.all("road");
    assert_eq!(roads.iter().map(|road| road.attr("name")).collect::<Vec<_>>(), ["lanes 1 2", "lanes 3 4", "lane 5"]);
    let section = roads[0].at("lanes").at("laneSection").at("right").all("lane");
    let width = |lane: &Node| lane.at("width").attr_number("a");
    let found = section.iter().map(|lane| (lane.attr("id"), width(lane))).collect::<Vec<_>>();
    assert_eq!(found, [("-1", 3.5), ("-2", 3.0)]);
    assert_eq!(section[0].at("roadMark").attr("type"), "broken");
    let connections = root.at("junction").all("connection");
    let links = |i: usize| -> Vec<(&str, &str)> {
        connections[i].all("laneLink").iter().map(|link| (link.attr("from"), link.attr("to"))).collect()
    };
    assert_eq!((links(0), links(1)), (vec![("-1", "-1"), ("-2", "-2")], vec![("-2", "-1")]));
    // Without the exit, roads and lanes follow each other.
    lanes[1].successors.pop();
    let root = document(lanes.drain(..4).collect());
    let linked = |road: usize, end: &str| {
        let lane = root.all("road")[road].at("lanes").at("laneSection").at("right").all("lane")[1];
        lane.at("link").all(end).iter().map(|lane| lane.attr("id").to_owned()).collect::<Vec<_>>()
    };
    assert_eq!([linked(0, "predecessor"), linked(0, "successor")], [vec![], vec!["-2".to_owned()]]);
    assert_eq!([linked(1, "predecessor"), linked(1, "successor")], [vec!["-2".to_owned()], vec![]]);
    // Around an island, or if one lane ends earlier, each is a road of its own.
    let mut apart = side_by_side([1, 2], [line(0.0, 3.5), line(0.0, 0.0), line(0.0, -5.0)]);
    apart[1].left.0.insert(1, Vec2::new(20.0, -1.0));
    assert_eq!(document(apart).all("road").len(), 2);
    let short = vec![Vec2::new(0.0, -3.0), Vec2::new(30.0, -3.0)];
    let root = document(side_by_side([1, 2], [line(0.0, 3.5), line(0.0, 0.0), short]));
    assert_eq!(root.all("road").len(), 2);
}

#[test]
fn roads_meet_without_gaps_where_their_ends_are_oblique() {
    // Lanes that meet at 10 degrees, across an end that is square to neither.
    let point = |x: f64, y: f64| Vec2::new(x, y);
    let (left, right) = (point(30.3, 3.5), point(30.0, 0.0));
    let bend = Vec2::from_angle(0.17) * 40.0;
    let mut lanes = vec![
        lane(1, vec![point(0.0, 3.5), left], vec![point(0.0, 0.0), right]),
        lane(2, vec![left, left + bend], vec![right, right + bend]),
    ];
    lanes[0].successors.push(LaneId(2));
    let root = document(lanes);
    let roads = root.all("road");
    let (end, start) = (across(roads[0], roads[0].attr_number("length")), across(roads[1], 0.0));
    for ((end, start), expected) in end.iter().zip(start).zip([left, left.lerp(right, 0.5), right]) {
        assert!(end.distance(start) < 1e-3 && start.distance(expected) < 1e-3, "{end:?} {start:?} {expected:?}");
    }
}
