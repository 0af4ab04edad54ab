//! From a document to lanes.

mod continuity;

use super::*;
use crate::geometry::Vec2;
use crate::scene::{Lane, LaneId, TurnDirection};

fn road(id: &str, more: &str, plan_view: &str, sections: &str) -> String {
    format!(
        "<road id='{id}' length='100' {more}>{}<planView>{plan_view}</planView><lanes>{sections}</lanes></road>",
        if more.contains("junction='7'") { "" } else { "<type s='0' type='town'><speed max='36' unit='km/h'/></type>" }
    )
}

fn read(body: &str) -> (LaneGraph, MapReport) {
    let text = format!("<OpenDRIVE><header revMajor='1' revMinor='6'/>{body}</OpenDRIVE>");
    read_map(&mut text.as_bytes(), "a.xodr").unwrap_or_else(|error| panic!("{error}"))
}

fn lane(id: i64, kind: &str, width: &str, link: &str) -> String {
    format!("<lane id='{id}' type='{kind}'><link>{link}</link>{width}</lane>")
}

const STRAIGHT: &str = "<geometry s='0' x='0' y='0' hdg='0' length='100'><line/></geometry>";
const WIDE: &str = "<width sOffset='0' a='3' b='0' c='0' d='0'/>";

/// One lane against the road, two along it, and a sidewalk.
fn two_way() -> String {
    let left = lane(1, "driving", WIDE, "");
    let right = [
        lane(-1, "driving", WIDE, ""),
        lane(-2, "driving", "<width sOffset='0' a='2' b='0.02' c='0' d='0'/>", ""),
        lane(-3, "sidewalk", WIDE, ""),
    ];
    let center = "<center><lane id='0' type='none'/></center>";
    format!("<laneSection s='0'><left>{left}</left>{center}<right>{}</right></laneSection>", right.concat())
}

fn by_lane<'g>(graph: &'g LaneGraph, road: &str, lane: &str) -> Vec<&'g Lane> {
    let is_it = |found: &&Lane| found.attributes.tags["road"] == road && found.attributes.tags["lane"] == lane;
    graph.lanes().iter().filter(is_it).collect()
}

#[test]
fn lanes_lie_where_widths_put_them_and_run_with_traffic() {
    let (graph, report) = read(&road("1", "junction='-1'", STRAIGHT, &two_way()));
    assert_eq!((graph.lanes().len(), report.n_lanelets, report.n_not_drivable), (3, 4, 1));
    assert!(report.warnings.is_empty(), "{report:?}");
    let (_, other) = read(&road("1", "", STRAIGHT, &two_way().replace("sidewalk", "Driving")));
    let said = &other.warnings["lanes_of_other_types"];
    assert_eq!((said.count, said.examples[0].contains("has type \"Driving\"")), (1, true), "{said:?}");
    let [against, inner, outer] = ["1", "-1", "-2"].map(|lane| by_lane(&graph, "1", lane)[0]);
    let rounded = |point: Vec2| ((point.x * 1e3).round() / 1e3, (point.y * 1e3).round() / 1e3);
    let ends = |lane: &Lane| [lane.centerline.0[0], *lane.centerline.0.last().unwrap()].map(rounded);
    assert_eq!(ends(against), [(100.0, 1.5), (0.0, 1.5)]);
    assert_eq!(ends(inner), [(0.0, -1.5), (100.0, -1.5)]);
    // 2 m wide at the start, 4 m at the end.
    assert_eq!(ends(outer), [(0.0, -4.0), (100.0, -5.0)]);
    assert_eq!((inner.left_neighbor, inner.right_neighbor), (None, Some(outer.id)));
    assert_eq!((outer.left_neighbor, outer.right_neighbor), (Some(inner.id), None));
    assert_eq!(inner.attributes.tags["opposite_left_neighbor"], against.id.0.to_string());
    assert_eq!((inner.attributes.tags["speed_limit_mps"].as_str(), inner.attributes.one_way), ("10", true));
    assert_eq!((against.left.0[0].y, against.right.0[0].y), (0.0, 3.0));
    let (left_hand, _) = read(&road("1", "rule='LHT'", STRAIGHT, &two_way()));
    assert_eq!(ends(by_lane(&left_hand, "1", "1")[0]), [(0.0, 1.5), (100.0, 1.5)]);
}

#[test]
fn lanes_end_where_they_are_before_the_next_section_shifts_them() {
    let [first, second] = [two_way(), two_way().replace("<laneSection s='0'>", "<laneSection s='60'>")];
    let offsets = "<laneOffset s='0' a='1'/><laneOffset s='60' a='4'/>";
    let (graph, _) = read(&road("1", "", STRAIGHT, &format!("{offsets}{first}{second}")));
    let lanes = by_lane(&graph, "1", "-1");
    for (lane, [from, to]) in lanes.into_iter().zip([[(0.0, -0.5), (60.0, -0.5)], [(60.0, 2.5), (100.0, 2.5)]]) {
        let near = |point: Vec2, (x, y): (f64, f64)| assert!(point.distance(Vec2::new(x, y)) < 1e-5, "{point:?}");
        near(lane.centerline.0[0], from);
        near(*lane.centerline.0.last().unwrap(), to);
    }
}

