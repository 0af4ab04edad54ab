//! The section of drawings: each generated scene beside its recording, with its provenance, to play and filter.
//!
//! The page has still drawings of the first scenes, for print and for browsers without scripts, and packed states of
//! all scenes (see `card/packed.rs`), from which `player.js` draws those that come into view.

mod accepted;
mod card;
mod filters;
mod ranges;

use super::{Section, table};
use crate::report::Drawn;
use crate::report::card::{SceneCard, pack_lanes};
use crate::report::model::ReportModel;
use crate::report::number::count;
use crate::report::svg::{CONTEXT, GENERATED_CONTEXT};
use maud::{Markup, PreEscaped, html};
use serde_json::Value;
use std::collections::BTreeMap;

/// The most scenes with a still drawing in the page. Each takes some tens of kilobytes, packed states a few.
const N_STILL: usize = 24;

pub(super) fn section(model: &ReportModel) -> Option<Section> {
    (!model.scenes.is_empty()).then(|| {
        let body = html! {
            (accepted::table_of(&model.scenes))
            details class="script-only" hidden {
                summary { "Filter scenes, and compare them by two figures" }
                (filters::form(&model.scenes))
                div id="scatter" class="scatter" hidden {}
            }
            (reading_help(&model.scenes))
            (player(&model.scenes))
            (drawn(&model.drawn))
            script type="application/json" id="index" { (json(&filters::index(&model.scenes))) }
        };
        Section::new("scenes", "Scenes", body)
    })
}

pub(super) fn player(scenes: &[SceneCard]) -> Markup {
    let lanes = Lanes::of(scenes);
    html! {
        div id="cards" {
            @for (i, card) in scenes.iter().enumerate() {
                (card::card(i, card, lanes.of_card[i], i < N_STILL))
            }
        }
        script type="application/json" id="lanes" { (json(&Value::from(lanes.packed))) }
    }
}

/// How much of each sweep is drawn, and the setting to change for more.
fn drawn(rows: &[Drawn]) -> Markup {
    let head = html! {
        tr { th scope="col" { "Sweep" } th scope="col" { "What" } th scope="col" class="n" { "Drawn" }
            th scope="col" class="n" { "There are" }
            th scope="col" { "At most" } }
    };
    let body = html! {
        @for row in rows {
            tr { th scope="row" { (row.sweep) } td { (row.what) } td class="n" { (count(row.n_drawn as u64)) }
                td class="n" { (count(row.n_there as u64)) } td { code { (row.limit) } } }
        }
    };
    html! { @if !rows.is_empty() { (table("Drawings by sweep", &head, &body)) } }
}

fn reading_help(scenes: &[SceneCard]) -> Markup {
    let n_scenes = scenes.len();
    let has_lights = scenes.iter().flat_map(|card| &card.lanes).any(|lane| !lane.lights.is_empty());
    html! {
        details { summary { "How to read the drawings" }
        p class="note" {
            "Seen from above and drawn to scale. Dotted dark lines are states that were given: the history of a \
             recording, or what a sample was conditioned on. "
            "Plain colored lines were generated or, in a recording, are its future. Filled boxes are given or recorded \
             states, light ones with an outline generated ones; the notch points forward. "
            "Outlines without filling are the end of the scene, faint ones a second apart on the way there."
            @if has_lights {
                " A bar across the beginning of a lane is its traffic light, gray where it is not known; models do not \
                 see lights."
            }
        } }
        ul class="legend" {
            li { span class="swatch" style=(format!("background:{CONTEXT}")) {} "others, recorded" }
            li { span class="swatch" style=(format!("background:{GENERATED_CONTEXT}")) {} "others, generated" }
        }
        noscript {
            p class="note" {
                "Without script, drawings stand still"
                @if n_scenes > N_STILL { " and only the first " (N_STILL) " scenes are drawn" } "."
            }
        }
        p class="note print-only" {
            "In print, the first " (n_scenes.min(N_STILL)) " of " (n_scenes) " scenes are drawn."
        }
        (keys_help())
    }
}

/// How to use the player without a mouse.
pub(super) fn keys_help() -> Markup {
    html! {
        p class="note script-only" hidden { "With the focus on a scene, the space bar plays and pauses, the arrow keys \
                                             go a step back and forth, Home and End to its ends." }
    }
}

/// The lanes of all cards, without duplicates.
struct Lanes {
    packed: Vec<String>,
    of_card: Vec<usize>,
}

impl Lanes {
    fn of(scenes: &[SceneCard]) -> Self {
        let mut known: BTreeMap<String, usize> = BTreeMap::new();
        let mut lanes = Self { packed: Vec::new(), of_card: Vec::new() };
        for card in scenes {
            let packed = pack_lanes(&card.lanes);
            let idx = *known.entry(packed).or_insert_with_key(|packed| {
                lanes.packed.push(packed.clone());
                lanes.packed.len() - 1
            });
            lanes.of_card.push(idx);
        }
        lanes
    }
}

/// JSON that cannot end its script element.
fn json(value: &Value) -> Markup {
    PreEscaped(value.to_string().replace('<', "\\u003c"))
}
