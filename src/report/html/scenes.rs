//! The drawings: each generated scene beside its recording, with what it came from.

use super::{Section, facts};
use crate::report::model::ReportModel;
use crate::report::scene_card::{SceneCard, ScenePanel};
use crate::report::svg::{role_color, scene_panel};
use maud::{Markup, PreEscaped, html};

pub(super) fn section(model: &ReportModel) -> Option<Section> {
    (!model.scenes.is_empty()).then(|| {
        let body = html! {
            p class="note" {
                "Seen from above and drawn to scale. Filled boxes are the present, the last moment that was observed; outlined boxes are the end of the scene, "
                "faint ones lie a second apart between. Grey traces are the observed past; colored ones are the future and grow stronger with time. "
                "The notch points forward. Hover over a box for its track."
            }
            @for (i, card) in model.scenes.iter().enumerate() { (scene(i, card)) }
        };
        Section::new("scenes", "Scenes", body)
    })
}

fn scene(card_idx: usize, card: &SceneCard) -> Markup {
    let roles = roles(card);
    let layout = if card.view.is_long() { "stack" } else { "beside" };
    html! {
        article class="card" aria-label=(card.title) {
            h3 { (card.title) }
            ul class="legend" {
                @for (i, role) in roles.iter().enumerate() {
                    li { span class="swatch" style=(format!("background:{}", role_color(i))) {} (role) }
                }
                li { span class="swatch context" {} "others" }
            }
            div class=(format!("panels {layout}")) {
                @for panel in &card.panels {
                    figure { figcaption { (panel.title) } (scene_panel(card, panel, &roles)) }
                }
            }
            div class="player" hidden {
                button type="button" aria-label="Play or pause" { "▶" }
                input type="range" min="0" max=(n_timesteps(card).saturating_sub(1)) value=(present(card)) aria-label="Time" ;
                output {}
            }
            script type="application/json" { (PreEscaped(player_data(card))) }
            details open[card_idx == 0] { summary { "Provenance and parameters" } (facts(&card.facts)) }
        }
    }
}

/// The roles of all panels in order of first appearance.
fn roles(card: &SceneCard) -> Vec<&str> {
    let mut roles: Vec<&str> =
        card.panels.iter().flat_map(|panel| &panel.agents).filter_map(|agent| agent.role.as_deref()).collect();
    roles.sort_unstable();
    roles.dedup();
    roles
}

fn n_timesteps(card: &SceneCard) -> usize {
    card.panels.iter().flat_map(|panel| &panel.agents).map(|agent| agent.states.len()).max().unwrap_or(0)
}

fn present(card: &SceneCard) -> usize {
    card.panels.first().map_or(0, |panel| panel.n_history.saturating_sub(1))
}

/// What the player needs, as JSON that cannot end the script element it stands in.
fn player_data(card: &SceneCard) -> String {
    let panel = |panel: &ScenePanel| {
        serde_json::json!({
            "dt_s": panel.dt_s,
            "present": panel.n_history.saturating_sub(1),
            "states": panel.agents.iter().map(|agent| &agent.states).collect::<Vec<_>>(),
        })
    };
    let panels: Vec<serde_json::Value> = card.panels.iter().map(panel).collect();
    serde_json::Value::from(panels).to_string().replace('<', "\\u003c")
}
