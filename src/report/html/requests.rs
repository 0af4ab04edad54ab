//! The section on requests: buckets, arms, and the cost of accepted scenarios.

use super::request_gallery::gallery;
use super::request_grid::{grid, range};
use super::{Section, table};
use crate::generate::{BucketSummary, Ended, RequestSummary, Yield};
use crate::report::card::SceneCard;
use crate::report::model::ReportModel;
use crate::report::number::{ABSENT, count, level, optional, share};
use maud::{Markup, html};

pub(super) fn section(model: &ReportModel) -> Option<Section> {
    (!model.requests.is_empty()).then(|| {
        let body = html! { @for request in &model.requests { (one(request, &model.scenes)) } };
        Section::new("requests", "Requested and delivered", body)
    })
}

fn one(request: &RequestSummary, cards: &[SceneCard]) -> Markup {
    let ended = match request.ended {
        Ended::Full => "all reachable buckets were full",
        Ended::GivenUp => "all reachable buckets were full or given up: their pairs brought nothing more",
        Ended::Budget => "its budget was spent",
    };
    html! {
        h3 { (request.name) ": " (request.behavior.replace('_', " ")) }
        p {
            (count(request.n_accepted)) " of " (count(request.n_wanted)) " scenarios were accepted, of "
            (count(request.n_situations)) " situations, from " (count(request.n_samples))
            " samples and " (count(request.n_evaluations)) " evaluations of the denoiser, over "
            (count(request.n_scenes as u64))
            " scenes (" (count(request.n_cells as u64)) " pairs of agents; " (count(request.n_infeasible as u64))
            " more can fall into no bucket). It ended after " (count(request.n_rounds as u64))
            " rounds, when " (ended) "."
        }
        @if let Some(grid) = grid(&request.buckets) { (grid) }
        (gallery(&request.name, cards))
        (buckets(request))
        (arms(request))
    }
}

/// A row for each bucket, with the accepted scenarios of each arm.
fn buckets(request: &RequestSummary) -> Markup {
    let head = html! {
        tr {
            @if let Some(first) = request.buckets.first() {
                @for part in &first.parts { th scope="col" { (part.parameter) } }
            }
            th scope="col" class="n" { "Pairs" } th scope="col" class="n" { "Wanted" }
            th scope="col" class="n" { "Accepted" }
            @for arm in &request.arms { th scope="col" class="n" { "by " (arm.name) } }
            th scope="col" class="n" { "Surplus" } th scope="col" class="n" { "Repeated" }
            th scope="col" class="n" { "Near-duplicates" }
            th scope="col" class="n" { "Samples while open" } th scope="col" class="n" { "Evaluations per accepted" }
            @for arm in &request.arms { th scope="col" class="n" { "Hits of " (arm.name) } }
        }
    };
    let body = html! {
        @for bucket in &request.buckets {
            tr class=[(bucket.n_accepted < bucket.n_wanted).then_some("reference")] {
                @for part in &bucket.parts { td { (range(&part.range)) } }
                td class="n" { (count(bucket.n_feasible as u64)) }
                td class="n" { (count(bucket.n_wanted)) }
                td class="n" {
                    strong { (count(bucket.n_accepted)) }
                    @if bucket.n_accepted < bucket.n_wanted {
                        small { (if bucket.is_given_up { " given up" } else { " short" }) }
                    }
                }
                @for n in &bucket.accepted_by_arm { td class="n" { (count(*n)) } }
                td class="n" { (count(bucket.n_surplus)) }
                td class="n" { (count(bucket.n_repeated)) } td class="n" { (count(bucket.n_near_duplicates)) }
                td class="n" { (count(bucket.n_samples_while_open)) }
                td class="n" { (optional(bucket.n_evaluations_per_accepted())) }
                @for (arm, n) in request.arms.iter().zip(&bucket.hits_by_arm) {
                    td class="n" { (rate(*n, arm.total.n_samples)) }
                }
            }
        }
    };
    html! {
        (table(&format!("Buckets of {}", request.name), &head, &body))
        p class="note" {
            "A bucket contains its lower edge and not its upper one. Pairs can fall into it by their past and the \
             limits of driving. Surplus scenarios meet the request, but came when their bucket was full; repeated \
             ones, "
            "when it had enough of the same scene and agents; in near-duplicates the requested agents move almost as \
             in an accepted scenario. All three are among the samples and not in the corpus. All buckets are filled \
             from the same "
            "samples: the cost of a scenario is what was evaluated while its bucket was open, for other buckets too. \
             Hits are scenarios in the bucket, "
            "accepted or not, near-duplicates aside, of all samples of the arm."
        }
    }
}

/// A row for each arm, over all rounds and in the first.
fn arms(request: &RequestSummary) -> Markup {
    let head = html! {
        tr {
            th scope="col" { "Arm" } th scope="col" class="n" { "Strength" }
            th scope="col" class="n" { "Evaluations a sample" }
            th scope="col" { "Rounds" } th scope="col" class="n" { "Samples" }
            th scope="col" class="n" { "Behavior found" }
            th scope="col" class="n" { "Outside" } th scope="col" class="n" { "Beyond limits" }
            th scope="col" class="n" { "In a bucket" }
            th scope="col" class="n" { "Buckets hit" } th scope="col" class="n" { "Accepted" }
        }
    };
    let of = |rounds: &str, own: &Yield, n_buckets: usize| {
        html! {
            td { (rounds) } td class="n" { (count(own.n_samples)) } td class="n" { (rate(own.n_found, own.n_samples)) }
            td class="n" { (count(own.n_outside)) } td class="n" { (count(own.n_beyond_limits)) }
            td class="n" { (rate(own.n_hits, own.n_samples)) } td class="n" { (count(n_buckets as u64)) }
            td class="n" { (count(own.n_accepted)) }
        }
    };
    let n_hit = |of: fn(&BucketSummary) -> &Vec<u64>, arm: usize| {
        request.buckets.iter().filter(|bucket| of(bucket).get(arm).is_some_and(|n| *n > 0)).count()
    };
    let body = html! {
        @for (i, arm) in request.arms.iter().enumerate() {
            tr {
                th scope="row" { (arm.name) } td class="n" { (level(arm.level)) }
                td class="n" { (count(arm.n_evaluations_per_sample)) }
                @if arm.first_round.n_samples > 0 {
                    (of("first", &arm.first_round, n_hit(|bucket| &bucket.first_round_hits_by_arm, i)))
                }
                @else { td { "first" } td colspan="7" { "not tried: known from an earlier run" } }
            }
            tr {
                th scope="row" { (arm.name) } td {} td {}
                (of("all", &arm.total, n_hit(|bucket| &bucket.hits_by_arm, i)))
            }
        }
    };
    html! {
        (table(&format!("Arms of {}", request.name), &head, &body))
        p class="note" {
            "In the first round all arms continue the same scenes from the same noise, and can be compared. Later \
             rounds favor the arms and scenes "
            "that fill open buckets."
        }
    }
}

fn rate(n_hits: u64, n: u64) -> String {
    if n == 0 { ABSENT.to_owned() } else { format!("{} ({})", count(n_hits), share(n_hits, n)) }
}
