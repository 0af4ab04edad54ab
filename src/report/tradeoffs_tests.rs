//! Do the curves over guidance strength match those drawn by hand?

use super::tradeoffs::tradeoffs;
use crate::evaluate::{EvaluationSummary, SamplingRow};
use crate::metrics::{Group, MetricRow};
use crate::scene::GuidanceLevel;

fn row(place: &str, strength: f64, n_scenarios: u64, n_verified: u64, offroad_rate: Option<f64>) -> SamplingRow {
    SamplingRow {
        place: place.into(),
        n_scenarios,
        n_collision: 1,
        offroad_rate,
        ..SamplingRow::example(strength, n_verified)
    }
}

fn evaluation() -> EvaluationSummary {
    let recorded = MetricRow { group: Group::Recorded, n: 20, ..MetricRow::example("collision_rate", 0.02) };
    EvaluationSummary {
        // Strengths and places out of order; a sweep of one strength is no curve.
        sampling: vec![
            row("A", 30.0, 30, 15, Some(0.2)),
            row("A", 0.0, 30, 3, Some(0.0)),
            row("B", 30.0, 10, 5, Some(0.6)),
            row("B", 0.0, 10, 0, None),
            SamplingRow { sweep: "plain".into(), behavior: None, ..row("A", 0.0, 30, 0, None) },
        ],
        aggregates: vec![recorded],
        ..EvaluationSummary::default()
    }
}

#[test]
fn places_are_added_up_and_strengths_ordered() {
    let charts = tradeoffs(&evaluation());
    let find = |title: &str| charts.iter().find(|chart| chart.title.starts_with(title)).expect(title);
    let verified = &find("Verified scenarios").curves;
    assert_eq!(verified.len(), 1);
    assert_eq!(verified[0].points, [[0.0, 7.5], [30.0, 50.0]]);
    // 20 of 40: Wilson's interval is 0.352 to 0.648 (Newcombe's formula by hand).
    let [low, high] = verified[0].intervals[1];
    assert!((low - 35.2).abs() < 0.05 && (high - 64.8).abs() < 0.05, "{low} {high}");
    let collisions = &find("Scenarios with a collision").curves;
    assert_eq!(collisions[1].name, "recorded");
    assert_eq!(collisions[1].points, [[0.0, 2.0], [30.0, 2.0]]);
    let offroad = &find("Vehicles off").curves[0];
    assert!((offroad.points[1][1] - 30.0).abs() < 1e-9, "{:?}", offroad.points);
    // 40 scenarios of 19 evaluations for 3 verified ones, and for 20.
    assert_eq!(find("Cost").curves[0].points, [[0.0, 760.0 / 3.0], [30.0, 38.0]]);
}

#[test]
fn runs_without_several_strengths_have_no_curves() {
    let mut evaluation = evaluation();
    evaluation.sampling.retain(|row| row.level == GuidanceLevel::UNGUIDED);
    assert!(tradeoffs(&evaluation).is_empty() && tradeoffs(&EvaluationSummary::default()).is_empty());
}
