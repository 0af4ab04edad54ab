//! Do the results meet the gates?

use super::gate_config::GatesConfig;
use super::measures::BEHAVIOR_RATE;
use super::summary::{EvaluationSummary, GateResult};
use crate::generate::RequestSummary;
use crate::metrics::{MetricRow, SeriesKey};
use crate::rates::Calibration;
use crate::scene::LevelAxis;
use std::fmt;

/// Checks every gate that is set against the results.
pub(super) fn check(gates: &GatesConfig, found: &EvaluationSummary) -> Vec<GateResult> {
    let counts = [("min_new", gates.min_new, found.n_new), ("min_accepted", gates.min_accepted, found.n_accepted)];
    let counts = counts.into_iter().filter_map(|(gate, required, found)| {
        let required = required?;
        Some(judged(gate.to_owned(), found >= required, format!("at least {required} required, {found} found")))
    });
    let mut results: Vec<GateResult> = counts.collect();
    let measured = Measured::of(found);
    if let Some(bound) = gates.min_validity_rate {
        results.extend(measured.validity_rate(bound));
    }
    if let Some(bound) = gates.max_rate_factor {
        results.extend(rate_factor(bound, found.calibration.as_deref()));
    }
    if gates.guidance_raises_rate {
        results.extend(measured.guidance_raises_rate());
    }
    results
}

/// Checks how far requests are filled, if that is asked for.
pub fn of_requests(gates: &GatesConfig, requests: &[RequestSummary]) -> Vec<GateResult> {
    let filled = |share: f64| {
        let of_request = move |request: &RequestSummary| {
            let RequestSummary { name, n_wanted, n_accepted, .. } = request;
            let is_met = *n_accepted as f64 >= share * *n_wanted as f64;
            let found = format!("{name}: at least {share} of {n_wanted} required, {n_accepted} found");
            judged("min_filled".to_owned(), is_met, found)
        };
        requests.iter().map(of_request)
    };
    gates.min_filled.into_iter().flat_map(filled).collect()
}

/// The data that gates look at, over all places.
struct Measured<'a> {
    /// The series of generated traffic, measured or not.
    generated: Vec<SeriesKey>,
    /// The sweeps that request a behavior.
    asking: Vec<&'a str>,
    means: Vec<&'a MetricRow>,
}

impl<'a> Measured<'a> {
    fn of(found: &'a EvaluationSummary) -> Self {
        let everywhere = found.validity.iter().filter(|row| row.place.is_empty() && row.group.is_generated());
        let asking = found.sampling.iter().filter(|row| row.behavior.is_some());
        Self {
            generated: everywhere.map(|row| row.series()).collect(),
            asking: asking.map(|row| row.sweep.as_str()).collect(),
            means: found.aggregates.iter().filter(|row| row.place.is_empty()).collect(),
        }
    }

    fn mean(&self, metric: &str, series: &SeriesKey) -> Option<f64> {
        self.means.iter().find(|row| row.metric == metric && row.series() == *series).map(|row| row.value)
    }

    fn validity_rate(&self, bound: f64) -> Vec<GateResult> {
        let (name, metric) = ("min_validity_rate", "validity_rate");
        let of_series = |series: &SeriesKey| {
            let gate = format!("{name} ({}, {})", series.sweep, series.level);
            match self.mean(metric, series) {
                Some(found) => judged(gate, found >= bound, format!("at least {bound} required, {found:.4} found")),
                None => not_judged(gate, format_args!("{metric} is undefined for all its scenes")),
            }
        };
        or_not_judged(name, "there are no scenarios to judge", self.generated.iter().map(of_series).collect())
    }

    /// A result for each sweep that requests a behavior at several strengths.
    fn guidance_raises_rate(&self) -> Vec<GateResult> {
        let name = "guidance_raises_rate";
        let mut sweeps: Vec<&str> = Vec::new();
        for series in self.generated.iter().filter(|series| self.asking.contains(&series.sweep.as_str())) {
            if !sweeps.contains(&series.sweep.as_str()) {
                sweeps.push(&series.sweep);
            }
        }
        let of_sweep = |sweep: &&str| {
            let gate = format!("{name} ({sweep})");
            let own = self.generated.iter().filter(|series| series.sweep == *sweep);
            let axis = LevelAxis::of(own.clone().map(|series| series.level));
            let strongest = own.clone().max_by(|a, b| axis.read(a.level).total_cmp(&axis.read(b.level)))?;
            let zero = own.clone().find(|series| axis.read(series.level) == 0.0);
            if own.count() < 2 {
                return None;
            }
            let Some(zero) = zero else {
                return Some(not_judged(gate, format_args!("it has no samples at {} 0", axis.name())));
            };
            let rates = self.mean(BEHAVIOR_RATE, strongest).zip(self.mean(BEHAVIOR_RATE, zero));
            let Some((guided, without)) = rates else {
                return Some(not_judged(gate, format_args!("{BEHAVIOR_RATE} is undefined for all its scenes")));
            };
            let detail = format!("{guided:.4} at {} against {without:.4} at {}", strongest.level, zero.level);
            Some(judged(gate, guided > without, detail))
        };
        let results = sweeps.iter().filter_map(of_sweep).collect();
        or_not_judged(name, "no sweep requests a behavior at several strengths", results)
    }
}

/// A result for each behavior at each place.
fn rate_factor(bound: f64, calibration: Option<&[Calibration]>) -> Vec<GateResult> {
    let name = "max_rate_factor";
    let compared = calibration.into_iter().flatten().filter(|one| one.is_judged());
    let results = compared.map(|one| {
        let gate =
            format!("{name} ({}, {})", one.behavior, if one.place.is_empty() { "all places" } else { &one.place });
        judged(gate, one.most() <= bound, format!("at most {bound} allowed, {:.2} found", one.most()))
    });
    or_not_judged(name, "no rates were modeled where ten events of a behavior were recorded", results.collect())
}

fn judged(gate: String, met: bool, detail: String) -> GateResult {
    GateResult { gate, met, detail }
}

fn not_judged(gate: impl Into<String>, why: impl fmt::Display) -> GateResult {
    GateResult { gate: gate.into(), met: false, detail: format!("cannot be judged: {why}") }
}

/// The results, or, if there are none, a failure because the gate cannot be judged.
fn or_not_judged(gate: &str, why: &str, results: Vec<GateResult>) -> Vec<GateResult> {
    if results.is_empty() { vec![not_judged(gate, why)] } else { results }
}
