//! The section on requested and generated scenarios, and their cost.

use super::{Section, table};
use crate::evaluate::SamplingRow;
use crate::report::model::ReportModel;
use crate::report::number::{ABSENT, count, level, percent, share, value};
use crate::report::svg::{Bar, bar_chart};
use crate::report::tradeoffs::recorded_value;
use crate::statistics::wilson_interval;
use maud::{Markup, html};

pub(super) fn section(model: &ReportModel) -> Option<Section> {
    (!model.evaluation.sampling.is_empty()).then(|| {
        let body = html! {
            (sampling_table(model))
            (yield_chart(&model.evaluation.sampling))
        };
        Section::new("outcome", "Requested and generated", body)
    })
}

fn sampling_table(model: &ReportModel) -> Markup {
    let rows = &model.evaluation.sampling;
    let head = html! {
        tr {
            th scope="col" { "Sweep" } th scope="col" { "Behavior" } th scope="col" { "Place" }
            th scope="col" class="n" { "Strength α" } th scope="col" { "Sampler" }
            th scope="col" class="n" { "Scenes" } th scope="col" class="n" { "Scenarios" }
            th scope="col" class="n" { "Verified" } th scope="col" class="n" { "Verified rate" small { " (95 %)" } }
            th scope="col" class="n" { "New" }
            th scope="col" class="n" { "With collision" } th scope="col" class="n" { "Off-road agents" }
            th scope="col" class="n" { "Evaluations per verified" }
        }
    };
    let body = html! {
        @for (i, row) in rows.iter().enumerate() {
            @if rows[..i].iter().all(|before| before.sweep != row.sweep) { (recorded_row(model, row)) }
            tr {
                th scope="row" { (row.sweep) }
                td { (row.behavior.as_deref().unwrap_or(ABSENT)) }
                td { (if row.place.is_empty() { "all" } else { &row.place }) }
                td class="n" { (level(row.level)) }
                td { (row.sampler) }
                td class="n" { (count(row.n_scenes)) }
                td class="n" { (count(row.n_scenarios)) }
                td class="n" { (if row.behavior.is_some() { count(row.n_verified) } else { ABSENT.to_owned() }) }
                td class="n" { (rate(row)) }
                td class="n" { (if row.behavior.is_some() { count(row.n_new) } else { ABSENT.to_owned() }) }
                td class="n" { (share(row.n_collision, row.n_scenarios)) }
                td class="n" { (row.offroad_rate.map_or_else(|| ABSENT.to_owned(), percent)) }
                td class="n" { (cost(row)) }
            }
        }
    };
    html! {
        (table("Sampling by sweep and guidance strength", &head, &body))
        p class="note" {
            "A scenario is verified if the miner that defines the behavior finds it for the requested tracks, \
             independently of the "
            "classifier that guided the sample. Rows of the recording show how often it contains the requested \
             behavior. A scenario is new if the recorded future of the same tracks does not contain it. Intervals are \
             95 % Wilson intervals."
        }
    }
}

/// The row of the recordings that a sweep continues, if they were measured.
fn recorded_row(model: &ReportModel, row: &SamplingRow) -> Markup {
    let of =
        |metric: &str| recorded_value(&model.evaluation, &row.sweep, metric).map_or_else(|| ABSENT.to_owned(), percent);
    let behavior = if row.behavior.is_some() { of("behavior_rate") } else { ABSENT.to_owned() };
    let (collision, offroad) = (of("collision_rate"), of("offroad_rate"));
    html! {
        @if [&behavior, &collision, &offroad].iter().any(|text| *text != ABSENT) {
            tr class="reference" {
                th scope="row" { "recorded (" (row.sweep) ")" }
                td { (row.behavior.as_deref().unwrap_or(ABSENT)) } td { "all" }
                @for text in
                    [ABSENT, "recording", ABSENT, ABSENT, ABSENT, &behavior, ABSENT, &collision, &offroad, ABSENT]
                {
                    td class=[(text != "recording").then_some("n")] { (text) }
                }
            }
        }
    }
}

fn rate(row: &SamplingRow) -> Markup {
    html! {
        @match (&row.behavior, wilson_interval(row.n_verified, row.n_scenarios)) {
            (Some(_), Some(interval)) => {
                (share(row.n_verified, row.n_scenarios))
                small { br; (percent(interval.low)) " to " (percent(interval.high)) }
            }
            _ => (ABSENT),
        }
    }
}

/// The cost of a verified scenario, including failures.
fn cost(row: &SamplingRow) -> String {
    if row.n_verified == 0 {
        return ABSENT.to_owned();
    }
    value((row.n_evaluations * row.n_scenarios) as f64 / row.n_verified as f64)
}

/// Verified rates as bars, so that guided and unguided sampling can be compared at a glance.
fn yield_chart(rows: &[SamplingRow]) -> Markup {
    let mut sweeps: Vec<&str> = Vec::new();
    let mut bars = Vec::new();
    for row in rows.iter().filter(|row| row.behavior.is_some() && row.n_scenarios > 0) {
        let group = sweeps.iter().position(|sweep| *sweep == row.sweep).unwrap_or_else(|| {
            sweeps.push(&row.sweep);
            sweeps.len() - 1
        });
        let place = if row.place.is_empty() { String::new() } else { format!("{}, ", row.place) };
        bars.push(Bar {
            label: format!("{}, {place}{}", row.sweep, row.level),
            group,
            rate: row.n_verified as f64 / row.n_scenarios as f64,
            interval: wilson_interval(row.n_verified, row.n_scenarios),
        });
    }
    html! {
        @if !bars.is_empty() {
            figure class="wide" {
                figcaption { "Rate of verified scenarios by sweep and guidance strength, with 95 % intervals" }
                (bar_chart("Rate of verified scenarios by sweep and guidance strength", &bars))
            }
        }
    }
}
