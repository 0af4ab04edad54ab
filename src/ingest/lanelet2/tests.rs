//! Maps written out by hand, damaged maps, and the maps of the development data.

use super::*;
use crate::geometry::Polyline;
use crate::ingest::test_data::test_data;
use crate::scene::{LaneDuty, LaneId};

/// Two lanes side by side, 10 m long and 4 m wide; the right one (1) continues in a third (3). Way 12 between the lanes
/// is drawn against driving direction, and relation 1 comes before the regulatory element it names.
const NODES: [(i64, f64, f64); 8] = [
    (1, 0.0, 0.0),
    (2, 10.0, 0.0),
    (3, 10.0, 4.0),
    (4, 0.0, 4.0),
    (5, 0.0, 8.0),
    (6, 10.0, 8.0),
    (7, 20.0, 0.0),
    (8, 20.0, 4.0),
];
const WAYS: &str = r#"
  <way id="11"><nd ref="1"/><nd ref="2"/><tag k="type" v="curbstone"/></way>
  <way id="12"><nd ref="3"/><nd ref="4"/></way>
  <way id="13"><nd ref="5"/><nd ref="6"/></way>
  <way id="14"><nd ref="7"/><nd ref="2"/></way>
  <way id="15"><nd ref="3"/><nd ref="8"/></way>"#;
const RELATIONS: &str = r#"
  <relation id="1"><member type="way" role="right" ref="11"/><member type="way" role="left" ref="12"/>
    <member type="relation" role="regulatory_element" ref="40"/>
    <tag k="type" v="lanelet"/><tag k="subtype" v="road"/><tag k="one_way" v="yes"/><tag k="region" v="de"/></relation>
  <relation id="2"><member type="way" role="right" ref="12"/><member type="way" role="left" ref="13"/>
    <tag k="type" v="lanelet"/><tag k="subtype" v="bus_lane"/><tag k="one_way" v="no"/></relation>
  <relation id="3"><member type="way" role="left" ref="15"/><member type="way" role="right" ref="14"/>
    <tag k="type" v="lanelet"/></relation>
  <relation id="9"><member type="way" role="left" ref="15"/><member type="way" role="right" ref="14"/>
    <tag k="type" v="lanelet"/><tag k="subtype" v="crosswalk"/></relation>
  <relation id="40"><tag k="type" v="regulatory_element"/><tag k="subtype" v="traffic_light"/></relation>"#;

fn nodes() -> String {
    NODES.iter().map(|(id, x, y)| format!("<node id=\"{id}\" x=\"{x}\" y=\"{y}\"/>\n")).collect()
}

fn osm(body: &str) -> String {
    format!("<?xml version=\"1.0\"?>\n<osm version=\"0.6\">\n{body}\n</osm>\n")
}

fn read(text: &str) -> Result<(LaneGraph, MapReport), Error> {
    read_map(&mut text.as_bytes(), "maps/test.osm")
}

fn read_valid(body: &str) -> (LaneGraph, MapReport) {
    read(&osm(body)).unwrap()
}

fn message(text: &str) -> String {
    let message = read(text).unwrap_err().to_string();
    assert!(message.starts_with("map maps/test.osm"), "{message}");
    message
}

#[test]
fn lanes_are_turned_into_driving_direction_and_connected() {
    let (graph, report) = read_valid(&[&nodes(), WAYS, RELATIONS].concat());
    assert_eq!((report.n_lanelets, report.n_not_drivable, report.n_lanes), (4, 1, 3));
    assert_eq!(report.summary(), "");
    let [first, second, third] = [1, 2, 3].map(|id| graph.get(LaneId(id)).unwrap());

    let points = |line: &Polyline| line.0.iter().map(|p| (p.x, p.y)).collect::<Vec<_>>();
    assert_eq!(points(&first.left), [(0.0, 4.0), (10.0, 4.0)]);
    assert_eq!(points(&first.right), [(0.0, 0.0), (10.0, 0.0)]);
    assert_eq!(points(&first.centerline), [0.0, 2.0, 4.0, 6.0, 8.0, 10.0].map(|x| (x, 2.0)));

    assert_eq!((first.successors.as_slice(), third.predecessors.as_slice()), (&[LaneId(3)][..], &[LaneId(1)][..]));
    assert!(first.predecessors.is_empty() && second.successors.is_empty() && third.successors.is_empty());
    assert_eq!((first.left_neighbor, first.right_neighbor), (Some(LaneId(2)), None));
    assert_eq!((second.left_neighbor, second.right_neighbor), (None, Some(LaneId(1))));
}

