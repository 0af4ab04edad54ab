//! Scenes that are drawn: a road of three lanes, on which another car comes over to the lane of the ego.

use djinn::geometry::{Polyline, Transform2, Vec2};
use djinn::report::{Acceptance, CardBucket, CardKey, CardValue, Fact, Sample, SceneCard, Verdict};
use djinn::scene::{
    AgentClass, Dataset, Extent, GuidanceLevel, Lane, LaneGraph, ObservationMask, Roles, Scene, SceneId, SceneSource,
    SituationKind, Split, State, Track, TrackId, TrackRole, Trajectory,
};
use std::sync::Arc;

const N_TIMESTEPS: usize = 40;
const N_HISTORY: usize = 10;

/// A drawn scenario: the other car comes over by `depth` lanes.
pub(crate) fn card(idx: usize, name: &str, depth: f64, turned_rad: f64) -> SceneCard {
    let (recorded, generated) = (scene(name, 0.0, turned_rad), scene(name, depth, turned_rad));
    let roles = Roles::from([("ego", "3"), ("other", name)]);
    let facts = vec![
        Fact::new("Scenario", format!("{name}-s4")),
        Fact::new("Source", format!("interaction/val/{name}/12.0")),
        Fact::new("Guidance", "classifier:cut_in, α = 2"),
        Fact::new("Verdict", "verified, not in the recording"),
        Fact::new("Gap at intrusion", "4.1 m"),
        Fact::new("Time to collision at intrusion", "2.6 s"),
        Fact::new("Relative speed", "−1.6 m/s"),
        Fact::new("Lateral speed", "0.9 m/s"),
    ];
    let figure = |name: &str, value: f64| CardValue { name: name.into(), value };
    let key = CardKey {
        sweep: "cut_in".into(),
        behavior: Some("cut_in".into()),
        bucket: (idx == 0).then(|| CardBucket {
            request: format!("tight cut-ins of {name}"),
            idx: 0,
            ranges: format!("gap_m 0..5 of {name}"),
        }),
        place: name.into(),
        verdict: if idx.is_multiple_of(2) { Verdict::New } else { Verdict::NotVerified },
        acceptance: Some(Acceptance {
            reasons: if idx.is_multiple_of(2) { vec![] } else { vec!["not_verified".into(), "yaw_rate".into()] },
        }),
        level: GuidanceLevel::of_strength(2.0),
        values: vec![
            figure("gap_m", 4.0 + idx as f64),
            figure("ttc_s", 2.6),
            figure("collision_rate", (idx % 2) as f64),
        ],
    };
    let observed = ObservationMask::predictive(generated.tracks.len(), N_TIMESTEPS, N_HISTORY);
    let sample = Sample { name: "sample 4", scene: &generated, observed: &observed };
    let named = (format!("cut_in-{idx}-{name}"), format!("{name}: other cuts in ahead of ego ({idx})"));
    SceneCard::new(named, key, facts, &recorded, &[sample], &roles)
}

/// Three samples of a scene of which every fifth state was given.
pub(super) fn gallery(name: &str) -> SceneCard {
    let recorded = scene(name, 0.0, 0.0);
    let scenes = [0.3, 0.6, 0.9].map(|depth| scene(name, depth, 0.0));
    let observed = ObservationMask::from_fn(recorded.tracks.len(), N_TIMESTEPS, |_, timestep| timestep % 5 == 4);
    let samples: Vec<Sample<'_>> = scenes
        .iter()
        .zip(["sample 0", "sample 1", name])
        .map(|(scene, name)| Sample { name, scene, observed: &observed })
        .collect();
    let key = CardKey {
        sweep: "masks".into(),
        behavior: None,
        bucket: None,
        place: name.into(),
        verdict: Verdict::NotAsked,
        acceptance: None,
        level: GuidanceLevel::UNGUIDED,
        values: vec![],
    };
    let named = (format!("masks-{name}"), format!("masks, {name}: 3 samples, observed: upsampling"));
    SceneCard::new(named, key, vec![Fact::new("Sweep", "masks")], &recorded, &samples, Roles::none())
}

/// Three lanes; `depth` of 1 brings the other car fully into the ego's lane.
fn scene(name: &str, depth: f64, turned_rad: f64) -> Scene {
    let turn = Transform2::from_pose(Vec2::new(0.0, 0.0), turned_rad);
    let cars = [
        (name, 6.0, 3.5, 10.5, -3.5 * depth),
        ("3", 0.0, 0.0, 12.5, 0.0),
        ("4", 28.0, 0.0, 12.0, 0.0),
        ("5", -18.0, 3.5, 12.0, 0.0),
        ("6", 15.0, -3.5, 9.0, 0.0),
        ("7", -9.0, -3.5, 13.5, 0.0),
    ];
    let tracks = cars
        .iter()
        .map(|(id, x, y, speed, shift)| Track {
            id: TrackId::from(*id),
            class: AgentClass::Vehicle,
            role: TrackRole::Context,
            extent: Some(Extent { length_m: 4.6, width_m: 1.9 }),
            trajectory: trajectory(*x, *y, *speed, *shift).transformed(&turn),
        })
        .collect();
    let lanes = (-1..=1).map(lane).collect();
    Scene {
        id: SceneId(format!("interaction/val/{name}/12.0")),
        source: SceneSource {
            dataset: Dataset::Interaction,
            version: "v1.2".into(),
            split: Split::Val,
            place: name.into(),
            file: "val/FIX_Merging_val.csv".into(),
            case_id: "12.0".into(),
            first_frame: "1".into(),
            situation: SituationKind::Recorded,
            continues: None,
        },
        dt_s: 0.1,
        n_timesteps: N_TIMESTEPS,
        n_history: N_HISTORY,
        world_from_scene: Transform2::from_pose(Vec2::new(1000.0, 1000.0), 0.0),
        ego_idx: 1,
        tracks,
        map_id: None,
        lanes: Arc::new(LaneGraph::new(lanes).transformed(&turn)),
    }
}

fn trajectory(x: f64, y: f64, speed: f64, shift: f64) -> Trajectory {
    let present = N_HISTORY as f64 - 1.0;
    let states = (0..N_TIMESTEPS).map(|timestep| {
        let t = (timestep as f64 - present) * 0.1;
        let done = (t / 3.0).clamp(0.0, 1.0);
        let lateral_speed = shift * std::f64::consts::FRAC_PI_2 / 3.0 * (std::f64::consts::PI * done).sin();
        let position = Vec2::new(x + speed * t, y + shift * 0.5 * (1.0 - (std::f64::consts::PI * done).cos()));
        Some(State { position, heading_rad: (lateral_speed / speed).atan(), velocity: Vec2::new(speed, lateral_speed) })
    });
    Trajectory::new(states.collect())
}

fn lane(i: i64) -> Lane {
    let line = |offset: f64| {
        Polyline((0..8).map(|k| Vec2::new(f64::from(k) * 30.0 - 80.0, i as f64 * 3.5 + offset)).collect())
    };
    let mut lane = Lane::unconnected(i, line(0.0), [1.75, -1.75].map(line));
    let light = ("traffic_light".to_owned(), "stop:0-20;go:21-39".to_owned());
    Arc::make_mut(&mut lane.attributes).tags.extend((i == 1).then_some(light));
    lane
}
