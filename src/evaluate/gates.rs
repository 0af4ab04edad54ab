//! Do the results meet the bounds of the configuration? A bound that cannot be judged is not met.

use super::distinguishability::DistinguishabilityRow;
use super::error::{Error, Result};
use super::evaluation::EvaluationSummary;
use super::measures::BEHAVIOR_RATE;
use crate::generate::{ResolvedGeneration, ResolvedSweep};
use crate::metrics::{Group, MetricRow, SeriesKey};
use crate::scene::LevelAxis;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Bounds for the results. Gates that are left out are not checked. A gate that cannot be judged, because nothing was
/// measured for it, fails.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GatesConfig {
    /// Minimum number of verified scenarios over all sweeps.
    #[schemars(range(max = 1_000_000_000_000_u64))]
    pub min_verified: Option<u64>,
    /// Minimum number of verified scenarios whose recording does not show the behavior for the same agents.
    #[schemars(range(max = 1_000_000_000_000_u64))]
    pub min_new: Option<u64>,
    /// Minimum number of accepted scenarios over all sweeps: verified, valid and no near-duplicates.
    #[schemars(range(max = 1_000_000_000_000_u64))]
    pub min_accepted: Option<u64>,
    /// Smallest share of valid scenarios of any sweep at any strength, 0 to 1.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub min_validity_rate: Option<f64>,
    /// Largest collision rate of any sweep at any strength, 0 to 1.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub max_collision_rate: Option<f64>,
    /// Largest off-road rate of any sweep at any strength, 0 to 1. Needs maps.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub max_offroad_rate: Option<f64>,
    /// Largest share of pairs, one recorded and one generated track of any sweep at any strength, of which a classifier
    /// that sees all features picks the generated one, .5 to 1. 0.5 is indistinguishable.
    #[schemars(range(min = 0.5, max = 1.0))]
    pub max_distinguishability: Option<f64>,
    /// Whether unguided samples must be closer to the recording than a constant velocity, by minSceneADE, in every
    /// sweep that has some; at least one must.
    pub beat_constant_velocity: bool,
    /// Whether in every sweep that requests a behavior at several strengths the strongest must find it more often than
    /// strength 0; at least one must.
    pub guidance_raises_rate: bool,
}

/// A gate and whether it was met.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GateResult {
    /// Which gate, and where: `max_collision_rate (cut_ins, α = 2)`.
    pub gate: String,
    /// Whether it was met.
    pub met: bool,
    /// The requirement and the value found, or why it cannot be judged.
    pub detail: String,
}

/// A bound on the mean of a metric, for every series.
#[derive(Clone, Copy)]
struct RateGate {
    name: &'static str,
    metric: &'static str,
    bound: Option<f64>,
    is_least: bool,
}

impl GatesConfig {
    fn rates(&self) -> [RateGate; 3] {
        let gate = |name, metric, bound, is_least| RateGate { name, metric, bound, is_least };
        [
            gate("max_collision_rate", "collision_rate", self.max_collision_rate, false),
            gate("max_offroad_rate", "offroad_rate", self.max_offroad_rate, false),
            gate("min_validity_rate", "validity_rate", self.min_validity_rate, true),
        ]
    }

    /// Refuses gates by metrics that are not among those `measured` (empty: all).
    ///
    /// # Errors
    /// [`Error::Config`] with the gate.
    pub(super) fn validate(&self, measured: &[String]) -> Result<()> {
        let by_rates =
            self.rates().into_iter().filter(|rate| rate.bound.is_some()).map(|rate| (rate.name, rate.metric));
        let by_displacement = self.beat_constant_velocity.then_some(("beat_constant_velocity", "min_scene_ade_m"));
        for (name, metric) in by_rates.chain(by_displacement) {
            if !measured.is_empty() && !measured.iter().any(|id| id == metric) {
                let why = format_args!("needs {metric}; add it to evaluate.metrics");
                return Err(refusal(name, why));
            }
        }
        Ok(())
    }

    /// Refuses gates that the generated samples cannot decide.
    ///
    /// # Errors
    /// [`Error::Config`] with the gate and the sweep.
    pub fn check_generated(&self, generated: &ResolvedGeneration, has_maps: bool) -> Result<()> {
        if self.max_offroad_rate.is_some() && !has_maps {
            return Err(refusal(
                "max_offroad_rate",
                "is set, but ingest.maps = \"none\" leaves no roads to judge by; ingest with maps",
            ));
        }
        let sweeps = &generated.sweeps;
        if self.beat_constant_velocity && !sweeps.iter().any(ResolvedSweep::has_unguided) {
            let why = "is set, but no sweep has unguided samples; add 0.0 to the strengths of a sweep without edits";
            return Err(refusal("beat_constant_velocity", why));
        }
        if self.guidance_raises_rate {
            let mut compared = sweeps.iter().filter(|sweep| sweep.behavior.is_some() && sweep.levels().len() > 1);
            let has_zero = |sweep: &&ResolvedSweep| {
                let axis = LevelAxis::of(sweep.levels().iter().copied());
                sweep.levels().iter().any(|level| axis.read(*level) == 0.0)
            };
            let without_zero = compared.clone().find(|sweep| !has_zero(sweep));
            if let Some(ResolvedSweep { name, .. }) = without_zero {
                let why =
                    format!("is set, but sweep {name} has no strength 0 to compare with; add 0.0 to its strengths");
                return Err(refusal("guidance_raises_rate", why));
            }
            if compared.next().is_none() {
                let why =
                    "is set, but no sweep requests a behavior at several strengths, such as strengths = [0.0, 10.0]";
                return Err(refusal("guidance_raises_rate", why));
            }
        }
        Ok(())
    }

