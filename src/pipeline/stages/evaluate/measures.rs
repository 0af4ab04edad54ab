//! What is measured on each group of samples: the metrics, and how often the miner finds the behaviors.

use super::config::EvaluateConfig;
use crate::behavior::{Behavior, BehaviorEvent, EventLabel};
use crate::metrics::{ALL, Direction, Metric, SampleGroup};
use crate::report::MetricDoc;
use crate::scene::{Scene, TrackId};

/// Share of samples that hold the behavior that was asked for, with the roles that were asked for.
pub(super) const BEHAVIOR_RATE: &str = "behavior_rate";

/// Everything that is measured, in the order of tables.
pub(super) struct Measures<'a> {
    metrics: Vec<&'static dyn Metric>,
    behaviors: &'a [Box<dyn Behavior>],
}

/// The behavior that was asked for, and of whom.
#[derive(Clone, Copy)]
pub(super) struct Requested<'a> {
    /// Its name.
    pub(super) behavior: &'a str,
    /// Roles and tracks.
    pub(super) roles: &'a [(String, TrackId)],
}

/// The names of all metrics that can be chosen.
pub(super) fn known_ids() -> Vec<&'static str> {
    ALL.iter().map(|metric| metric.spec().id).collect()
}

impl<'a> Measures<'a> {
    pub(super) fn new(config: &EvaluateConfig, behaviors: &'a [Box<dyn Behavior>]) -> Self {
        let chosen = |id: &str| config.metrics.is_empty() || config.metrics.iter().any(|name| name == id);
        Self { metrics: ALL.iter().copied().filter(|metric| chosen(metric.spec().id)).collect(), behaviors }
    }

    /// What is measured, for reading the tables.
    pub(super) fn docs(&self) -> Vec<MetricDoc> {
        let metrics = self.metrics.iter().map(|metric| MetricDoc::from(metric.spec()));
        let requested = rate(
            BEHAVIOR_RATE.to_owned(),
            "share of samples in which the miner finds the behavior that was asked for, with the agents that were asked"
                .to_owned(),
        );
        let of_anybody = self.behaviors.iter().map(|behavior| {
            let id = behavior.id();
            rate(format!("{id}_rate"), format!("share of samples in which the miner finds {id}, whoever takes part"))
        });
        metrics.chain([requested]).chain(of_anybody).collect()
    }

    /// The values of a group, in the order of [`Measures::docs`]. `None` where one is not defined.
    pub(super) fn evaluate(&self, group: &SampleGroup<'_>, requested: Option<Requested<'_>>) -> Vec<Option<f64>> {
        let metrics = self.metrics.iter().map(|metric| metric.evaluate(group));
        let events: Vec<Vec<BehaviorEvent>> = group.samples.iter().map(|sample| self.positive_events(sample)).collect();
        let share = |holds: &dyn Fn(&[BehaviorEvent]) -> bool| {
            let n_holding = events.iter().filter(|events| holds(events)).count();
            let is_defined = !events.is_empty() && group.samples.iter().all(Scene::has_future);
            is_defined.then(|| n_holding as f64 / events.len() as f64)
        };
        let requested = requested.and_then(|Requested { behavior, roles }| {
            let is_asked = |event: &BehaviorEvent| roles.is_empty() || event.roles == roles;
            share(&|events| events.iter().any(|event| event.behavior == behavior && is_asked(event)))
        });
        let of_anybody = self
            .behaviors
            .iter()
            .map(|behavior| share(&|events| events.iter().any(|event| event.behavior == behavior.id())));
        metrics.chain([requested]).chain(of_anybody).collect()
    }

    fn positive_events(&self, scene: &Scene) -> Vec<BehaviorEvent> {
        let found = self.behaviors.iter().flat_map(|behavior| behavior.detect(scene));
        found.filter(|event| event.label == EventLabel::Positive).collect()
    }
}

fn rate(metric: String, description: String) -> MetricDoc {
    MetricDoc { metric, unit: "1".to_owned(), direction: Direction::Neither, description }
}
