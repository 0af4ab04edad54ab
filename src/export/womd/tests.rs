//! Waymo Open Motion: do scenarios have the dataset's fields, and does our own reader find what was written?
//! `scripts/check_exports.py` reads them with the dataset's own package.

use super::*;
use crate::export::testing::{self, add_all, assert_same_states, womd_scenes};
use crate::geometry::{Polyline, Vec2};
use crate::ingest::womd::messages::{BoundarySegment, FeatureData, LaneNeighbor};
use crate::scene::{Lane, LaneGraph, LaneId, SituationKind};
use std::sync::Arc;

fn written(scenes: &[Scene]) -> (tempfile::TempDir, Vec<std::result::Result<Written, &'static str>>) {
    let dir = tempfile::tempdir().unwrap();
    let outcomes = add_all(Box::new(Womd::new(dir.path())), scenes);
    (dir, outcomes)
}

#[test]
fn states_classes_and_roles_are_the_ones_of_the_scenario() {
    let mut scene = testing::scene();
    scene.tracks[2].id = "77".into();
    let (dir, outcomes) = written(std::slice::from_ref(&scene));
    let outcome = outcomes[0].as_ref().unwrap();
    assert_eq!((outcome.file.as_str(), outcome.name.as_str()), ("training.tfrecord-00000-of-00001", "0a1b0"));
    assert_eq!(outcome.tracks, ["1", "2", "77"].map(|id| Ok(id.to_owned())));
    assert_eq!(outcome.assumed, [("lane_without_extent", 0), ("nominal_size", 1), ("renumbered_track", 0)]);
    let read = &womd_scenes(dir.path(), [4, 8])[0];
    assert_eq!((read.source.case_id.as_str(), read.n_timesteps, read.ego().id.0.as_str()), ("0a1b0", 12, "1"));
    let of = |id: &str| &read.tracks[read.track_idx(&id.into()).unwrap()];
    // Track 2 takes part in the event, as the ego does.
    assert_eq!((of("2").role, of("77").role), (TrackRole::Scored, TrackRole::Context));
    assert_eq!((of("2").class, of("77").class), (AgentClass::Vehicle, AgentClass::Pedestrian));
    let now = read.ego().trajectory.get(3).unwrap().transformed(&read.world_from_scene);
    assert!(now.position.distance(Vec2::new(1000.0, 2003.0)) < 1e-9);
    assert!(now.velocity.distance(Vec2::new(0.0, 10.0)) < 1e-6);
    assert!(!of("77").trajectory.is_valid(2) && !of("2").trajectory.is_valid(0));
    // Names that are no numbers give way to numbers, of all.
    scene.tracks[2].id = "P3".into();
    assert_eq!(ids(&scene), [1, 2, 3]);
    scene.tracks[2].id = "1".into();
    assert_eq!(ids(&scene), [1, 2, 3]);
    scene.dt_s = 0.04;
    assert_eq!(written(&[scene]).1[0].as_ref().err(), Some(&"not_10_hz"));
}

/// A lane of 40 m along x in the scene, with these tags.
fn lane(id: i64, tags: &[(&str, &str)]) -> Lane {
    let mut lane = testing::lane(id);
    Arc::make_mut(&mut lane.attributes).tags.extend(tags.iter().map(|(key, value)| ((*key).into(), (*value).into())));
    lane
}

