//! A hand-made report: a cut-in on a three-lane road, with every section filled.

use djinn::generate::{ArmSummary, BucketPart, BucketSummary, BudgetConfig, Ended, RequestSummary, Yield};
use djinn::geometry::{Polyline, Transform2, Vec2};
use djinn::ingest::{IngestReport, RejectCount};
use djinn::metrics::Direction;
use djinn::report::{
    Acceptance, AcceptanceRow, BehaviorCount, BehaviorDoc, CardKey, CardValue, Chart, Curve, Distribution, Fact,
    LeftOutRow, MetricDoc, MetricTable, MiningSummary, PlainSection, PlainTable, RealismRow, ReportModel, Sample,
    SamplingRow, SceneCard, TrainingSummary, ValidityRow, Verdict, Warning,
};
use djinn::scene::{
    AgentClass, Dataset, Extent, Lane, LaneGraph, LaneId, ObservationMask, Scene, SceneId, SceneSource, Split, State,
    Track, TrackId, TrackRole, Trajectory,
};
use djinn::seed::Seed;
use djinn::store::MetricRow;
use djinn::train::NoiseLevelReport;
use std::collections::BTreeMap;
use std::sync::Arc;

const N_TIMESTEPS: usize = 40;
const N_HISTORY: usize = 10;

/// A report with every section.
pub(crate) fn model() -> ReportModel {
    model_named("v17")
}

/// The same with `name` wherever a name comes from the recordings or the configuration.
pub(crate) fn model_named(name: &str) -> ReportModel {
    ReportModel {
        title: format!("Cut-ins at the merging highway ({name})"),
        facts: vec![
            Fact::new("Run", name),
            Fact::new("Seed", 20),
            Fact::new("Device", "cpu"),
            Fact::new("Denoiser", "small, residual parametrization, 0.6 million parameters"),
            Fact::new("Checkpoint", "9f3c0d1be2"),
            Fact::new("Recordings", "INTERACTION v1.2, 3 places"),
        ],
        warnings: vec![
            Warning { stage: "ingest".into(), message: format!("1 case of {name} was rejected as non_finite; see Recordings.") },
            Warning {
                stage: "evaluate".into(),
                message: "Collision rate of guided samples is more than twice that of unguided ones; lower the guidance strength.".into(),
            },
        ],
        ingest: Some(ingest(name)),
        mining: Some(mining(name)),
        training: vec![training("Denoiser", 2.2), training("Classifier (cut_in)", 0.6)],
        classifier_quality: (0..12).map(quality).collect(),
        sampling: sampling(name),
        requests: vec![request(name)],
        metrics: metrics(name),
        realism: realism(name),
        acceptance: acceptance(name),
        left_out: left_out(name),
        validity: validity(name),
        distributions: distributions(),
        scenes: vec![
            card(0, name, 1.0, 0.0),
            card(1, name, 0.6, std::f64::consts::FRAC_PI_3),
            gallery(name),
        ],
        more: vec![more(name)],
        config: format!("[run]\nname = \"{name}\"\nseed = 20\n\n[generate]\nsplit = \"val\"\nsampler = {{ kind = \"heun\", n_steps = 20 }}\n"),
    }
}

fn acceptance(name: &str) -> Vec<AcceptanceRow> {
    let row = |strength, n_verified, n_accepted| AcceptanceRow {
        sweep: name.into(),
        strength,
        n_scenarios: 90,
        n_verified,
        n_valid: 71,
        n_verified_valid: n_accepted + 2,
        n_accepted,
        n_kept: n_accepted,
    };
    vec![row(0.0, 4, 3), row(2.0, 31, 22)]
}

