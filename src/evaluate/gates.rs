//! Do the results keep the bounds that the configuration sets?

use super::measures::BEHAVIOR_RATE;
use super::sampling::SamplingRow;
use super::verdicts::AcceptanceRow;
use crate::metrics::Group;
use crate::store::MetricRow;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Bounds that the results must keep. What is left out is not checked.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GatesConfig {
    /// At least so many scenarios, over all sweeps, hold the behavior that was asked for.
    pub min_verified: Option<u64>,
    /// At least so many of them where the recording does not hold it for the same agents.
    pub min_new: Option<u64>,
    /// At least so many scenarios, over all sweeps, are accepted: verified, valid and no near-duplicates.
    pub min_accepted: Option<u64>,
    /// Smallest share of valid scenarios of any sweep at any strength.
    pub min_validity_rate: Option<f64>,
    /// Largest collision rate of any sweep at any strength.
    pub max_collision_rate: Option<f64>,
    /// Largest off-road rate of any sweep at any strength.
    pub max_offroad_rate: Option<f64>,
    /// Whether unguided samples must be closer to the recording than a constant velocity, by minSceneADE, in every sweep.
    pub beat_constant_velocity: bool,
    /// Whether in every sweep that asks for a behavior the strongest guidance must find it more often than strength 0.
    pub guidance_raises_rate: bool,
}

/// A gate and whether it was met.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GateResult {
    /// Which gate, and where: `max_collision_rate (cut_ins, strength 2)`.
    pub gate: String,
    /// Whether it was met.
    pub met: bool,
    /// What was required and what was found.
    pub detail: String,
}

/// Checks every gate that is set. `aggregates` are rows over scenes; those of all places together count.
pub(super) fn check(
    config: &GatesConfig,
    sampling: &[SamplingRow],
    acceptance: &[AcceptanceRow],
    aggregates: &[MetricRow],
) -> Vec<GateResult> {
    let mut results = Vec::new();
    let mut add = |gate: String, met: bool, detail: String| results.push(GateResult { gate, met, detail });
    let sum = |of: fn(&SamplingRow) -> u64| sampling.iter().map(of).sum::<u64>();
    for (gate, required, found) in [
        ("min_verified", config.min_verified, sum(|row| row.n_verified)),
        ("min_new", config.min_new, sum(|row| row.n_new)),
        ("min_accepted", config.min_accepted, acceptance.iter().map(|row| row.n_accepted).sum()),
    ] {
        if let Some(required) = required {
            add(gate.to_owned(), found >= required, format!("at least {required} required, {found} found"));
        }
    }
    let overall = |metric: &str| -> Vec<&MetricRow> {
        aggregates.iter().filter(|row| row.place.is_empty() && row.metric == metric).collect()
    };
    for (gate, metric, limit) in [
        ("max_collision_rate", "collision_rate", config.max_collision_rate),
        ("max_offroad_rate", "offroad_rate", config.max_offroad_rate),
    ] {
        let Some(limit) = limit else { continue };
        for row in overall(metric).into_iter().filter(|row| row.group.is_generated()) {
            let place = format!("{gate} ({}, strength {})", row.sweep, row.strength);
            add(place, row.value <= limit, format!("at most {limit} allowed, {:.4} found", row.value));
        }
    }
    if let Some(limit) = config.min_validity_rate {
        for row in overall("validity_rate").into_iter().filter(|row| row.group.is_generated()) {
            let place = format!("min_validity_rate ({}, strength {})", row.sweep, row.strength);
            add(place, row.value >= limit, format!("at least {limit} required, {:.4} found", row.value));
        }
    }
    if config.beat_constant_velocity {
        let rows = overall("min_scene_ade_m");
        for own in rows.iter().filter(|row| row.group == Group::Unguided) {
            let baseline = rows.iter().find(|row| row.group == Group::ConstantVelocity && row.sweep == own.sweep);
            let Some(baseline) = baseline else { continue };
            let detail = format!("minSceneADE {:.3} m against {:.3} m", own.value, baseline.value);
            add(format!("beat_constant_velocity ({})", own.sweep), own.value < baseline.value, detail);
        }
    }
    if config.guidance_raises_rate {
        let rows = overall(BEHAVIOR_RATE);
        for unguided in rows.iter().filter(|row| row.group == Group::Unguided) {
            let same_sweep =
                rows.iter().filter(|row| matches!(row.group, Group::Sweep(_)) && row.sweep == unguided.sweep);
            let Some(guided) = same_sweep.max_by(|a, b| a.strength.total_cmp(&b.strength)) else { continue };
            let detail =
                format!("{:.4} at strength {} against {:.4} unguided", guided.value, guided.strength, unguided.value);
            add(format!("guidance_raises_rate ({})", guided.sweep), guided.value > unguided.value, detail);
        }
    }
    results
}
