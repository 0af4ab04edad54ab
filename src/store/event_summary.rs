//! Summaries of many events by group.

use super::schema::unit_of_name;
use crate::behavior::{BehaviorEvent, EventLabel};
use crate::quantile::quantile;
use std::collections::{BTreeMap, BTreeSet};

/// The quantiles in the summary of a parameter.
pub const QUANTILES: [f64; 7] = [0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0];

/// How the events of a behavior are distributed.
#[derive(Debug, Clone, PartialEq)]
pub struct EventSummary {
    /// The behavior.
    pub behavior: String,
    /// Positive events or hard negatives.
    pub label: EventLabel,
    /// Number of events.
    pub n_events: usize,
    /// Number of scenes with at least one.
    pub n_scenes: usize,
    /// The parameters that occur, by name.
    pub parameters: Vec<ParameterSummary>,
}

/// How one parameter of an event is distributed.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterSummary {
    /// Its name, which ends in its unit.
    pub name: String,
    /// Its unit.
    pub unit: &'static str,
    /// Number of events with it.
    pub n: usize,
    /// Their mean.
    pub mean: f64,
    /// Their [`QUANTILES`], interpolated linearly.
    pub quantiles: [f64; QUANTILES.len()],
}

/// The values of a group of events.
#[derive(Default)]
struct Group<'a> {
    n_events: usize,
    scenes: BTreeSet<&'a str>,
    values: BTreeMap<&'a str, Vec<f64>>,
}

/// Counts of events and the distributions of their parameters, for each behavior and label, in the order of first
/// occurrence.
pub fn summarize_events(events: &[BehaviorEvent]) -> Vec<EventSummary> {
    let mut groups: Vec<((&str, EventLabel), Group<'_>)> = Vec::new();
    for event in events {
        let key = (event.behavior.as_str(), event.label);
        let at = groups.iter().position(|(own, _)| *own == key).unwrap_or_else(|| {
            groups.push((key, Group::default()));
            groups.len() - 1
        });
        let group = &mut groups[at].1;
        group.n_events += 1;
        group.scenes.insert(&event.scene_id.0);
        for (name, value) in &event.parameters {
            group.values.entry(name).or_default().push(*value);
        }
    }
    let summary = |((behavior, label), group): ((&str, EventLabel), Group<'_>)| EventSummary {
        behavior: behavior.to_owned(),
        label,
        n_events: group.n_events,
        n_scenes: group.scenes.len(),
        parameters: group.values.into_iter().map(|(name, values)| ParameterSummary::of(name, values)).collect(),
    };
    groups.into_iter().map(summary).collect()
}

impl ParameterSummary {
    fn of(name: &str, mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        Self {
            name: name.to_owned(),
            unit: unit_of_name(name),
            n: values.len(),
            mean: values.iter().sum::<f64>() / values.len() as f64,
            quantiles: QUANTILES.map(|share| quantile(&values, share).unwrap_or(f64::NAN)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::SceneId;
    use crate::store::testing::event;

    #[test]
    fn events_have_counts_and_quantiles() {
        let scene = |place: &str, case: usize| SceneId(format!("interaction/val/{place}/{case}"));
        let mut events: Vec<BehaviorEvent> =
            (0..5).map(|i| event(&scene("A", i / 2), "cut_in", &[("gap_m", 10.0 * i as f64)])).collect();
        events.push(BehaviorEvent { label: EventLabel::Negative, ..event(&scene("B", 0), "cut_in", &[]) });
        events.push(event(&scene("B", 1), "cut_in", &[("gap_m", 100.0), ("ttc_s", 2.0)]));

        let summaries = summarize_events(&events);
        assert_eq!(summaries.len(), 2);
        let positive = &summaries[0];
        assert_eq!((positive.label, positive.n_events, positive.n_scenes), (EventLabel::Positive, 6, 4));
        let names: Vec<_> = positive.parameters.iter().map(|p| (p.name.as_str(), p.unit, p.n)).collect();
        assert_eq!(names, [("gap_m", "m", 6), ("ttc_s", "s", 1)]);
        let gap = &positive.parameters[0];
        assert!((gap.mean - 200.0 / 6.0).abs() < 1e-12);
        assert_eq!((gap.quantiles[0], gap.quantiles[3], gap.quantiles[6]), (0.0, 25.0, 100.0));
        assert!((gap.quantiles[2] - 12.5).abs() < 1e-12);
        assert_eq!(summaries[1].parameters, []);

        assert_eq!(summarize_events(&[]), []);
    }
}
