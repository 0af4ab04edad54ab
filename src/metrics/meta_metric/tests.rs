//! The likelihoods against those of the challenge's own program, against values by hand, and the edges of a small map.

use super::*;
use crate::geometry::{Polyline, Vec2};
use crate::metrics::constant_velocity;
use crate::scene::testing::{self, Drive, without_states};
use crate::scene::{Extent, Lane, LaneGraph, LaneId, State, Track, TrackId, TrackRole, Trajectory};
use serde::Deserialize;
use std::collections::BTreeMap;

/// `scripts/golden_meta_metric.py` writes it with the challenge's own program.
#[derive(Deserialize)]
struct Golden {
    dt_s: f64,
    n_history: usize,
    agents: Vec<GoldenAgent>,
    edges: Vec<Vec<[f64; 2]>>,
    cases: Vec<GoldenCase>,
}

#[derive(Deserialize)]
struct GoldenAgent {
    class: String,
    length_m: f64,
    width_m: f64,
}

/// States are `[x, y, heading]`, agent by agent.
#[derive(Deserialize)]
struct GoldenCase {
    recorded: Vec<Vec<Option<[f64; 3]>>>,
    samples: Vec<Vec<Vec<[f64; 3]>>>,
    likelihoods: BTreeMap<String, f64>,
}

impl Golden {
    fn scene(&self, states: &[Vec<Option<[f64; 3]>>]) -> Scene {
        let state = |[x, y, heading_rad]: [f64; 3]| State {
            position: Vec2::new(x, y),
            heading_rad,
            velocity: Vec2::new(99.0, 99.0),
        };
        let tracks = self.agents.iter().zip(states).enumerate().map(|(idx, (agent, states))| Track {
            id: TrackId(idx.to_string()),
            class: AgentClass::from_name(&agent.class).unwrap(),
            role: TrackRole::Context,
            extent: Some(Extent { length_m: agent.length_m, width_m: agent.width_m }),
            trajectory: Trajectory::new(states.iter().map(|of| of.map(state)).collect()),
        });
        let (n_history, n_timesteps) = (self.n_history, states[0].len());
        Scene { dt_s: self.dt_s, n_history, n_timesteps, tracks: tracks.collect(), ..testing::scene(&[]) }
    }
}

#[test]
fn likelihoods_are_those_of_the_challenge() {
    let golden = fs_err::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/meta_metric.json")).unwrap();
    let golden: Golden = serde_json::from_str(&golden).unwrap();
    let lines: Vec<Vec<Vec2>> =
        golden.edges.iter().map(|line| line.iter().map(|[x, y]| Vec2::new(*x, *y)).collect()).collect();
    for case in &golden.cases {
        let recorded = golden.scene(&case.recorded);
        let sample = |futures: &Vec<Vec<[f64; 3]>>| {
            let whole = case.recorded.iter().zip(futures).map(|(recorded, future)| {
                recorded[..golden.n_history].iter().copied().chain(future.iter().map(|state| Some(*state))).collect()
            });
            golden.scene(&whole.collect::<Vec<_>>())
        };
        let samples: Vec<Scene> = case.samples.iter().map(sample).collect();
        let edges = Some(RoadEdges::new(&lines));
        let [found] = Likelihoods::with_edges(&recorded, edges.as_ref(), [&samples], samples.len());
        assert_eq!(case.likelihoods.len(), FEATURES.len());
        for (feature, value) in FEATURES.iter().zip(found.0) {
            let expected = case.likelihoods[feature.id.strip_prefix("realism_").unwrap()];
            let value = value.unwrap();
            assert!((value - expected).abs() < 1e-5, "{}: {value} instead of {expected}", feature.id);
        }
    }
}

#[test]
fn one_car_by_hand() {
    // A car at a steady 11 m/s on the lane of the test scene, 3.5 m wide, and nobody else, for 8 timesteps.
    let recorded = testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 11.0)]);
    let faster = testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 12.6)]);
    let groups = [std::slice::from_ref(&recorded), std::slice::from_ref(&faster)];
    let [own, other] = Likelihoods::of_groups(&recorded, true, groups, 2);
    let names: BTreeMap<&str, Option<f64>> = Likelihoods::specs().map(|spec| spec.id).zip(own.values()).collect();
    // In the 16 samples, the last speed is undefined and counts in the last bin; so do two accelerations.
    for (name, expected) in [
        ("realism_linear_speed", 14.1 / 17.0),
        ("realism_linear_acceleration", 12.1 / 17.1),
        ("realism_distance_to_nearest_object", 16.1 / 17.0),
        ("realism_collision_indication", 2.001 / 2.002),
        ("realism_offroad_indication", 2.001 / 2.002),
        ("realism_kinematic", (2.0 * 12.1 / 17.1 + 14.1 / 17.0 + 14.1 / 17.1) / 4.0),
    ] {
        assert!((names[name].unwrap() - expected).abs() < 1e-9, "{name}: {:?}", names[name]);
    }
    assert!((other.0[0].unwrap() - 0.1 / 17.0).abs() < 1e-9, "speeds of another bin");
    assert_eq!(other.0[1..], own.0[1..]);
}

