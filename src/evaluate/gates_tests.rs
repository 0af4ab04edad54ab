//! Tests of every gate: met, at its edge, unmet, and without anything to judge.

use super::gate_config::GatesConfig;
use super::gates::{check, of_requests};
use super::summary::EvaluationSummary;
use super::{GateResult, SamplingRow, ValidityRow};
use crate::generate::RequestSummary;
use crate::metrics::{Group, MetricRow, SeriesKey};
use crate::scene::GuidanceLevel;
use serde_json::json;
use std::collections::BTreeMap;

const SWEEP: &str = "cut_ins";

fn series(group: Group, strength: f64) -> SeriesKey {
    SeriesKey { group, sweep: SWEEP.to_owned(), level: GuidanceLevel::of_strength(strength) }
}

fn unguided() -> SeriesKey {
    series(Group::Unguided, 0.0)
}

fn guided() -> SeriesKey {
    series(Group::Sweep(SWEEP.to_owned()), 2.0)
}

/// 10 scenarios of a sweep that requests a cut-in, of `generated` series, with these means over all places and no
/// others.
fn found(generated: &[SeriesKey], means: &[(SeriesKey, &str, f64)]) -> EvaluationSummary {
    let validity_row = |SeriesKey { group, sweep, level }: &SeriesKey, place: &str| ValidityRow {
        group: group.clone(),
        sweep: sweep.clone(),
        level: *level,
        place: place.to_owned(),
        n: 5,
        n_valid: 5,
        violations: BTreeMap::new(),
        not_checked: BTreeMap::new(),
        plausibility: None,
    };
    let mean = |(SeriesKey { group, sweep, level }, metric, value): &(SeriesKey, &str, f64), place: &str| MetricRow {
        group: group.clone(),
        sweep: sweep.clone(),
        level: *level,
        place: place.to_owned(),
        n: 5,
        ..MetricRow::example(metric, *value)
    };
    let sampling = SamplingRow {
        sweep: SWEEP.to_owned(),
        n_scenes: 5,
        n_scenarios: 10,
        n_new: 3,
        n_collision: 0,
        ..SamplingRow::example(0.0, 4)
    };
    // A place that meets every gate by itself decides nothing.
    let of_place = means.iter().map(|row| mean(&(row.0.clone(), row.1, 0.5), "X"));
    EvaluationSummary {
        n_scenarios: 10,
        n_verified: 4,
        n_new: 3,
        n_valid: 8,
        n_accepted: 2,
        n_kept: 2,
        sampling: vec![sampling],
        aggregates: of_place.chain(means.iter().map(|row| mean(row, ""))).collect(),
        validity: ["", "X"]
            .iter()
            .flat_map(|place| generated.iter().map(move |key| validity_row(key, place)))
            .collect(),
        ..EvaluationSummary::default()
    }
}

fn gates(toml: &str) -> GatesConfig {
    toml::from_str(toml).expect("readable")
}

fn results(toml: &str, found: &EvaluationSummary) -> Vec<GateResult> {
    let results = check(&gates(toml), found);
    assert!(!results.is_empty(), "{toml}: a gate that is set says something");
    results
}

/// Whether the only result is met, with its detail.
fn only(toml: &str, found: &EvaluationSummary) -> (bool, String) {
    let results = results(toml, found);
    assert_eq!(results.len(), 1, "{results:?}");
    (results[0].met, format!("{}: {}", results[0].gate, results[0].detail))
}

#[test]
fn counts_are_met_at_their_bound_and_unmet_above() {
    let found = found(&[], &[]);
    for (gate, n) in [("min_new", 3), ("min_accepted", 2)] {
        for (required, met) in [(0, true), (n - 1, true), (n, true), (n + 1, false)] {
            let expected = format!("{gate}: at least {required} required, {n} found");
            assert_eq!(only(&format!("{gate} = {required}"), &found), (met, expected));
        }
    }
    let nothing = EvaluationSummary { n_accepted: 0, ..found };
    assert_eq!(only("min_accepted = 1", &nothing), (false, "min_accepted: at least 1 required, 0 found".to_owned()));
}

