//! The first screen: request, result, cost, and whether to trust the result.

use crate::evaluate::{SamplingRow, ValidityRow};
use crate::metrics::Group;
use crate::report::model::ReportModel;
use crate::report::number::{count, percent, share, value};
use maud::{Markup, html};

/// The run in four boxes; boxes without content are left out.
pub(super) fn summary(model: &ReportModel) -> Markup {
    html! {
        ul class="summary" {
            @if !model.evaluation.sampling.is_empty() || !model.requests.is_empty() {
                (answer("Asked", &asked(model)))
                (answer("Got", &got(model)))
                (answer("Cost", &cost(model)))
            } @else if let Some(ingest) = &model.ingest {
                (answer("Got", &html! { p { strong { (count(ingest.n_scenes)) }
                    " recorded scenes; nothing was generated." } }))
            }
            (answer("Can you trust it?", &trust(model)))
            @if !model.requests.is_empty() {
                li class="wide" { h2 { "Requested and delivered" } (requested(model)) }
            }
        }
    }
}

fn answer(question: &str, body: &Markup) -> Markup {
    html! { li { h2 { (question) } (body) } }
}

fn asked(model: &ReportModel) -> Markup {
    // Samples of a request are named after it, and serve what it wants.
    let is_of_request = |row: &&SamplingRow| {
        let request = row.sweep.split_once('/').map(|(request, _)| request);
        model.requests.iter().any(|known| Some(known.name.as_str()) == request)
    };
    let of_sweeps: Vec<&SamplingRow> = model.evaluation.sampling.iter().filter(|row| !is_of_request(row)).collect();
    let n_of = |behavior: Option<&str>| -> u64 {
        let rows = of_sweeps.iter().filter(|row| row.behavior.as_deref() == behavior);
        rows.map(|row| row.n_scenarios).sum()
    };
    let mut behaviors: Vec<Option<&str>> = Vec::new();
    for row in &of_sweeps {
        if !behaviors.contains(&row.behavior.as_deref()) {
            behaviors.push(row.behavior.as_deref());
        }
    }
    html! {
        @if !model.requests.is_empty() {
            p {
                strong { (count(model.requests.iter().map(|request| request.n_wanted).sum())) }
                " accepted scenarios in buckets of their parameters"
            }
        }
        @for behavior in behaviors {
            p { strong { (count(n_of(behavior))) } " futures"
                @match behavior {
                    Some(behavior) => { ", requested: " (behavior.replace('_', " ")) } None => " as traffic may go on"
                }
            }
        }
        @if model.n_continued > 0 {
            p { "from " (count(model.n_continued as u64))
                @if let Some(ingest) = &model.ingest { " of " (count(ingest.n_scenes)) } " recorded scenes" }
        }
    }
}

fn got(model: &ReportModel) -> Markup {
    let asked: Vec<&SamplingRow> = model.evaluation.sampling.iter().filter(|row| row.behavior.is_some()).collect();
    let sum = |rows: &[&SamplingRow], of: fn(&SamplingRow) -> u64| rows.iter().map(|row| of(row)).sum::<u64>();
    let n_accepted: u64 = model.evaluation.acceptance.iter().map(|row| row.n_accepted).sum();
    let n_judged: u64 = model.evaluation.acceptance.iter().map(|row| row.n_scenarios).sum();
    html! {
        @if !model.evaluation.acceptance.is_empty() {
            p {
                strong { (count(n_accepted)) } " accepted of " (count(n_judged)) ": verified, valid, no near-duplicate"
            }
        }
        @if let Some(hardness) = model.hardness.filter(|_| n_accepted > 0) {
            p { "in " strong { (count(hardness.n_situations)) }
                @if hardness.n_situations == 1 { " situation" } @else { " situations" }
                @if let Some((n_critical, n_without)) = hardness.n_critical.zip(hardness.n_without_ttc) {
                    "; " strong { (count(n_critical)) } " have a time to collision below 1.5 s, "
                    strong { (count(n_without)) } " have none"
                }
                @if hardness.n_careful > 0 {
                    "; a careful driver could not prevent " strong { (count(hardness.n_not_preventable)) } " of "
                    (count(hardness.n_careful)) " judged"
                }
            }
        }
        @if !asked.is_empty() {
            p { strong { (count(sum(&asked, |row| row.n_verified))) }
                " verified: the miner finds the requested behavior; "
                (count(sum(&asked, |row| row.n_new))) " of them are not in the recording" }
        }
    }
}

/// Wanted and accepted scenarios of each request.
fn requested(model: &ReportModel) -> Markup {
    html! {
        div class="scroll" { table {
            thead { tr {
                th scope="col" { "Request" } th scope="col" { "Behavior" } th scope="col" class="n" { "Wanted" }
                th scope="col" class="n" { "Accepted" } th scope="col" class="n" { "Scenes tried" }
                th scope="col" class="n" { "Samples" }
            } }
            tbody { @for request in &model.requests {
                tr class=[(request.n_accepted < request.n_wanted).then_some("short")] {
                    td { (request.name) } td { (request.behavior.replace('_', " ")) }
                    td class="n" { (count(request.n_wanted)) } td class="n" { (count(request.n_accepted)) }
                    td class="n" { (count(request.n_scenes as u64)) } td class="n" { (count(request.n_samples)) }
                }
            } }
        } }
    }
}

fn cost(model: &ReportModel) -> Markup {
    let n_evaluations: u64 = model.evaluation.sampling.iter().map(|row| row.n_evaluations * row.n_scenarios).sum();
    let n_samples: u64 = model.evaluation.sampling.iter().map(|row| row.n_scenarios).sum();
    let n_accepted: u64 = model.evaluation.acceptance.iter().map(|row| row.n_accepted).sum();
    html! {
        p { strong { (count(n_evaluations)) } " evaluations of the denoiser for " (count(n_samples)) " samples" }
        @if n_accepted > 0 {
            p { strong { (value(n_evaluations as f64 / n_accepted as f64)) } " for each accepted scenario" }
        }
    }
}

fn trust(model: &ReportModel) -> Markup {
    let over_all = || model.evaluation.validity.iter().filter(|row| row.place.is_empty());
    let rate = |rows: Vec<&ValidityRow>| {
        let (n_valid, n) = rows.iter().fold((0, 0), |(n_valid, n), row| (n_valid + row.n_valid, n + row.n));
        (n > 0).then(|| share(n_valid, n))
    };
    let generated = rate(over_all().filter(|row| row.group.is_generated()).collect());
    let recorded = rate(over_all().filter(|row| row.group == Group::Recorded).collect());
    let told = model.evaluation.distinguishability.iter().filter(|row| row.is_overall()).map(|row| row.auc);
    let most_told = told.reduce(f64::max);
    html! {
        p {
            @match model.warnings.len() {
                0 => { strong class="fine" { "No warnings" } }
                n => {
                    strong class="warn" { (count(n as u64)) } " "
                    a href="#warnings" { (if n == 1 { "warning" } else { "warnings" }) } ", to be read first"
                }
            }
        }
        @if let Some(generated) = generated {
            p {
                strong { (generated) } " of the samples are physically valid"
                @if let Some(recorded) = recorded { "; of the recordings " (recorded) }
            }
        }
        @if let Some(most_told) = most_told {
            p { "Of a recorded and a generated track, a classifier "
                a href="#distinguishability" { "picks the generated one" } " in up to "
                strong { (percent(most_told)) } " of pairs; 50 % is indistinguishable" }
        }
    }
}
