//! CommonRoad: do the numbers in the files follow from a scene by hand?

use super::*;
use crate::export::testing::{self, Node, add_all, assert_same_states};
use crate::geometry::Polyline;
use crate::ingest::{IngestConfig, scenes_of};
use crate::scene::testing::without_states;
use crate::scene::{AgentClass, Dataset, Lane, LaneGraph, Scene, Trajectory};
use std::sync::Arc;

fn written(scene: &Scene, ego: EgoMotion) -> std::result::Result<(Node, Written), &'static str> {
    let dir = tempfile::tempdir().unwrap();
    let mut outcomes = add_all(Box::new(CommonRoad::new(dir.path(), ego)), std::slice::from_ref(scene));
    let written = outcomes.remove(0)?;
    Ok((Node::parse(&testing::read(dir.path(), &written.file)), written))
}

fn xy(node: &Node) -> (f64, f64) {
    (node.number("x"), node.number("y"))
}

#[test]
fn the_file_says_what_it_is() {
    let (root, written) = written(&testing::scene(), EgoMotion::Replayed).unwrap();
    assert_eq!((root.name.as_str(), root.attr("commonRoadVersion")), ("commonRoad", "2020a"));
    assert_eq!((root.attr("benchmarkID"), root.attr("timeStepSize")), ("ZAM_Test-1_1_T-1", "0.1"));
    assert_eq!((written.file.as_str(), written.first_timestep), ("ZAM_Test-1_1_T-1.xml", 3));
    let tags: Vec<&str> = root.at("scenarioTags").children.iter().map(|tag| tag.name.as_str()).collect();
    assert_eq!(tags, ["simulated", "cut_in"]);
    // In the order that the schema demands.
    let mut order: Vec<&str> = root.children.iter().map(|child| child.name.as_str()).collect();
    order.dedup();
    assert_eq!(order, ["location", "scenarioTags", "lanelet", "dynamicObstacle", "planningProblem"]);
}

#[test]
fn lanelets_are_connected_and_lie_where_the_lanes_lie() {
    let (root, _) = written(&testing::scene(), EgoMotion::Replayed).unwrap();
    let lanelets = root.all("lanelet");
    assert_eq!(lanelets.iter().map(|lanelet| lanelet.attr("id")).collect::<Vec<_>>(), ["1", "2"]);
    assert_eq!((lanelets[0].at("successor").attr("ref"), lanelets[0].all("predecessor").len()), ("2", 0));
    assert_eq!(lanelets[1].at("predecessor").attr("ref"), "1");
    let points = |bound: &str| lanelets[0].at(bound).all("point").into_iter().map(xy).collect::<Vec<_>>();
    // The lane runs north; its left boundary is 2 m to the west.
    assert_eq!(points("leftBound"), [(998.0, 2000.0), (998.0, 2040.0)]);
    assert_eq!(points("rightBound"), [(1002.0, 2000.0), (1002.0, 2040.0)]);
    let found = (lanelets[0].at("laneletType").text.as_str(), lanelets[0].at("userOneWay").text.as_str());
    assert_eq!(found, ("urban", "vehicle"));
}

#[test]
fn obstacles_move_from_the_present_on() {
    let mut scene = testing::scene();
    // The pedestrian moves 1 m/s to the left and looks ahead.
    let ahead = |state: &Option<State>| state.map(|state| State { heading_rad: 0.0, ..state });
    let entries = scene.tracks[2].trajectory.entries().iter().map(ahead).collect();
    scene.tracks[2].trajectory = crate::scene::Trajectory::new(entries);
    let (root, written) = written(&scene, EgoMotion::Replayed).unwrap();
    let obstacles = root.all("dynamicObstacle");
    assert_eq!(obstacles.iter().map(|o| o.attr("id")).collect::<Vec<_>>(), ["3", "4", "5"]);
    assert_eq!(written.tracks, ["3", "4", "5"].map(|id| Ok(id.to_owned())));
    let initial = obstacles[0].at("initialState");
    // The present is timestep 3: three meters to the north of the origin, heading north at 10 m/s.
    assert_eq!(xy(initial.at("position").at("point")), (1000.0, 2003.0));
    assert_eq!((initial.at("time").number("exact"), initial.at("velocity").number("exact")), (0.0, 10.0));
    let sideways = obstacles[2].at("initialState");
    let velocity = |name: &str| sideways.at(name).number("exact");
    assert_eq!((velocity("velocity"), velocity("velocityY")), (0.0, 1.0));
    assert!((initial.at("orientation").number("exact") - std::f64::consts::FRAC_PI_2).abs() < 1e-6);
    let states = obstacles[0].at("trajectory").all("state");
    let steps: Vec<f64> = states.iter().map(|state| state.at("time").number("exact")).collect();
    assert_eq!(steps, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]);
    assert_eq!(xy(states[7].at("position").at("point")), (1000.0, 2011.0));
    let size =
        |i: usize| (obstacles[i].at("shape").at("rectangle").number("length"), obstacles[i].at("type").text.clone());
    assert_eq!((size(0), size(2)), ((4.5, "car".to_owned()), (0.75, "pedestrian".to_owned())));
    assert!(written.assumed.contains(&("nominal_size", 1)), "{:?}", written.assumed);
}

