//! The outcome of one drive: a scenario, a driver of its ego, and the result.

use std::collections::BTreeMap;

/// A drive from a scenario.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DriveRow {
    /// The scenario.
    pub scenario_id: String,
    /// The requested behavior.
    pub behavior: Option<String>,
    /// Who drove the ego: `planner`, or the name of a driver.
    pub driver: String,
    /// How it ended.
    pub outcome: String,
    /// Whether the careful driver comes through; `None` if the model had no future.
    pub careful_survives: Option<bool>,
    /// More about the end, for people.
    pub why: Option<String>,
    /// Its duration, seconds after the present.
    pub lasted_s: f64,
    /// The agent that the ego touched, on which of its sides, and with what relative speed, m/s.
    pub contact: Option<(String, String, f64)>,
    /// The shortest time to collision of the ego, seconds.
    pub min_ttc_s: Option<f64>,
    /// The hardest braking of the ego, m/s².
    pub max_braking_mps2: f64,
    /// The distance that the ego drove, meters.
    pub progress_m: f64,
    /// Whether the agents of the event gave their plan up.
    pub gave_up_plan: bool,
    /// Whether the scenario's event happens in the driven states; `None` for a scenario without an event.
    pub event_happens: Option<bool>,
    /// The parameters of the scenario's event.
    pub parameters: BTreeMap<String, f64>,
}
