//! The outcome: scenarios that were requested, found, accepted and measured.

use djinn::evaluate::{
    AcceptanceRow, DistinguishabilityRow, EvaluationSummary, LeftOutRow, MapFitRow, MetricDoc, RealismRow, SamplingRow,
    TellingFeatureRow, ValidityRow,
};
use djinn::generate::{ArmSummary, BucketPart, BucketSummary, BudgetConfig, Ended, RequestSummary, Yield};
use djinn::metrics::{Direction, MapFit, MetricRow};
use djinn::scene::GuidanceLevel;
use std::collections::BTreeMap;

pub(super) fn evaluation(name: &str) -> EvaluationSummary {
    let (docs, aggregates) = metrics(name);
    EvaluationSummary {
        sampling: sampling(name),
        docs,
        aggregates,
        realism: realism(name),
        acceptance: acceptance(name),
        left_out: left_out(name),
        validity: validity(name),
        distinguishability: distinguishability(name),
        telling_features: telling_features(name),
        maps: maps(),
        ..EvaluationSummary::default()
    }
}

fn acceptance(name: &str) -> Vec<AcceptanceRow> {
    let row = |strength: f64, n_verified, n_accepted| AcceptanceRow {
        sweep: name.into(),
        level: GuidanceLevel::of_strength(strength),
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
    let row = |reason: &str, strength: Option<f64>, n_left_out, n_found| LeftOutRow {
        stage: if strength.is_some() { "evaluate" } else { "generate" }.into(),
        sweep: name.into(),
        level: strength.map(GuidanceLevel::of_strength),
        reason: reason.into(),
        n_left_out,
        n_found,
    };
    vec![
        row("not_verified", Some(0.0), 3, 4),
        row("selection: not among the best 6", None, 12, 12),
        row("not_verified", Some(2.0), 59, 59),
        row("collision", Some(2.0), 7, 15),
        row("near_duplicate", Some(2.0), 2, 3),
    ]
}

fn validity(name: &str) -> Vec<ValidityRow> {
    let row = |group: &str, strength: f64, n_valid, n_collision: u64| ValidityRow {
        group: group.to_owned().into(),
        sweep: name.into(),
        level: GuidanceLevel::of_strength(strength),
        place: String::new(),
        n: 90,
        n_valid,
        violations: BTreeMap::from([("collision".into(), n_collision), ("offroad".into(), 2)]),
        not_checked: BTreeMap::from([("offroad".into(), 30)]),
        plausibility: Some(0.97),
    };
    vec![row("recorded", 0.0, 90, 0), row("unguided", 0.0, 74, 11), row(name, 2.0, 71, 15)]
}

/// Unguided tracks that are told in 3 of 4 pairs, and guided ones in 9 of 10.
fn distinguishability(name: &str) -> Vec<DistinguishabilityRow> {
    let row = |group: &str, strength: f64, place: &str, features: &str, auc: f64| DistinguishabilityRow {
        group: group.to_owned().into(),
        sweep: name.into(),
        level: GuidanceLevel::of_strength(strength),
        place: place.into(),
        class: String::new(),
        features: features.into(),
        n_tracks: 412,
        auc,
        low: auc - 0.02,
        high: auc + 0.02,
    };
    vec![
        row("unguided", 0.0, "", "all", 0.75),
        row("unguided", 0.0, "", "seam", 0.625),
        row("unguided", 0.0, "Fitting", "all", 0.7),
        row(name, 2.0, "", "all", 0.9),
        row(name, 2.0, "", "whole_scenes", 0.97),
    ]
}

fn telling_features(name: &str) -> Vec<TellingFeatureRow> {
    vec![TellingFeatureRow {
        group: "unguided".to_owned().into(),
        sweep: name.into(),
        level: GuidanceLevel::of_strength(0.0),
        feature: "jerk_q90".into(),
        unit: "m/s^3".into(),
        auc_drop: 0.037,
        auc_alone: 0.77,
        recorded_median: 2.0,
        generated_median: 8.75,
    }]
}

/// A map that fits, and one that lacks road.
fn maps() -> Vec<MapFitRow> {
    let row = |place: &str, n_states_off: u64, allows_offroad: bool| MapFitRow {
        place: place.into(),
        fit: MapFit { n_scenes: 50, n_scenes_leaving: n_states_off / 100, n_states: 4000, n_states_off },
        allows_offroad,
    };
    vec![row("Fitting", 8, true), row("Lacking", 1240, false)]
}

/// Two buckets, of which one stayed short, and two arms.
pub(super) fn request(name: &str) -> RequestSummary {
    let bucket = |idx: usize, range: &str, by_arm: [u64; 2]| BucketSummary {
        n_feasible: 9,
        idx,
        parts: vec![BucketPart { parameter: "gap_m".into(), range: range.into() }],
        is_given_up: false,
        n_wanted: 10,
        n_accepted: by_arm.iter().sum(),
        n_surplus: 3,
        n_near_duplicates: 3,
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
    let arm = |name: &str, strength: f64, first_round, total| ArmSummary {
        name: name.into(),
        level: GuidanceLevel::of_strength(strength),
        n_evaluations_per_sample: 39,
        n_aimed: 0,
        n_aimed_hits: 0,
        total,
        first_round,
    };
    RequestSummary {
        n_infeasible: 3,
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
        n_situations: 2,
        arms: vec![
            arm("unguided", 0.0, of(48, 3, 1, 1), of(96, 6, 3, 3)),
            arm("guided@10", 10.0, of(48, 9, 5, 5), of(384, 60, 19, 11)),
        ],
        buckets: vec![bucket(0, "0..5", [1, 3]), bucket(1, "5..10", [2, 8])],
    }
}

fn sampling(name: &str) -> Vec<SamplingRow> {
    let row = |sweep: &str, strength: f64, n_verified, n_collision| SamplingRow {
        sweep: sweep.into(),
        behavior: Some("cut_in".into()),
        place: name.into(),
        level: GuidanceLevel::of_strength(strength),
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
        group: group.to_owned().into(),
        sweep: name.into(),
        level: GuidanceLevel::of_strength(strength),
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

fn metrics(name: &str) -> (Vec<MetricDoc>, Vec<MetricRow>) {
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
                group: group.to_owned().into(),
                sweep: group.into(),
                level: GuidanceLevel::of_strength(strength),
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
    (docs, rows)
}