fn left_out(name: &str) -> Vec<LeftOutRow> {
    let row = |reason: &str, strength, n_left_out, n_found| LeftOutRow {
        stage: if strength == Some(2.0) { "evaluate" } else { "generate" }.into(),
        sweep: name.into(),
        strength,
        reason: reason.into(),
        n_left_out,
        n_found,
    };
    vec![
        row("selection: not among the best 6", None, 12, 12),
        row("not_verified", Some(2.0), 59, 59),
        row("collision", Some(2.0), 7, 15),
        row("near_duplicate", Some(2.0), 2, 3),
    ]
}

fn validity(name: &str) -> Vec<ValidityRow> {
    let row = |group: &str, strength, n_valid, n_collision: u64| ValidityRow {
        group: group.into(),
        sweep: name.into(),
        strength,
        place: String::new(),
        n: 90,
        n_valid,
        violations: BTreeMap::from([("collision".into(), n_collision), ("offroad".into(), 2)]),
        plausibility: Some(0.97),
    };
    vec![row("recorded", 0.0, 90, 0), row("unguided", 0.0, 74, 11), row(name, 2.0, 71, 15)]
}

/// Two buckets, of which one stayed short, and two arms.
fn request(name: &str) -> RequestSummary {
    let bucket = |idx: usize, range: &str, by_arm: [u64; 2]| BucketSummary {
        idx,
        parts: vec![BucketPart { parameter: "gap_m".into(), range: range.into() }],
        n_wanted: 10,
        n_accepted: by_arm.iter().sum(),
        n_surplus: 3,
        n_repeated: 1,
        accepted_by_arm: by_arm.to_vec(),
        hits_by_arm: by_arm.map(|n| n + 2).to_vec(),
        first_round_hits_by_arm: vec![0, 1],
        n_samples_while_open: 480,
        n_evaluations_while_open: 18_720,
    };
    let of = |n_samples, n_found, n_hits, n_accepted| Yield {
        n_samples,
        n_found,
        n_outside: 2,
        n_beyond_limits: 1,
        n_hits,
        n_accepted,
    };
    let arm = |name: &str, level, first_round, total| ArmSummary {
        name: name.into(),
        level,
        n_evaluations_per_sample: 39,
        total,
        first_round,
    };
    RequestSummary {
        name: format!("tight cut-ins of {name}"),
        behavior: "cut_in".into(),
        ended: Ended::Budget,
        budget: BudgetConfig { n_samples: Some(480), n_evaluations: None },
        n_rounds: 3,
        n_samples: 480,
        n_evaluations: 18_720,
        n_scenes: 40,
        n_cells: 61,
        n_wanted: 20,
        n_accepted: 14,
        arms: vec![
            arm("unguided", 0.0, of(48, 3, 1, 1), of(96, 6, 3, 3)),
            arm("guided@10", 10.0, of(48, 9, 5, 5), of(384, 60, 19, 11)),
        ],
        buckets: vec![bucket(0, "0..5", [1, 3]), bucket(1, "5..10", [2, 8])],
    }
}

fn ingest(name: &str) -> IngestReport {
    IngestReport {
        n_units: 151,
        n_bytes: 5_183_806,
        n_scenes: 150,
        n_agents: 2_364,
        scenes_by: BTreeMap::from([("train/FIX_Merging".into(), 120), (format!("val/{name}"), 30)]),
        rejects: BTreeMap::from([(
            "non_finite".into(),
            RejectCount { count: 1, examples: vec![format!("{name}/bad_rows.csv:17: x is not finite in case 12")] },
        )]),
        dropped: BTreeMap::from([("agents_absent_at_present".into(), 412)]),
        assumed: BTreeMap::from([("heading_of_standing_agents".into(), 3)]),
    }
}

fn mining(name: &str) -> MiningSummary {
    let count = |split: &str, n_scenes, n_scenes_with, n_positive, n_negative| BehaviorCount {
        behavior: "cut_in".into(),
        split: split.into(),
        place: name.into(),
        n_scenes,
        n_scenes_with,
        n_positive,
        n_negative,
    };
    MiningSummary {
        definitions: vec![BehaviorDoc {
            behavior: "cut_in".into(),
            definition: "A future state of the other overlaps a future state that the ego reaches less than 3 s later, and the other's \
                         present does not overlap any state of the ego."
                .into(),
        }],
        counts: vec![count("train", 120, 64, 105, 2_310), count("val", 30, 15, 20, 601)],
    }
}

