//! One value of one metric, and the traffic that it describes.

use super::{Group, SeriesKey};
use crate::scene::{GuidanceLevel, SceneId};
use serde::{Deserialize, Serialize};

/// One value of one metric: of a single scene or scenario, or aggregated over many.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MetricRow {
    /// The group of traffic.
    pub group: Group,
    /// The measured sweep, or the sweep that continues these recordings.
    pub sweep: String,
    /// The level of guidance.
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
    /// The number of scenes, scenarios or samples behind the value.
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

#[cfg(test)]
impl MetricRow {
    /// The mean of a metric of unguided samples over 10 scenes of all places.
    pub(crate) fn example(metric: &str, value: f64) -> Self {
        Self {
            group: Group::Unguided,
            sweep: "cut_ins".to_owned(),
            level: GuidanceLevel::UNGUIDED,
            place: String::new(),
            scene_id: None,
            scenario_id: None,
            metric: metric.to_owned(),
            value,
            n: 10,
            std_error: None,
        }
    }
}
