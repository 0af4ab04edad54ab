//! One scene on the page: a heading, the drawings or room for them, and the player's data.

use super::json;
use crate::report::card::{SceneCard, pack_sample};
use crate::report::html::facts;
use crate::report::svg::{role_color, scene_panel};
use maud::{Markup, html};
use serde_json::{Value, json};

/// The card; `lanes_idx` is the index of its lanes among those of all cards. Cards that are not `is_still` are drawn by
/// script alone.
pub(super) fn card(card_idx: usize, card: &SceneCard, lanes_idx: usize, is_still: bool) -> Markup {
    let title_id = format!("scene-{card_idx}-title");
    let layout = if card.view.is_long() { "stack" } else { "beside" };
    html! {
        article class=(if is_still { "card still" } else { "card" }) id=(format!("scene-{card_idx}"))
            aria-labelledby=(title_id) {
            h3 id=(title_id) { (card.title) @if card.key.acceptance.is_some() { " " small { (card.id) } } }
            div class=(format!("panels {layout}")) style=(format!("aspect-ratio:{}", aspect_ratio(card))) {
                @if is_still { (still(card)) }
            }
            script type="application/json" { (json(&player_data(card, lanes_idx, !is_still))) }
            @if is_still { details { summary { "Provenance and figures" } (facts(&card.facts)) } }
        }
    }
}

/// Drawings of the present and the end.
fn still(card: &SceneCard) -> Markup {
    let roles = card.roles();
    html! {
        @for panel in &card.panels {
            figure {
                figcaption {
                    (panel.title)
                    @for (i, role) in roles.iter().enumerate() {
                        " " span class="swatch" style=(format!("background:{}", role_color(i))) {} (role)
                    }
                }
                (scene_panel(card, panel, &roles))
            }
        }
    }
}

/// The approximate size of the drawings, so that the page keeps its length while they come and go.
fn aspect_ratio(card: &SceneCard) -> String {
    let [width, height] = card.view.size();
    let n = card.panels.len().max(1) as f64;
    let ratio = if card.view.is_long() { width / (n * height) } else { n * width / height };
    format!("{ratio:.2}")
}

/// The player's data, with facts unless they are on the page already.
fn player_data(card: &SceneCard, lanes_idx: usize, with_facts: bool) -> Value {
    let roles = card.roles();
    // The agents in the drawings, without duplicates.
    let mut agents: Vec<(&str, Value)> = Vec::new();
    for agent in card.panels.iter().flat_map(|panel| &panel.samples).flat_map(|sample| &sample.agents) {
        if agents.iter().all(|(id, _)| *id != agent.id) {
            let role = agent.role.as_deref().and_then(|role| roles.iter().position(|known| *known == role));
            agents.push((&agent.id, json!([agent.id, role, agent.length_m, agent.width_m])));
        }
    }
    let ids: Vec<&str> = agents.iter().map(|(id, _)| *id).collect();
    let panels: Vec<Value> = card
        .panels
        .iter()
        .map(|panel| {
            let samples: Vec<Value> =
                panel.samples.iter().map(|sample| json!([sample.name, pack_sample(sample, &ids)])).collect();
            json!([panel.title, panel.is_recorded, samples])
        })
        .collect();
    let states = card.panels.iter().flat_map(|panel| &panel.samples).flat_map(|sample| &sample.agents);
    let first = card.panels.first();
    let mut data = json!({
        "dt": first.map_or(0.1, |panel| panel.dt_s),
        "present": first.map_or(0, |panel| panel.n_history.saturating_sub(1)),
        "steps": states.map(|agent| agent.states.len()).max().unwrap_or(0),
        "view": [card.view.min[0], card.view.min[1], card.view.max[0], card.view.max[1]],
        "lanes": lanes_idx,
        "roles": roles,
        "agents": agents.into_iter().map(|(_, agent)| agent).collect::<Vec<_>>(),
        "panels": panels,
    });
    if !card.closeness.is_empty() {
        let rounded = |value: &Option<f64>| value.map(|value| (value * 100.0).round() / 100.0);
        data["closeness"] = card.closeness.iter().map(|[ttc_s, m]| json!([rounded(ttc_s), rounded(m)])).collect();
    }
    if with_facts {
        data["facts"] = card.facts.iter().map(|fact| json!([fact.name, fact.value])).collect();
    }
    data
}
