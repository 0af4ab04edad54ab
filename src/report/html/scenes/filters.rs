//! The filters for scenes: a form, and the keys of every scene.

use super::ranges::{Range, groups, ranges};
use crate::report::card::{CardBucket, SceneCard, Verdict};
use crate::report::number::level;
use crate::scene::GuidanceLevel;
use maud::{Markup, html};
use serde_json::{Value, json};

/// The form. It is hidden until its script runs.
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
    let mut levels: Vec<GuidanceLevel> = cards.iter().map(|card| card.key.level).collect();
    levels.sort_by(|a, b| a.strength.total_cmp(&b.strength).then(a.weight.total_cmp(&b.weight)));
    levels.dedup();
    let levels: Vec<(String, String)> = levels.into_iter().map(|own| (own.to_string(), level(own))).collect();
    let buckets = distinct(cards.iter().filter_map(|card| card.key.bucket.as_ref()).map(|b| (b.words(), b.words())));
    let decisions = decisions(cards);
    let ranges = ranges(cards.iter());
    html! {
        form id="filters" class="filters" hidden aria-label="Choose scenes" {
            div class="choices" {
                (choice("sweep", "Sweep", &sweeps))
                (choice("behavior", "Behavior", &behaviors))
                (choice("place", "Place", &places))
                (choice("verdict", "Verdict", &verdicts))
                (choice("bucket", "Bucket", &buckets))
                (choice("decision", "Decision", &decisions))
                (choice("strength", "Strength α", &levels))
            }
            (groups(&ranges))
            div class="found" {
                output id="found" role="status" aria-live="polite" {}
                button type="button" id="show-all" { "Show all" }
            }
        }
    }
}

const NO_BEHAVIOR: &str = "none";
const ACCEPTED: &str = "accepted";
const REJECTED: &str = "rejected";

/// Accepted, rejected, and rejected for each of the reasons that occur.
fn decisions(cards: &[SceneCard]) -> Vec<(String, String)> {
    let known: Vec<Vec<String>> = cards.iter().map(tags).collect();
    let has = |tag: &str| known.iter().flatten().any(|known| known == tag);
    let mut options: Vec<(String, String)> = [(ACCEPTED, "accepted"), (REJECTED, "rejected, for any reason")]
        .into_iter()
        .filter(|(tag, _)| has(tag))
        .map(|(tag, words)| (tag.to_owned(), words.to_owned()))
        .collect();
    let reasons = cards.iter().filter_map(|card| card.key.acceptance.as_ref()).flat_map(|decision| &decision.reasons);
    let option = |reason: &String| (format!("{REJECTED}.{reason}"), format!("rejected: {}", reason.replace('_', " ")));
    options.extend(distinct(reasons.map(option)));
    options
}

/// The decisions by which a card is found; none if acceptance was not decided.
fn tags(card: &SceneCard) -> Vec<String> {
    match &card.key.acceptance {
        None => Vec::new(),
        Some(decision) if decision.is_accepted() => vec![ACCEPTED.to_owned()],
        Some(decision) => {
            let reasons = decision.reasons.iter().map(|reason| format!("{REJECTED}.{reason}"));
            std::iter::once(REJECTED.to_owned()).chain(reasons).collect()
        }
    }
}

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

/// The data of the filters: the names of the figures, and for each scene its sweep, behavior, place, verdict, strength,
/// bucket, decisions and figures.
pub(super) fn index(cards: &[SceneCard]) -> Value {
    let ranges = ranges(cards.iter());
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
            card.key.level.to_string(),
            card.key.bucket.as_ref().map(CardBucket::words),
            tags(card),
            ranges.iter().map(figure).collect::<Vec<_>>(),
        ])
    };
    json!({
        "figures": ranges.iter().map(|range| range.name).collect::<Vec<_>>(),
        "cards": cards.iter().map(entry).collect::<Vec<_>>(),
    })
}

/// Four decimals are enough for filters.
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
