//! What can be wrong with maps, and with scenarios that bring their own.

use super::cases::Edit::{Cut, Gone, Made, Replace, Whole};
use super::cases::Then::{Ends, GoesOn, Rejected};
use super::cases::{Case, case, replaced_last, text};
use super::inputs::{ARGOVERSE1_MAP, ARGOVERSE2, ARGOVERSE2_MAP, Input, MAP, OSM, XML, XODR};

const ROADS: (Input, &str) = (Input::OpenDrive, XODR);
const LANELETS: (Input, &str) = (Input::Lanelet2, OSM);
const SCENARIO: (Input, &str) = (Input::CommonRoad, XML);

pub(super) const CASES: &[Case] = &[
    // Maps in OpenDRIVE.
    case("an empty map", ROADS, Whole(""), Ends, &["town.xodr", "line 1", "no element"]),
    case("no XML", ROADS, Whole("id,t\n1,2\n"), Ends, &["town.xodr", "line 1"]),
    case("a map cut short", ROADS, Cut(70), Ends, &["town.xodr", "line 23", "cut short"]),
    case(
        "tags that do not match",
        ROADS,
        Replace(&[("</planView>", "</planwiew>")]),
        Ends,
        &["town.xodr", "line 8", "planwiew"],
    ),
    case(
        "another root",
        ROADS,
        Replace(&[("<OpenDRIVE>", "<net>"), ("</OpenDRIVE>", "</net>")]),
        Ends,
        &["town.xodr", "<net>", "<OpenDRIVE>"],
    ),
    case(
        "a document type",
        ROADS,
        Replace(&[("<OpenDRIVE>", "<!DOCTYPE a [<!ENTITY b 'c'>]>\n<OpenDRIVE>")]),
        Ends,
        &["town.xodr", "line 2", "document type"],
    ),
    case(
        "a map in no encoding",
        ROADS,
        Made(|bytes| [bytes, b"<!-- \xff -->"].concat()),
        Ends,
        &["town.xodr", "line 37", "UTF-8"],
    ),
    case(
        "a road without lanes to drive on",
        ROADS,
        Made(|bytes| text(bytes).replace("'driving'", "'sidewalk'").into_bytes()),
        Ends,
        &["town.xodr", "no vehicle lane", "2 roads"],
    ),
    case(
        "a road without geometry",
        ROADS,
        Replace(&[("<geometry s='0' x='20' y='0' hdg='0' length='60'><line/></geometry>", "")]),
        GoesOn,
        &["town.xodr", "road 2 on line 20: has no geometry"],
    ),
    case(
        "a road of no length",
        ROADS,
        Replace(&[("<road id='2' length='60'", "<road id='2' length='0'")]),
        GoesOn,
        &["town.xodr", "road 2 on line 20: is 0 m long, expected more than 0"],
    ),
    case(
        "a road of negative length",
        ROADS,
        Replace(&[("<road id='2' length='60'", "<road id='2' length='-60'")]),
        GoesOn,
        &["town.xodr", "road 2 on line 20: is -60 m long"],
    ),
    case(
        "a road around the earth",
        ROADS,
        Replace(&[("<road id='2' length='60'", "<road id='2' length='4e7'")]),
        GoesOn,
        &["town.xodr", "road 2 on line 20: is 40000000 m long", "at most 100000"],
    ),
    case(
        "a width below zero",
        ROADS,
        Made(|bytes| replaced_last(bytes, "a='3.5'", "a='-3.5'")),
        GoesOn,
        &["town.xodr", "road 2, lane -1", "-3.5 m"],
    ),
    case(
        "a width that is no number",
        ROADS,
        Made(|bytes| replaced_last(bytes, "a='3.5'", "a='nan'")),
        GoesOn,
        &["town.xodr", "road 2 on line 20: <width> on line 30 has a \"nan\", expected a number"],
    ),
    case(
        "a length that is a word",
        ROADS,
        Replace(&[("<road id='2' length='60'", "<road id='2' length='long'")]),
        GoesOn,
        &["town.xodr", "road 2 on line 20: <road> on line 20 has length \"long\", expected a number"],
    ),
    case(
        "a road without lanes",
        ROADS,
        Made(|bytes| {
            let text = text(bytes);
            let at = text.rfind("<laneSection").unwrap();
            let end = text.rfind("</lanes>").unwrap();
            [&text[..at], &text[end..]].concat().into_bytes()
        }),
        GoesOn,
        &["town.xodr", "road 2 on line 20: has no <laneSection>"],
    ),
    case(
        "a reference line with a hole",
        ROADS,
        Replace(&[(
            "<geometry s='0' x='20' y='0' hdg='0' length='60'>",
            "<geometry s='0' x='20' y='0' hdg='0' \
            length='30'><line/></geometry><geometry s='30' x='90' y='30' hdg='0' length='30'>",
        )]),
        GoesOn,
        &["town.xodr", "road 2: its geometry at 30 m begins 50.0 m from where the one before ends"],
    ),
    case(
        "a reference line that ends early",
        ROADS,
        Replace(&[("hdg='0' length='60'", "hdg='0' length='30'")]),
        GoesOn,
        &["town.xodr", "road 2: its geometry ends after 30 of 60 m"],
    ),
    case(
        "a link to an unknown junction",
        ROADS,
        Replace(&[("elementType='road' elementId='2'", "elementType='junction' elementId='9'")]),
        GoesOn,
        &["town.xodr", "road 1 is linked to junction 9, which is not read"],
    ),
    case(
        "a link to an unknown lane",
        ROADS,
        Replace(&[("<successor id='-1'/>", "<successor id='-7'/>")]),
        GoesOn,
        &["town.xodr", "lane -1 of road 1 is linked to lane -7 of road 2, which is not there"],
    ),
    case(
        "a link to a street",
        ROADS,
        Replace(&[("elementType='road' elementId='2'", "elementType='street' elementId='2'")]),
        GoesOn,
        &["town.xodr", "<successor> on line 5 has elementType \"street\", expected road or junction"],
    ),
    case(
        "a contact in the middle",
        ROADS,
        Replace(&[("contactPoint='start'", "contactPoint='middle'")]),
        GoesOn,
        &["town.xodr", "<successor> on line 5 has contactPoint \"middle\", expected start or end"],
    ),
    case(
        "a junction of unknown roads",
        ROADS,
        Replace(&[(
            "</OpenDRIVE>",
            "<junction id='5'><connection incomingRoad='1' connectingRoad='8'/></junction>\n\
            </OpenDRIVE>",
        )]),
        GoesOn,
        &["town.xodr", "junction 5 connects road 8, which is not read"],
    ),
    case(
        "a map of somewhere else",
        ROADS,
        Made(|bytes| {
            text(bytes)
                .replace("x='-20' y='0'", "x='5000' y='0'")
                .replace("x='20' y='0'", "x='5040' y='0'")
                .into_bytes()
        }),
        Ends,
        &["no lane of table/town within 100 m", "its lanes lie from (5000.0, -1.8) to (5100.0, -1.8)"],
    ),
    case(
        "an unknown geometry",
        ROADS,
        Made(|bytes| replaced_last(bytes, "<line/>", "<helix/>")),
        GoesOn,
        &["town.xodr", "road 2 on line 20: ", "<helix>, which the format does not list"],
    ),
    case(
        "a place beyond all maps",
        ROADS,
        Replace(&[("x='20'", "x='1e300'")]),
        GoesOn,
        &["town.xodr", "road 2, lane -1"],
    ),
    case(
        "a lane twice",
        ROADS,
        Made(|bytes| replaced_last(bytes, "</right>", "<lane id='-1' type='driving'/></right>")),
        GoesOn,
        &["town.xodr", "road 2", "lane -1 twice"],
    ),
    case(
        "a road twice",
        ROADS,
        Replace(&[("<road id='2'", "<road id='1'")]),
        GoesOn,
        &["town.xodr", "road 1 on line 20: the first of this id is kept"],
    ),
    case(
        "a link to nowhere",
        ROADS,
        Replace(&[
            ("elementId='2'", "elementId='9'"),
            ("<predecessor elementType='road' elementId='1'", "<predecessor elementType='road' elementId='8'"),
        ]),
        GoesOn,
        &["town.xodr", "road 1 is linked to road 9"],
    ),
    case(
        "a road that follows itself",
        ROADS,
        Replace(&[("elementId='2' contactPoint='start'", "elementId='1' contactPoint='start'")]),
        GoesOn,
        &["town.xodr", "lane -1 of road 1 and lane -1 of road 1 are linked, but 40.0 m apart"],
    ),
    case(
        "a section behind the end",
        ROADS,
        Made(|bytes| replaced_last(bytes, "<laneSection s='0'>", "<laneSection s='600'>")),
        GoesOn,
        &["town.xodr", "road 2 on line 20: has lanes from 600 m on, but is 60 m long"],
    ),
    // Maps in Lanelet2.
    case("an empty map in OSM", LANELETS, Whole(""), Ends, &["town.osm", "no "]),
    case("no OSM", LANELETS, Whole("{\"type\": \"osm\"}"), Ends, &["town.osm", "line 1", "no XML"]),
    case("OSM cut short", LANELETS, Cut(70), Ends, &["town.osm", "line 15"]),
    case(
        "a coordinate that is a word",
        LANELETS,
        Replace(&[("x='80' y='0'", "x='east' y='0'")]),
        GoesOn,
        &["town.osm", "node 5", "`x` is \"east\", expected a number"],
    ),
    case(
        "a node that is missing",
        LANELETS,
        Replace(&[("<node id='5' x='80' y='0'/>", "")]),
        GoesOn,
        &["town.osm", "22", "node 5"],
    ),
    case(
        "a lanelet with one bound",
        LANELETS,
        Replace(&[("<member type='way' role='right' ref='14'/>\n", "")]),
        GoesOn,
        &["town.osm", "22", "right"],
    ),
    case(
        "a relation twice",
        LANELETS,
        Replace(&[("<relation id='22'>", "<relation id='21'>")]),
        GoesOn,
        &["town.osm", "relation 21"],
    ),
    case(
        "an id that is a word",
        LANELETS,
        Replace(&[("<way id='13'>", "<way id='left'>")]),
        Ends,
        &["town.osm", "line 11", "`id` is \"left\", expected a whole number"],
    ),
    // Scenarios of CommonRoad.
    case("a scenario cut short", SCENARIO, Cut(70), Rejected, &["a.xml", "line 107", "cut short"]),
    case(
        "another time step",
        SCENARIO,
        Replace(&[("timeStepSize='0.1'", "timeStepSize='0.04'")]),
        Rejected,
        &["a.xml", "timeStepSize is 0.04, expected 0.1"],
    ),
    case(
        "an obstacle without a beginning",
        SCENARIO,
        Made(|bytes| {
            text(bytes)
                .rsplit_once("<initialState>")
                .map(|(a, b)| [a, "<firstState>", &b.replace("</initialState>", "</firstState>")].concat().into_bytes())
                .unwrap()
        }),
        GoesOn,
        &["a.xml", "obstacle 8 on line 81: has no <initialState>"],
    ),
    case(
        "a heading that is no number",
        SCENARIO,
        Made(|bytes| replaced_last(bytes, "<orientation><exact>0.0", "<orientation><exact>nan")),
        GoesOn,
        &["a.xml", "obstacle 8 on line 81: ", "on line 144 is \"nan\", expected a number"],
    ),
    case(
        "an obstacle without width",
        SCENARIO,
        Made(|bytes| replaced_last(bytes, "<width>1.8", "<width>0")),
        GoesOn,
        &["a.xml", "obstacle 8", "4.5 by 0 m"],
    ),
    case(
        "two states at one time",
        SCENARIO,
        Made(|bytes| replaced_last(bytes, "<time><exact>59<", "<time><exact>58<")),
        GoesOn,
        &["a.xml", "obstacle 8", "two states at time 58"],
    ),
    case(
        "a bound of a word",
        SCENARIO,
        Replace(&[("<x>80</x><y>0</y>", "<x>east</x><y>0</y>")]),
        GoesOn,
        &["a.xml", "lanelet 2 on line 9: ", "on line 10 is \"east\", expected a number"],
    ),
    case(
        "a version to come",
        SCENARIO,
        Replace(&[("'2020a'", "'2031z'")]),
        GoesOn,
        &["a.xml: commonRoadVersion is \"2031z\", expected one of 2018a, 2018b, 2020a"],
    ),
    case(
        "an obstacle twice",
        SCENARIO,
        Replace(&[("<dynamicObstacle id='8'>", "<dynamicObstacle id='7'>")]),
        GoesOn,
        &["a.xml: obstacle 7 on line 81: the first of this id is kept"],
    ),
    case(
        "a speed that is a word",
        SCENARIO,
        Made(|bytes| replaced_last(bytes, "<velocity><exact>10.0", "<velocity><exact>fast")),
        GoesOn,
        &["a.xml", "obstacle 8", "on line 144 is \"fast\", expected a number"],
    ),
    case(
        "a lanelet that leads nowhere",
        SCENARIO,
        Replace(&[("<successor ref='2'/>", "<successor ref='9'/>")]),
        GoesOn,
        &["a.xml: lanelet 1 is linked to lanelet 9, which is not there"],
    ),
    case(
        "no lanelets",
        SCENARIO,
        Made(|bytes| text(bytes).replace("lanelet id", "lane id").replace("</lanelet>", "</lane>").into_bytes()),
        Rejected,
        &["a.xml: has no lane", "ingest.maps = \"none\""],
    ),
    case(
        "nobody who moves",
        SCENARIO,
        Made(|bytes| text(bytes).replace("dynamicObstacle", "planningProblem").into_bytes()),
        Rejected,
        &["a.xml", "has no obstacle that moves"],
    ),
    case(
        "a scenario of two seconds",
        SCENARIO,
        Made(|bytes| {
            let text = text(bytes);
            let begins: Vec<usize> = text.match_indices("<state>").map(|(at, _)| at).collect();
            let ends: Vec<usize> = text.match_indices("</trajectory>").map(|(at, _)| at).collect();
            [&text[..begins[20]], &text[ends[0]..begins[79]], &text[ends[1]..]].concat().into_bytes()
        }),
        Rejected,
        &["a.xml", "21 time steps, a scene has 40", "ingest.n_history and ingest.n_future"],
    ),
    // INTERACTION and Argoverse.
    case("a map that is missing", (Input::Interaction, MAP), Gone, Ends, &["map", "ingest.map_inputs", "ingest.maps"]),
    case("a vector map cut short", (Input::Argoverse1, ARGOVERSE1_MAP), Cut(50), Ends, &["vector_map.xml, line "]),
    case("a scenario in half a Parquet", (Input::Argoverse2, ARGOVERSE2), Cut(50), Ends, &["scenario_5f1d", "Parquet"]),
    case("half a map", (Input::Argoverse2, ARGOVERSE2_MAP), Cut(50), Ends, &["log_map_archive_5f1d", "line "]),
    case(
        "a list for a map",
        (Input::Argoverse2, ARGOVERSE2_MAP),
        Whole("[1, 2]"),
        Ends,
        &["log_map_archive_5f1d", "line 1", "expected"],
    ),
    case(
        "a map that is not there",
        (Input::Argoverse2, ARGOVERSE2_MAP),
        Gone,
        Ends,
        &["scenario_5f1d", "log_map_archive_"],
    ),
];