#[test]
fn the_validity_rate_is_met_at_its_bound_and_unmet_beyond() {
    let metric = "validity_rate";
    let found = found(&[guided()], &[(guided(), metric, 0.25), (series(Group::Recorded, 0.0), metric, 0.9)]);
    for (bound, met) in [(0.2, true), (0.25, true), (0.3, false)] {
        let expected = format!("min_validity_rate (cut_ins, α = 2): at least {bound} required, 0.2500 found");
        assert_eq!(only(&format!("min_validity_rate = {bound}"), &found), (met, expected));
    }
}

#[test]
fn a_rate_without_data_is_not_met() {
    let (gate, metric) = ("min_validity_rate = 0", "validity_rate");
    let (met, text) = only(gate, &found(&[], &[]));
    assert!(!met && text.ends_with("cannot be judged: there are no scenarios to judge"), "{text}");
    let baseline = (series(Group::ConstantVelocity, 0.0), metric, 0.0);
    let (met, text) = only(gate, &found(&[guided()], &[baseline]));
    assert!(!met && text.ends_with("cannot be judged: validity_rate is undefined for all its scenes"), "{text}");
    // One series alone does not stand for all.
    let partial = results(gate, &found(&[unguided(), guided()], &[(unguided(), metric, 0.5)]));
    assert_eq!(partial.iter().map(|result| result.met).collect::<Vec<_>>(), [true, false]);
    let (met, _) = only(gate, &found(&[guided()], &[(guided(), metric, f64::NAN)]));
    assert!(!met, "no number keeps no bound");
}

#[test]
fn the_strongest_guidance_must_find_more_than_strength_0() {
    let gate = "guidance_raises_rate = true";
    // Edited scenarios at strength 0 are not unguided traffic, but still the reference for guidance of edited ones.
    for zero in [unguided(), series(Group::Sweep(SWEEP.to_owned()), 0.0)] {
        let strongest = series(Group::Sweep(SWEEP.to_owned()), 10.0);
        for (rate, met) in [(0.3, true), (0.2, false), (0.1, false)] {
            let means = [(zero.clone(), 0.2), (guided(), 0.9), (strongest.clone(), rate)];
            let means = means.map(|(series, rate)| (series, "behavior_rate", rate));
            let (is_met, text) = only(gate, &found(&[zero.clone(), guided(), strongest.clone()], &means));
            let expected = format!("guidance_raises_rate (cut_ins): {rate:.4} at α = 10 against 0.2000 at α = 0");
            assert_eq!((is_met, text), (met, expected));
        }
    }
    let weaker = series(Group::Sweep(SWEEP.to_owned()), 1.0);
    for (generated, why) in [
        (vec![], "no sweep requests a behavior at several strengths"),
        (vec![guided()], "no sweep requests a behavior at several strengths"),
        (vec![weaker, guided()], "it has no samples at strength 0"),
        (vec![unguided(), guided()], "behavior_rate is undefined for all its scenes"),
    ] {
        let (met, text) = only(gate, &found(&generated, &[]));
        assert!(!met && text.ends_with(&format!("cannot be judged: {why}")), "{text}");
    }
    let mut continued = found(&[unguided(), guided()], &[]);
    continued.sampling[0].behavior = None;
    let (met, text) = only(gate, &continued);
    assert!(!met && text.ends_with("no sweep requests a behavior at several strengths"), "{text}");
}

#[test]
fn every_request_must_be_filled_as_far_as_is_asked() {
    let request = |name: &str, n_accepted: u64| -> RequestSummary {
        let budget = json!({ "n_samples": 9 });
        serde_json::from_value(json!({
            "name": name, "behavior": "cut_in", "ended": "budget", "budget": budget, "n_rounds": 1, "n_samples": 9,
            "n_evaluations": 9, "n_scenes": 1, "n_cells": 1, "n_infeasible": 0, "n_wanted": 10,
            "n_accepted": n_accepted, "n_situations": 1, "arms": [], "buckets": [],
        }))
        .unwrap()
    };
    let requests = [request("all", 10), request("most", 9)];
    let met = |gate: &str| of_requests(&gates(gate), &requests).iter().map(|gate| gate.met).collect::<Vec<_>>();
    assert_eq!([met("min_filled = 1.0"), met("min_filled = 0.9"), met("")], [vec![true, false], vec![true; 2], vec![]]);
}
