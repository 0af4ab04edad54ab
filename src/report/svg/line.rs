//! Curves over a common axis.

use super::axes::{Plot, PlotAxis};
use super::{color, dash, marker, path};
use crate::report::model::{Chart, Curve};
use crate::report::number::coordinate;
use maud::{Markup, html};

/// Curves with more points than this have no marks.
const MAX_MARKED: usize = 12;

/// The chart with its title above and its legend below.
pub(in crate::report) fn line_chart(chart: &Chart) -> Markup {
    html! {
        figure {
            figcaption { (chart.title) }
            (line_plot(chart))
            (legend(chart.curves.iter().map(|curve| curve.name.as_str())))
        }
    }
}

/// The chart alone.
pub(in crate::report) fn line_plot(chart: &Chart) -> Markup {
    let is_drawn = |[x, y]: [f64; 2]| x.is_finite() && y.is_finite() && (!chart.log_x || x > 0.0);
    let points = || chart.curves.iter().flat_map(|curve| curve.points.iter().copied().filter(|p| is_drawn(*p)));
    let ends = chart.curves.iter().flat_map(|curve| curve.intervals.iter().flatten().copied());
    // Losses, shares and distances are read against zero.
    let x = PlotAxis::over(points().map(|p| p[0]), chart.log_x);
    let y = PlotAxis::over(points().map(|p| p[1]).chain(ends).chain([0.0]), false);
    let plot = Plot { x, y };
    let inner = html! {
        @for (i, curve) in chart.curves.iter().enumerate() {
            @let drawn: Vec<(usize, [f64; 2])> = curve.points.iter().enumerate().filter(|(_, p)| is_drawn(**p))
                .map(|(at, p)| (at, plot.point(p[0], p[1]))).collect();
            path class="curve" d=(path(drawn.iter().map(|(_, point)| *point))) stroke=(color(i))
                stroke-dasharray=(dash(i)) fill="none" {}
            @if drawn.len() <= MAX_MARKED {
                @for (at, point) in &drawn {
                    (whisker(&plot, curve, *at, color(i)))
                    path d=(marker(i, *point)) fill=(color(i)) {}
                }
            }
        }
    };
    let name = format!("{}: {} over {}", chart.title, chart.y_label, chart.x_label);
    plot.draw(&name, &chart.x_label, &chart.y_label, &inner)
}

/// The interval of a point, as a line with ends.
fn whisker(plot: &Plot, curve: &Curve, at: usize, stroke: &str) -> Markup {
    let ends = curve.points.get(at).zip(curve.intervals.get(at)).map(|([x, _], [low, high])| {
        let ([x, low], [_, high]) = (plot.point(*x, *low), plot.point(*x, *high));
        let [left, right, low, high] = [x - 3.0, x + 3.0, low, high].map(coordinate);
        let x = coordinate(x);
        format!("M{x} {low}L{x} {high}M{left} {low}L{right} {low}M{left} {high}L{right} {high}")
    });
    html! { @if let Some(d) = ends { path class="interval" d=(d) stroke=(stroke) fill="none" {} } }
}

/// A line sample and a name for each series with a name.
pub(super) fn legend<'a>(names: impl Iterator<Item = &'a str>) -> Markup {
    let named: Vec<(usize, &str)> = names.enumerate().filter(|(_, name)| !name.is_empty()).collect();
    html! {
        @if !named.is_empty() {
            ul class="legend" {
                @for (i, name) in named {
                    li {
                        svg viewBox="0 0 26 8" width="26" height="8" aria-hidden="true" { (sample(i)) }
                        (name)
                    }
                }
            }
        }
    }
}

/// A sample of the line of the i-th series: 26 wide and 8 high.
pub(super) fn sample(i: usize) -> Markup {
    html! {
        path class="curve" d="M1 4L25 4" stroke=(color(i)) stroke-dasharray=(dash(i)) fill="none" {}
        path d=(marker(i, [13.0, 4.0])) fill=(color(i)) {}
    }
}