#[test]
fn maps_have_what_tags_tell_and_else_what_lanes_are() {
    let mut scene = testing::scene();
    let first = lane(
        1,
        &[
            ("left_boundaries", "9:0-0/edge;9:1-1/broken_single_white"),
            ("left_neighbors", "5:0-1/0-1;99:0-1/0-1"),
            ("speed_limit_mps", "11.176"),
            ("stop_signs", "30"),
            ("traffic_light", "stop:0-4;go:6-90"),
            ("crosswalk:31", "1000,2010 1002,2010 1002,2013"),
        ],
    );
    let second = Lane {
        right_neighbor: Some(LaneId(1)),
        predecessors: vec![LaneId(1)],
        ..lane(5, &[("boundaries", "assumed:3.8_m_wide"), ("stop_signs", "30")])
    };
    let pointless = Lane { centerline: Polyline(vec![Vec2::ZERO]), ..testing::lane(8) };
    scene.lanes = Arc::new(LaneGraph::new(vec![first, second, pointless]));
    let (features, left_out) = map::features(&scene);
    assert_eq!(left_out, [("lane_without_extent", 1)]);
    assert_eq!(features.iter().map(|feature| feature.id).collect::<Vec<_>>(), [1, 2, 3, 5, 30, 31]);
    let of = |id: i64| features.iter().find(|feature| feature.id == id).unwrap().feature_data.clone().unwrap();
    let (FeatureData::Lane(one), FeatureData::Lane(other)) = (of(1), of(5)) else { panic!("lanes") };
    let bound = |id, [lane_start_index, lane_end_index]: [i32; 2], boundary_type| BoundarySegment {
        lane_start_index,
        lane_end_index,
        boundary_feature_id: id,
        boundary_type,
    };
    assert_eq!(one.left_boundaries, [bound(2, [0, 0], 0), bound(2, [1, 1], 1)]);
    assert_eq!(one.right_boundaries, [bound(3, [0, 1], 0)], "not marked");
    assert!(other.left_boundaries.is_empty() && other.right_boundaries.is_empty(), "assumed");
    let neighbor = |feature_id| LaneNeighbor {
        feature_id,
        self_start_index: 0,
        self_end_index: 1,
        neighbor_start_index: 0,
        neighbor_end_index: 1,
    };
    assert_eq!((one.left_neighbors, other.right_neighbors), (vec![neighbor(5)], vec![neighbor(1)]));
    assert!((one.speed_limit_mph - 25.0).abs() < 1e-9 && one.kind == 2 && other.entry_lanes == [1]);
    let FeatureData::RoadEdge(edge) = of(2) else { panic!("the map calls its first part an edge") };
    // 2 m to the left of a lane to the north.
    assert!((edge.polyline[1].x - 998.0).abs() < 1e-9 && (edge.polyline[1].y - 2040.0).abs() < 1e-9);
    assert!(matches!(of(3), FeatureData::RoadLine(line) if line.kind == 0));
    assert!(matches!(of(30), FeatureData::StopSign(sign) if sign.lane == [1, 5]));
    assert!(matches!(of(31), FeatureData::Crosswalk(of) if of.polygon.len() == 3 && of.polygon[2].y == 2013.0));
    let shown = |scene: &Scene, timestep| map::lights(scene, timestep).iter().map(|of| (of.lane, of.state)).collect();
    let states: [Vec<(i64, i32)>; 3] = [4, 5, 6].map(|timestep| shown(&scene, timestep));
    assert_eq!(states, [vec![(1, 4)], vec![], vec![(1, 6)]]);
    scene.source.situation = SituationKind::Continued;
    assert_eq!(shown(&scene, 4), []);
}

#[test]
fn our_own_reader_finds_the_same_scenes() {
    // Recordings in this format, of which all is kept.
    let mut scenes = womd_scenes(Path::new("tests/fixtures/recordings/womd/training"), [11, 80]);
    assert_eq!(scenes.len(), 2);
    for scene in &mut scenes {
        scene.tracks.swap(0, scene.ego_idx);
        scene.ego_idx = 0;
    }
    let (dir, _) = written(&scenes);
    let read = womd_scenes(dir.path(), [11, 80]);
    for (ours, theirs) in scenes.iter().zip(&read) {
        assert_eq!((ours.tracks.len(), ours.n_timesteps, &ours.ego().id), (theirs.tracks.len(), 91, &theirs.ego().id));
        for (agent_idx, track) in ours.tracks.iter().enumerate() {
            let other_idx = theirs.track_idx(&track.id).unwrap();
            let other = &theirs.tracks[other_idx];
            assert_eq!((track.class, track.extent), (other.class, other.extent));
            assert_same_states((ours, agent_idx), (theirs, other_idx), 0, [1e-6, 1e-4]);
        }
        let [own, other] = [ours, theirs].map(|scene| scene.lanes.transformed(&scene.world_from_scene));
        assert_eq!(own.lanes().len(), other.lanes().len());
        for (a, b) in own.lanes().iter().zip(other.lanes()) {
            let plain = |lane: &Lane| {
                let mut attributes = (*lane.attributes).clone();
                // Boundaries have other names.
                attributes.tags.retain(|key, _| !key.ends_with("_boundaries"));
                (
                    lane.id,
                    lane.left_neighbor,
                    lane.right_neighbor,
                    lane.successors.clone(),
                    lane.predecessors.clone(),
                    attributes,
                )
            };
            assert_eq!(plain(a), plain(b));
            assert!(a.centerline.0.iter().zip(&b.centerline.0).all(|(a, b)| a.distance(*b) < 1e-6), "{:?}", a.id);
            // Other points of the same lines.
            for (a, b) in [(&a.left, &b.left), (&a.right, &b.right)] {
                let off_m = b.0.iter().filter_map(|at| Some(a.project(*at)?.point.distance(*at))).fold(0.0, f64::max);
                assert!(a.0.is_empty() == b.0.is_empty() && off_m < 1e-3, "{off_m}");
            }
        }
    }
}