#[test]
fn the_planning_problem_leads_from_the_present_into_the_last_second() {
    let mut scene = testing::scene();
    // One step before the present the ego was slower by 1 m/s and headed 0.1 rad more to the right.
    let mut entries = scene.tracks[0].trajectory.entries().to_vec();
    entries[2] = entries[2].map(|state| State {
        heading_rad: -0.1,
        velocity: crate::geometry::Vec2::from_angle(-0.1) * 9.0,
        ..state
    });
    scene.tracks[0].trajectory = crate::scene::Trajectory::new(entries);
    let (root, written) = written(&scene, EgoMotion::Free).unwrap();
    assert_eq!(written.tracks[0], Err("ego_is_free"));
    assert_eq!(root.all("dynamicObstacle").len(), 2);
    let problem = root.at("planningProblem");
    assert_eq!(problem.attr("id"), "6");
    let initial = problem.at("initialState");
    assert_eq!(xy(initial.at("position").at("point")), (1000.0, 2003.0));
    assert!((initial.at("yawRate").number("exact") - 1.0).abs() < 1e-6);
    assert!((initial.at("acceleration").number("exact") - 10.0).abs() < 1e-6);
    let goal = problem.at("goalState");
    // Eight steps remain; all but none of them are within the last second.
    assert_eq!((goal.at("time").number("intervalStart"), goal.at("time").number("intervalEnd")), (1.0, 8.0));
    // A planner that brakes for the event comes through, too.
    assert!(goal.all("position").is_empty());
}

#[test]
fn what_cannot_be_written_is_told() {
    let scene = testing::scene();
    let without_lanes = Scene { lanes: Arc::new(LaneGraph::default()), ..scene.clone() };
    assert_eq!(written(&without_lanes, EgoMotion::Replayed).err(), Some("no_lanes"));
    let past = Scene { n_history: 12, ..scene.clone() };
    assert_eq!(written(&past, EgoMotion::Replayed).err(), Some("no_future"));
    let lonely = without_states(scene.clone(), 0, |timestep| timestep > 3);
    assert_eq!(written(&lonely, EgoMotion::Replayed).err(), Some("no_ego"));

    let gaps = without_states(scene.clone(), 1, |timestep| timestep == 7);
    let gaps = without_states(gaps, 2, |timestep| timestep == 3);
    let (root, outcome) = written(&gaps, EgoMotion::Replayed).unwrap();
    assert_eq!(outcome.tracks[2], Err("absent_at_present"));
    // Timesteps 4 to 6 follow the present; 8 to 11 come after the gap.
    assert_eq!(root.all("dynamicObstacle")[1].at("trajectory").all("state").len(), 3);
    assert!(outcome.assumed.contains(&("states_after_gap", 4)), "{:?}", outcome.assumed);

    let center = Lane { left: Polyline::default(), ..testing::lane(1) };
    let point = Lane { centerline: Polyline::default(), ..Lane { id: crate::scene::LaneId(2), ..center.clone() } };
    let narrow = Scene { lanes: Arc::new(LaneGraph::new(vec![center, point])), ..scene };
    let (root, outcome) = written(&narrow, EgoMotion::Replayed).unwrap();
    assert_eq!(root.all("lanelet").len(), 1);
    assert_eq!(outcome.assumed[..2], [("nominal_lane_width", 1), ("lane_without_extent", 1)]);
}

#[test]
fn what_is_exported_can_be_ingested_again() {
    let mut scene = testing::scene();
    // The pedestrian walks to the left.
    let ahead = |state: &Option<State>| state.map(|state| State { heading_rad: 0.0, ..state });
    scene.tracks[2].trajectory = Trajectory::new(scene.tracks[2].trajectory.entries().iter().map(ahead).collect());
    scene.tracks[2].class = AgentClass::Pedestrian;
    let dir = tempfile::tempdir().unwrap();
    let written = add_all(Box::new(CommonRoad::new(dir.path(), EgoMotion::Replayed)), std::slice::from_ref(&scene));
    let tracks = &written[0].as_ref().unwrap().tracks;
    let config = IngestConfig {
        n_history: Some(1),
        n_future: Some(scene.n_timesteps - scene.n_history),
        ..IngestConfig::new(Dataset::CommonRoad, vec![dir.path().to_owned()])
    };
    let (scenes, _) = scenes_of(&config).unwrap();
    let [again] = scenes.as_slice() else { panic!("{} scenes", scenes.len()) };
    for (idx, track) in scene.tracks.iter().enumerate() {
        let name = tracks[idx].as_ref().unwrap();
        let found = again.tracks.iter().position(|track| &track.id.0 == name).unwrap();
        let seen = (again.tracks[found].class, again.tracks[found].extent);
        assert_eq!(seen, (track.class, Some(track.extent_or_nominal())));
        assert_same_states((&scene, idx), (again, found), -(scene.current_timestep() as isize), [1e-6; 2]);
    }
    assert_eq!(again.lanes.lanes().len(), scene.lanes.lanes().len());
}