#[test]
fn tags_become_attributes() {
    let (graph, _) = read_valid(&[&nodes(), WAYS, RELATIONS].concat());
    let [first, second, third] = [1, 2, 3].map(|id| &graph.get(LaneId(id)).unwrap().attributes);
    assert_eq!((first.kind.as_str(), second.kind.as_str(), third.kind.as_str()), ("road", "bus_lane", ""));
    assert_eq!((first.one_way, second.one_way, third.one_way), (true, false, true));
    assert_eq!((first.has_traffic_control, second.has_traffic_control), (true, false));
    assert_eq!(first.tags["regulatory:40"], "subtype=traffic_light;type=regulatory_element");
    assert_eq!(first.tags["region"], "de");
}

#[test]
fn lanes_know_their_part_in_rules_about_the_right_of_way() {
    let rule = r#"<relation id="40"><member type="relation" role="yield" ref="1"/>
        <member type="relation" role="right_of_way" ref="3"/><member type="way" role="ref_line" ref="3"/>
        <tag k="type" v="regulatory_element"/><tag k="subtype" v="right_of_way"/></relation>"#;
    let relations = RELATIONS[..RELATIONS.find("<relation id=\"40\"").unwrap()].to_owned() + rule;
    let third = r#"<relation id="3"><member type="relation" role="regulatory_element" ref="40"/>"#;
    let relations = relations.replace(r#"<relation id="3">"#, third);
    let (graph, _) = read_valid(&[&nodes(), WAYS, &relations].concat());
    let duties = |id: i64| graph.get(LaneId(id)).unwrap().attributes.duties().collect::<Vec<_>>();
    assert_eq!(duties(1), [("regulatory:40", LaneDuty::Yields)]);
    assert_eq!(duties(3), [("regulatory:40", LaneDuty::HasRightOfWay)]);
    assert_eq!(duties(2), []);
}

#[test]
fn oncoming_lanes_are_not_neighbors() {
    // Lane 2 with its bounds exchanged runs the other way.
    let relations = RELATIONS
        .replace(r#"role="right" ref="12""#, r#"role="left" ref="12""#)
        .replace(r#"role="left" ref="13""#, r#"role="right" ref="13""#);
    let (graph, _) = read_valid(&[&nodes(), WAYS, &relations].concat());
    let [first, second] = [1, 2].map(|id| graph.get(LaneId(id)).unwrap());
    assert!(second.centerline.0[0].x > 9.0);
    assert_eq!((first.left_neighbor, second.left_neighbor), (None, None));
}

#[test]
fn participants_overrule_the_subtype() {
    let with = |tags: &str| {
        let relation = format!(
            r#"<relation id="5"><member type="way" role="left" ref="15"/><member type="way" role="right" ref="14"/>
               <tag k="type" v="lanelet"/>{tags}</relation>"#
        );
        let (graph, _) = read_valid(&[&nodes(), WAYS, RELATIONS, &relation].concat());
        graph.get(LaneId(5)).is_some()
    };
    assert!(with(r#"<tag k="subtype" v="exit"/>"#));
    assert!(!with(r#"<tag k="subtype" v="road"/><tag k="participant:bicycle" v="yes"/>"#));
    assert!(with(r#"<tag k="subtype" v="walkway"/><tag k="participant:vehicle:car" v="yes"/>"#));
    assert!(!with(r#"<tag k="subtype" v="rail"/>"#));
}

#[test]
fn bounds_of_several_ways_are_joined() {
    let ways = WAYS.replace(
        r#"<way id="11"><nd ref="1"/><nd ref="2"/>"#,
        r#"<node id="9" x="5" y="-0.5"/><way id="16"><nd ref="2"/><nd ref="9"/></way><way id="11"><nd ref="1"/><nd ref="9"/>"#,
    );
    let right = r#"<member type="way" role="right" ref="11"/>"#;
    let relations = RELATIONS.replace(right, &format!(r#"<member type="way" role="right" ref="16"/>{right}"#));
    let (graph, report) = read_valid(&[&nodes(), ways.as_str(), &relations].concat());
    assert_eq!(report.summary(), "");
    let first = graph.get(LaneId(1)).unwrap();
    assert_eq!(first.right.0, [(0.0, 0.0), (5.0, -0.5), (10.0, 0.0)].map(|(x, y)| Vec2::new(x, y)));
    assert_eq!(first.successors, [LaneId(3)]);
}

#[test]
fn lanelets_that_are_not_whole_are_left_out_and_reported() {
    let lanelet =
        |id: i64, members: &str| format!(r#"<relation id="{id}">{members}<tag k="type" v="lanelet"/></relation>"#);
    let way = |role: &str, id: i64| format!(r#"<member type="way" role="{role}" ref="{id}"/>"#);
    let broken = [
        lanelet(51, &way("left", 12)),
        lanelet(52, &[way("left", 12), way("right", 99)].concat()),
        lanelet(53, &[way("left", 12), way("right", 17)].concat()),
        lanelet(54, &[way("left", 12), way("right", 18)].concat()),
        lanelet(55, &[way("left", 12), way("right", 11), way("right", 13)].concat()),
        lanelet(56, r#"<member type="relation" role="left" ref="56"/><member type="way" role="right" ref="11"/>"#),
        lanelet(57, &[way("left", 12), r#"<member type="relation" role="right" ref="1"/>"#.into()].concat()),
        // These keep their geometry, and so stay.
        lanelet(
            58,
            &[&way("left", 12), &way("right", 11), r#"<member type="relation" role="regulatory_element" ref="58"/>"#]
                .concat(),
        ),
        lanelet(
            59,
            &[&way("left", 12), &way("right", 11), r#"<member type="relation" role="regulatory_element" ref="98"/>"#]
                .concat(),
        ),
    ];
    let extra = r#"<way id="17"><nd ref="1"/><nd ref="99"/></way><way id="18"><nd ref="1"/><nd ref="1"/></way>
        <node id="97" lat="x" lon="1"/><node id="96" lat="95" lon="1"/><way id="11"><nd ref="7"/></way>"#;
    let (graph, report) = read_valid(&[&nodes(), WAYS, extra, RELATIONS, &broken.concat()].concat());
    assert_eq!(graph.lanes().len(), 3 + 2);
    let count = |reason: &str| report.warnings.get(reason).map_or(0, |warnings| warnings.count);
    for (reason, expected) in [
        ("missing_bound", 1),
        ("missing_way", 1),
        ("missing_node", 1),
        ("short_bound", 1),
        ("broken_bound", 1),
        ("self_reference", 2),
        ("wrong_member", 1),
        ("missing_regulatory_element", 1),
        ("node_without_position", 2),
        ("duplicate_id", 1),
    ] {
        assert_eq!(count(reason), expected, "{reason}: {}", report.summary());
    }
    assert!(report.warnings["missing_way"].examples[0].contains("lanelet 52"));
}

#[test]
fn nodes_that_are_nowhere_are_said_to_be_so() {
    let node_7 = "<node id=\"7\" x=\"20\" y=\"0\"/>";
    for (position, expected) in [
        (r#"x="NaN" y="0""#, "`x` is \"NaN\", expected a number from -21000000 to 21000000 m"),
        (r#"x="20" y="1e300""#, "`y` is \"1e300\""),
        (r#"lat="nan" lon="0""#, "`lat` is \"nan\", expected a number from -90 to 90 degrees"),
        (r#"lat="0.01" lon="181""#, "`lon` is \"181\", expected a number from -180 to 180 degrees"),
        (r#"x="east" y="0""#, "`x` is \"east\""),
        (r#"x="20""#, "has no position; it needs `lat` and `lon`, or `x` and `y`"),
    ] {
        let nodes = nodes().replace(node_7, &format!("<node id=\"7\" {position}/>"));
        let (graph, report) = read_valid(&[&nodes, WAYS, RELATIONS].concat());
        assert_eq!(graph.lanes().len(), 2, "lane 3 has lost its right bound");
        assert_eq!(report.warnings["node_without_position"].examples.len(), 1);
        let examples = &report.warnings["misplaced_node"].examples;
        assert!(examples[0].starts_with("lanelet 3: node 7 of its right bound: "), "{examples:?}");
        assert!(examples[0].contains(expected), "{examples:?}");
    }
}

#[test]
fn positions_of_autoware_count_where_there_are_no_others() {
    let (expected, _) = read_valid(&[&nodes(), WAYS, RELATIONS].concat());
    for geo in ["", r#"lat="" lon="""#, r#"lat="0" lon="0.0""#] {
        let node = |(id, x, y): &(i64, f64, f64)| {
            let tags = format!(r#"<tag k="local_x" v="{x}"/><tag k="ele" v="1"/><tag k="local_y" v="{y}"/>"#);
            format!("<node id=\"{id}\" {geo}>{tags}</node>")
        };
        let nodes: String = NODES.iter().map(node).collect();
        let (graph, report) = read_valid(&[&nodes, WAYS, RELATIONS].concat());
        assert_eq!((graph, report.summary().as_str()), (expected.clone(), ""), "{geo}");
    }
    // If nodes have both, latitude and longitude count.
    let both: String = NODES
        .iter()
        .map(|(id, x, y)| {
            let (lat, lon) = (y / 1e5, x / 1e5);
            format!(
                r#"<node id="{id}" lat="4{lat}" lon="8{lon}"><tag k="local_x" v="0"/><tag k="local_y" v="0"/></node>"#
            )
        })
        .collect();
    assert!(read(&osm(&[&both, WAYS, RELATIONS].concat())).is_ok());
}

#[test]
fn the_frame_of_real_coordinates_is_that_of_the_lanes() {
    let node = |(id, x, y): (i64, f64, f64)| {
        format!("<node id=\"{id}\" lat=\"{}\" lon=\"{}\"/>", 48.1 + y / 1e5, 11.5 + x / 1e5)
    };
    let in_order: Vec<String> = NODES.map(node).to_vec();
    let (graph, report) = read_valid(&[&in_order.concat(), WAYS, RELATIONS].concat());
    let corner = graph.get(LaneId(1)).unwrap().right.0.iter().map(|point| point.norm()).fold(f64::INFINITY, f64::min);
    assert!(corner < 1e-6, "node 1 is the corner: {corner}");
    assert_eq!(
        report.summary(),
        "1 maps_of_assumed_origin (latitude 48.1 and longitude 11.5, the southwest corner of its lanes, are taken for \
         (0, 0); tracks must be given from there)"
    );
    let reversed: String = in_order.iter().rev().map(String::as_str).collect();
    let whole = in_order.concat();
    let far = node((90, -3000.0, -3000.0));
    let foot = r#"<way id="90"><nd ref="90"/><nd ref="1"/></way><relation id="90"><member type="way" role="left" ref="90"/>
        <member type="way" role="right" ref="90"/><tag k="type" v="lanelet"/><tag k="subtype" v="walkway"/></relation>"#;
    for nodes in [
        reversed,
        format!("{far}{whole}"),
        format!("{}{whole}", far.replace("<node", "<node action=\"delete\"")),
        format!("{far}{foot}{whole}"),
        format!("<node id=\"91\" lat=\"0\" lon=\"0\"/>{whole}"),
        // A lane that is left out because one of its nodes is in another country.
        format!(
            "<node id=\"92\" lat=\"4.81\" lon=\"1.15\"/><way id=\"92\"><nd ref=\"92\"/><nd ref=\"2\"/></way>{}{whole}",
            r#"<relation id="92"><member type="way" role="left" ref="92"/><member type="way" role="right" ref="11"/>
            <tag k="type" v="lanelet"/></relation>"#
        ),
    ] {
        let (found, report) = read_valid(&[&nodes, WAYS, RELATIONS].concat());
        assert_eq!(found, graph, "{nodes}");
        assert!(report.summary().contains("latitude 48.1 and longitude 11.5"), "{}", report.summary());
    }
}

#[test]
fn maps_are_read_in_the_encoding_they_declare() {
    let (expected, _) = read_valid(&[&nodes(), WAYS, RELATIONS].concat());
    let text = osm(&[&nodes(), WAYS, RELATIONS].concat()).replace("<osm ", "<!-- Stra\u{df}e --><osm ");
    let latin1 = |declaration: &str| -> Vec<u8> {
        text.replace("version=\"1.0\"", declaration).chars().map(|c| c as u8).collect()
    };
    let utf16: Vec<u8> = [0xfeff].into_iter().chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect();
    let declared = latin1("version=\"1.0\" encoding=\"ISO-8859-1\"");
    for bytes in [declared, utf16] {
        assert_eq!(read_map(&mut bytes.as_slice(), "maps/test.osm").unwrap().0, expected);
    }
    assert!(read_map(&mut latin1("version=\"1.0\"").as_slice(), "maps/test.osm").is_err());
}

#[test]
fn hostile_and_malformed_documents_are_errors_with_their_line() {
    let bomb = r#"<?xml version="1.0"?>
<!DOCTYPE osm [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;&b;">]>
<osm><node id="&c;" x="0" y="0"/></osm>"#;
    assert!(message(bomb).contains("line 2") && message(bomb).contains("DOCTYPE"));
    let entity = osm("<relation id=\"1\"><tag k=\"type\" v=\"&lane;\"/></relation>");
    assert!(message(&entity).contains("line 3"), "{}", message(&entity));
    assert!(message(&osm("text &lane; text")).contains("&lane;"));
    let deep = format!("<osm>{}", "<a>".repeat(100_000));
    assert!(message(&deep).contains("deeper than"));
    let attributes: String = (0..100_000).map(|i| format!(" a{i}=\"\"")).collect();
    assert!(message(&osm(&format!("<node id=\"1\"{attributes}/>"))).contains("attributes"));
    assert!(message("<osm><node id=\"1\" x=\"0\" y=\"0\"/>").contains("ends within an element"));
    assert!(message("<osm><way id=\"1\"></osm>").contains("line 1"));
    assert!(message("<commonRoad/>").contains("<commonRoad>"));
    assert!(message(&osm("<node id=\"one\" x=\"0\" y=\"0\"/>")).contains("expected a whole number"));
    assert!(message("").contains("no XML"));
    assert!(message(&osm(&[&nodes(), WAYS].concat())).contains("no vehicle lane"));
    let latin1 = read_map(&mut &b"<osm>\xe9</osm>"[..], "maps/test.osm").unwrap_err().to_string();
    assert!(latin1.contains("line 1") && latin1.contains("UTF-8"), "{latin1}");
}

#[test]
fn a_map_cannot_grow_beyond_its_file() {
    // One long way, named by many lanelets; it lacks a node, which keeps the test quick.
    let way: String = (0..50_000).map(|i| format!("<nd ref=\"{}\"/>", 1 + i % 2)).collect();
    let relations: String = (100..200)
        .map(|id| {
            format!(
                r#"<relation id="{id}"><member type="way" role="left" ref="20"/><member type="way" role="right" ref="20"/>
                   <tag k="type" v="lanelet"/></relation>"#
            )
        })
        .collect();
    let body = format!("{}<way id=\"20\">{way}<nd ref=\"99\"/></way>{relations}", nodes());
    assert!(message(&osm(&body)).contains("points"));
}

fn read_file(path: &std::path::Path) -> (LaneGraph, MapReport) {
    let mut reader = std::io::BufReader::new(fs_err::File::open(path).unwrap());
    read_map(&mut reader, &path.display().to_string()).unwrap()
}

/// Whether left lies left of the centerline and right lies right of it, and both run along with it.
fn assert_sane(graph: &LaneGraph) {
    for lane in graph.lanes() {
        let n = lane.centerline.0.len();
        assert!(n >= 2, "{:?}", lane.id);
        let outline = lane.outline().unwrap();
        let area = (0..outline.len()).map(|i| outline[i].cross(outline[(i + 1) % outline.len()])).sum::<f64>();
        assert!(area < 0.0, "{:?}: left and right are exchanged", lane.id);
        let (left, right) = (&lane.left.0, &lane.right.0);
        let along = left[0].distance(right[0]) + left[left.len() - 1].distance(right[right.len() - 1]);
        let across = left[0].distance(right[right.len() - 1]) + left[left.len() - 1].distance(right[0]);
        assert!(along < across, "{:?}: the bounds run against each other", lane.id);
        for successor in &lane.successors {
            let next = graph.get(*successor).unwrap();
            assert!(next.predecessors.contains(&lane.id));
            assert!(lane.centerline.0[n - 1].distance(next.centerline.0[0]) < 1e-9);
        }
    }
}

#[test]
fn both_encodings_of_a_map_agree() {
    let [(osm, report), (osm_xy, _)] = ["osm", "osm_xy"].map(|kind| {
        let map = format!("tests/fixtures/recordings/interaction_v1_1/maps/FIX_Intersection.{kind}");
        read_file(std::path::Path::new(&map))
    });
    assert_eq!(report.summary(), "");
    // Of its 64 lanelets, 28 have the right bound of another one as their left bound.
    assert_eq!((osm.lanes().len(), osm_xy.lanes().len()), (64, 64));
    assert_eq!(osm.lanes().iter().filter(|lane| lane.left_neighbor.is_some()).count(), 28);
    assert_sane(&osm);
    for (a, b) in osm.lanes().iter().zip(osm_xy.lanes()) {
        assert_eq!((a.id, &a.successors, &a.attributes), (b.id, &b.successors, &b.attributes));
        for (line_a, line_b) in [(&a.left, &b.left), (&a.right, &b.right), (&a.centerline, &b.centerline)] {
            assert_eq!(line_a.0.len(), line_b.0.len());
            assert!(line_a.0.iter().zip(&line_b.0).all(|(p, q)| p.distance(*q) < 1e-3));
        }
    }
    assert!(osm.lanes().iter().any(|lane| !lane.successors.is_empty()));
}

#[test]
fn the_toy_map_of_the_interaction_authors_has_its_two_opposed_lanes() {
    let Some(samples) = test_data("samples/interaction_official") else { return };
    let (graph, report) = read_file(&samples.join("TestScenarioForScripts.osm"));
    assert_eq!(report.summary(), "");
    // Nodes lie at y = 1, 4 and 7 m, x = 1 and 101 m; the lower lane runs along x, the upper one against it.
    let [lower, upper] = [20, 21].map(|id| graph.get(LaneId(id)).unwrap());
    let ends = |lane: &crate::scene::Lane| (lane.centerline.0[0], lane.centerline.0[lane.centerline.0.len() - 1]);
    assert!(ends(lower).0.distance(Vec2::new(1.0, 2.5)) < 1e-2 && ends(lower).1.distance(Vec2::new(101.0, 2.5)) < 1e-2);
    assert!(ends(upper).0.distance(Vec2::new(101.0, 5.5)) < 1e-2 && ends(upper).1.distance(Vec2::new(1.0, 5.5)) < 1e-2);
    assert_eq!((lower.left_neighbor, upper.left_neighbor), (None, None));
}

#[test]
fn a_real_map_with_true_coordinates_is_read() {
    let Some(samples) = test_data("samples/lanelet2") else { return };
    let (graph, report) = read_file(&samples.join("mapping_example.osm"));
    assert_eq!(report.n_lanelets, 371);
    assert!(graph.lanes().len() > 300, "{report:?}");
    assert_sane(&graph);
    // It covers a part of Karlsruhe 3.4 km wide.
    assert!(graph.lanes().iter().all(|lane| lane.centerline.0.iter().all(|p| p.norm() < 3500.0)));
    assert!(graph.lanes().iter().any(|lane| lane.attributes.has_traffic_control));
    let n_connected = graph.lanes().iter().filter(|lane| !lane.successors.is_empty()).count();
    assert!(n_connected > 250, "{n_connected}");
}

#[test]
fn elements_without_content_count() {
    let mut report = MapReport::default();
    let text = r#"<osm><way id="7"/><relation id="8"/><way id="9" action="delete"/><node id="1" x="0" y="0"/></osm>"#;
    let osm = osm::parse(text, "", &mut report).unwrap();
    assert_eq!((osm.ways.keys().collect::<Vec<_>>(), osm.ways[&7].len()), (vec![&7], 0));
    assert_eq!((osm.relations.len(), osm.nodes.len()), (1, 1));
    osm::parse(r#"<osm><way id="7"/><way id="7"/></osm>"#, "", &mut report).unwrap();
    assert!(report.summary().contains("duplicate_id"), "{}", report.summary());
}
