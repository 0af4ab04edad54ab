//! The part of the report on how well generated tracks can be told from recorded ones, and how likely recorded futures
//! are among samples.

use super::number::{ABSENT, level, optional, percent, uncertainty, value};
use super::plain::{PlainRow, PlainSection, PlainTable};
use crate::evaluate::{DistinguishabilityRow, EvaluationSummary};
use crate::metrics::{Likelihoods, MetricRow, SeriesKey};

const NOTE: &str = "For each series, gradient-boosted trees learn to tell generated from recorded futures of the same \
    tracks, and are asked about scenes that they have not seen. The AUC is the share of pairs, one recorded and one \
    generated track, of which they pick the generated one: 50 % is indistinguishable. In parentheses its interval of \
    95 % over scenes. How likely recorded futures are among forecasts is the realism meta-metric of the Waymo sim \
    agents challenge of 2025, without traffic lights and on the horizon of the scenes, with its standard error. The \
    recording and constant velocity are scored as copies of one sample.";

/// The classifier's input, in words.
fn title(features: &str) -> String {
    match features {
        "all" => "All features",
        "smoothed" => "Smoothed over .7 s",
        "half_seconds" => "Steps of .5 s",
        "half_seconds_moving" => "Steps of .5 s, who moves",
        "seam" => "The seam at present",
        "lanes_and_gaps" => "Lanes and gaps",
        "whole_scenes" => "Whole scenes",
        other => other,
    }
    .to_owned()
}

fn of_series(SeriesKey { sweep, level: own, .. }: &SeriesKey) -> [String; 2] {
    [sweep.clone(), level(*own)]
}

/// The section; `None` if there are no results.
pub(super) fn section(found: &EvaluationSummary) -> Option<PlainSection> {
    let rows = &found.distinguishability;
    let is_of_all = |row: &&DistinguishabilityRow| row.place.is_empty() && row.class.is_empty();
    let mut sets: Vec<&str> = Vec::new();
    let mut series: Vec<SeriesKey> = Vec::new();
    for row in rows.iter().filter(is_of_all) {
        if !sets.contains(&row.features.as_str()) {
            sets.push(&row.features);
        }
        if !series.contains(&row.series()) {
            series.push(row.series());
        }
    }
    let in_words =
        |row: &DistinguishabilityRow| format!("{} ({:.1}–{:.1})", percent(row.auc), 100.0 * row.low, 100.0 * row.high);
    let titles: Vec<String> = sets.iter().map(|set| title(set)).collect();
    let columns: Vec<&str> =
        ["Sweep", "Strength α", "Tracks"].into_iter().chain(titles.iter().map(String::as_str)).collect();
    let mut by_set = PlainTable::new("How often the generated track is picked (AUC)", &columns);
    for key in &series {
        let own: Vec<&DistinguishabilityRow> =
            rows.iter().filter(is_of_all).filter(|row| row.series() == *key).collect();
        let n_tracks = own.iter().map(|row| row.n_tracks).max().unwrap_or_default();
        let cell = |set: &&str| {
            own.iter().find(|row| row.features == **set).map_or_else(|| ABSENT.to_owned(), |row| in_words(row))
        };
        by_set.push(of_series(key).into_iter().chain([n_tracks.to_string()]).chain(sets.iter().map(cell)).collect());
    }
    let mut parts =
        PlainTable::new("By place and class, all features", &["Sweep", "Strength α", "Of", "Tracks", "AUC"]);
    for row in rows.iter().filter(|row| !is_of_all(row)) {
        let part = format!("{}{}", row.place, row.class);
        parts.push(
            of_series(&row.series()).into_iter().chain([part, row.n_tracks.to_string(), in_words(row)]).collect(),
        );
    }
    let tables = [by_set, likelihoods(found), telling_features(found), parts];
    let tables: Vec<PlainTable> = tables.into_iter().filter(|table| !table.rows.is_empty()).collect();
    (!tables.is_empty()).then(|| PlainSection {
        id: "distinguishability".to_owned(),
        title: "Told from recordings".to_owned(),
        note: NOTE.to_owned(),
        tables,
        charts: Vec::new(),
    })
}

