//! Curves over a common axis.

use super::axes::{Axis, Plot};
use super::{color, dash, path};
use crate::report::model::Chart;
use crate::report::number::coordinate;
use maud::{Markup, html};

/// The chart with its legend below.
pub(in crate::report) fn line_chart(chart: &Chart) -> Markup {
    let finite = |p: &&[f64; 2]| p[0].is_finite() && p[1].is_finite() && (!chart.log_x || p[0] > 0.0);
    let points = || chart.curves.iter().flat_map(|curve| curve.points.iter().filter(finite));
    let x = Axis::over(points().map(|p| p[0]), chart.log_x);
    // Losses and shares are read against zero.
    let y = Axis::over(points().map(|p| p[1]).chain([0.0]), false);
    let plot = Plot { x, y };
    let inner = html! {
        @for (i, curve) in chart.curves.iter().enumerate() {
            @let drawn: Vec<[f64; 2]> = curve.points.iter().filter(finite).map(|p| plot.point(p[0], p[1])).collect();
            path class="curve" d=(path(drawn.iter().copied())) stroke=(color(i)) stroke-dasharray=(dash(i)) fill="none" {}
            @if drawn.len() <= 12 {
                @for [x, y] in &drawn { circle cx=(coordinate(*x)) cy=(coordinate(*y)) r="2.6" fill=(color(i)) {} }
            }
        }
    };
    let name = format!("{}: {} over {}", chart.title, chart.y_label, chart.x_label);
    html! {
        figure {
            figcaption { (chart.title) }
            (plot.draw(&name, &chart.x_label, &chart.y_label, &inner))
            (legend(chart.curves.iter().map(|curve| curve.name.as_str())))
        }
    }
}

/// A line sample and a name for each series; nothing for a single one.
pub(super) fn legend<'a>(names: impl ExactSizeIterator<Item = &'a str>) -> Markup {
    html! {
        @if names.len() > 1 {
            ul class="legend" {
                @for (i, name) in names.enumerate() {
                    li {
                        svg viewBox="0 0 26 8" width="26" height="8" aria-hidden="true" {
                            path class="curve" d="M1 4L25 4" stroke=(color(i)) stroke-dasharray=(dash(i)) fill="none" {}
                        }
                        (name)
                    }
                }
            }
        }
    }
}
