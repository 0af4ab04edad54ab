//! Scenarios of both versions, whole and broken.

use crate::ingest::test_data::scenes;
use crate::ingest::xml_tree::Element;
use crate::ingest::{Error, IngestConfig, IngestReport};
use crate::scene::{AgentClass, Dataset, LaneId, Scene, TurnDirection};
use fs_err as fs;
use std::fmt::Write as _;

/// A point, a state and a lanelet as the format writes them.
fn point(x: f64, y: f64) -> String {
    format!("<point><x>{x}</x><y>{y}</y></point>")
}

fn state(name: &str, time: f64, x: f64, y: f64) -> String {
    format!(
        "<{name}><position>{}</position><orientation><exact>0.0</exact></orientation><time><exact>{time}</exact></time>\
         <velocity><exact>10</exact></velocity></{name}>",
        point(x, y)
    )
}

fn lanelet(id: i64, y: f64, links: &str) -> String {
    let bound = |name: &str, y: f64| format!("<{name}>{}{}</{name}>", point(-50.0, y), point(150.0, y));
    format!("<lanelet id=\"{id}\">{}{}{links}</lanelet>", bound("leftBound", y + 1.75), bound("rightBound", y - 1.75))
}

/// An obstacle that drives along x from `first` to `last` at 10 m/s.
fn moving(open: &str, id: i64, kind: &str, [first, last]: [i64; 2], y: f64) -> String {
    let x = |time: i64| time as f64;
    let mut text = format!(
        "<{open} id=\"{id}\"><role>dynamic</role><type>{kind}</type>\
         <shape><rectangle><length>4.4</length><width>1.8</width></rectangle></shape>{}<trajectory>",
        state("initialState", first as f64, x(first), y)
    );
    for time in first + 1..=last {
        text += &state("state", time as f64, x(time), y);
    }
    write!(text, "</trajectory></{open}>").unwrap();
    text
}

fn scenario(content: &str) -> String {
    format!(
        "<?xml version=\"1.0\"?><commonRoad benchmarkID=\"USA_Some-3_2_T-1\" commonRoadVersion=\"2018b\" \
         timeStepSize=\"0.1\">{content}</commonRoad>"
    )
}

fn whole() -> String {
    let lanes = lanelet(1, 0.0, "<adjacentLeft ref=\"2\" drivingDir=\"same\"/><speedLimit>13.4</speedLimit>")
        + &lanelet(2, 3.5, "<adjacentRight ref=\"1\" drivingDir=\"same\"/>");
    scenario(&(lanes + &moving("obstacle", 7, "car", [0, 84], 0.0) + &moving("obstacle", 8, "truck", [20, 60], 3.5)))
}

fn read(text: &str) -> Result<(Vec<Scene>, IngestReport), Error> {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("a.xml"), text).unwrap();
    scenes(&IngestConfig::new(Dataset::CommonRoad, vec![folder.path().to_owned()]))
}

#[test]
fn windows_of_a_scenario_hold_its_obstacles_and_lanes() {
    let (scenes, report) = read(&whole()).unwrap();
    assert_eq!((scenes.len(), report.n_scenes, report.n_rejects()), (2, 2, 0));
    let (first, second) = (&scenes[0], &scenes[1]);
    assert_eq!(first.id.0, "commonroad/unsplit/USA_Some-3/USA_Some-3_2_T-1@0");
    assert_eq!((second.source.first_frame.as_str(), second.source.place.as_str()), ("40", "USA_Some-3"));
    assert_eq!((first.n_history, first.n_timesteps, first.dt_s), (10, 40, 0.1));
    // The truck appears after the present of the first window.
    let classes = |scene: &Scene| scene.tracks.iter().map(|track| track.class).collect::<Vec<_>>();
    assert_eq!((classes(first), classes(second)), (vec![AgentClass::Vehicle], vec![AgentClass::Vehicle; 2]));
    let truck = second.tracks.iter().find(|track| track.id.0 == "8").unwrap();
    assert!(truck.trajectory.is_valid(20) && !truck.trajectory.is_valid(21), "it is gone after time 60");
    assert_eq!(truck.extent.map(|extent| (extent.length_m, extent.width_m)), Some((4.4, 1.8)));
    let world =
        |scene: &Scene, idx: usize, t: usize| scene.world_from_scene.point(scene.state(idx, t).unwrap().position);
    let car = world(second, 0, 9);
    assert!((car.x - 49.0).abs() < 1e-9 && car.y.abs() < 1e-9, "{car:?}");
    let lane = second.lanes.get(LaneId(1)).unwrap();
    assert_eq!(lane.left_neighbor, Some(LaneId(2)));
    assert_eq!(lane.attributes.tags["speed_limit_mps"], "13.4");
    assert_eq!(first.map_id, second.map_id);
}

