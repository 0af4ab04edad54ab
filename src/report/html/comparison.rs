//! The page of a comparison of two runs.

use super::plain::plain_table;
use super::{Section, page};
use crate::report::comparison::Comparison;
use crate::report::plain::PlainTable;
use crate::report::svg::line_chart;
use maud::{Markup, html};

/// The comparison as one self-contained HTML file: equal comparisons give equal bytes.
pub fn render_comparison(comparison: &Comparison) -> String {
    let sections: Vec<Section> = [
        Some(Section::new("settings", "Settings that differ", settings(&comparison.settings()))),
        of_table(
            "outcome",
            "Requested and generated",
            &comparison.sampling(),
            "A star marks shares whose Wilson intervals (95 %) do not overlap.",
        ),
        of_table(
            "accepted",
            "Accepted",
            &comparison.acceptance(),
            "Accepted: verified, valid and no near-duplicate of an accepted scenario before it.",
        ),
        charts(comparison),
        metrics(comparison),
        of_table(
            "distinguishability",
            "Told from recordings",
            &comparison.distinguishability(),
            "50 % is indistinguishable. A star marks areas whose intervals (95 %) do not overlap.",
        ),
        of_table(
            "realism",
            "Realism of motion",
            &comparison.realism(),
            "Wasserstein-1 distance in the quantity's unit and Jensen-Shannon divergence in bits; lower is closer to \
             the recording.",
        ),
        of_table(
            "mining",
            "Events in the recordings",
            &comparison.mining(),
            "Shares of scenes. They differ if recordings, splits or definitions do.",
        ),
    ]
    .into_iter()
    .flatten()
    .collect();
    let head = html! {
        p { "Differences are B − A. “–” marks values that one of the runs does not have." }
        (plain_table(&comparison.facts()))
    };
    page("Two runs compared", &head, &sections, &html! {})
}

fn settings(table: &PlainTable) -> Markup {
    html! {
        @if table.rows.is_empty() { p class="fine" { "None: both runs have the same configuration." } } @else {
            (plain_table(table))
        }
    }
}

fn of_table(id: &'static str, title: &'static str, table: &PlainTable, note: &str) -> Option<Section> {
    (!table.rows.is_empty()).then(|| Section::new(id, title, html! { (plain_table(table)) p class="note" { (note) } }))
}

fn charts(comparison: &Comparison) -> Option<Section> {
    let charts = comparison.charts();
    (!charts.is_empty()).then(|| {
        let body = html! { div class="grid" { @for chart in &charts { (line_chart(chart)) } } };
        Section::new("tradeoffs", "Guidance strength: yield, realism, cost", body)
    })
}

fn metrics(comparison: &Comparison) -> Option<Section> {
    let tables = comparison.metrics();
    let docs = [&comparison.a, &comparison.b].map(|run| &run.evaluation.docs);
    (!tables.is_empty()).then(|| {
        let body = html! {
            p class="note" {
                "Means over scenes, all places together. A star marks differences of more than twice their standard \
                 error, "
                "which holds for different scenes and is too large where both runs continue the same ones."
            }
            div class="grid broad" { @for table in &tables { (plain_table(table)) } }
            details {
                summary { "What the metrics mean" }
                dl class="definitions" {
                    @for (i, doc) in
                        docs[0].iter().chain(docs[1].iter().filter(|doc| !docs[0].contains(doc))).enumerate()
                    {
                        @let changed = i >= docs[0].len() && docs[0].iter().any(|other| other.metric == doc.metric);
                        dt { (doc.metric) @if changed { " (in B)" } } dd { (doc.description) "." }
                    }
                }
            }
        };
        Section::new("metrics", "Metrics", body)
    })
}
