//! Scenes, maps and scenarios for the tests of this layer: arbitrary, but the same for the same seed.

use super::as_stored;
use crate::behavior::{BehaviorEvent, Cause, EventLabel, Explanation};
use crate::geometry::{Polyline, Transform2, Vec2};
use crate::metrics::{CarefulJudgment, Check, Ending, PairCriticality, SceneCriticality, Violation};
use crate::rates::{BucketRate, RateSource};
use crate::scenario::{Assessment, BucketTag, RequestOutcome, RequestTag, ScenarioRecord};
use crate::scene::{
    AgentClass, Dataset, Extent, GuidanceLevel, GuidanceTag, Lane, LaneAttributes, LaneGraph, LaneId, MapId,
    ObservationMask, Provenance, Roles, Scenario, Scene, SceneId, SceneSource, SituationKind, Split, State, Track,
    TrackId, TrackRole, Trajectory, TurnDirection,
};
use crate::seed::{Seed, SeededRng};
use crate::statistics::Interval;
use std::sync::Arc;

/// A map of `n_lanes` lanes with coordinates as large as in city frames.
pub(crate) fn map(seed: u64, n_lanes: i64) -> LaneGraph {
    let mut rng = Seed(seed).derive_named("test", "map").rng();
    let mut line = |n_points: usize| {
        let start = Vec2::new(2000.0 + 100.0 * rng.normal(), -1500.0 + 100.0 * rng.normal());
        Polyline((0..n_points).map(|i| start + Vec2::new(i as f64 * 1.7, rng.normal())).collect())
    };
    let lanes = (0..n_lanes).map(|i| Lane {
        id: LaneId(10 * i - 20),
        centerline: line(5 + i as usize % 3),
        left: if i % 4 == 0 { Polyline::default() } else { line(4) },
        right: if i % 4 == 0 { Polyline::default() } else { line(6) },
        successors: vec![LaneId(10 * i - 10)],
        predecessors: vec![LaneId(10 * i - 30)],
        left_neighbor: (i % 2 == 0).then_some(LaneId(10 * i)),
        right_neighbor: None,
        attributes: Arc::new(LaneAttributes {
            kind: "road".to_owned(),
            turn: if i % 3 == 0 { TurnDirection::Left } else { TurnDirection::None },
            is_intersection: i % 2 == 1,
            has_traffic_control: false,
            one_way: true,
            tags: [("speed_limit".to_owned(), format!("{i} km/h"))].into_iter().take(i as usize % 2).collect(),
        }),
    });
    LaneGraph::new(lanes.collect())
}

/// A scene on the first lanes of `map`; without lanes if there is no map.
pub(crate) fn scene(seed: u64, map: Option<(&MapId, &LaneGraph)>) -> Scene {
    let mut rng = Seed(seed).derive_named("test", "scene").rng();
    let (n_timesteps, n_history) = (12 + rng.below(4), 5);
    let tracks: Vec<Track> = (0..2 + rng.below(5)).map(|i| track(&mut rng, i, n_timesteps)).collect();
    let world_from_scene = Transform2::from_pose(Vec2::new(1987.654321, -1432.1), 3.0 * rng.uniform());
    let lanes = map.map_or_else(LaneGraph::default, |(_, graph)| {
        let near: Vec<LaneId> = graph.lanes().iter().take(4 + rng.below(3)).map(|lane| lane.id).collect();
        graph.subset(&near).into_frame(&world_from_scene.inverse())
    });
    Scene {
        id: SceneId(format!("argoverse1/train/PIT/{seed}")),
        source: SceneSource {
            dataset: Dataset::Argoverse1,
            version: String::new(),
            split: Split::Train,
            place: "PIT".to_owned(),
            file: format!("train/data/{seed}.csv"),
            case_id: seed.to_string(),
            first_frame: "315969629.2".to_owned(),
            situation: SituationKind::Recorded,
            continues: None,
        },
        dt_s: 0.1,
        n_timesteps,
        n_history,
        world_from_scene,
        ego_idx: 1,
        tracks,
        map_id: map.map(|(id, _)| id.clone()),
        lanes: Arc::new(lanes),
    }
}

fn track(rng: &mut SeededRng, i: usize, n_timesteps: usize) -> Track {
    let start = Vec2::new(60.0 * rng.normal(), 60.0 * rng.normal());
    let velocity = Vec2::new(8.0 * rng.normal(), 2.0 * rng.normal());
    let enters = rng.below(4);
    let state = |timestep: usize| State {
        position: start + velocity * (0.1 * timestep as f64),
        heading_rad: velocity.angle(),
        velocity,
    };
    Track {
        id: TrackId(format!("track-{i}")),
        class: AgentClass::ALL[i % AgentClass::ALL.len()],
        role: TrackRole::ALL[i % TrackRole::ALL.len()],
        extent: i.is_multiple_of(2).then_some(Extent { length_m: 4.31 + i as f64, width_m: 1.83 }),
        trajectory: Trajectory::new((0..n_timesteps).map(|t| (t >= enters && t != 7).then(|| state(t))).collect()),
    }
}

