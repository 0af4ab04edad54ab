//! Overlaid histograms of several groups.

use super::axes::{Plot, PlotAxis};
use super::line::legend;
use super::{color, dash, path};
use crate::report::distribution::{Distribution, DistributionSeries};
use maud::{Markup, html};

/// The histograms with their legend below.
pub(in crate::report) fn histogram(distribution: &Distribution) -> Markup {
    html! {
        (histogram_plot(distribution))
        (legend(distribution.series.iter().map(|series| series.name.as_str())))
    }
}

/// The histograms as outlines of shares; the reference, which comes first, is filled.
pub(in crate::report) fn histogram_plot(distribution: &Distribution) -> Markup {
    let edges = &distribution.edges;
    let (Some(low), Some(high)) = (edges.first(), edges.last()) else { return html! {} };
    let drawn: Vec<(usize, &DistributionSeries)> =
        distribution.series.iter().enumerate().filter(|(_, s)| s.n > 0).collect();
    let shares =
        |series: &DistributionSeries| series.counts.iter().map(|c| *c as f64 / series.n as f64).collect::<Vec<_>>();
    let highest = drawn.iter().flat_map(|(_, series)| shares(series)).fold(0.0, f64::max);
    let plot = Plot { x: PlotAxis::exactly(*low, *high), y: PlotAxis::over([0.0, 100.0 * highest].into_iter(), false) };
    let outline = |series: &DistributionSeries| {
        let mut points = vec![plot.point(*low, 0.0)];
        for (share, bin) in shares(series).into_iter().zip(edges.windows(2)) {
            points.extend([plot.point(bin[0], 100.0 * share), plot.point(bin[1], 100.0 * share)]);
        }
        points.push(plot.point(*high, 0.0));
        path(points)
    };
    let inner = html! {
        @for (i, series) in &drawn {
            @let fill = if *i == 0 { color(0) } else { "none" };
            path class="curve" d=(outline(series)) stroke=(color(*i)) stroke-dasharray=(dash(*i)) fill=(fill)
                fill-opacity="0.18" {}
        }
    };
    let unit = if distribution.unit.is_empty() { String::new() } else { format!(" ({})", distribution.unit) };
    let x_label = format!("{}{unit}", distribution.title);
    let name = format!(
        "Histogram of {x_label}, {}",
        distribution.series.iter().map(|s| s.name.as_str()).collect::<Vec<_>>().join(" and ")
    );
    plot.draw(&name, &x_label, "share of values (%)", &inner)
}
