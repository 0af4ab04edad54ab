//! The table of accepted scenarios, which a script sorts, and the commands that export or regenerate one.

use super::ranges::{Group, ranges};
use crate::report::accepted::HARDNESS;
use crate::report::card::SceneCard;
use crate::report::html::table;
use crate::report::number::{ABSENT, value};
use crate::report::quantities::title_and_unit;
use maud::{Markup, html};

/// The most columns of figures: more do not fit beside each other.
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

/// The figures of the columns: the time to collision, then parameters of events in which accepted scenarios differ, and
/// other measures of criticality.
fn figures<'a>(accepted: &[(usize, &'a SceneCard)]) -> Vec<&'a str> {
    let ranges = ranges(accepted.iter().map(|(_, card)| *card));
    let of = |group: Group| ranges.iter().map(|range| range.name).filter(move |name| Group::of(name) == group);
    let (hardest, others) = of(Group::Criticality).partition::<Vec<&str>, _>(|name| *name == HARDNESS);
    // The time of an event and the length of a vehicle tell little about a scenario.
    let of_event = of(Group::Event).filter(|name| !name.ends_with("timestep") && !name.ends_with("length_m"));
    let n_of_event = MAX_FIGURES - hardest.len() - others.len().min(2);
    hardest.into_iter().chain(of_event.take(n_of_event)).chain(others).take(MAX_FIGURES).collect()
}