fn training(name: &str, scale: f64) -> TrainingSummary {
    let curve = |name: &str, offset: f64| {
        let loss = |i| scale * (0.2 + offset + (-f64::from(i) / 12.0).exp());
        Curve::new(name, (1..60).map(|i| [f64::from(i) * 100.0, loss(i)]).collect())
    };
    let loss = |title: &str, y_label: &str| Chart {
        title: title.into(),
        x_label: "training step".into(),
        y_label: y_label.into(),
        log_x: false,
        curves: vec![curve("train", 0.0), curve("val", 0.06)],
    };
    TrainingSummary {
        name: name.into(),
        facts: vec![Fact::new("Steps", "6 000"), Fact::new("Batch size", 16), Fact::new("Parameters", "604 931")],
        charts: vec![loss("Loss", "loss"), loss("minSceneADE of 6 samples", "m")],
    }
}

fn quality(i: u32) -> NoiseLevelReport {
    let sigma = 0.002 * 2.6f64.powi(i as i32);
    let skill = 1.0 / (1.0 + sigma * sigma);
    NoiseLevelReport {
        sigma,
        n_positive: 20,
        n_negative: 600,
        precision: (i < 11).then_some(0.05 + 0.8 * skill),
        recall: Some(0.1 + 0.85 * skill),
        false_positive_rate: Some(0.02),
        accuracy: Some(0.9),
        auc: Some(0.5 + 0.48 * skill),
    }
}

fn sampling(name: &str) -> Vec<SamplingRow> {
    let row = |sweep: &str, strength, n_verified, n_collision| SamplingRow {
        sweep: sweep.into(),
        behavior: Some("cut_in".into()),
        place: name.into(),
        strength,
        sampler: "heun-20".into(),
        n_scenes: 30,
        n_scenarios: 180,
        n_verified,
        n_new: n_verified / 2,
        n_collision,
        offroad_rate: Some(0.012),
        n_evaluations: 39,
    };
    vec![row("cut_in", 0.0, 9, 4), row("cut_in", 1.0, 21, 5), row("cut_in", 2.0, 47, 9), row("cut_in", 4.0, 61, 31)]
}

fn realism(name: &str) -> Vec<RealismRow> {
    let row = |group: &str, strength: f64, (quantity, unit): (&str, &str), distance: Option<f64>| RealismRow {
        group: group.into(),
        sweep: name.into(),
        strength,
        quantity: quantity.into(),
        unit: unit.into(),
        n_recorded: 9_000,
        n: 54_000,
        recorded_mean: Some(8.0),
        mean: distance.map(|d| 8.0 + d),
        wasserstein: distance,
        jensen_shannon: distance.map(|d| d / 10.0),
    };
    let quantities = [("speed", "m/s"), ("yaw rate", "rad/s")];
    let groups = [("constant_velocity", 0.0, Some(0.71)), ("unguided", 0.0, Some(0.173)), (name, 2.0, None)];
    groups
        .iter()
        .flat_map(|(group, strength, distance)| quantities.map(|quantity| row(group, *strength, quantity, *distance)))
        .collect()
}

