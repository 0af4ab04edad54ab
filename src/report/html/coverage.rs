//! The section on coverage: what was recorded, and what of it has scenarios.

use super::Section;
use super::plain::plain_table;
use crate::coverage::{ATTRIBUTES, CellState, CoverageRow, CoverageShare, Tag, shares};
use crate::report::model::ReportModel;
use crate::report::number::{count, share, value};
use crate::report::plain::PlainTable;
use maud::{Markup, html};

/// Cells without scenarios that are listed.
const N_LISTED: usize = 12;

/// The section; `None` if nothing was recorded or generated.
pub(super) fn section(model: &ReportModel) -> Option<Section> {
    let of = |n_tags: usize| model.coverage.iter().filter(move |row| row.n_tags() == n_tags);
    let mut columns: Vec<(&str, &str)> = Vec::new();
    for row in of(0).filter(|row| row.n_recorded + row.n_generated > 0) {
        columns.push((&row.behavior, &row.within));
    }
    if columns.is_empty() {
        return None;
    }
    let body = html! {
        p { (words(shares(&model.coverage))) }
        (grid(&of(1).collect::<Vec<_>>(), &columns))
        (missing(&of(2).filter(|row| row.state() == CellState::Missing).collect::<Vec<_>>()))
        details {
            summary { "What the words mean" }
            dl class="facts" {
                @for attribute in &ATTRIBUTES { div { dt { (spaced(attribute.name)) } dd { (attribute.definition) } } }
            }
        }
    };
    Some(Section::new("coverage", "What is covered", body))
}

fn words([single, pairs]: [CoverageShare; 2]) -> String {
    let of = |CoverageShare { n_recorded, n_covered }: CoverageShare| {
        (count(n_recorded as u64), count(n_covered as u64), share(n_covered as u64, n_recorded as u64))
    };
    let ((n, covered, part), (n_pairs, covered_pairs, part_of_pairs)) = (of(single), of(pairs));
    format!(
        "Of {n} recorded combinations of a behavior and what surrounds it, {covered} ({part}) have accepted \
         scenarios; of {n_pairs} with two attributes, {covered_pairs} ({part_of_pairs})."
    )
}

/// Surroundings down, behaviors across.
fn grid(rows: &[&CoverageRow], columns: &[(&str, &str)]) -> Markup {
    let known: Vec<Tag> = Tag::all().filter(|tag| rows.iter().any(|row| row.tags[0] == Some(*tag))).collect();
    let row = |tag: Tag, (behavior, within): (&str, &str)| {
        let is = |row: &&&CoverageRow| row.tags[0] == Some(tag) && row.behavior == behavior && row.within == within;
        rows.iter().find(is).copied()
    };
    html! {
        div class="scroll" tabindex="0" role="region" aria-label="Coverage" {
            table class="bucket-grid" {
                thead {
                    tr {
                        th scope="col" colspan="2" { "Around the center" }
                        @for (behavior, within) in columns { th scope="col" { (spaced(behavior)) " " (within) } }
                    }
                }
                tbody {
                    @for of in known.chunk_by(|a, b| a.attribute() == b.attribute()) {
                        @for (idx, tag) in of.iter().enumerate() {
                            tr {
                                @if idx == 0 {
                                    th scope="rowgroup" rowspan=(of.len()) { (spaced(tag.attribute().name)) }
                                }
                                th scope="row" { (spaced(tag.value())) }
                                @for column in columns { (cell(row(*tag, *column))) }
                            }
                        }
                    }
                }
            }
        }
        p class="note" {
            "Accepted scenarios / recorded events. " span class="key full" { "covered" } " "
            span class="key short" { "recorded, but without a scenario" } " "
            span class="key infeasible" { "never recorded there" } ". Point at a cell for its rate."
        }
    }
}

fn cell(row: Option<&CoverageRow>) -> Markup {
    let Some(row) = row else { return html! { td class="n infeasible" { "–" } } };
    let class = match row.state() {
        CellState::Covered => "full",
        CellState::Missing => "short",
        CellState::NeverRecorded | CellState::NoSuchPlace => "infeasible",
    };
    let title = match row.per_hour {
        Some(_) => format!("{} an hour in {} h", rate(row), value(row.observed_h)),
        None => "no such surroundings were recorded".to_owned(),
    };
    let text = format!("{}/{}", count(row.n_accepted), count(row.n_recorded));
    html! { td class=(format!("n {class}")) title=(title) { (text) } }
}

/// Recorded events an hour, with their interval.
fn rate(row: &CoverageRow) -> String {
    match (row.rate_per_hour, row.per_hour) {
        (Some(rate), Some(interval)) if row.n_recorded > 0 => {
            format!("{} ({} to {})", value(rate), value(interval.low), value(interval.high))
        }
        (_, Some(interval)) => format!("below {}", value(interval.high)),
        _ => String::new(),
    }
}

/// The most frequent of the pairs without scenarios.
fn missing(rows: &[&CoverageRow]) -> Markup {
    let mut rows: Vec<&CoverageRow> = rows.iter().copied().filter(|row| row.within.is_empty()).collect();
    rows.sort_by_key(|row| std::cmp::Reverse(row.n_recorded));
    let mut plain =
        PlainTable::new("Recorded, but without a scenario", &["Behavior", "Around the center", "Events", "An hour"]);
    for row in rows.iter().take(N_LISTED) {
        let tags = row.tags.iter().flatten();
        let tags = tags.map(|tag| format!("{} {}", spaced(tag.attribute().name), spaced(tag.value())));
        let tags = tags.collect::<Vec<_>>().join(", ");
        plain.push(vec![spaced(&row.behavior), tags, count(row.n_recorded), rate(row)]);
    }
    html! {
        @if !rows.is_empty() {
            details {
                summary { "What is missing most, by two attributes" }
                (plain_table(&plain))
                @if rows.len() > N_LISTED {
                    p class="note" { (count((rows.len() - N_LISTED) as u64)) " more are in coverage.parquet." }
                }
            }
        }
    }
}

fn spaced(name: &str) -> String {
    name.replace("km_h", "km/h").replace('_', " ")
}
