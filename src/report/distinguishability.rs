//! The part of the report on how well generated tracks can be told from recorded ones.

use super::number::{ABSENT, level, percent, value};
use super::plain::{PlainSection, PlainTable};
use crate::evaluate::{DistinguishabilityRow, EvaluationSummary};
use crate::metrics::SeriesKey;

const NOTE: &str = "For each series, gradient-boosted trees learn to tell generated from recorded futures of the same \
    tracks, and are asked about scenes that they have not seen. The AUC is the share of pairs, one recorded and one \
    generated track, of which they pick the generated one: 50 % is indistinguishable. In parentheses its interval of \
    95 % over scenes.";

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
    let mut telling = PlainTable::new(
        "What gives generated tracks away",
        &[
            "Sweep",
            "Strength α",
            "Feature",
            "Unit",
            "AUC lost without it (pp)",
            "AUC of it alone (%)",
            "Recorded median",
            "Generated median",
        ],
    );
    for row in &found.telling_features {
        let key = SeriesKey { group: row.group.clone(), sweep: row.sweep.clone(), level: row.level };
        let figures =
            [100.0 * row.auc_drop, 100.0 * row.auc_alone].map(|points| format!("{points:.1}").replace('-', "−"));
        let medians = [value(row.recorded_median), value(row.generated_median)];
        let names = [row.feature.clone(), row.unit.clone()];
        telling.push(of_series(&key).into_iter().chain(names).chain(figures).chain(medians).collect());
    }
    let mut parts =
        PlainTable::new("By place and class, all features", &["Sweep", "Strength α", "Of", "Tracks", "AUC"]);
    for row in rows.iter().filter(|row| !is_of_all(row)) {
        let part = format!("{}{}", row.place, row.class);
        parts.push(
            of_series(&row.series()).into_iter().chain([part, row.n_tracks.to_string(), in_words(row)]).collect(),
        );
    }
    let tables = [by_set, telling, parts];
    let tables: Vec<PlainTable> = tables.into_iter().filter(|table| !table.rows.is_empty()).collect();
    (!tables.is_empty()).then(|| PlainSection {
        id: "distinguishability".to_owned(),
        title: "Told from recordings".to_owned(),
        note: NOTE.to_owned(),
        tables,
        charts: Vec::new(),
    })
}
