//! A still drawing of a scene, to scale: lanes, boxes at the present and at the end, observed and generated traces.

use super::{PALETTE, path};
use crate::report::card::{DrawnAgent, DrawnLane, DrawnSample, Light, SceneCard, ScenePanel};
use crate::report::number::coordinate;
use maud::{Markup, html};

/// Seconds between the boxes along a highlighted trace.
const GHOST_INTERVAL_S: f64 = 1.0;
/// Timesteps between the dots that mark observed states.
const DOT_STEPS: usize = 3;
/// The length of the arrows of a recording that is drawn alone, however large the view, pixels.
const ARROW: f64 = 26.0;
/// Length of the bar of a light, meters.
const LIGHT_M: f64 = 2.8;
/// Color of recorded agents without a role.
pub(in crate::report) const CONTEXT: &str = "#777777";
/// Color of generated agents without a role.
pub(in crate::report) const GENERATED_CONTEXT: &str = "#A05C8B";

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
    let pen = Pen { panel, roles, present, fades: if panel.samples.len() > 1 { 0.6 } else { 1.0 } };
    let first = panel.samples.first().map_or(&[][..], |sample| &sample.agents);
    html! {
        svg class="scene" viewBox=(format!("{} {} {} {}", card.view.min[0], -card.view.max[1], width, height))
            role="img" aria-label=(name) {
            rect class="ground" x=(card.view.min[0]) y=(-card.view.max[1]) width=(width) height=(height) {}
            (lanes(&card.lanes))
            (lights(&card.lanes, present))
            @for sample in &panel.samples { (pen.traces(sample)) }
            @for (i, sample) in panel.samples.iter().enumerate() { (pen.ends(sample, i == 0)) }
            @for agent in in_drawing_order(first) {
                @if let Some(Some(now)) = agent.states.get(present) {
                    @let given = panel.is_recorded || agent.observed.get(present).copied().unwrap_or(false);
                    (footprint(agent, *now, if given { "now" } else { "now made" }, pen.color(agent)))
                }
            }
            @if card.panels.len() == 1 && panel.is_recorded {
                @for [x, y, heading] in first.iter().filter_map(|agent| *agent.states.get(present)?) {
                    path class="arrow" d=(arrow([x, y], heading, ARROW * unit)) {}
                }
            }
            @for agent in first.iter().filter(|agent| agent.role.is_some()) {
                @if let Some([x, y, _]) = agent.states.iter().take(present + 1).rev().flatten().next() {
                    text class="role" x=(coordinate(*x)) y=(coordinate(-*y - 0.6 * agent.width_m - 6.0 * unit))
                        font-size=(coordinate(15.0 * unit))
                        stroke-width=(coordinate(4.0 * unit)) text-anchor="middle" {
                        (agent.role.as_deref().unwrap_or_default())
                    }
                }
            }
            (scale_bar(card, unit))
        }
    }
}

/// How the agents of a panel are drawn.
struct Pen<'a> {
    panel: &'a ScenePanel,
    roles: &'a [&'a str],
    present: usize,
    /// Opacity of the traces, because many samples overlap.
    fades: f64,
}

impl Pen<'_> {
    fn color(&self, agent: &DrawnAgent) -> &'static str {
        let context = if self.panel.is_recorded { CONTEXT } else { GENERATED_CONTEXT };
        let role = agent.role.as_deref().and_then(|role| self.roles.iter().position(|known| *known == role));
        role.map_or(context, role_color)
    }

    /// The traces of the agents of a sample: dotted gray lines for observed states, colored ones for generated states.
    fn traces(&self, sample: &DrawnSample) -> Markup {
        let steps = ((GHOST_INTERVAL_S / self.panel.dt_s.max(1e-3)).round() as usize).max(1);
        html! {
            @for agent in in_drawing_order(&sample.agents) {
                @let strong = agent.role.is_some();
                @for (observed, start, end) in agent.stretches() {
                    // Generated stretches are drawn from the previous state to the next one.
                    @let (from, to) = if observed { (start, end) } else {
                        (start.saturating_sub(1), (end + 1).min(agent.states.len()))
                    };
                    @let points: Vec<[f64; 2]> = agent.states[from..to].iter().flatten()
                        .map(|[x, y, _]| [*x, *y]).collect();
                    @if observed {
                        path class=(if strong { "past strong" } else { "past" }) d=(line(&points)) {}
                        path class=(if strong { "dots strong" } else { "dots" }) d=(dots(&points)) {}
                    } @else {
                        path class=(if strong { "future strong" } else { "future" }) d=(line(&points))
                            stroke=(self.color(agent)) opacity=(self.fades) {}
                    }
                }
                @if strong && self.panel.samples.len() == 1 {
                    @for timestep in (self.present + steps..agent.states.len().saturating_sub(1)).step_by(steps) {
                        @if let Some(Some(state)) = agent.states.get(timestep) {
                            (footprint(agent, *state, "ghost", self.color(agent)))
                        }
                    }
                }
            }
        }
    }

    /// Outlines of the agents at their last state; filled if it was observed, which is the same in all samples.
    fn ends(&self, sample: &DrawnSample, is_first: bool) -> Markup {
        html! {
            @for agent in in_drawing_order(&sample.agents) {
                @let last = agent.states.iter().enumerate().skip(self.present + 1).rev()
                    .find_map(|(t, state)| state.map(|state| (t, state)));
                @if let Some((timestep, state)) = last {
                    @let given = agent.observed.get(timestep).copied().unwrap_or(false);
                    @if is_first || !given {
                        (footprint(agent, state, if given { "last given" } else { "last" }, self.color(agent)))
                    }
                }
            }
        }
    }
}

