//! The section on rejected scenarios: reasons, and the validity checks on scenarios and recordings.

use super::quality::{distinct, heading_of_series};
use super::{Section, table};
use crate::evaluate::{AcceptanceRow, LeftOutRow, MapFitRow, ValidityRow};
use crate::metrics::Check;
use crate::report::model::ReportModel;
use crate::report::number::{ABSENT, count, level, optional, percent, share};
use maud::{Markup, html};

/// The section; `None` if nothing was evaluated.
pub(super) fn section(model: &ReportModel) -> Option<Section> {
    (!model.evaluation.acceptance.is_empty()).then(|| {
        let body = html! {
            (acceptance(&model.evaluation.acceptance))
            @if !model.evaluation.left_out.is_empty() { (left_out(&model.evaluation.left_out)) }
            (validity(&model.evaluation.validity))
            @if model.evaluation.maps.iter().any(|map| !map.allows_offroad) { (maps(&model.evaluation.maps)) }
        };
        Section::new("verdicts", "Rejected scenarios", body)
    })
}

fn acceptance(rows: &[AcceptanceRow]) -> Markup {
    let head = html! {
        tr {
            th scope="col" { "Sweep" } th scope="col" class="n" { "Strength α" }
            th scope="col" class="n" { "Scenarios" }
            th scope="col" class="n" { "Verified" } th scope="col" class="n" { "Valid" }
            th scope="col" class="n" { "Both" }
            th scope="col" class="n" { "Accepted" } th scope="col" class="n" { "In the corpus" }
        }
    };
    let body = html! {
        @for row in rows {
            tr {
                th scope="row" { (row.sweep) }
                td class="n" { (level(row.level)) }
                td class="n" { (count(row.n_scenarios)) }
                @for n in [row.n_verified, row.n_valid, row.n_verified_valid, row.n_accepted, row.n_kept] {
                    td class="n" { (count(n)) small { " " (share(n, row.n_scenarios)) } }
                }
            }
        }
    };
    html! {
        (table("From scenarios to the corpus", &head, &body))
        p class="note" {
            "Verified: the miner finds the requested behavior. Valid: it passes every check below. Accepted: both, and \
             no near-duplicate of an accepted scenario before it."
        }
    }
}

/// Reasons by sweeps, the most frequent first; samples of all strengths together.
fn left_out(rows: &[LeftOutRow]) -> Markup {
    let sweeps = distinct(rows.iter().map(|row| &row.sweep));
    let mut reasons = distinct(rows.iter().map(|row| (&row.reason, &row.stage)));
    let of = |reason: (&String, &String), sweep: Option<&String>| -> (u64, u64) {
        let is_of =
            |row: &&LeftOutRow| (&row.reason, &row.stage) == reason && sweep.is_none_or(|sweep| row.sweep == *sweep);
        rows.iter()
            .filter(is_of)
            .fold((0, 0), |(left_out, found), row| (left_out + row.n_left_out, found + row.n_found))
    };
    reasons.sort_by_key(|reason| std::cmp::Reverse(of(*reason, None)));
    let head = html! {
        tr {
            th scope="col" { "Reason" } th scope="col" { "Stage" } th scope="col" class="n" { "All sweeps" }
            @if sweeps.len() > 1 { @for sweep in &sweeps { th scope="col" class="n" { (sweep) } } }
        }
    };
    let cell = |(n_left_out, n_found): (u64, u64)| {
        html! {
            @if n_found == 0 && n_left_out == 0 { (ABSENT) } @else {
                (count(n_left_out)) @if n_found > n_left_out { small { " of " (count(n_found)) } }
            }
        }
    };
    let body = html! {
        @for reason in reasons {
            tr {
                th scope="row" { (reason.0.replace('_', " ")) } td { (reason.1) }
                td class="n" { (cell(of(reason, None))) }
                @if sweeps.len() > 1 { @for sweep in &sweeps { td class="n" { (cell(of(reason, Some(sweep)))) } } }
            }
        }
    };
    html! {
        (table("Why samples are not in the corpus", &head, &body))
        p class="note" {
            "Each sample that is not in the corpus is counted once, for its first reason. “Of” so many samples have \
             the reason, alone or with others; "
            "where they stay in the corpus, the configuration keeps them."
        }
    }
}

