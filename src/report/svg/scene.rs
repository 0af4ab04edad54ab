//! One drawing of a scene, to scale: lanes, boxes at the present and at the end, and traces that fade into the past.

use super::{PALETTE, path};
use crate::report::number::coordinate;
use crate::report::scene_card::{DrawnAgent, SceneCard, ScenePanel};
use maud::{Markup, html};

/// Seconds between the boxes along a highlighted trace.
const GHOST_INTERVAL_S: f64 = 1.0;
/// Timesteps a piece of a fading trace.
const FADE_STEPS: usize = 3;
/// Color of agents without a role.
const CONTEXT: &str = "#777777";

/// The color of a role, by the order of the roles.
pub(in crate::report) fn role_color(role_idx: usize) -> &'static str {
    PALETTE[role_idx % PALETTE.len()]
}

/// Draws one panel of a card. `roles` lists the card's roles in order of their colors.
pub(in crate::report) fn scene_panel(card: &SceneCard, panel: &ScenePanel, roles: &[&str]) -> Markup {
    let [width, height] = card.view.size();
    // Text and marks keep their size on the page whatever the extent of the view: a unit is about a pixel.
    let unit = width.max(1.0) / if card.view.is_long() { 1000.0 } else { 500.0 };
    let present = panel.n_history.saturating_sub(1);
    let name = format!("{}, {}: road users from above", card.title, panel.title);
    let color_of = |agent: &DrawnAgent| role_index(agent, roles).map_or(CONTEXT, role_color);
    // Those with a role are drawn last, on top.
    let mut order: Vec<usize> = (0..panel.agents.len()).collect();
    order.sort_by_key(|i| panel.agents[*i].role.is_some());
    html! {
        svg class="scene" viewBox=(format!("{} {} {} {}", card.view.min[0], -card.view.max[1], width, height)) role="img" aria-label=(name) {
            rect class="ground" x=(card.view.min[0]) y=(-card.view.max[1]) width=(width) height=(height) {}
            @for lane in &card.lanes {
                @if lane.left.len() >= 2 && lane.right.len() >= 2 {
                    path class="lane" d=(format!("{}Z", line(lane.left.iter().chain(lane.right.iter().rev())))) {}
                }
            }
            @for lane in &card.lanes {
                path class="centerline" d=(line(&lane.centerline)) {}
                path class="border" d=(line(&lane.left)) {}
                path class="border" d=(line(&lane.right)) {}
            }
            @for agent in order.iter().map(|i| &panel.agents[*i]) { (trace(agent, panel, color_of(agent))) }
            @for (i, agent) in order.iter().map(|i| (*i, &panel.agents[*i])) {
                @let color = color_of(agent);
                @if let Some(last) = agent.states.iter().skip(present + 1).rev().flatten().next() {
                    (footprint(agent, *last, "last", color, None))
                }
                @if let Some(Some(now)) = agent.states.get(present) { (footprint(agent, *now, "now", color, Some(i))) }
            }
            @for agent in panel.agents.iter().filter(|agent| agent.role.is_some()) {
                @if let Some([x, y, _]) = agent.states.iter().take(present + 1).rev().flatten().next() {
                    text class="role" x=(coordinate(*x)) y=(coordinate(-*y - 0.6 * agent.width_m - 6.0 * unit)) font-size=(coordinate(15.0 * unit))
                        stroke-width=(coordinate(4.0 * unit)) text-anchor="middle" { (agent.role.as_deref().unwrap_or_default()) }
                }
            }
            (scale_bar(card, unit))
        }
    }
}

fn role_index(agent: &DrawnAgent, roles: &[&str]) -> Option<usize> {
    agent.role.as_deref().and_then(|role| roles.iter().position(|known| *known == role))
}

/// The y axis points down in SVG and up in scenes.
fn line<'a>(points: impl IntoIterator<Item = &'a [f64; 2]>) -> String {
    path(points.into_iter().map(|[x, y]| [*x, -y]))
}

