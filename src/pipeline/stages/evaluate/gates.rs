//! Do the results keep the bounds that the configuration sets?

use super::config::GatesConfig;
use super::measures::BEHAVIOR_RATE;
use crate::report::{AcceptanceRow, SamplingRow};
use crate::store::MetricRow;
use serde::{Deserialize, Serialize};

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
        for row in overall(metric).into_iter().filter(|row| is_generated(row)) {
            let place = format!("{gate} ({}, strength {})", row.sweep, row.strength);
            add(place, row.value <= limit, format!("at most {limit} allowed, {:.4} found", row.value));
        }
    }
    if let Some(limit) = config.min_validity_rate {
        for row in overall("validity_rate").into_iter().filter(|row| is_generated(row)) {
            let place = format!("min_validity_rate ({}, strength {})", row.sweep, row.strength);
            add(place, row.value >= limit, format!("at least {limit} required, {:.4} found", row.value));
        }
    }
    if config.beat_constant_velocity {
        let rows = overall("min_scene_ade_m");
        for own in rows.iter().filter(|row| row.group == "unguided") {
            let baseline = rows.iter().find(|row| row.group == "constant_velocity" && row.sweep == own.sweep);
            let Some(baseline) = baseline else { continue };
            let detail = format!("minSceneADE {:.3} m against {:.3} m", own.value, baseline.value);
            add(format!("beat_constant_velocity ({})", own.sweep), own.value < baseline.value, detail);
        }
    }
    if config.guidance_raises_rate {
        let rows = overall(BEHAVIOR_RATE);
        for unguided in rows.iter().filter(|row| row.group == "unguided") {
            let same_sweep = rows.iter().filter(|row| row.group == row.sweep && row.sweep == unguided.sweep);
            let Some(guided) = same_sweep.max_by(|a, b| a.strength.total_cmp(&b.strength)) else { continue };
            let detail =
                format!("{:.4} at strength {} against {:.4} unguided", guided.value, guided.strength, unguided.value);
            add(format!("guidance_raises_rate ({})", guided.sweep), guided.value > unguided.value, detail);
        }
    }
    results
}

fn is_generated(row: &MetricRow) -> bool {
    !matches!(row.group.as_str(), "recorded" | "constant_velocity")
}
