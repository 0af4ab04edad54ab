//! What lanes continue in, where maps say it in unusual words or wrongly.

use super::*;

/// A straight road along x from `from_m`, one lane wide, with the attributes and links of `more`.
fn piece(id: usize, from_m: f64, length_m: f64, more: &str, lane_links: &str) -> String {
    let section = format!("<laneSection s='0'><right>{}</right></laneSection>", lane(-1, "driving", WIDE, lane_links));
    let line = format!("<geometry s='0' x='{from_m}' y='0' hdg='0' length='{length_m}'><line/></geometry>");
    let (junction, links) = more.split_once('|').unwrap_or(("", more));
    format!(
        "<road id='{id}' length='{length_m}' {junction}><link>{links}</link><planView>{line}</planView>\
         <lanes>{section}</lanes></road>"
    )
}

fn link(end: &str, to: usize, contact: &str) -> String {
    format!("<{end} elementType='road' elementId='{to}' contactPoint='{contact}'/>")
}

const BOTH: &str = "<predecessor id='-1'/><successor id='-1'/>";

/// The stretches of the lanes along x with those of the lanes that they continue in, rounded to centimeters.
fn stretches(graph: &LaneGraph) -> Vec<([f64; 2], Vec<[f64; 2]>)> {
    let of = |lane: &Lane| {
        [lane.centerline.0[0], *lane.centerline.0.last().unwrap()].map(|at| (at.x * 100.0).round() / 100.0)
    };
    let next = |lane: &Lane| lane.successors.iter().map(|id| of(graph.get(*id).unwrap())).collect();
    graph.lanes().iter().map(|lane| (of(lane), next(lane))).collect()
}

fn kinds(report: &MapReport) -> Vec<(&str, u64)> {
    report.warnings.iter().map(|(what, found)| (*what, found.count)).collect()
}

#[test]
fn what_is_too_short_for_a_lane_hands_its_links_on() {
    for short_m in [0.0, 1e-7, 1e-3, 4e-3] {
        // Sections: 0 to 40 m, two short ones, then up to 100 m.
        let section = |s: f64| {
            let lane = lane(-1, "driving", WIDE, BOTH);
            format!("<laneSection s='{s}'><right>{lane}</right></laneSection>")
        };
        let sections = [0.0, 40.0, 40.0 + short_m, 40.0 + 2.0 * short_m].map(section).concat();
        let (graph, report) = read(&road("1", "", STRAIGHT, &sections));
        let [first, second] = [[0.0, 40.0], [if short_m < 4e-3 { 40.0 } else { 40.01 }, 100.0]];
        assert_eq!(stretches(&graph), [(first, vec![second]), (second, vec![])], "{short_m}");
        assert_eq!(kinds(&report), [("lanes_without_length", 2)]);
        // Roads: one of 40 m, a short one within a junction, which forks to two of 60 m.
        let roads = [
            piece(1, 0.0, 40.0, "<successor elementType='junction' elementId='7'/>", ""),
            piece(
                2,
                40.0,
                short_m,
                &format!("junction='7'|{}{}", link("predecessor", 1, "end"), link("successor", 3, "start")),
                BOTH,
            ),
            piece(3, 40.0 + short_m, 60.0, &link("predecessor", 2, "end"), "<predecessor id='-1'/>"),
            piece(4, 40.0 + short_m, 50.0, &link("predecessor", 2, "end"), "<predecessor id='-1'/>"),
            "<junction id='7'><connection incomingRoad='1' connectingRoad='2' contactPoint='start'>
             <laneLink from='-1' to='-1'/></connection></junction>"
                .to_owned(),
        ];
        let (graph, _) = read(&roads.concat());
        let beginning: Vec<[f64; 2]> = stretches(&graph)[0].1.clone();
        assert_eq!(beginning.iter().map(|at| at[1]).collect::<Vec<_>>(), [100.0, 90.0], "{short_m}");
    }
}

#[test]
fn lanes_run_as_their_directions_say() {
    let lanes = ["", "reversed", "both", "sideways"].iter().zip(1..).map(|(direction, id)| {
        lane(-id, "driving", WIDE, "").replace("<lane ", &format!("<lane direction='{direction}' "))
    });
    let lanes = lanes.collect::<String>().replace("direction='' ", "");
    let (graph, report) =
        read(&road("1", "", STRAIGHT, &format!("<laneSection s='0'><right>{lanes}</right></laneSection>")));
    let found: Vec<(bool, bool)> =
        graph.lanes().iter().map(|lane| (lane.centerline.0[0].x < 50.0, lane.attributes.one_way)).collect();
    assert_eq!(found, [(true, true), (false, true), (true, false), (true, true)]);
    assert_eq!(kinds(&report), [("broken_directions", 1)]);
    // The one that is reversed has the others on its other side, as oncoming ones.
    let reversed = &graph.lanes()[1];
    assert_eq!((reversed.left_neighbor, reversed.right_neighbor), (None, None));
    let opposite =
        ["left", "right"].map(|side| reversed.attributes.tags[&format!("opposite_{side}_neighbor")].as_str());
    assert_eq!(opposite, ["3", "1"]);
    assert!(reversed.left.0[0].y < reversed.right.0[0].y);
}

