//! The table of accepted scenarios, which a script sorts, and the commands that hand one on.

use super::ranges::ranges;
use crate::report::accepted::HARDNESS;
use crate::report::card::SceneCard;
use crate::report::html::table;
use crate::report::number::{ABSENT, value};
use crate::report::quantities::title_and_unit;
use maud::{Markup, html};

/// Most columns of figures: more do not fit beside each other.
const MAX_FIGURES: usize = 7;

/// The accepted scenarios among `cards`, in their order.
pub(super) fn table_of(cards: &[SceneCard]) -> Markup {
    let accepted: Vec<(usize, &SceneCard)> = cards.iter().enumerate().filter(|(_, c)| c.key.is_accepted()).collect();
    let figures = figures(&accepted);
    let head = html! {
        tr {
            th scope="col" { "Scenario" } th scope="col" { "Behavior" } th scope="col" { "Place" }
            th scope="col" { "Sweep" }
            @for figure in &figures {
                @let (title, unit) = title_and_unit(figure);
                th scope="col" class="n" { (title) @if !unit.is_empty() { small { " (" (unit) ")" } } }
            }
        }
    };
    let body = html! {
        @for (i, card) in &accepted {
            tr {
                th scope="row" { a href=(format!("#scene-{i}")) { (card.id) } }
                td { (card.key.behavior.as_deref().unwrap_or(ABSENT).replace('_', " ")) }
                td { (card.key.place) } td { (card.key.sweep) }
                @for figure in &figures { td class="n" { (card.key.value(figure).map_or(ABSENT.to_owned(), value)) } }
            }
        }
    };
    html! {
        @if !accepted.is_empty() {
            div class="sortable long" { (table("Accepted scenarios that are drawn, the hardest first", &head, &body)) }
            p class="note" {
                "A heading sorts, an id leads to the scene. In the folder of the run, "
                code { "djinn export commonroad corpus --scenario ID --out FOLDER" }
                " exports one, and "
                code { "djinn corpus filter corpus --where \"scenario_id = 'ID'\" --out FOLDER" }
                " keeps it as a corpus; all scenarios are in "
                code { "corpus/scenarios" }
                "."
            }
        }
    }
}

/// The figures of the columns: the time to collision, then those in which accepted scenarios differ.
fn figures<'a>(accepted: &[(usize, &'a SceneCard)]) -> Vec<&'a str> {
    let has = |name: &str| accepted.iter().any(|(_, card)| card.key.value(name).is_some());
    let mut figures: Vec<&str> = if has(HARDNESS) { vec![HARDNESS] } else { Vec::new() };
    for name in ranges(accepted.iter().map(|(_, card)| *card)).into_iter().map(|range| range.name) {
        if figures.len() < MAX_FIGURES && !figures.contains(&name) {
            figures.push(name);
        }
    }
    figures
}