#[test]
fn the_later_version_has_kinds_turns_and_things_that_stand() {
    let lanes = lanelet(1, 0.0, "<laneletType>urban</laneletType>")
        + &lanelet(2, 3.5, "<laneletType>crosswalk</laneletType>")
        + "<intersection id=\"9\"><incoming id=\"10\"><incomingLanelet ref=\"5\"/><successorsLeft ref=\"1\"/>\
           </incoming></intersection>";
    let parked = format!(
        "<staticObstacle id=\"3\"><type>parkedVehicle</type><shape><circle><radius>1</radius></circle></shape>{}\
         </staticObstacle>",
        state("initialState", 0.0, 30.0, -3.0)
    );
    let text = scenario(&(lanes + &moving("dynamicObstacle", 7, "taxi", [0, 50], 0.0) + &parked));
    let (scenes, _) = read(&text.replace("2018b", "2020a")).unwrap();
    let lane = scenes[0].lanes.get(LaneId(1)).unwrap();
    assert_eq!(scenes[0].lanes.lanes().len(), 1, "nobody drives on a crosswalk");
    assert!(lane.attributes.is_intersection && lane.attributes.turn == TurnDirection::Left);
    let parked = scenes[0].tracks.iter().find(|track| track.id.0 == "3").unwrap();
    assert!((0..40).all(|timestep| parked.trajectory.is_valid(timestep)));
    assert_eq!(parked.extent.map(|extent| extent.length_m), Some(2.0));
}

#[test]
fn one_bad_obstacle_or_lanelet_is_named_and_costs_nothing_else() {
    for (good, bad, expected) in [
        (
            "<type>truck</type>",
            "<type>tank</type>",
            "obstacle 8 on line 1: is of type \"tank\", which the format does not list",
        ),
        ("<time><exact>30</exact>", "<time><exact>29</exact>", "has two states at time 29"),
        ("<exact>84</exact>", "<intervalStart>84</intervalStart>", "<time/exact> within <state> on line 1 is missing"),
        ("<x>33</x><y>3.5</y>", "<x>NaN</x><y>3.5</y>", "<x> within <point> on line 1 is \"NaN\", expected a number"),
        ("<x>33</x><y>3.5</y>", "<x>1e9</x><y>3.5</y>", "lies at (1000000000, 3.5)"),
        (
            "<lanelet id=\"2\">",
            "<lanelet id=\"b\">",
            "lanelet b on line 1: <lanelet> on line 1 has id \"b\", expected a whole number",
        ),
    ] {
        let text = whole().replacen(good, bad, 1);
        assert_ne!(text, whole(), "{good}");
        let (scenes, report) = read(&text).unwrap_or_else(|error| panic!("{bad}: {error}"));
        let found = format!("{report:?}");
        // A lanelet that is left out may be the successor of others.
        let warnings = report.warnings.iter().filter(|(what, _)| **what != "links_to_nowhere");
        let n_warnings: u64 = warnings.map(|(_, warning)| warning.count).sum();
        assert_eq!(n_warnings, 1, "however many windows: {bad}: {found}");
        assert!(!scenes.is_empty() && found.contains(&expected.replace('"', "\\\"")), "{bad}: {found}");
    }
}