/// The places whose maps show the whole road.
fn maps(rows: &[MapFitRow]) -> Markup {
    let head = html! {
        tr {
            th scope="col" { "Place" } th scope="col" class="n" { "Recorded states off the lanes" }
            th scope="col" class="n" { "Recorded scenes with a departure" }
            th scope="col" { "Departures from the road" }
        }
    };
    let body = html! {
        @for MapFitRow { place, fit, allows_offroad, with_driven_area } in rows {
            tr {
                th scope="row" { (place) }
                td class="n" { (share(fit.n_states_off, fit.n_states)) }
                td class="n" { (share(fit.n_scenes_leaving, fit.n_scenes)) small { " of " (count(fit.n_scenes)) } }
                td {
                    @match (*allows_offroad, *with_driven_area) {
                        (true, _) => "checked",
                        (_, true) => "checked by lanes and where recorded vehicles drive",
                        _ => "the map does not allow it",
                    }
                }
            }
        }
    };
    html! {
        (table("Maps, and whether they show the whole road", &head, &body))
        p class="note" {
            "Where more of the recorded vehicles' states lie off the lanes, or more recorded scenes hold a departure, \
             than "
            code { "evaluate.validity.max_recorded_offroad" }
            " says, the map lacks road that people drive on. The check is then made by its lanes and the area where \
             recorded vehicles drive, if that of half of the recordings holds the other half. Recordings cannot leave \
             it."
        }
    }
}

fn n_not_checked(row: &ValidityRow, check: Check) -> u64 {
    row.not_checked.get(check.name()).copied().unwrap_or(0)
}

/// The checks that were not made, with the numbers of scenes.
fn not_checked(rows: &[&ValidityRow]) -> Markup {
    let n_scenes: u64 = rows.iter().map(|row| row.n).sum();
    let n_of = |check| rows.iter().map(|row| n_not_checked(row, check)).sum::<u64>();
    let left_out: Vec<(Check, u64)> =
        Check::ALL.into_iter().map(|check| (check, n_of(check))).filter(|(_, n)| *n > 0).collect();
    html! {
        @if !left_out.is_empty() {
            p class="note" {
                "Not checked: "
                @for (i, (check, n)) in left_out.iter().enumerate() {
                    @if i > 0 { ", " } (check.name().replace('_', " ")) " in " (count(*n)) " of " (count(n_scenes))
                    " scenes"
                }
                ". Motion is not checked where a dataset's positions are too noisy, departures from the road where \
                 there is no map or one that does not allow it. "
                "Shares are of the scenes that were checked."
            }
        }
    }
}

fn validity(rows: &[ValidityRow]) -> Markup {
    let rows: Vec<&ValidityRow> = rows.iter().filter(|row| row.place.is_empty()).collect();
    let is_failed = |check: &Check| rows.iter().any(|row| row.violations.contains_key(check.name()));
    let checks: Vec<Check> = Check::ALL.into_iter().filter(is_failed).collect();
    let head = html! {
        tr {
            th scope="col" { "Group" } th scope="col" class="n" { "Strength α" } th scope="col" class="n" { "n" }
            th scope="col" class="n" { "Valid" } th scope="col" class="n" { "Plausibility" }
            @for check in &checks { th scope="col" class="n" { (check.name().replace('_', " ")) } }
        }
    };
    let body = html! {
        @for row in &rows {
            tr class=[(!row.group.is_generated()).then_some("reference")] {
                (heading_of_series(&row.series()))
                td class="n" { (count(row.n)) }
                td class="n" { (share(row.n_valid, row.n)) }
                td class="n" { (row.plausibility.map_or_else(|| optional(None), percent)) }
                @for check in &checks {
                    td class="n" {
                        @if n_not_checked(row, *check) == row.n { "not checked" }
                        @else {
                            (share(
                                row.violations.get(check.name()).copied().unwrap_or(0),
                                row.n - n_not_checked(row, *check)
                            ))
                        }
                    }
                }
            }
        }
    };
    html! {
        (table("Validity, and the share that fails each check", &head, &body))
        p class="note" {
            "The recordings are judged as if they were generated: what they fail shows how strict a limit is, or how \
             noisy they are. "
            "Plausibility is the share of motion between the 0.1 % and 99.9 % quantiles of recorded motion."
        }
        (not_checked(&rows))
        details {
            summary { "What is checked" }
            dl class="definitions" {
                @for check in Check::ALL {
                    dt { (check.name()) small { " (" (check.unit()) ")" } } dd { (check.description()) "." }
                }
            }
        }
    }
}