/// An event between the first two tracks of a scene.
pub(crate) fn event(scene_id: &SceneId, behavior: &str, parameters: &[(&str, f64)]) -> BehaviorEvent {
    BehaviorEvent {
        behavior: behavior.to_owned(),
        scene_id: scene_id.clone(),
        label: EventLabel::Positive,
        roles: Roles::from([("other", "track-1"), ("ego", "track-0")]),
        start_timestep: 3,
        end_timestep: 8,
        parameters: parameters.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect(),
    }
}

/// A generated scenario from `scene`.
pub(crate) fn record(scene: &Scene, sample_idx: usize) -> ScenarioRecord {
    let verified = sample_idx % 2 == 1;
    let events =
        if verified { vec![event(&scene.id, "cut_in", &[("gap_m", 5.0 + sample_idx as f64)])] } else { vec![] };
    ScenarioRecord {
        scenario: Scenario {
            id: format!("{}#{sample_idx}", scene.id),
            scene: as_stored(scene),
            observed: ObservationMask::from_fn(scene.tracks.len(), scene.n_timesteps, |agent_idx, timestep| {
                timestep < scene.n_history + sample_idx && scene.state(agent_idx, timestep).is_some()
            }),
            provenance: Provenance {
                scene_id: scene.id.clone(),
                observation: if verified { "windowed" } else { "predictive" }.to_owned(),
                edit_tau: verified.then_some(0.8),
                checkpoint: "c0ffee".to_owned(),
                classifier: verified.then(|| "beef".to_owned()),
                seed: u64::MAX,
                sample_idx,
                probability: verified.then_some(0.625),
                guidance: GuidanceTag {
                    kind: "classifier:cut_in".to_owned(),
                    level: GuidanceLevel::of_strength(2.0),
                    roles: Roles::from([("ego", "track-0")]),
                },
                sampler: "heun-20".to_owned(),
                ego_driver: (sample_idx == 0).then(|| "idm".to_owned()),
                settings: r#"{"observe":"predictive"}"#.to_owned(),
            },
        },
        sweep: "guided".to_owned(),
        requested_behavior: Some("cut_in".to_owned()),
        verified,
        events,
        recorded_event: false,
        assessment: None,
        shard: 7,
        request: verified.then(|| RequestTag {
            request: "tight".to_owned(),
            round: 2,
            outcome: RequestOutcome::Surplus,
            bucket: (sample_idx % 4 == 1).then(|| BucketTag { idx: 3, ranges: "gap_m 0..5".to_owned() }),
        }),
    }
}

/// A judgment of a scenario from `scene`, with values in all of its parts or in few.
pub(crate) fn assessment(scene: &Scene, has_all: bool) -> Assessment {
    let violation = |check: Check, timestep: usize| Violation {
        check,
        track: scene.tracks[0].id.clone(),
        timestep,
        value: 9.5,
        limit: 9.0,
    };
    Assessment {
        accepted: !has_all,
        violations: match has_all {
            true => vec![violation(Check::Deceleration, 12), violation(Check::Offroad, 17)],
            false => Vec::new(),
        },
        plausibility: Some(0.75),
        recorded_likeness: has_all.then_some(0.125),
        pair: has_all.then_some(PairCriticality {
            min_ttc_s: None,
            tet_s: 0.5,
            tit_s2: 0.25,
            max_drac_mps2: 3.0,
            min_headway_s: Some(0.8),
            pet_s: None,
            min_distance_m: 1.5,
        }),
        scene: Some(SceneCriticality { min_ttc_s: Some(1.25), max_drac_mps2: 4.0, min_distance_m: 0.5 }),
        careful: has_all.then_some(CarefulJudgment {
            preventable: false,
            braking_from_s: Some(1.45),
            margin_s: Some(-0.25),
            intrusion_ttc_s: None,
            avoidance_required: Some(true),
        }),
        ending: has_all.then_some(Ending {
            contact_s: Some(0.75),
            required_deceleration_mps2: 6.5,
            remaining_mps: None,
            subject_reacts: true,
        }),
        explanation: has_all.then_some(Explanation { cause: Cause::LookedTooLate, mistake_s: Some(0.75) }),
        nearest_recorded_event: Some(2.5),
        nearest_scenario_m: has_all.then_some(0.125),
        near_duplicate_of: has_all.then(|| "before".to_owned()),
        rate: has_all.then_some(BucketRate {
            per_1000_km: Some(2.5),
            per_hour: Some(0.25),
            interval: Some(Interval { low: 1.0, high: 5.0 }),
            source: RateSource::Extrapolated,
        }),
    }
}

/// The names and contents of all files below a folder.
pub(crate) fn folder_bytes(dir: &std::path::Path) -> std::collections::BTreeMap<String, Vec<u8>> {
    let mut files = std::collections::BTreeMap::new();
    for entry in fs_err::read_dir(dir).unwrap().map(|entry| entry.unwrap()) {
        let name = entry.file_name().to_string_lossy().into_owned();
        if entry.path().is_dir() {
            files
                .extend(folder_bytes(&entry.path()).into_iter().map(|(file, bytes)| (format!("{name}/{file}"), bytes)));
        } else {
            files.insert(name, fs_err::read(entry.path()).unwrap());
        }
    }
    files
}

/// Writes a table from rows that need not make sense.
pub(crate) fn write_table(
    path: &std::path::Path,
    table: &super::TableSchema,
    batch: &arrow::array::RecordBatch,
) -> super::FileStamp {
    super::parquet_file::write_batch(path, table, batch).unwrap()
}