#[test]
fn features_without_values_leave_their_weights_to_others() {
    let drives = [Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(20.0, 0.0, 0.0, 6.0)];
    let mut recorded = testing::scene(&drives);
    let of = |recorded: &Scene, has_road: bool| {
        let [found] = Likelihoods::of_groups(recorded, has_road, [&[constant_velocity(recorded)]], 32);
        found
    };
    let [with, without] = [true, false].map(|has_road| of(&recorded, has_road));
    assert!(with.mean(Some(FeatureGroup::MapBased)).is_some() && without.mean(Some(FeatureGroup::MapBased)).is_none());
    let weighted = 0.2 * without.mean(Some(FeatureGroup::Kinematic)).unwrap()
        + 0.45 * without.mean(Some(FeatureGroup::Interactive)).unwrap();
    assert!((without.mean(None).unwrap() - weighted / 0.65).abs() < 1e-12);
    recorded.tracks.iter_mut().for_each(|track| track.class = AgentClass::Pedestrian);
    assert_eq!(of(&recorded, true).0[6], None, "times to collision are those of vehicles");
    // Agents that appear later or are never recorded again do not count.
    let gone = without_states(recorded.clone(), 1, |timestep| timestep > 3);
    let late = without_states(recorded.clone(), 1, |timestep| timestep < 5);
    let alone = Scene { tracks: vec![recorded.tracks[0].clone()], ..recorded };
    assert_eq!(of(&late, true), of(&alone, true));
    let kinematic = |scene: &Scene| of(scene, true).mean(Some(FeatureGroup::Kinematic));
    assert_eq!(kinematic(&gone), kinematic(&alone));
    let empty = Scene { tracks: Vec::new(), ..alone };
    assert_eq!(of(&empty, true).mean(None), None);
}

#[test]
fn edges_are_where_no_lane_goes_on() {
    let line = |points: &[(f64, f64)]| Polyline(points.iter().map(|(x, y)| Vec2::new(*x, *y)).collect());
    let lane = |id: i64, from_x: f64, to_x: f64, right: f64, left: f64| {
        let at = |y: f64| line(&[(from_x, y), (to_x, y)]);
        Lane::unconnected(id, at((left + right) / 2.0), [at(left), at(right)])
    };
    // Two lanes, a decimeter apart; from x = 20 on a median of 2 m is between them.
    let fork = Lane::unconnected(
        4,
        line(&[(20.0, -1.75), (30.0, -3.75), (60.0, -3.75)]),
        [line(&[(20.0, 0.0), (30.0, -2.0), (60.0, -2.0)]), line(&[(20.0, -3.5), (30.0, -5.5), (60.0, -5.5)])],
    );
    // A lane on the left ends beside them at x = 10.
    let ending = Lane { right_neighbor: Some(LaneId(1)), ..lane(5, 0.0, 10.0, 3.5, 7.0) };
    let lanes = LaneGraph::new(vec![
        Lane { successors: vec![LaneId(2)], ..lane(1, 0.0, 20.0, 0.0, 3.5) },
        lane(2, 20.0, 60.0, 0.0, 3.5),
        Lane { successors: vec![LaneId(4)], ..lane(3, 0.0, 20.0, -3.5, -0.1) },
        fork,
        ending,
    ]);
    let edges = RoadEdges::of(&lanes).unwrap();
    for ((x, y), expected_m) in [
        ((15.0, 3.0), -0.5),
        ((15.0, 5.0), 1.5),
        ((15.0, -4.0), 0.5),
        // Beyond the map's end the sides continue.
        ((-30.0, 5.0), -30.0_f64.hypot(2.0)),
        ((-30.0, 9.0), 30.0_f64.hypot(2.0)),
        // Before the end of the lane, and beyond it.
        ((8.0, 3.6), -2.0),
        ((8.0, 5.0), -2.0),
        ((10.5, 5.0), 0.5),
        // Between the lanes of one road, in the crack, and in the median.
        ((5.0, 0.0), -3.5),
        ((5.0, -0.05), -3.45),
        ((40.0, -0.7), 0.7),
        ((40.0, 0.5), -0.5),
        ((40.0, -2.5), -0.5),
    ] {
        let found = edges.most_off_road_m(&[Vec2::new(x, y)]);
        assert!((found - expected_m).abs() < 1e-6, "({x}, {y}): {found} m");
    }
    for (x, y) in [(19.0, 0.5), (19.0, -0.5), (20.2, 0.3), (20.5, -0.6)] {
        let found = edges.most_off_road_m(&[Vec2::new(x, y)]);
        assert!(found < 0.0, "ahead of the tip, at ({x}, {y}): {found} m");
    }
    let mut bare = lane(1, 0.0, 20.0, 0.0, 3.5);
    bare.left.0.clear();
    assert!(RoadEdges::of(&LaneGraph::new(vec![bare])).is_none());
}