#[test]
fn bends_are_followed_to_millimeters() {
    // A circle of radius 20 to the left around (0, 20), with an offset of the lanes by 1 m to the left.
    let arc = "<geometry s='0' x='0' y='0' hdg='0' length='100'><arc curvature='0.05'/></geometry>";
    let sections = format!("<laneOffset s='0' a='1' b='0' c='0' d='0'/>{}", two_way());
    let (graph, _) = read(&road("1", "", arc, &sections));
    for (lane, radius_m) in [("1", 17.5), ("-1", 20.5)] {
        let lane = by_lane(&graph, "1", lane)[0];
        for pair in lane.centerline.0.windows(2) {
            for point in [pair[0], pair[0].lerp(pair[1], 0.5)] {
                assert!((point.distance(Vec2::new(0.0, 20.0)) - radius_m).abs() < 0.006, "{point:?}");
            }
        }
        assert!(lane.centerline.0.len() > 100, "{}", lane.centerline.0.len());
    }
}

#[test]
fn widths_that_bend_are_followed_to_millimeters() {
    // From 0 to 3.5 m in 14 m.
    let width = |x: f64| 3.0 * 3.5 * (x / 14.0).powi(2) - 2.0 * 3.5 * (x / 14.0).powi(3);
    let (c, d) = (3.0 * 3.5 / 14f64.powi(2), -2.0 * 3.5 / 14f64.powi(3));
    let widths = format!("<width sOffset='0' a='0' b='0' c='{c}' d='{d}'/><width sOffset='14' a='3.5'/>");
    let opening = lane(-1, "driving", &widths, "");
    let (graph, _) =
        read(&road("1", "", STRAIGHT, &format!("<laneSection s='0'><right>{opening}</right></laneSection>")));
    let edge = &by_lane(&graph, "1", "-1")[0].right;
    for middle in edge.0.windows(2).map(|pair| pair[0].lerp(pair[1], 0.5)).filter(|middle| middle.x < 14.0) {
        assert!((middle.y + width(middle.x)).abs() < 0.006, "{middle:?}");
    }
}

#[test]
fn sections_roads_and_junctions_connect_lanes() {
    let section = |s: f64, links: [&str; 2]| {
        let [left, right] = [lane(1, "driving", WIDE, links[0]), lane(-1, "driving", WIDE, links[1])];
        format!("<laneSection s='{s}'><left>{left}</left><right>{right}</right></laneSection>")
    };
    let next = |id: i64| format!("<successor id='{id}'/>");
    let before = |id: i64| format!("<predecessor id='{id}'/>");
    let linked = |road: String, links: &str| road.replace("<planView>", &format!("<link>{links}</link><planView>"));
    // Road 1 with two sections, then road 2, which is drawn the other way, then a junction with a turn to road 4.
    let first = section(0.0, [&next(1), &next(-1)]);
    let second = section(40.0, [&(before(1) + &next(-1)), &(before(-1) + &next(1))]);
    let backward = STRAIGHT.replace("x='0' y='0' hdg='0'", "x='200' y='0' hdg='3.141592653589793'");
    let turn = "<geometry s='0' x='200' y='0' hdg='0' length='100'><arc curvature='0.0157'/></geometry>";
    let turning = lane(-1, "driving", WIDE, &(before(1) + &next(-1)));
    let body = [
        linked(
            road("1", "", STRAIGHT, &(first + &second)),
            "<successor elementType='road' elementId='2' contactPoint='end'/>",
        ),
        linked(
            road("2", "", &backward, &section(0.0, ["", ""])),
            "<predecessor elementType='junction' elementId='7'/>",
        ),
        linked(
            road("3", "junction='7'", turn, &format!("<laneSection s='0'><right>{turning}</right></laneSection>")),
            "<predecessor elementType='road' elementId='2' contactPoint='start'/>
             <successor elementType='road' elementId='4' contactPoint='start'/>",
        ),
        road(
            "4",
            "",
            &STRAIGHT.replace("x='0' y='0' hdg='0'", "x='263.7' y='63.7' hdg='1.57'"),
            &section(0.0, ["", ""]),
        ),
        "<junction id='7'><connection id='0' incomingRoad='2' connectingRoad='3' contactPoint='start'>
             <laneLink from='1' to='-1'/></connection></junction>"
            .to_owned(),
    ]
    .concat();
    let (graph, _) = read(&body);
    let successors = |road: &str, lane: &str| -> Vec<Vec<String>> {
        let name = |id: &LaneId| {
            let tags = &graph.get(*id).unwrap().attributes.tags;
            format!("{}:{}", tags["road"], tags["lane"])
        };
        by_lane(&graph, road, lane).iter().map(|lane| lane.successors.iter().map(name).collect()).collect()
    };
    // Along: both sections of road 1, then the left lane of road 2, which runs the other way, the junction, road 4.
    assert_eq!(successors("1", "-1"), [["1:-1"], ["2:1"]]);
    assert_eq!(successors("2", "1"), [["3:-1"]]);
    assert_eq!(successors("3", "-1"), [["4:-1"]]);
    // Back: road 2 into road 1.
    assert_eq!(successors("2", "-1"), [["1:1"]]);
    assert_eq!(successors("1", "1"), [vec![], vec!["1:1".to_owned()]]);
    let turn = by_lane(&graph, "3", "-1")[0];
    assert_eq!((turn.attributes.turn, turn.attributes.is_intersection), (TurnDirection::Left, true));
}