fn telling_features(found: &EvaluationSummary) -> PlainTable {
    let columns = [
        "Sweep",
        "Strength α",
        "Feature",
        "Unit",
        "AUC lost without it (pp)",
        "AUC of it alone (%)",
        "Recorded median",
        "Generated median",
    ];
    let mut table = PlainTable::new("What gives generated tracks away", &columns);
    for row in &found.telling_features {
        let key = SeriesKey { group: row.group.clone(), sweep: row.sweep.clone(), level: row.level };
        let figures =
            [100.0 * row.auc_drop, 100.0 * row.auc_alone].map(|points| format!("{points:.1}").replace('-', "−"));
        let medians = [value(row.recorded_median), value(row.generated_median)];
        let names = [row.feature.clone(), row.unit.clone()];
        table.push(of_series(&key).into_iter().chain(names).chain(figures).chain(medians).collect());
    }
    table
}

/// The meta-metric and its parts over all places, with the recording and constant velocity beside the samples.
fn likelihoods(found: &EvaluationSummary) -> PlainTable {
    let parts = ["Realism meta-metric", "Motion", "Distances, collisions", "Road"];
    let columns: Vec<&str> = ["Sweep", "Strength α", "Futures", "Scenes"].into_iter().chain(parts).collect();
    let mut table = PlainTable::new("How likely recorded futures are", &columns);
    let rows = || found.aggregates.iter().filter(|row| row.place.is_empty());
    for whole in rows().filter(|row| row.metric == Likelihoods::META_METRIC) {
        let own = |metric: &str| rows().find(|row| row.series() == whole.series() && row.metric == metric);
        let in_words = |row: &MetricRow| match row.std_error {
            Some(error) => format!("{} ± {}", value(row.value), uncertainty(error)),
            None => value(row.value),
        };
        let parts = Likelihoods::specs().take(parts.len()).map(|spec| match own(spec.id) {
            Some(row) if spec.id == Likelihoods::META_METRIC => in_words(row),
            row => optional(row.map(|row| row.value)),
        });
        let names = [whole.group.to_string(), whole.n.to_string()];
        let cells = of_series(&whole.series()).into_iter().chain(names).chain(parts).collect();
        table.rows.push(PlainRow { cells, is_reference: !whole.group.is_generated() });
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::Group;

    #[test]
    fn the_recording_and_constant_velocity_stand_beside_forecasts() {
        let row = |group: Group, metric: &str, value: f64, std_error: Option<f64>| MetricRow {
            group,
            sweep: "raw".to_owned(),
            n: 40,
            std_error,
            ..MetricRow::example(metric, value)
        };
        let aggregates = vec![
            row(Group::Recorded, "realism_meta_metric", 0.91, Some(0.0042)),
            row(Group::Recorded, "realism_kinematic", 0.8, Some(0.01)),
            row(Group::Unguided, "realism_meta_metric", 0.85, None),
            MetricRow { place: "A".to_owned(), ..row(Group::Unguided, "realism_meta_metric", 0.1, None) },
            row(Group::Unguided, "min_scene_ade_m", 0.3, None),
        ];
        let found = section(&EvaluationSummary { aggregates, ..EvaluationSummary::default() }).expect("a section");
        let [table] = &found.tables[..] else { panic!("one table: {found:?}") };
        let told: Vec<(String, bool)> = table.rows.iter().map(|row| (row.cells.join("|"), row.is_reference)).collect();
        let expected = [
            ("raw|0|recorded|40|0.910 ± 0.0042|0.800|–|–".to_owned(), true),
            ("raw|0|unguided|40|0.850|–|–|–".to_owned(), false),
        ];
        assert_eq!(told, expected);
        assert!(section(&EvaluationSummary::default()).is_none());
    }
}
