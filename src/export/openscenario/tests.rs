//! OpenSCENARIO: the positions of entities over time, by the numbers in the file.

use super::*;
use crate::export::testing::{self, Node, add_all};
use crate::scene::testing::without_states;
use crate::scene::{Scene, Trajectory};
use std::f64::consts::{FRAC_PI_2, PI};

fn written(scene: &Scene, ego: EgoMotion) -> (Node, Written) {
    let dir = tempfile::tempdir().unwrap();
    let mut outcomes = add_all(Box::new(OpenScenario::new(dir.path(), ego)), std::slice::from_ref(scene));
    let written = outcomes.remove(0).unwrap();
    (Node::parse(&testing::read(dir.path(), &written.file)), written)
}

/// The name, the time and the action's innermost names of each event of an entity.
fn events<'a>(root: &'a Node, entity: &str) -> Vec<(String, f64, &'a Node)> {
    let groups = root.below("ManeuverGroup");
    let group = groups.into_iter().find(|group| group.at("Actors").at("EntityRef").attr("entityRef") == entity);
    let events = group.map_or_else(Vec::new, |group| group.at("Maneuver").all("Event"));
    let event = |event: &'a Node| {
        let condition = event.at("StartTrigger").below("Condition")[0];
        assert_eq!(condition.attr("conditionEdge"), "none");
        let time = condition.below("SimulationTimeCondition")[0];
        assert_eq!(time.attr("rule"), "greaterOrEqual");
        (event.attr("name").to_owned(), time.attr_number("value"), event.at("Action"))
    };
    events.into_iter().map(event).collect()
}

/// The scene's lanes have boundaries.
const NO_NOMINAL_LANES: [(&str, u64); 2] = [("nominal_lane_width", 0), ("lane_without_extent", 0)];

fn place(position: &Node) -> (f64, f64, f64) {
    let world = position.at("WorldPosition");
    (world.attr_number("x"), world.attr_number("y"), world.attr_number("h"))
}

#[test]
fn the_ego_comes_first_and_is_where_it_is() {
    let (root, outcome) = written(&testing::scene(), EgoMotion::Replayed);
    assert_eq!((root.at("FileHeader").attr("revMajor"), root.at("FileHeader").attr("revMinor")), ("1", "2"));
    assert_eq!(root.at("FileHeader").at("License").text, "none");
    let properties = root.at("FileHeader").at("Properties").all("Property");
    let present = properties.iter().find(|property| property.attr("name") == "present_s").unwrap();
    assert_eq!(present.attr_number("value"), 0.3, "the fourth timestep at 10 Hz");
    let objects = root.at("Entities").all("ScenarioObject");
    let names: Vec<&str> = objects.iter().map(|object| object.attr("name")).collect();
    assert_eq!(names, ["Ego", "track_2", "track_P3", "track_P3_part2"]);
    assert_eq!(outcome.tracks, ["Ego", "track_2", "track_P3"].map(|name| Ok(name.to_owned())));
    assert_eq!(outcome.assumed, [("nominal_size", 1), ("split_at_gap", 1), NO_NOMINAL_LANES[0], NO_NOMINAL_LANES[1]]);

    // A car of 4.5 m has its axles 2.7 m apart, and its center half of that ahead of the rear one.
    let car = objects[0].at("Vehicle");
    assert_eq!(car.at("BoundingBox").at("Center").attr_number("x"), 1.35);
    assert_eq!(car.at("BoundingBox").at("Dimensions").attr_number("length"), 4.5);
    assert_eq!(car.at("Axles").at("FrontAxle").attr_number("positionX"), 2.7);
    assert_eq!(objects[2].at("Pedestrian").at("BoundingBox").at("Center").attr_number("x"), 0.0);

    // The center is at (1000, 2000) at first and heads north: the rear axle is south of it.
    let privates = root.below("Private");
    assert_eq!(privates.iter().map(|p| p.attr("entityRef")).collect::<Vec<_>>(), ["Ego", "track_P3"]);
    let (x, y, h) = place(privates[0].below("Position")[0]);
    assert_eq!((x, y), (1000.0, 1998.65));
    assert!((h - FRAC_PI_2).abs() < 1e-6);
    assert_eq!(privates[0].below("AbsoluteTargetSpeed")[0].attr_number("value"), 10.0);
}

