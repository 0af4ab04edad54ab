//! Curves over guidance strength: yield, cost, collisions and departures from the road.

use super::model::{Chart, Curve};
use crate::evaluate::{EvaluationSummary, SamplingRow};
use crate::metrics::Group;
use crate::scene::{GuidanceLevel, LevelAxis};
use crate::statistics::wilson_interval;

const LEVEL: &str = "guidance strength α, or weight λ if that varies";

/// The results of a sweep at one level, over all places.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Point {
    level: GuidanceLevel,
    n_scenarios: u64,
    n_verified: u64,
    n_new: u64,
    n_collision: u64,
    /// Mean over scenarios of places with lanes.
    offroad_rate: Option<f64>,
    n_evaluations: u64,
}

/// The points of a sweep with more than one level, along the number that varies.
struct SweepCurve<'a> {
    name: &'a str,
    has_behavior: bool,
    axis: LevelAxis,
    points: Vec<Point>,
}

/// Charts over guidance strength, with a curve for each sweep with several levels; none if no sweep has several.
pub fn tradeoffs(evaluation: &EvaluationSummary) -> Vec<Chart> {
    let sweeps = sweeps(&evaluation.sampling);
    let asked: Vec<&SweepCurve<'_>> = sweeps.iter().filter(|sweep| sweep.has_behavior).collect();
    let all: Vec<&SweepCurve<'_>> = sweeps.iter().collect();
    let recorded = |metric: &str| recorded_levels(evaluation, &all, metric);
    let mut charts = vec![
        over_strength("Verified scenarios", "% of scenarios", share_curves(&asked, |point| point.n_verified)),
        over_strength(
            "Verified, and not in the recording",
            "% of scenarios",
            share_curves(&asked, |point| point.n_new),
        ),
        over_strength(
            "Scenarios with a collision",
            "% of scenarios",
            [share_curves(&all, |point| point.n_collision), recorded("collision_rate")].concat(),
        ),
        over_strength(
            "Vehicles off the road",
            "% of vehicles",
            [curves(&all, |point| Some(100.0 * point.offroad_rate?)), recorded("offroad_rate")].concat(),
        ),
        over_strength(
            "Cost of a verified scenario",
            "evaluations of the network",
            curves(&asked, evaluations_per_verified),
        ),
    ];
    charts.retain(|chart| chart.curves.iter().any(|curve| curve.points.len() > 1));
    charts
}

/// Evaluations of the network for each verified scenario, failures included.
fn evaluations_per_verified(point: &Point) -> Option<f64> {
    (point.n_verified > 0).then(|| (point.n_evaluations * point.n_scenarios) as f64 / point.n_verified as f64)
}

fn sweeps(rows: &[SamplingRow]) -> Vec<SweepCurve<'_>> {
    let mut sweeps: Vec<SweepCurve<'_>> = Vec::new();
    for row in rows.iter().filter(|row| row.n_scenarios > 0) {
        let at = sweeps.iter().position(|sweep| sweep.name == row.sweep).unwrap_or_else(|| {
            sweeps.push(SweepCurve {
                name: &row.sweep,
                has_behavior: row.behavior.is_some(),
                axis: LevelAxis::Strength,
                points: Vec::new(),
            });
            sweeps.len() - 1
        });
        let points = &mut sweeps[at].points;
        let new = Point {
            level: row.level,
            n_scenarios: row.n_scenarios,
            n_verified: row.n_verified,
            n_new: row.n_new,
            n_collision: row.n_collision,
            offroad_rate: row.offroad_rate,
            n_evaluations: row.n_evaluations,
        };
        match points.iter_mut().find(|point| point.level == row.level) {
            Some(point) => *point = together(point, &new),
            None => points.push(new),
        }
    }
    for sweep in &mut sweeps {
        let axis = LevelAxis::of(sweep.points.iter().map(|point| point.level));
        sweep.axis = axis;
        sweep.points.sort_by(|a, b| axis.read(a.level).total_cmp(&axis.read(b.level)));
    }
    sweeps.retain(|sweep| sweep.points.len() > 1);
    sweeps
}

/// The sum of two places.
fn together(a: &Point, b: &Point) -> Point {
    let weighted = match (a.offroad_rate, b.offroad_rate) {
        (Some(rate), Some(other)) => {
            let (n, n_other) = (a.n_scenarios as f64, b.n_scenarios as f64);
            Some((rate * n + other * n_other) / (n + n_other))
        }
        (rate, other) => rate.or(other),
    };
    Point {
        n_scenarios: a.n_scenarios + b.n_scenarios,
        n_verified: a.n_verified + b.n_verified,
        n_new: a.n_new + b.n_new,
        n_collision: a.n_collision + b.n_collision,
        offroad_rate: weighted,
        ..*a
    }
}

fn over_strength(title: &str, y_label: &str, curves: Vec<Curve>) -> Chart {
    Chart { title: title.to_owned(), x_label: LEVEL.to_owned(), y_label: y_label.to_owned(), log_x: false, curves }
}

fn curves(sweeps: &[&SweepCurve<'_>], value: impl Fn(&Point) -> Option<f64>) -> Vec<Curve> {
    let points = |sweep: &SweepCurve<'_>| {
        sweep.points.iter().filter_map(|point| Some([sweep.axis.read(point.level), value(point)?])).collect::<Vec<_>>()
    };
    sweeps.iter().map(|sweep| Curve::new(sweep.name, points(sweep))).collect()
}

/// Shares of scenarios as percentages, with Wilson's 95 % intervals.
fn share_curves(sweeps: &[&SweepCurve<'_>], n_hits: fn(&Point) -> u64) -> Vec<Curve> {
    let percent = |point: &Point| 100.0 * n_hits(point) as f64 / point.n_scenarios as f64;
    let mut curves = curves(sweeps, |point| Some(percent(point)));
    for (curve, sweep) in curves.iter_mut().zip(sweeps) {
        let interval = |point: &Point| {
            wilson_interval(n_hits(point), point.n_scenarios)
                .map_or([percent(point); 2], |i| [100.0 * i.low, 100.0 * i.high])
        };
        curve.intervals = sweep.points.iter().map(interval).collect();
    }
    curves
}

/// Level lines at the metric of the recordings that each sweep continues, where they have it.
fn recorded_levels(evaluation: &EvaluationSummary, sweeps: &[&SweepCurve<'_>], metric: &str) -> Vec<Curve> {
    let level = |sweep: &&SweepCurve<'_>| {
        let value = 100.0 * recorded_value(evaluation, sweep.name, metric)?;
        let ends = [sweep.points.first()?, sweep.points.last()?].map(|point| sweep.axis.read(point.level));
        let name = if sweeps.len() == 1 { "recorded".to_owned() } else { format!("recorded ({})", sweep.name) };
        Some(Curve::new(name, ends.map(|x| [x, value]).to_vec()))
    };
    sweeps.iter().filter_map(level).collect()
}

/// A metric of the recordings that a sweep continues, over all places.
pub(super) fn recorded_value(evaluation: &EvaluationSummary, sweep: &str, metric: &str) -> Option<f64> {
    let is_it = |row: &&crate::metrics::MetricRow| {
        row.group == Group::Recorded
            && row.sweep == sweep
            && row.metric == metric
            && row.place.is_empty()
            && row.scene_id.is_none()
    };
    evaluation.aggregates.iter().find(is_it).map(|row| row.value)
}