#[test]
fn sections_of_one_side_end_at_the_next_of_that_side() {
    let single = |s: f64, side: &str, id: i64, links: &str| {
        let lane = lane(id, "driving", WIDE, links);
        format!("<laneSection s='{s}' singleSide='true'><{side}>{lane}</{side}></laneSection>")
    };
    let sections = single(0.0, "left", 1, "")
        + &single(0.0, "right", -1, "<successor id='-1'/>")
        + &single(50.0, "right", -1, "<predecessor id='-1'/>");
    let (graph, report) = read(&road("1", "", STRAIGHT, &sections));
    let mut found = stretches(&graph);
    found.sort_by(|a, b| a.0[0].total_cmp(&b.0[0]));
    assert_eq!(
        found,
        [([0.0, 50.0], vec![[50.0, 100.0]]), ([50.0, 100.0], vec![]), ([100.0, 0.0], vec![])],
        "{}",
        report.summary()
    );
}

#[test]
fn every_successor_counts_and_motorway_exits_are_lanes() {
    let first = lane(-1, "driving", WIDE, "<successor id='-1'/><successor id='-2'/>");
    let then = lane(-1, "driving", WIDE, "") + &lane(-2, "mwyExit", WIDE, "");
    let section = |s: f64, lanes: &str| format!("<laneSection s='{s}'><right>{lanes}</right></laneSection>");
    let (graph, _) = read(&road("1", "", STRAIGHT, &(section(0.0, &first) + &section(50.0, &then))));
    assert_eq!((graph.lanes().len(), graph.lanes()[0].successors.len()), (3, 2));
}

#[test]
fn places_count_where_links_are_missing_or_contradict_them() {
    let first = |more: &str| piece(1, 0.0, 40.0, more, "<successor id='-1'/>");
    let second = |more: &str| piece(2, 40.0, 60.0, more, "<predecessor id='-1'/>");
    let in_junction = |connection: &str| {
        first("<successor elementType='junction' elementId='7'/>")
            + &piece(2, 40.0, 60.0, "junction='7'|", "")
            + &format!("<junction id='7'><connection incomingRoad='1' connectingRoad='2'{connection}</junction>")
    };
    let contradicted = [("lane_links_by_place", 1)].as_slice();
    for (roads, expected) in [
        // The contact point is the wrong one, the link is none, leads to no lane, or to itself.
        (first(&link("successor", 2, "end")) + &second(""), contradicted),
        (first("<successor elementType='none' elementId='2'/>") + &second(""), &[("broken_links", 1), contradicted[0]]),
        (
            first(&link("successor", 2, "start")).replace("<successor id='-1'/>", "<successor id='-3'/>") + &second(""),
            contradicted,
        ),
        (first(&link("successor", 1, "start")) + &second(""), contradicted),
        // Connections that do not name the lanes, or a road that does not lead to them.
        (in_junction("/>"), &[("connections_by_place", 1)]),
        (
            in_junction("/>").replace("elementId='7'", "elementId='8'"),
            &[("connections_by_place", 1), ("links_to_nowhere", 1)],
        ),
    ] {
        let (graph, report) = read(&roads);
        assert_eq!(stretches(&graph)[0], ([0.0, 40.0], vec![[40.0, 100.0]]), "{roads}");
        assert_eq!(kinds(&report), expected, "{}", report.summary());
    }
    // Where nothing begins, a contradiction is only told.
    let (graph, report) = read(&(first(&link("successor", 2, "end")) + &piece(2, 42.0, 60.0, "", "")));
    assert!(stretches(&graph).iter().all(|(_, next)| next.is_empty()));
    assert_eq!(kinds(&report), [("lane_links_against_traffic", 1)]);
}

#[test]
fn lanes_that_open_late_are_lanes_from_there() {
    let closed = "<width sOffset='0' a='0'/>";
    let opens = "<width sOffset='70' a='0' b='0.3'/><width sOffset='80' a='3'/>";
    let of_road = |widths: &str| {
        let lanes = lane(-1, "driving", WIDE, "") + &lane(-2, "driving", widths, "<successor id='-1'/>");
        let section = format!("<laneSection s='0'><right>{lanes}</right></laneSection>");
        road("1", "", STRAIGHT, &section)
            .replace("<planView>", &format!("<link>{}</link><planView>", link("successor", 2, "start")))
    };
    let beyond = piece(2, 100.0, 60.0, "", "").replace("y='0'", "y='-3'");
    let (graph, report) = read(&(of_road(&(closed.to_owned() + opens)) + &beyond));
    let opening = by_lane(&graph, "1", "-2")[0];
    assert!(opening.left_neighbor.is_some(), "{:?}", opening.centerline.0[0]);
    assert!(opening.centerline.0[0].x >= 70.0 - 1e-9, "{:?}", opening.centerline.0[0]);
    assert_eq!(stretches(&graph)[1], ([70.0, 100.0], vec![[100.0, 160.0]]));
    assert_eq!(kinds(&report), []);
    assert_eq!(kinds(&read(&of_road(closed)).1), [("lanes_without_width", 1), ("links_to_nowhere", 1)]);
}
