//! Summaries of many events by group, with polars.

use super::schema::unit_of_name;
use super::{Error, Result};
use crate::behavior::{BehaviorEvent, EventLabel};
use polars::prelude::*;

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

/// Counts of events and the distributions of their parameters, for each behavior and label, in the order of first
/// occurrence.
///
/// # Errors
/// [`Error::Frame`] when a group-by fails.
pub fn summarize_events(events: &[BehaviorEvent]) -> Result<Vec<EventSummary>> {
    let summarize = || {
        let mut summaries = event_counts(events)?;
        add_parameters(&mut summaries, events)?;
        Ok(summaries)
    };
    summarize().map_err(|source| Error::Frame { table: "events", source })
}

fn event_counts(events: &[BehaviorEvent]) -> PolarsResult<Vec<EventSummary>> {
    let frame = df! {
        "behavior" => events.iter().map(|event| event.behavior.as_str()).collect::<Vec<_>>(),
        "label" => events.iter().map(|event| event.label.name()).collect::<Vec<_>>(),
        "scene_id" => events.iter().map(|event| event.scene_id.0.as_str()).collect::<Vec<_>>(),
    }?;
    let summary = |group: DataFrame| {
        Ok(EventSummary {
            behavior: first(&group, "behavior")?,
            label: label(&group)?,
            n_events: group.height(),
            n_scenes: group.column("scene_id")?.n_unique()?,
            parameters: Vec::new(),
        })
    };
    frame.partition_by_stable(["behavior", "label"], true)?.into_iter().map(summary).collect()
}

fn add_parameters(summaries: &mut [EventSummary], events: &[BehaviorEvent]) -> PolarsResult<()> {
    let parameters = |event| -> Vec<_> {
        let event: &BehaviorEvent = event;
        event.parameters.iter().map(|(name, value)| (event, name.as_str(), *value)).collect()
    };
    let rows: Vec<(&BehaviorEvent, &str, f64)> = events.iter().flat_map(parameters).collect();
    let frame = df! {
        "behavior" => rows.iter().map(|(event, ..)| event.behavior.as_str()).collect::<Vec<_>>(),
        "label" => rows.iter().map(|(event, ..)| event.label.name()).collect::<Vec<_>>(),
        "name" => rows.iter().map(|(_, name, _)| *name).collect::<Vec<_>>(),
        "value" => rows.iter().map(|(.., value)| *value).collect::<Vec<_>>(),
    }?;
    for group in frame.partition_by_stable(["behavior", "label", "name"], true)? {
        let name = first(&group, "name")?;
        let values = group.column("value")?.f64()?;
        let mut quantiles = [f64::NAN; QUANTILES.len()];
        for (quantile, q) in quantiles.iter_mut().zip(QUANTILES) {
            *quantile = values.quantile(q, QuantileMethod::Linear)?.unwrap_or(f64::NAN);
        }
        let (unit, mean) = (unit_of_name(&name), values.mean().unwrap_or(f64::NAN));
        let parameter = ParameterSummary { name, unit, n: group.height(), mean, quantiles };
        let key = (first(&group, "behavior")?, label(&group)?);
        let of_group = |s: &&mut EventSummary| s.behavior == key.0 && s.label == key.1;
        if let Some(summary) = summaries.iter_mut().find(of_group) {
            summary.parameters.push(parameter);
        }
    }
    for summary in summaries {
        summary.parameters.sort_by(|a, b| a.name.cmp(&b.name));
    }
    Ok(())
}

/// The value of a column in the first row of a group.
fn first(group: &DataFrame, column: &str) -> PolarsResult<String> {
    Ok(group.column(column)?.str()?.get(0).unwrap_or_default().to_owned())
}

fn label(group: &DataFrame) -> PolarsResult<EventLabel> {
    let name = first(group, "label")?;
    EventLabel::from_name(&name).ok_or_else(|| polars_err!(ComputeError: "unknown label {name}"))
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

        let summaries = summarize_events(&events).unwrap();
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

        assert_eq!(summarize_events(&[]).unwrap(), []);
    }
}