#[test]
fn trajectories_have_the_times_of_the_scenario_and_last_to_the_end() {
    let (root, _) = written(&testing::scene(), EgoMotion::Replayed);
    let ego = events(&root, "Ego");
    assert_eq!(ego.len(), 1);
    assert_eq!((ego[0].0.as_str(), ego[0].1), ("follow_Ego", 0.0));
    let follow = ego[0].2.below("FollowTrajectoryAction")[0];
    let timing = follow.at("TimeReference").at("Timing");
    let timing = ["domainAbsoluteRelative", "offset", "scale"].map(|name| timing.attr(name));
    assert_eq!(timing, ["absolute", "0.0", "1.0"]);
    assert_eq!(follow.at("TrajectoryFollowingMode").attr("followingMode"), "position");
    let vertices = follow.below("Vertex");
    assert_eq!(vertices.len(), 12);
    assert_eq!((vertices[0].attr_number("time"), vertices[11].attr_number("time")), (0.0, 1.1));
    let (x, y, _) = place(vertices[11].at("Position"));
    assert_eq!((x, y), (1000.0, 2009.65));
    let stop = root.at("Storyboard").at("StopTrigger").below("Condition")[0];
    assert_eq!(stop.below("SimulationTimeCondition")[0].attr_number("value"), 1.099);
    assert_eq!((stop.attr("conditionEdge"), root.below("None").len()), ("none", 0));
}

#[test]
fn who_comes_later_is_added_and_who_leaves_is_deleted() {
    let (root, _) = written(&testing::scene(), EgoMotion::Replayed);
    let names =
        |entity: &str| events(&root, entity).into_iter().map(|(name, time, _)| (name, time)).collect::<Vec<_>>();
    let event = |name: &str, time: f64| (name.to_owned(), time);
    // A millisecond early, so that a player whose clock says 0.09999999999999999 does not wait for another step.
    assert_eq!(names("track_2"), [event("add_track_2", 0.099), event("follow_track_2", 0.099)]);
    // Two timesteps, a gap of one, and nine to the end.
    assert_eq!(names("track_P3"), [event("follow_track_P3", 0.0), event("delete_track_P3", 0.199)]);
    let again = "track_P3_part2";
    assert_eq!(names(again), [event("add_track_P3_part2", 0.299), event("follow_track_P3_part2", 0.299)]);
    let later = events(&root, again);
    let entity = later[0].2.below("EntityAction")[0];
    assert_eq!(entity.attr("entityRef"), again);
    let (x, y, _) = place(entity.at("AddEntityAction").at("Position"));
    // A pedestrian is placed by the center: 0.3 m to the west after 0.3 s.
    assert_eq!((x, y), (999.7, 2005.0));
    let vertices = later[1].2.below("Vertex");
    let times = (vertices[0].attr_number("time"), vertices[8].attr_number("time"));
    assert_eq!((vertices.len(), times), (9, (0.3, 1.1)));
}

#[test]
fn headings_go_on_beyond_half_a_turn() {
    let mut scene = testing::scene();
    scene.world_from_scene = crate::geometry::Transform2::from_pose(scene.world_from_scene.translation, 0.0);
    let turning = |timestep: usize| {
        let heading_rad = crate::geometry::wrap_angle(3.0 + 0.1 * timestep as f64);
        Some(State { heading_rad, ..State::default() })
    };
    scene.tracks[0].trajectory = Trajectory::new((0..12).map(turning).collect());
    let (root, _) = written(&scene, EgoMotion::Replayed);
    let ego = events(&root, "Ego");
    let headings: Vec<f64> = ego[0].2.below("Vertex").iter().map(|vertex| place(vertex.at("Position")).2).collect();
    assert!(headings[11] > PI);
    assert!(headings.iter().enumerate().all(|(i, h)| (h - 3.0 - 0.1 * i as f64).abs() < 1e-6), "{headings:?}");
}

