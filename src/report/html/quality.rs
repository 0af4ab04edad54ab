//! Metrics and distributions of generated scenes beside the recording and constant velocity.

use super::{Section, table};
use crate::evaluate::{EvaluationSummary, MetricDoc};
use crate::metrics::{Direction, MetricRow, SeriesKey};
use crate::report::distribution::Distribution;
use crate::report::model::ReportModel;
use crate::report::number::{ABSENT, count, level, optional, uncertainty};
use crate::report::svg::histogram;
use maud::{Markup, html};

/// The most series beside each other in a table of metrics: as many as a laptop's screen shows.
const N_SERIES_BESIDE: usize = 7;

/// The metric tables, one for each place, and the definitions.
pub(super) fn metrics(model: &ReportModel) -> Option<Section> {
    let EvaluationSummary { docs, aggregates, .. } = &model.evaluation;
    let rows: Vec<&MetricRow> =
        aggregates.iter().filter(|row| row.scene_id.is_none() && row.scenario_id.is_none()).collect();
    if rows.is_empty() {
        return None;
    }
    // Metrics without any value, such as those of another dataset, get no row.
    let docs: Vec<&MetricDoc> = docs.iter().filter(|doc| rows.iter().any(|row| row.metric == doc.metric)).collect();
    let mut places = distinct(rows.iter().map(|row| row.place.clone()));
    if let [_, _] = &places[..] {
        // With a single place, the table of all places is enough.
        places.retain(|place| !place.is_empty());
    }
    let body = html! {
        @for place in &places {
            @let tables = place_tables(
                place,
                &docs,
                &rows.iter().copied().filter(|row| row.place == *place).collect::<Vec<_>>()
            );
            @if place.is_empty() || places.len() == 1 { (tables) } @else {
                details { summary { "Metrics, " (place) } (tables) }
            }
        }
        p class="note" { "Means with their standard error. Recorded futures are the reference: their column shows the \
                          metric on real traffic. "
            "The constant-velocity baseline continues every agent at its present velocity." }
        details {
            summary { "What the metrics mean" }
            dl class="definitions" {
                @for doc in &docs { dt { (heading(doc)) } dd { (doc.description) "." (better(doc)) } }
            }
        }
    };
    Some(Section::new("metrics", "Metrics beside recording and baseline", body))
}

/// A row for each metric, a column for each series. Series that do not fit side by side go into further tables.
fn place_tables(place: &str, docs: &[&MetricDoc], rows: &[&MetricRow]) -> Markup {
    // In order of first appearance: the writer puts the recording and the baseline first.
    let all_series = distinct(rows.iter().map(|row| row.series()));
    let of =
        |series: &SeriesKey| rows.iter().copied().filter(|row| row.series() == *series).collect::<Vec<&MetricRow>>();
    let caption = format!("Metrics, {}", if place.is_empty() { "all places" } else { place });
    html! {
        @for part in all_series.chunks(N_SERIES_BESIDE) {
            @let series: Vec<(&SeriesKey, Vec<&MetricRow>)> = part.iter().map(|series| (series, of(series))).collect();
            @let head = html! {
                tr {
                    th scope="col" { "Metric" }
                    @for (series, rows) in &series {
                        th scope="col" class="n" {
                            (column_of_series(series)) br;
                            small { "n = " (count(rows.iter().map(|row| row.n).max().unwrap_or(0))) }
                        }
                    }
                }
            };
            @let body = html! {
                @for doc in docs {
                    @let cells: Vec<_> = series.iter()
                        .map(|(_, rows)| rows.iter().copied().find(|row| row.metric == doc.metric)).collect();
                    @if cells.iter().any(Option::is_some) {
                        tr { th scope="row" { (heading(doc)) } @for row in cells { td class="n" { (cell(row)) } } }
                    }
                }
            };
            (table(&caption, &head, &body))
        }
    }
}

/// Group, sweep and strength, in the heading of a column.
fn column_of_series(SeriesKey { group, sweep, level: own }: &SeriesKey) -> Markup {
    html! {
        (group) @if !sweep.is_empty() && sweep != group.name() { " (" (sweep) ")" }
        @if group.is_generated() { br; (level(*own)) }
    }
}

/// Group, sweep and strength, in two cells.
pub(super) fn heading_of_series(SeriesKey { group, sweep, level: own }: &SeriesKey) -> Markup {
    html! {
        th scope="row" { (group) @if !sweep.is_empty() && sweep != group.name() { " (" (sweep) ")" } }
        td class="n" { (if group.is_generated() { level(*own) } else { ABSENT.to_owned() }) }
    }
}

fn cell(row: Option<&MetricRow>) -> Markup {
    html! {
        (optional(row.map(|row| row.value)))
        @if let Some(error) = row.and_then(|row| row.std_error) { small { " ± " (uncertainty(error)) } }
    }
}

fn heading(doc: &MetricDoc) -> Markup {
    html! { (doc.metric) @if doc.unit != "1" { small { " (" (doc.unit) ")" } } }
}

fn better(doc: &MetricDoc) -> &'static str {
    match doc.direction {
        Direction::LowerIsBetter => " Lower is better.",
        Direction::HigherIsBetter => " Higher is better.",
        Direction::Neither => "",
    }
}

/// Each item once, in order of first appearance.
pub(super) fn distinct<T: PartialEq>(items: impl Iterator<Item = T>) -> Vec<T> {
    let mut seen = Vec::new();
    for item in items {
        if !seen.contains(&item) {
            seen.push(item);
        }
    }
    seen
}

/// Histograms with their distances.
pub(super) fn distributions(model: &ReportModel) -> Option<Section> {
    let distributions = &model.distributions;
    let reference = distributions.first()?.series.first().map(|series| &series.name);
    let body = html! {
        @if let Some(reference) = reference {
            p class="note" {
                "Values beyond the ends of an axis are counted in its first and last bins. The distance is \
                 Wasserstein-1 to “" (reference) "”: "
                "how far, on average, a value must be moved to turn one distribution into the other."
            }
            div class="grid" { @for distribution in distributions { (distribution_figure(distribution)) } }
        }
    };
    Some(Section::new("distributions", "Distributions, recorded and generated", body))
}

fn distribution_figure(distribution: &Distribution) -> Markup {
    let unit = if distribution.unit.is_empty() { String::new() } else { format!(" ({})", distribution.unit) };
    let head = html! {
        tr { th scope="col" { "Group" } th scope="col" class="n" { "n" } th scope="col" class="n" { "Mean" }
            th scope="col" class="n" { "Median" } th scope="col" class="n" { "Distance" } }
    };
    let body = html! {
        @for series in &distribution.series {
            tr { th scope="row" { (series.name) } td class="n" { (count(series.n)) }
                td class="n" { (optional(series.mean)) }
                td class="n" { (optional(series.median)) } td class="n" { (optional(series.distance)) } }
        }
    };
    html! {
        figure {
            figcaption {
                (distribution.title) @if !distribution.description.is_empty() { ": " (distribution.description) }
            }
            (histogram(distribution))
            (table(&format!("{}{unit} in numbers", distribution.title), &head, &body))
        }
    }
}
