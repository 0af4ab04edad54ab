//! By what can scenes be found? A form, and what the page knows of every scene to answer it.

use crate::report::card::{SceneCard, Verdict};
use crate::report::number::{setting, value};
use crate::report::quantities::title_and_unit;
use maud::{Markup, html};
use serde_json::{Value, json};

/// The form. It is shown by the script that answers it.
pub(super) fn form(cards: &[SceneCard]) -> Markup {
    let plain = |word: &str| (word.to_owned(), word.replace('_', " "));
    let sweeps = distinct(cards.iter().map(|card| (card.key.sweep.clone(), card.key.sweep.clone())));
    let behaviors = distinct(cards.iter().map(|card| match &card.key.behavior {
        Some(behavior) => plain(behavior),
        None => (NO_BEHAVIOR.to_owned(), "none".to_owned()),
    }));
    let places = distinct(cards.iter().map(|card| (card.key.place.clone(), card.key.place.clone())));
    let verdicts: Vec<(String, String)> = Verdict::ALL
        .into_iter()
        .filter(|verdict| cards.iter().any(|card| card.key.verdict == *verdict))
        .map(|verdict| (verdict.name().to_owned(), verdict.words().to_owned()))
        .collect();
    let mut strengths: Vec<f64> = cards.iter().map(|card| card.key.strength).collect();
    strengths.sort_by(f64::total_cmp);
    strengths.dedup();
    let strengths: Vec<(String, String)> = strengths.into_iter().map(|s| (s.to_string(), setting(s))).collect();
    let ranges = ranges(cards);
    html! {
        form id="filters" class="filters" hidden aria-label="Choose scenes" {
            div class="choices" {
                (choice("sweep", "Sweep", &sweeps))
                (choice("behavior", "Behavior", &behaviors))
                (choice("place", "Place", &places))
                (choice("verdict", "Verdict", &verdicts))
                (choice("strength", "Strength α", &strengths))
            }
            @if !ranges.is_empty() {
                details {
                    summary { "By figures of the event and of the scenario" }
                    div class="ranges" { @for range in &ranges { (range_inputs(range)) } }
                }
            }
            div class="found" {
                output id="found" role="status" aria-live="polite" {}
                button type="button" id="show-all" { "Show all" }
            }
        }
    }
}

const NO_BEHAVIOR: &str = "none";

fn choice(name: &str, label: &str, options: &[(String, String)]) -> Markup {
    html! {
        @if options.len() > 1 {
            label {
                (label)
                select name=(name) {
                    option value="" { "all" }
                    @for (value, text) in options { option value=(value) { (text) } }
                }
            }
        }
    }
}

/// A figure that scenes differ in.
struct Range<'a> {
    name: &'a str,
    low: f64,
    high: f64,
}

/// The figures that are not the same everywhere: parameters of events, then metrics.
fn ranges(cards: &[SceneCard]) -> Vec<Range<'_>> {
    let mut ranges: Vec<Range<'_>> = Vec::new();
    // Scenes with an event name its parameters first.
    let has_event = |card: &&SceneCard| matches!(card.key.verdict, Verdict::New | Verdict::Recorded);
    let (with, without): (Vec<&SceneCard>, Vec<&SceneCard>) = cards.iter().partition(has_event);
    let values = with.into_iter().chain(without).flat_map(|card| &card.key.values);
    for found in values.filter(|found| found.value.is_finite()) {
        match ranges.iter_mut().find(|range| range.name == found.name) {
            Some(range) => (range.low, range.high) = (range.low.min(found.value), range.high.max(found.value)),
            None => ranges.push(Range { name: &found.name, low: found.value, high: found.value }),
        }
    }
    ranges.retain(|range| range.high > range.low);
    ranges
}

fn range_inputs(range: &Range<'_>) -> Markup {
    let (title, unit) = title_and_unit(range.name);
    let input = |end: &str, words: &str, least: f64| {
        html! {
            input type="number" step="any" name=(format!("{}.{end}", range.name)) placeholder=(value(least)) aria-label=(format!("{title}, {words}")) ;
        }
    };
    html! {
        div {
            span { (title) @if !unit.is_empty() { small { " (" (unit) ")" } } }
            (input("min", "at least", range.low)) "to" (input("max", "at most", range.high))
        }
    }
}

/// What the form is answered from: the names of the figures, and of each scene its sweep, behavior, place, verdict, strength
/// and figures.
pub(super) fn index(cards: &[SceneCard]) -> Value {
    let ranges = ranges(cards);
    let entry = |card: &SceneCard| {
        let figure = |range: &Range<'_>| {
            let found = card.key.values.iter().find(|found| found.name == range.name)?;
            found.value.is_finite().then(|| rounded(found.value))
        };
        json!([
            card.key.sweep,
            card.key.behavior.as_deref().unwrap_or(NO_BEHAVIOR),
            card.key.place,
            card.key.verdict.name(),
            card.key.strength.to_string(),
            ranges.iter().map(figure).collect::<Vec<_>>(),
        ])
    };
    json!({
        "figures": ranges.iter().map(|range| range.name).collect::<Vec<_>>(),
        "cards": cards.iter().map(entry).collect::<Vec<_>>(),
    })
}

/// Four decimals are enough to choose by.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

fn distinct(items: impl Iterator<Item = (String, String)>) -> Vec<(String, String)> {
    let mut seen: Vec<(String, String)> = Vec::new();
    for item in items {
        if !seen.contains(&item) {
            seen.push(item);
        }
    }
    seen
}