#[test]
fn a_free_ego_moves_as_recorded_until_the_present() {
    let scene = testing::scene();
    let (root, outcome) = written(&scene, EgoMotion::Free);
    assert_eq!(outcome.tracks[0], Ok("Ego".to_owned()));
    assert_eq!(root.below("Private")[0].attr("entityRef"), "Ego");
    // Four timesteps are observed; the ego is not deleted after them.
    let ego = events(&root, "Ego");
    assert_eq!((ego.len(), ego[0].0.as_str()), (1, "follow_Ego"));
    let vertices = ego[0].2.below("Vertex");
    assert_eq!((vertices.len(), vertices[3].attr_number("time")), (4, 0.3));
    assert_eq!(root.at("FileHeader").below("Property")[3].attr("value"), "0.3");
    // The states before a gap are not the way to the present.
    let gap = without_states(scene.clone(), 0, |timestep| timestep == 1);
    let (root, _) = written(&gap, EgoMotion::Free);
    let names: Vec<String> = events(&root, "Ego").into_iter().map(|(name, ..)| name).collect();
    assert_eq!((names, root.below("ScenarioObject").len()), (vec!["add_Ego".to_owned(), "follow_Ego".to_owned()], 4));
    // Without a past there is only a start; without a present there is no agent to take over.
    let start = Scene { n_history: 1, ..scene.clone() };
    let (root, _) = written(&start, EgoMotion::Free);
    assert_eq!((root.below("Private")[0].attr("entityRef"), events(&root, "Ego").len()), ("Ego", 0));
    let absent = without_states(scene, 0, |timestep| timestep == 3);
    let dir = tempfile::tempdir().unwrap();
    let outcome = add_all(Box::new(OpenScenario::new(dir.path(), EgoMotion::Free)), &[absent]).remove(0);
    assert_eq!(outcome.err(), Some("no_ego"));
}

#[test]
fn who_has_one_state_alone_stays_there_for_a_timestep() {
    let brief = without_states(testing::scene(), 1, |timestep| timestep != 5);
    let (root, _) = written(&brief, EgoMotion::Replayed);
    let names: Vec<String> = events(&root, "track_2").into_iter().map(|(name, ..)| name).collect();
    assert_eq!(names, ["add_track_2", "follow_track_2", "delete_track_2"]);
    let vertices = events(&root, "track_2")[1].2.below("Vertex");
    let times: Vec<f64> = vertices.iter().map(|vertex| vertex.attr_number("time")).collect();
    assert_eq!((times, place(vertices[0].at("Position"))), (vec![0.5, 0.6], place(vertices[1].at("Position"))));
}

#[test]
fn scenarios_of_a_scene_share_their_roads() {
    let scene = testing::scene();
    let other = Scene { id: "other".into(), ..scene.clone() };
    let roadless = Scene { id: "roadless".into(), lanes: std::sync::Arc::default(), ..scene.clone() };
    let dir = tempfile::tempdir().unwrap();
    let scenes = [scene.clone(), scene, other, roadless];
    let written = add_all(Box::new(OpenScenario::new(dir.path(), EgoMotion::Replayed)), &scenes);
    let roads = |i: usize| {
        let root = Node::parse(&testing::read(dir.path(), &written[i].as_ref().unwrap().file));
        root.at("RoadNetwork").children.first().map(|file| file.attr("filepath").to_owned())
    };
    let expected = ["roads/0a1b0.xodr", "roads/0a1b0.xodr", "roads/0a1b2.xodr"].map(|file| Some(file.to_owned()));
    assert_eq!(([0, 1, 2].map(roads), roads(3)), (expected, None));
    assert_eq!(Node::parse(&testing::read(dir.path(), "roads/0a1b2.xodr")).all("road").len(), 2);
}