    /// Checks every gate that is set against what was found.
    pub(super) fn check(&self, found: &EvaluationSummary) -> Vec<GateResult> {
        let counts = [
            ("min_verified", self.min_verified, found.n_verified),
            ("min_new", self.min_new, found.n_new),
            ("min_accepted", self.min_accepted, found.n_accepted),
        ];
        let counts = counts.into_iter().filter_map(|(gate, required, found)| {
            let required = required?;
            Some(judged(gate.to_owned(), found >= required, format!("at least {required} required, {found} found")))
        });
        let mut results: Vec<GateResult> = counts.collect();
        let measured = Measured::of(found);
        results.extend(self.rates().iter().flat_map(|rate| measured.rate(rate)));
        if let Some(bound) = self.max_distinguishability {
            results.extend(measured.distinguishability(bound));
        }
        if self.beat_constant_velocity {
            results.extend(measured.beat_constant_velocity());
        }
        if self.guidance_raises_rate {
            results.extend(measured.guidance_raises_rate());
        }
        results
    }
}

/// The data that gates look at, over all places.
struct Measured<'a> {
    /// The series of generated traffic, measured or not.
    generated: Vec<SeriesKey>,
    /// The sweeps that request a behavior.
    asking: Vec<&'a str>,
    means: Vec<&'a MetricRow>,
    /// The performance of classifiers with all features against recorded tracks.
    told: Vec<&'a DistinguishabilityRow>,
}

impl<'a> Measured<'a> {
    fn of(found: &'a EvaluationSummary) -> Self {
        let everywhere = found.validity.iter().filter(|row| row.place.is_empty() && row.group.is_generated());
        let asking = found.sampling.iter().filter(|row| row.behavior.is_some());
        Self {
            generated: everywhere.map(|row| row.series()).collect(),
            asking: asking.map(|row| row.sweep.as_str()).collect(),
            told: found.distinguishability.iter().filter(|row| row.is_overall()).collect(),
            means: found.aggregates.iter().filter(|row| row.place.is_empty()).collect(),
        }
    }

    fn mean(&self, metric: &str, series: &SeriesKey) -> Option<f64> {
        self.means.iter().find(|row| row.metric == metric && row.series() == *series).map(|row| row.value)
    }

    /// A result for each series.
    fn rate(&self, RateGate { name, metric, bound, is_least }: &RateGate) -> Vec<GateResult> {
        let Some(bound) = *bound else { return Vec::new() };
        let of_series = |series: &SeriesKey| {
            let gate = format!("{name} ({}, {})", series.sweep, series.level);
            let Some(found) = self.mean(metric, series) else {
                return not_judged(gate, format_args!("{metric} is undefined for all its scenes"));
            };
            match is_least {
                true => judged(gate, found >= bound, format!("at least {bound} required, {found:.4} found")),
                false => judged(gate, found <= bound, format!("at most {bound} allowed, {found:.4} found")),
            }
        };
        or_not_judged(name, "there are no scenarios to judge", self.generated.iter().map(of_series).collect())
    }

    /// A result for each series.
    fn distinguishability(&self, bound: f64) -> Vec<GateResult> {
        let name = "max_distinguishability";
        let of_series = |series: &SeriesKey| {
            let gate = format!("{name} ({}, {})", series.sweep, series.level);
            match self.told.iter().find(|row| row.series() == *series) {
                Some(DistinguishabilityRow { auc, .. }) => {
                    judged(gate, *auc <= bound, format!("at most {bound} allowed, {auc:.4} found"))
                }
                None => not_judged(gate, "it has too few tracks or scenes to learn from"),
            }
        };
        or_not_judged(name, "there are no scenarios to judge", self.generated.iter().map(of_series).collect())
    }

    /// A result for each sweep with unguided samples.
    fn beat_constant_velocity(&self) -> Vec<GateResult> {
        let name = "beat_constant_velocity";
        let of_series = |series: &SeriesKey| {
            let gate = format!("{name} ({})", series.sweep);
            let baseline = SeriesKey::reference(Group::ConstantVelocity, &series.sweep);
            let [own, baseline] = [series, &baseline].map(|series| self.mean("min_scene_ade_m", series));
            match own.zip(baseline) {
                Some((own, baseline)) => {
                    judged(gate, own < baseline, format!("minSceneADE {own:.3} m against {baseline:.3} m"))
                }
                None => not_judged(gate, "min_scene_ade_m is undefined for all its scenes"),
            }
        };
        let unguided = self.generated.iter().filter(|series| series.group == Group::Unguided);
        or_not_judged(name, "no sweep has unguided samples", unguided.map(of_series).collect())
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

fn refusal(gate: &str, why: impl fmt::Display) -> Error {
    let message = format!("evaluate.gates.{gate} {why}");
    Error::Config { message, advice: "or leave the gate out".to_owned() }
}
