//! Rates with their intervals, one row each.

use super::color;
use crate::report::number::{coordinate, percent};
use crate::report::wilson::Interval;
use maud::{Markup, html};

const WIDTH: f64 = 760.0;
const ROW: f64 = 24.0;
const LABELS: f64 = 250.0;
const VALUES: f64 = 110.0;

/// A rate to be drawn.
pub(in crate::report) struct Bar {
    /// What it is the rate of.
    pub(in crate::report) label: String,
    /// The group that decides its color.
    pub(in crate::report) group: usize,
    /// Between 0 and 1.
    pub(in crate::report) rate: f64,
    /// How sure it is.
    pub(in crate::report) interval: Option<Interval>,
}

/// Horizontal bars from zero with 95 % intervals; `name` is read out in place of the drawing.
pub(in crate::report) fn bar_chart(name: &str, bars: &[Bar]) -> Markup {
    let highest = bars.iter().map(|bar| bar.interval.map_or(bar.rate, |i| i.high)).fold(0.01, f64::max);
    let x = |rate: f64| coordinate(LABELS + (WIDTH - LABELS - VALUES) * rate / highest);
    let height = ROW * bars.len() as f64 + 8.0;
    html! {
        svg class="chart wide" viewBox=(format!("0 0 {WIDTH} {height}")) role="img" aria-label=(name) {
            @for (i, bar) in bars.iter().enumerate() {
                @let top = ROW * i as f64 + 4.0;
                @let middle = top + ROW / 2.0;
                text class="tick" x=(LABELS - 8.0) y=(middle) dy="0.32em" text-anchor="end" { (bar.label) }
                rect x=(LABELS) y=(top + 4.0) width=(coordinate((WIDTH - LABELS - VALUES) * bar.rate / highest)) height=(ROW - 8.0)
                    fill=(color(bar.group)) fill-opacity="0.75" {}
                @if let Some(interval) = bar.interval {
                    path class="whisker" d=(format!("M{low} {middle}L{high} {middle}M{low} {a}L{low} {b}M{high} {a}L{high} {b}",
                        low = x(interval.low), high = x(interval.high), a = middle - 4.0, b = middle + 4.0)) {}
                }
                text class="tick" x=(WIDTH - VALUES + 8.0) y=(middle) dy="0.32em" { (percent(bar.rate)) }
            }
            line class="axis" x1=(LABELS) x2=(LABELS) y1="0" y2=(height) {}
        }
    }
}