/// Where the agent goes: grey in the past; in the future stronger the later, with a box each second for highlighted agents.
fn trace(agent: &DrawnAgent, panel: &ScenePanel, color: &str) -> Markup {
    let present = panel.n_history.saturating_sub(1);
    let last = agent.states.len().saturating_sub(1);
    let future = last.saturating_sub(present).max(1) as f64;
    let piece = |from: usize, to: usize| -> Vec<[f64; 2]> {
        agent.states[from.min(last)..=to.min(last)].iter().flatten().map(|[x, y, _]| [*x, *y]).collect()
    };
    if agent.states.is_empty() {
        return html! {};
    }
    let history = piece(0, present);
    if agent.role.is_none() {
        let rest = piece(present, last);
        return html! {
            @if history.len() > 1 { path class="past" d=(line(&history)) {} }
            @if rest.len() > 1 { path class="future" d=(line(&rest)) stroke=(color) opacity="0.5" {} }
        };
    }
    let ghost_steps = ((GHOST_INTERVAL_S / panel.dt_s.max(1e-3)).round() as usize).max(1);
    let opacity = |timestep: usize| coordinate(0.3 + 0.7 * (timestep - present) as f64 / future);
    html! {
        @if history.len() > 1 { path class="past strong" d=(line(&history)) {} }
        @for from in (present..last).step_by(FADE_STEPS) {
            @let points = piece(from, from + FADE_STEPS);
            @if points.len() > 1 {
                path class="future strong" d=(line(&points)) stroke=(color) opacity=(opacity((from + FADE_STEPS).min(last))) {}
            }
        }
        @for timestep in (present + ghost_steps..last).step_by(ghost_steps) {
            @if let Some(Some(state)) = agent.states.get(timestep) { (footprint(agent, *state, "ghost", color, None)) }
        }
    }
}

/// The agent's box with a notch at its front; `agent_idx` marks the box that the player moves.
fn footprint(
    agent: &DrawnAgent,
    [x, y, heading]: [f64; 3],
    class: &str,
    color: &str,
    agent_idx: Option<usize>,
) -> Markup {
    let (half_length, half_width) = (agent.length_m / 2.0, agent.width_m / 2.0);
    let place =
        format!("translate({} {}) rotate({})", coordinate(x), coordinate(-y), coordinate(-heading.to_degrees()));
    let front = half_length * 0.45;
    html! {
        g class=(class) transform=(place) data-agent=[agent_idx] {
            rect x=(coordinate(-half_length)) y=(coordinate(-half_width)) width=(coordinate(agent.length_m)) height=(coordinate(agent.width_m))
                rx="0.3" fill=(color) stroke=(color) {
                title { (agent.role.as_deref().map_or(String::new(), |role| format!("{role}: "))) "track " (agent.id) }
            }
            path class="front" d=(path([[front, -half_width * 0.7], [half_length * 0.9, 0.0], [front, half_width * 0.7]])) {}
        }
    }
}

/// A bar of a round length in the lower left corner.
fn scale_bar(card: &SceneCard, unit: f64) -> Markup {
    let [width, _] = card.view.size();
    let length = [100.0, 50.0, 20.0, 10.0, 5.0].into_iter().find(|l| *l <= width / 4.0).unwrap_or(2.0);
    let (left, bottom) = (card.view.min[0] + 14.0 * unit, -card.view.min[1] - 12.0 * unit);
    let (x1, x2, y) = (coordinate(left), coordinate(left + length), coordinate(bottom));
    let tick = coordinate(bottom - 6.0 * unit);
    html! {
        path class="scale" d=(format!("M{x1} {tick}L{x1} {y}L{x2} {y}L{x2} {tick}")) {}
        text class="role" x=(coordinate(left + length / 2.0)) y=(coordinate(bottom - 6.0 * unit)) font-size=(coordinate(14.0 * unit))
            stroke-width=(coordinate(4.0 * unit)) text-anchor="middle" { (length) " m" }
    }
}
