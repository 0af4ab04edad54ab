//! Drawings of the page as files, with style and legend.

use super::axes::{HEIGHT, WIDTH};
use super::line::sample;
use super::{histogram_plot, line_plot, role_color, scene_panel};
use crate::report::card::SceneCard;
use crate::report::distribution::Distribution;
use crate::report::model::Chart;
use crate::report::number::coordinate;
use maud::{Markup, PreEscaped, html};

/// The style of drawings, on the page and in files.
const STYLE: &str = include_str!("drawing.css");
const FONT: &str = "text { font-family: Helvetica, Arial, sans-serif; fill: #1a1d21; } .caption { font-size: 13px; }";
/// Height of a line of text, SVG user units.
const LINE: f64 = 18.0;
/// Width of a scene in a column, and of scenes side by side.
const SCENE_WIDTHS: [f64; 2] = [800.0, 480.0];

/// A chart with its title and legend.
pub(in crate::report) fn chart_file(chart: &Chart) -> String {
    let names: Vec<&str> = chart.curves.iter().map(|curve| curve.name.as_str()).collect();
    with_legend(&chart.title, &line_plot(chart), &names)
}

/// A histogram with its title and legend.
pub(in crate::report) fn distribution_file(distribution: &Distribution) -> String {
    let names: Vec<&str> = distribution.series.iter().map(|series| series.name.as_str()).collect();
    with_legend(&distribution.title, &histogram_plot(distribution), &names)
}

/// The panels of a card with their titles, one below the other if they are long.
pub(in crate::report) fn scene_file(card: &SceneCard) -> String {
    let [width_m, height_m] = card.view.size();
    let is_long = card.view.is_long();
    let width = SCENE_WIDTHS[usize::from(!is_long)];
    let height = width * height_m / width_m;
    let roles = card.roles();
    let n = card.panels.len() as f64;
    let step = if is_long { [0.0, height + 2.0 * LINE] } else { [width + LINE, 0.0] };
    let body = html! {
        text class="caption" x="0" y="13" { (card.title) }
        @for (i, panel) in card.panels.iter().enumerate() {
            @let [x, y] = step.map(|step| step * i as f64);
            text class="caption" x=(coordinate(x)) y=(coordinate(y + 2.0 * LINE - 5.0)) { (panel.title) }
            (placed(&scene_panel(card, panel, &roles), [x, y + 2.0 * LINE], [width, height]))
        }
        @for (i, role) in roles.iter().enumerate() {
            @let y = (n - 1.0) * step[1] + height + 2.0 * LINE + 6.0;
            @let x = 110.0 * i as f64;
            rect x=(coordinate(x)) y=(coordinate(y)) width="22" height="11" rx="2" fill=(role_color(i)) {}
            text class="caption" x=(coordinate(x + 28.0)) y=(coordinate(y + 10.0)) { (role) }
        }
    };
    file([(n - 1.0) * step[0] + width, (n - 1.0) * step[1] + height + 3.5 * LINE], &body)
}

fn with_legend(title: &str, plot: &Markup, names: &[&str]) -> String {
    let names: Vec<(usize, &str)> = names.iter().copied().enumerate().filter(|(_, name)| !name.is_empty()).collect();
    let bottom = LINE + HEIGHT;
    let body = html! {
        text class="caption" x="4" y="13" { (title) }
        (placed(plot, [0.0, LINE], [WIDTH, HEIGHT]))
        @for (row, (i, name)) in names.iter().enumerate() {
            @let y = bottom + LINE * row as f64;
            g transform=(format!("translate(56 {})", coordinate(y + 4.0))) { (sample(*i)) }
            text class="caption" x="90" y=(coordinate(y + 12.0)) { (name) }
        }
    };
    file([WIDTH, bottom + LINE * names.len() as f64 + 4.0], &body)
}

/// A drawing of the page, placed within another one.
fn placed(drawing: &Markup, [x, y]: [f64; 2], [width, height]: [f64; 2]) -> Markup {
    let [x, y, width, height] = [x, y, width, height].map(coordinate);
    let place = format!(r#"<svg x="{x}" y="{y}" width="{width}" height="{height}" "#);
    PreEscaped(drawing.0.replacen("<svg ", &place, 1))
}

fn file([width, height]: [f64; 2], body: &Markup) -> String {
    let [width, height] = [width, height].map(coordinate);
    let page = html! {
        svg xmlns="http://www.w3.org/2000/svg" width=(width) height=(height) viewBox=(format!("0 0 {width} {height}")) {
            style { (PreEscaped(STYLE)) (FONT) }
            rect width=(width) height=(height) fill="#ffffff" {}
            (body)
        }
    };
    let is_allowed = |c: char| c == '\n' || !(c.is_control() || ('\u{fffe}'..='\u{ffff}').contains(&c));
    // XML holds no control characters, escaped or not; names of recordings may.
    let text = page.into_string();
    let text = text.chars().map(|c| if is_allowed(c) { c } else { char::REPLACEMENT_CHARACTER });
    format!("{}\n", text.collect::<String>())
}
