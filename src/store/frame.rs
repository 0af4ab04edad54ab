//! The polars view of our tables: what do many metric values, or many events, come to by group?

use super::schema::unit_of_name;
use super::tables::event::{label_from_name, scene_part};
use super::{Error, MetricRow, Result};
use crate::behavior::{BehaviorEvent, EventLabel};
use polars::prelude::*;

/// The quantiles that a parameter is summarized by.
pub const QUANTILES: [f64; 7] = [0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0];

/// How the events of a behavior are distributed.
#[derive(Debug, Clone, PartialEq)]
pub struct EventSummary {
    /// The behavior.
    pub behavior: String,
    /// Examples or hard negatives.
    pub label: EventLabel,
    /// The place; empty for all places together.
    pub place: String,
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
    /// Number of events that have it.
    pub n: usize,
    /// Their mean.
    pub mean: f64,
    /// Their [`QUANTILES`], interpolated linearly.
    pub quantiles: [f64; QUANTILES.len()],
}

/// The mean, number and standard error of the values of single scenes or scenarios, for each series, strength and metric
/// (and place), in the order in which these come first. Rows that are aggregates already, and values that are not finite,
/// are left out.
///
/// # Errors
/// [`Error::Frame`] when the group-by fails.
pub fn summarize_metrics(rows: &[MetricRow], by_place: bool) -> Result<Vec<MetricRow>> {
    let rows: Vec<&MetricRow> = rows.iter().filter(|row| row.scene_id.is_some() && row.value.is_finite()).collect();
    let summarize = || {
        let text = |of: fn(&MetricRow) -> &str| rows.iter().map(|row| of(row)).collect::<Vec<&str>>();
        let frame = df! {
            "series" => text(|row| row.group.name()),
            "sweep" => text(|row| &row.sweep),
            "strength" => rows.iter().map(|row| row.strength).collect::<Vec<_>>(),
            "place" => rows.iter().map(|row| if by_place { &row.place } else { "" }).collect::<Vec<&str>>(),
            "metric" => text(|row| &row.metric),
            "value" => rows.iter().map(|row| row.value).collect::<Vec<_>>(),
        }?;
        // Each group is summed by itself in the order of its rows: the number of threads does not matter.
        let groups = frame
            .lazy()
            .group_by_stable([col("series"), col("sweep"), col("strength"), col("place"), col("metric")])
            .agg([
                len().cast(DataType::UInt64).alias("n"),
                col("value").mean().alias("mean"),
                col("value").std(1).alias("std"),
            ])
            .collect()?;
        (0..groups.height()).map(|i| metric_summary(&groups, i)).collect::<PolarsResult<Vec<_>>>()
    };
    summarize().map_err(|source| Error::Frame { table: "metrics", source })
}

fn metric_summary(groups: &DataFrame, i: usize) -> PolarsResult<MetricRow> {
    let n = groups.column("n")?.u64()?.get(i).unwrap_or_default();
    let std = groups.column("std")?.f64()?.get(i).filter(|_| n >= 2);
    Ok(MetricRow {
        group: text(groups, "series", i)?.into(),
        sweep: text(groups, "sweep", i)?,
        strength: number(groups, "strength", i)?,
        place: text(groups, "place", i)?,
        scene_id: None,
        scenario_id: None,
        metric: text(groups, "metric", i)?,
        value: number(groups, "mean", i)?,
        n,
        std_error: std.map(|std| std / (n as f64).sqrt()),
    })
}

/// Counts of events and the distributions of their parameters, for each behavior and label (and place), in the order in
/// which these come first.
///
/// # Errors
/// [`Error::Frame`] when a group-by fails.
pub fn summarize_events(events: &[BehaviorEvent], by_place: bool) -> Result<Vec<EventSummary>> {
    let place = |event: &BehaviorEvent| {
        let place = scene_part(&event.scene_id, 2).filter(|_| by_place);
        place.unwrap_or_default().to_owned()
    };
    let places: Vec<String> = events.iter().map(place).collect();
    let summarize = || {
        let mut summaries = event_counts(events, &places)?;
        add_parameters(&mut summaries, events, &places)?;
        Ok(summaries)
    };
    summarize().map_err(|source| Error::Frame { table: "events", source })
}

fn event_counts(events: &[BehaviorEvent], places: &[String]) -> PolarsResult<Vec<EventSummary>> {
    let frame = df! {
        "behavior" => events.iter().map(|event| event.behavior.as_str()).collect::<Vec<_>>(),
        "label" => events.iter().map(|event| event.label.name()).collect::<Vec<_>>(),
        "place" => places,
        "scene_id" => events.iter().map(|event| event.scene_id.0.as_str()).collect::<Vec<_>>(),
    }?;
    let groups = frame
        .lazy()
        .group_by_stable([col("behavior"), col("label"), col("place")])
        .agg([
            len().cast(DataType::UInt64).alias("n_events"),
            col("scene_id").n_unique().cast(DataType::UInt64).alias("n_scenes"),
        ])
        .collect()?;
    let summary = |i: usize| {
        Ok(EventSummary {
            behavior: text(&groups, "behavior", i)?,
            label: label(&groups, i)?,
            place: text(&groups, "place", i)?,
            n_events: count(&groups, "n_events", i)?,
            n_scenes: count(&groups, "n_scenes", i)?,
            parameters: Vec::new(),
        })
    };
    (0..groups.height()).map(summary).collect()
}

