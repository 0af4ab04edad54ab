//! What a corpus is made of: a generated scenario with its verdict, and one value of a metric.

use super::{Assessment, RequestTag};
use crate::behavior::{BehaviorEntry, BehaviorEvent, EventLabel};
use crate::metrics::{Group, SeriesKey};
use crate::scene::{GuidanceLevel, Scenario, SceneId};
use serde::{Deserialize, Serialize};

/// A generated scenario, what was asked for and what was found in it.
#[derive(Debug, Clone, PartialEq)]
pub struct ScenarioRecord {
    /// The scenario. Its states must be as the store keeps them: pass the scene through
    /// [`as_stored`](super::as_stored) before verifying it, so that what was verified is what is written.
    pub scenario: Scenario,
    /// The sweep of the configuration that asked for it.
    pub sweep: String,
    /// The behavior that was asked for; `None` for unconditional sampling.
    pub requested_behavior: Option<String>,
    /// Whether the miner found the requested behavior with the requested roles; `false` when none was requested.
    pub verified: bool,
    /// The positive events of the requested behavior that the miner found, those with the requested roles first; their
    /// `scene_id` is the scene's.
    pub events: Vec<BehaviorEvent>,
    /// Whether the recording already held the requested behavior with these roles.
    pub recorded_event: bool,
    /// What was judged of it; `None` before it is evaluated. Only the corpus keeps it.
    pub assessment: Option<Assessment>,
    /// Which shard of the run's samples it was generated in.
    pub shard: usize,
    /// The request behind it, and what became of it there; `None` for scenarios of plain sweeps.
    pub request: Option<RequestTag>,
}

impl ScenarioRecord {
    /// Whether those who were asked for something were asked to collide.
    pub fn asks_for_collision(&self) -> bool {
        BehaviorEntry::is_collision(self.requested_behavior.as_deref())
    }

    /// The event that stands for a verified scenario in tables: the first positive one of the requested behavior, which
    /// verification puts those with the requested roles before.
    pub fn main_event(&self) -> Option<&BehaviorEvent> {
        let requested = self.requested_behavior.as_ref().filter(|_| self.verified)?;
        self.events.iter().find(|event| event.behavior == *requested && event.label == EventLabel::Positive)
    }
}

/// One value of one metric: of a single scene or scenario, or aggregated over many.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MetricRow {
    /// Whose figure it is.
    pub group: Group,
    /// The sweep that is measured, or that continues these recordings.
    pub sweep: String,
    /// How strongly it was guided.
    #[serde(flatten)]
    pub level: GuidanceLevel,
    /// The place; empty for all places together.
    pub place: String,
    /// The recorded scene; `None` for an aggregate.
    pub scene_id: Option<SceneId>,
    /// The scenario; `None` for an aggregate or a value over all samples of a scene.
    pub scenario_id: Option<String>,
    /// The metric's id, such as `min_scene_ade_m`.
    pub metric: String,
    /// The value, in the unit that the metric's name ends in.
    pub value: f64,
    /// How many scenes, scenarios or samples the value is over.
    pub n: u64,
    /// Standard error of the mean, for aggregates over at least two values.
    pub std_error: Option<f64>,
}

impl MetricRow {
    /// The series that it belongs to.
    pub fn series(&self) -> SeriesKey {
        SeriesKey { group: self.group.clone(), sweep: self.sweep.clone(), level: self.level }
    }
}

/// What became of a generated scenario.
#[derive(Debug, Clone, PartialEq)]
pub struct VerdictRow {
    /// The scenario.
    pub scenario_id: String,
    /// The sweep that asked for it.
    pub sweep: String,
    /// How strongly it was guided.
    pub level: GuidanceLevel,
    /// Whether it is verified, valid and no near-duplicate.
    pub accepted: bool,
    /// Whether it is in the corpus.
    pub kept: bool,
    /// Why it is not accepted, the first reason first; empty where it is.
    pub reasons: Vec<String>,
    /// The checks of validity that were not made: of motion where the dataset, of departures from the road where the map does not allow them.
    pub not_checked: Vec<String>,
}