fn metrics(name: &str) -> MetricTable {
    let doc = |metric: &str, unit: &str, direction: Direction, description: &str| MetricDoc {
        metric: metric.into(),
        unit: unit.into(),
        direction,
        description: description.into(),
    };
    let mut rows = Vec::new();
    for (group, strength, values) in [
        ("recorded", 0.0, [0.0, 0.0, 0.001, 0.0]),
        ("constant_velocity", 0.0, [0.43, 1.15, 0.021, -1.0]),
        ("unguided", 0.0, [0.38, 1.04, 0.004, 2.31]),
        ("cut_in", 2.0, [0.52, 1.46, 0.012, 3.02]),
    ] {
        for (metric, value) in ["min_scene_ade_m", "min_scene_fde_m", "collision_rate", "mfd_m"].iter().zip(values) {
            if value < 0.0 {
                continue; // one prediction has no spread
            }
            rows.push(MetricRow {
                group: group.into(),
                sweep: group.into(),
                strength,
                place: name.into(),
                scene_id: None,
                scenario_id: None,
                metric: (*metric).into(),
                value,
                n: 30,
                std_error: (value > 0.0).then_some(value / 12.0),
            });
        }
    }
    let docs = vec![
        doc(
            "min_scene_ade_m",
            "m",
            Direction::LowerIsBetter,
            "Mean distance to the recorded positions over all agents and future timesteps, of the best of 6 samples.",
        ),
        doc("min_scene_fde_m", "m", Direction::LowerIsBetter, "The same at the last timestep."),
        doc(
            "collision_rate",
            "1",
            Direction::LowerIsBetter,
            "Share of agents whose box overlaps another's in the future though it did not at the present.",
        ),
        doc(
            "mfd_m",
            "m",
            Direction::Neither,
            "Largest distance between the final positions of two samples, mean over agents.",
        ),
    ];
    MetricTable { docs, rows }
}

fn distributions() -> Vec<Distribution> {
    let mut rng = Seed(5).rng();
    let mut draw = |mean: f64, std: f64, n: usize| (0..n).map(|_| mean + std * rng.normal()).collect::<Vec<_>>();
    [("speed", "m/s", 11.9, 1.9), ("longitudinal acceleration", "m/s²", 0.0, 0.8), ("gap at intrusion", "m", 9.0, 4.0)]
        .into_iter()
        .map(|(title, unit, mean, std)| {
            let (recorded, generated) = (draw(mean, std, 4000), draw(mean - 0.3 * std, 1.2 * std, 2500));
            let groups = [("recorded", recorded.as_slice()), ("generated, α = 2", generated.as_slice())];
            Distribution::of(title, unit, "every agent at every future timestep", 40, &groups)
        })
        .collect()
}

/// A drawn scenario: the other car comes over by `depth` lanes.
pub(crate) fn card(idx: usize, name: &str, depth: f64, turned_rad: f64) -> SceneCard {
    let (recorded, generated) = (scene(name, 0.0, turned_rad), scene(name, depth, turned_rad));
    let roles = [("ego".to_owned(), TrackId::from("3")), ("other".to_owned(), TrackId::from(name))];
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
        place: name.into(),
        verdict: if idx.is_multiple_of(2) { Verdict::New } else { Verdict::NotVerified },
        acceptance: Some(Acceptance {
            reasons: if idx.is_multiple_of(2) { vec![] } else { vec!["not_verified".into(), "yaw_rate".into()] },
        }),
        strength: 2.0,
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
fn gallery(name: &str) -> SceneCard {
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
        place: name.into(),
        verdict: Verdict::NotAsked,
        acceptance: None,
        strength: 0.0,
        values: vec![],
    };
    let named = (format!("masks-{name}"), format!("masks, {name}: 3 samples, observed: upsampling"));
    SceneCard::new(named, key, vec![Fact::new("Sweep", "masks")], &recorded, &samples, &[])
}

fn more(name: &str) -> PlainSection {
    let mut table = PlainTable::new("How hard it was", &["Group", "Mean"]);
    table.push(vec![name.into(), "0.25".into()]);
    PlainSection {
        id: "more-of-it".into(),
        title: "More".into(),
        note: name.into(),
        tables: vec![table],
        charts: vec![],
    }
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
    Lane {
        id: LaneId(i),
        centerline: line(0.0),
        left: line(1.75),
        right: line(-1.75),
        successors: vec![],
        predecessors: vec![],
        left_neighbor: None,
        right_neighbor: None,
        attributes: Arc::default(),
    }
}