#[test]
fn elements_may_not_be_nested_without_end() {
    let deep = "<a>".repeat(40) + &"</a>".repeat(40);
    assert!(Element::parse(&deep).unwrap_err().to_string().contains("more than 32 elements"));
}

/// The scenario of a car, an obstacle 9 with this shape, which drives north, and these elements.
fn with_shape(shape: &str, more: &str) -> String {
    let car = moving("dynamicObstacle", 7, "car", [0, 45], 0.0);
    let north = (moving("dynamicObstacle", 9, "truck", [0, 45], 8.0))
        .replace("<rectangle><length>4.4</length><width>1.8</width></rectangle>", shape)
        .replace("<orientation><exact>0.0", "<orientation><exact>1.5707963267948966");
    scenario(&(lanelet(1, 0.0, more) + &car + &north))
}

#[test]
fn the_position_is_the_center_of_the_box_around_all_shapes() {
    let rectangle =
        |length: f64, more: &str| format!("<rectangle><length>{length}</length><width>2</width>{more}</rectangle>");
    let center = |x: f64, y: f64| format!("<center><x>{x}</x><y>{y}</y></center>");
    let corners = [(-1.0, -1.0), (5.0, -1.0), (5.0, 1.0), (-1.0, 1.0)].map(|(x, y)| point(x, y)).concat();
    for (shape, size, [ahead, left]) in [
        (rectangle(4.0, &center(1.5, 0.25)), [4.0, 2.0], [1.5, 0.25]),
        (rectangle(4.0, "<orientation>1.5707963267948966</orientation>"), [2.0, 4.0], [0.0, 0.0]),
        // A tractor of 4 m, and a trailer of 8 m whose middle is 6.5 m behind the middle of the tractor.
        (rectangle(4.0, "") + &rectangle(8.0, &center(-6.5, 0.0)), [12.5, 2.0], [-4.25, 0.0]),
        (format!("<circle><radius>1</radius>{}</circle>", center(2.0, 0.0)), [2.0, 2.0], [2.0, 0.0]),
        (format!("<polygon>{corners}</polygon>"), [6.0, 2.0], [2.0, 0.0]),
    ] {
        let (scenes, _) = read(&with_shape(&shape, "")).unwrap();
        let track = scenes[0].tracks.iter().position(|track| track.id.0 == "9").unwrap();
        let extent = scenes[0].tracks[track].extent.unwrap();
        assert!((extent.length_m - size[0]).abs().max((extent.width_m - size[1]).abs()) < 1e-9, "{extent:?}");
        for timestep in [0, 9, 39] {
            // North is ahead, west is to the left.
            let at = scenes[0].world_from_scene.point(scenes[0].state(track, timestep).unwrap().position);
            let (x, y) = (timestep as f64 - left, 8.0 + ahead);
            assert!((at.x - x).abs().max((at.y - y).abs()) < 1e-9, "{shape}: {at:?}");
        }
    }
    for (length, expected) in [("-4.4", "-4.4 by 2 m"), ("1e308", "1e308 by 2 m"), ("nan", "is \"nan\"")] {
        let shape = rectangle(4.0, "").replace(">4<", &format!(">{length}<"));
        let (_, report) = read(&with_shape(&shape, "")).unwrap();
        assert!(report.warnings["obstacles_left_out"].examples[0].contains(expected), "{report:?}");
    }
}

#[test]
fn lanelets_for_both_directions_are_for_both() {
    for (more, one_way) in [
        ("<userBidirectional>vehicle</userBidirectional>", false),
        ("<userOneWay>car</userOneWay><userBidirectional>bicycle</userBidirectional>", true),
    ] {
        let (scenes, _) = read(&with_shape("<circle><radius>1</radius></circle>", more)).unwrap();
        assert_eq!(scenes[0].lanes.get(LaneId(1)).unwrap().attributes.one_way, one_way);
    }
}

