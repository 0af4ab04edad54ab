//! The sections on the recordings: how much was read and left out, and the mined behaviors.

use super::{Section, table};
use crate::evaluate::MiningSummary;
use crate::report::model::ReportModel;
use crate::report::number::{count, share};
use maud::{Markup, html};
use std::collections::BTreeMap;

/// Counts of mined events and the definitions behind them.
pub(super) fn mining(model: &ReportModel) -> Option<Section> {
    let MiningSummary { definitions, counts } = model.mining.as_ref()?;
    let head = html! {
        tr { th scope="col" { "Behavior" } th scope="col" { "Split" } th scope="col" { "Place" }
            th scope="col" class="n" { "Scenes" }
            th scope="col" class="n" { "Scenes with it" } th scope="col" class="n" { "Share" }
            th scope="col" class="n" { "Events" } th scope="col" class="n" { "Hard negatives" } }
    };
    let rows = html! {
        @for row in counts {
            tr { th scope="row" { (row.behavior) } td { (row.split) } td { (row.place) }
                td class="n" { (count(row.n_scenes)) }
                td class="n" { (count(row.n_scenes_with)) } td class="n" { (share(row.n_scenes_with, row.n_scenes)) }
                td class="n" { (count(row.n_positive)) } td class="n" { (count(row.n_negative)) } }
        }
    };
    let body = html! {
        (table("Events found in the recordings", &head, &rows))
        @if !definitions.is_empty() {
            details open {
                summary { "What counts" }
                dl class="definitions" { @for doc in definitions { dt { (doc.behavior) } dd { (doc.definition) } } }
            }
        }
    };
    Some(Section::new("mining", "Events in the recordings", body))
}

/// The section on recordings that were read and rejected.
pub(super) fn ingest(model: &ReportModel) -> Option<Section> {
    let report = model.ingest.as_ref()?;
    let head = html! { tr { th scope="col" { "Split and place" } th scope="col" class="n" { "Scenes" } } };
    let rows =
        html! { @for (part, n) in &report.scenes_by { tr { th scope="row" { (part) } td class="n" { (count(*n)) } } } };
    let body = html! {
        p {
            (count(report.n_units)) " files, cases or recordings were read (" (count(report.n_bytes / 1_000_000))
            " MB uncompressed); they gave "
            (count(report.n_scenes)) " scenes with " (count(report.n_agents)) " agents."
        }
        (table("Scenes", &head, &rows))
        (rejects(report))
        (tally("Left out", "What", &report.dropped))
        (tally("Assumed where the recording has no value", "What", &report.assumed))
    };
    Some(Section::new("data", "Recordings", body))
}

fn rejects(report: &crate::ingest::IngestReport) -> Markup {
    let head = html! {
        tr { th scope="col" { "Reason" } th scope="col" class="n" { "Count" } th scope="col" { "First examples" } }
    };
    let rows = html! {
        @for (reason, rejects) in &report.rejects {
            tr { th scope="row" { (reason.replace('_', " ")) } td class="n" { (count(rejects.count)) }
                td { ul class="plain" { @for example in &rejects.examples { li { code { (example) } } } } } }
        }
    };
    html! {
        @if report.rejects.is_empty() { p class="fine" { "Nothing was rejected." } } @else {
            (table("Rejected", &head, &rows))
        }
    }
}

fn tally(caption: &str, what: &str, counts: &BTreeMap<String, u64>) -> Markup {
    let head = html! { tr { th scope="col" { (what) } th scope="col" class="n" { "Count" } } };
    let rows = html! {
        @for (key, n) in counts { tr { th scope="row" { (key.replace('_', " ")) } td class="n" { (count(*n)) } } }
    };
    html! { @if !counts.is_empty() { (table(caption, &head, &rows)) } }
}