/// Agents with a role come last, on top.
fn in_drawing_order(agents: &[DrawnAgent]) -> Vec<&DrawnAgent> {
    let mut order: Vec<&DrawnAgent> = agents.iter().collect();
    order.sort_by_key(|agent| agent.role.is_some());
    order
}

/// All lanes in three paths: their surfaces, center lines and borders.
fn lanes(lanes: &[DrawnLane]) -> Markup {
    let (mut surfaces, mut centers, mut borders) = (String::new(), String::new(), String::new());
    for lane in lanes {
        if lane.left.len() >= 2 && lane.right.len() >= 2 {
            surfaces += &line(lane.left.iter().chain(lane.right.iter().rev()));
            surfaces.push('Z');
        }
        centers += &line(&lane.centerline);
        borders += &line(&lane.left);
        borders += &line(&lane.right);
    }
    html! {
        path class="lane" d=(surfaces) {}
        path class="centerline" d=(centers) {}
        path class="border" d=(borders) {}
    }
}

/// A bar across the beginning of each lane with a light, in its color at a timestep. Lanes may begin together, so known
/// colors lie on top.
fn lights(lanes: &[DrawnLane], timestep: usize) -> Markup {
    let mut bars: Vec<(Light, String)> = lanes
        .iter()
        .filter_map(|lane| {
            let [[x, y], [next_x, next_y], ..] = lane.centerline.as_slice() else { return None };
            let [ahead_x, ahead_y] = [next_x - x, next_y - y];
            let half = LIGHT_M / 2.0 / ahead_x.hypot(ahead_y).max(1e-3);
            let end = |side: f64| [x - side * half * ahead_y, y + side * half * ahead_x];
            Some((lane.light(timestep)?, line(&[end(1.0), end(-1.0)])))
        })
        .collect();
    bars.sort_by_key(|(light, _)| *light);
    html! { @for (light, bar) in bars { path class=(format!("light {}", light.name())) d=(bar) {} } }
}

/// The y axis points down in SVG and up in scenes.
fn line<'a>(points: impl IntoIterator<Item = &'a [f64; 2]>) -> String {
    path(points.into_iter().map(|[x, y]| [*x, -y]))
}

/// Dots, as lines of no length with round caps: at the last of the points, and at every few before it.
fn dots(points: &[[f64; 2]]) -> String {
    let marked = points.iter().rev().step_by(DOT_STEPS);
    marked.map(|[x, y]| format!("M{} {}h0", coordinate(*x), coordinate(-y))).collect()
}

/// An arrow of this length along a heading.
fn arrow([x, y]: [f64; 2], heading: f64, length: f64) -> String {
    let ahead = |along: f64, across: f64| {
        let (sin, cos) = heading.sin_cos();
        [x + length * (along * cos - across * sin), y + length * (along * sin + across * cos)]
    };
    line(&[[x, y], ahead(1.0, 0.0)]) + &line(&[ahead(0.7, 0.2), ahead(1.0, 0.0), ahead(0.7, -0.2)])
}

/// The agent's box with a notch at its front.
fn footprint(agent: &DrawnAgent, [x, y, heading]: [f64; 3], class: &str, color: &str) -> Markup {
    let (half_length, half_width) = (agent.length_m / 2.0, agent.width_m / 2.0);
    let place =
        format!("translate({} {}) rotate({})", coordinate(x), coordinate(-y), coordinate(-heading.to_degrees()));
    let front = half_length * 0.45;
    let is_now = class.starts_with("now");
    html! {
        g class=(class) transform=(place) {
            rect x=(coordinate(-half_length)) y=(coordinate(-half_width)) width=(coordinate(agent.length_m))
                height=(coordinate(agent.width_m))
                rx="0.3" fill=(color) stroke=(color) {
                @if is_now {
                    title {
                        (agent.role.as_deref().map_or(String::new(), |role| format!("{role}: "))) "track " (agent.id)
                    }
                }
            }
            @if is_now {
                path class="front"
                    d=(path([[front, -half_width * 0.7], [half_length * 0.9, 0.0], [front, half_width * 0.7]])) {}
            }
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
        text class="role" x=(coordinate(left + length / 2.0)) y=(coordinate(bottom - 6.0 * unit))
            font-size=(coordinate(14.0 * unit))
            stroke-width=(coordinate(4.0 * unit)) text-anchor="middle" { (length) " m" }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrows_point_along_headings() {
        // North is up.
        let up = arrow([1.0, 2.0], std::f64::consts::FRAC_PI_2, 10.0);
        assert_eq!(up, "M1 -2L1 -12M-1 -9L1 -12L3 -9");
    }

    #[test]
    fn a_light_is_a_bar_across_the_beginning_of_its_lane() {
        let lane = |light: Light| DrawnLane {
            centerline: vec![[1.0, 2.0], [1.0, 12.0]],
            left: Vec::new(),
            right: Vec::new(),
            lights: vec![(light, 0..=3)],
        };
        // To the north, and y points down; what is known lies on top.
        let bar = |state: &str| format!(r#"<path class="light {state}" d="M-0.4 -2L2.4 -2"></path>"#);
        assert_eq!(lights(&[lane(Light::Go), lane(Light::Unknown)], 3).0, bar("unknown") + &bar("go"));
        assert!(lights(&[DrawnLane { lights: Vec::new(), ..lane(Light::Go) }], 3).0.is_empty());
    }
}