#[test]
fn states_without_orientation_head_as_they_move() {
    // Positions and velocities alone, as of point masses: 10 m/s along y.
    let orientation = "<orientation><exact>0.0</exact></orientation>";
    let mut text = moving("dynamicObstacle", 7, "car", [0, 45], 3.0).replace(orientation, "");
    for time in 0..=45 {
        text = text.replace(&point(f64::from(time), 3.0), &point(3.0, f64::from(time)));
    }
    let text = text.replace("<velocity><exact>10", "<velocityY><exact>10").replace("</velocity>", "</velocityY>");
    let (scenes, report) = read(&scenario(&(lanelet(1, 0.0, "") + &text))).unwrap();
    assert_eq!(report.warnings.len(), 0, "{report:?}");
    let heading_rad = scenes[0].world_from_scene.heading(scenes[0].state(0, 0).unwrap().heading_rad);
    assert!((heading_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-9, "{heading_rad}");
}

#[test]
fn what_is_left_out_is_said_where_nothing_is_left() {
    let car = moving("dynamicObstacle", 7, "car", [0, 45], 0.0);
    let others = "<phantomObstacle id=\"3\"/><environmentObstacle id=\"4\"/>";
    let ignored = car.replace("<trajectory>", "<occupancySet/><trajectory>");
    let (_, report) = read(&scenario(&(lanelet(1, 0.0, "") + &ignored + others))).unwrap();
    assert_eq!(report.warnings["predicted_obstacles_ignored"].count, 3, "{report:?}");
    for (bad, expected) in [
        (car.replace("<x>5</x>", "<x>1e300</x>"), "obstacle 7 on line 1: lies at (1e300, 0)"),
        (car.replace("<length>4.4", "<length>nan"), "1 obstacles left out: a.xml: obstacle 7 on line 1"),
        (car.replace("<exact>45</exact>", "<exact>1e9</exact>"), "has time 1000000000,"),
        (car.replace("<exact>45</exact>", "<exact>-5</exact>"), "has time -5, expected a whole number from 0 to"),
    ] {
        let error = read(&scenario(&(lanelet(1, 0.0, "") + &bad))).unwrap_err().to_string();
        assert!(error.contains("no_obstacles") && error.contains(expected), "{error}");
    }
}

#[test]
fn places_far_from_the_origin_are_read_and_kept() {
    // In UTM: everything moved by (691,000, 5,335,000) m.
    let (east, north) = (691_000.0, 5_335_000.0);
    let car = |x0: f64, y0: f64| {
        let states =
            (0..=45).map(|t| state(if t == 0 { "initialState" } else { "state" }, f64::from(t), x0 + f64::from(t), y0));
        let states: Vec<String> = states.collect();
        let shape = "<shape><rectangle><length>4.4</length><width>1.8</width></rectangle></shape>";
        format!(
            "<dynamicObstacle id=\"7\"><type>car</type>{shape}{}<trajectory>{}</trajectory></dynamicObstacle>",
            states[0],
            states[1..].concat()
        )
    };
    let bound = |name: &str, y: f64| {
        format!("<{name}>{}{}</{name}>", point(east - 50.0, north + y), point(east + 150.0, north + y))
    };
    let lanelet = format!("<lanelet id=\"1\">{}{}</lanelet>", bound("leftBound", 1.75), bound("rightBound", -1.75));
    let (scenes, report) = read(&scenario(&(lanelet + &car(east, north)))).unwrap();
    assert_eq!((scenes[0].lanes.lanes().len(), report.warnings.len()), (1, 0), "{report:?}");
    let at = scenes[0].world_from_scene.point(scenes[0].state(0, 39).unwrap().position);
    assert!((at.x - east - 39.0).abs().max((at.y - north).abs()) < 1e-6, "{at:?}");
}