fn add_parameters<'e>(
    summaries: &mut [EventSummary],
    events: &'e [BehaviorEvent],
    places: &'e [String],
) -> PolarsResult<()> {
    let of_event = |(event, place): (&'e BehaviorEvent, &'e String)| {
        event.parameters.iter().map(move |(name, value)| (event, place.as_str(), name.as_str(), *value))
    };
    let rows: Vec<_> = events.iter().zip(places).flat_map(of_event).collect();
    let frame = df! {
        "behavior" => rows.iter().map(|(event, ..)| event.behavior.as_str()).collect::<Vec<_>>(),
        "label" => rows.iter().map(|(event, ..)| event.label.name()).collect::<Vec<_>>(),
        "place" => rows.iter().map(|(_, place, ..)| *place).collect::<Vec<_>>(),
        "name" => rows.iter().map(|(_, _, name, _)| *name).collect::<Vec<_>>(),
        "value" => rows.iter().map(|(.., value)| *value).collect::<Vec<_>>(),
    }?;
    let quantile =
        |(i, q): (usize, &f64)| col("value").quantile(lit(*q), QuantileMethod::Linear).alias(format!("quantile {i}"));
    let groups = frame
        .lazy()
        .group_by_stable([col("behavior"), col("label"), col("place"), col("name")])
        .agg(
            [len().cast(DataType::UInt64).alias("n"), col("value").mean().alias("mean")]
                .into_iter()
                .chain(QUANTILES.iter().enumerate().map(quantile))
                .collect::<Vec<_>>(),
        )
        .collect()?;
    for i in 0..groups.height() {
        let name = text(&groups, "name", i)?;
        let mut quantiles = [0.0; QUANTILES.len()];
        for (q, value) in quantiles.iter_mut().enumerate() {
            *value = number(&groups, &format!("quantile {q}"), i)?;
        }
        let parameter = ParameterSummary {
            unit: unit_of_name(&name),
            name,
            n: count(&groups, "n", i)?,
            mean: number(&groups, "mean", i)?,
            quantiles,
        };
        let key = (text(&groups, "behavior", i)?, label(&groups, i)?, text(&groups, "place", i)?);
        let of_group = |s: &&mut EventSummary| s.behavior == key.0 && s.label == key.1 && s.place == key.2;
        if let Some(summary) = summaries.iter_mut().find(of_group) {
            summary.parameters.push(parameter);
        }
    }
    for summary in summaries {
        summary.parameters.sort_by(|a, b| a.name.cmp(&b.name));
    }
    Ok(())
}

fn text(frame: &DataFrame, column: &str, i: usize) -> PolarsResult<String> {
    Ok(frame.column(column)?.str()?.get(i).unwrap_or_default().to_owned())
}

fn number(frame: &DataFrame, column: &str, i: usize) -> PolarsResult<f64> {
    Ok(frame.column(column)?.f64()?.get(i).unwrap_or(f64::NAN))
}

fn count(frame: &DataFrame, column: &str, i: usize) -> PolarsResult<usize> {
    Ok(frame.column(column)?.u64()?.get(i).unwrap_or_default() as usize)
}

fn label(frame: &DataFrame, i: usize) -> PolarsResult<EventLabel> {
    let name = text(frame, "label", i)?;
    label_from_name(&name).ok_or_else(|| polars_err!(ComputeError: "there is no label {name}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::SceneId;
    use crate::store::testing::event;

    fn row(group: &str, place: &str, value: f64) -> MetricRow {
        MetricRow {
            group: group.to_owned().into(),
            sweep: String::new(),
            strength: 0.0,
            place: place.to_owned(),
            scene_id: Some(SceneId::from("a/b/c/d")),
            scenario_id: None,
            metric: "min_ade_m".to_owned(),
            value,
            n: 6,
            std_error: None,
        }
    }

    #[test]
    fn metrics_have_means_and_standard_errors() {
        let aggregate = MetricRow { scene_id: None, ..row("recorded", "A", 99.0) };
        let rows = [
            row("recorded", "A", 1.0),
            row("unguided", "A", 5.0),
            row("recorded", "B", 2.0),
            aggregate,
            row("recorded", "A", 6.0),
            row("recorded", "A", f64::NAN),
        ];
        let all = summarize_metrics(&rows, false).unwrap();
        assert_eq!(all.len(), 2);
        assert_eq!((all[0].group.name(), all[0].n, all[0].value), ("recorded", 3, 3.0));
        // Sample variance of 1, 2, 6 is 7.
        assert!((all[0].std_error.unwrap() - (7.0f64 / 3.0).sqrt()).abs() < 1e-12);
        assert_eq!((all[1].n, all[1].value, all[1].std_error), (1, 5.0, None));
        let by_place = summarize_metrics(&rows, true).unwrap();
        let found: Vec<_> = by_place.iter().map(|row| (row.group.name(), row.place.as_str(), row.value)).collect();
        assert_eq!(found, [("recorded", "A", 3.5), ("unguided", "A", 5.0), ("recorded", "B", 2.0)]);
        assert_eq!(summarize_metrics(&[], true).unwrap(), []);
    }

    #[test]
    fn events_have_counts_and_quantiles() {
        let scene = |place: &str, case: usize| SceneId(format!("interaction/val/{place}/{case}"));
        let mut events: Vec<BehaviorEvent> =
            (0..5).map(|i| event(&scene("A", i / 2), "cut_in", &[("gap_m", 10.0 * i as f64)])).collect();
        events.push(BehaviorEvent { label: EventLabel::Negative, ..event(&scene("B", 0), "cut_in", &[]) });
        events.push(event(&scene("B", 1), "cut_in", &[("gap_m", 100.0), ("ttc_s", 2.0)]));

        let summaries = summarize_events(&events, false).unwrap();
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

        let by_place = summarize_events(&events, true).unwrap();
        let counts: Vec<_> = by_place.iter().map(|s| (s.place.as_str(), s.n_events)).collect();
        assert_eq!(counts, [("A", 5), ("B", 1), ("B", 1)]);
        assert_eq!(summarize_events(&[], false).unwrap(), []);
    }
}
