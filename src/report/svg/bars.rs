//! Rates with their intervals, one row each.

use super::color;
use crate::report::number::{coordinate, percent};
use crate::statistics::Interval;
use maud::{Markup, html};

const BARS: f64 = 400.0;
const ROW: f64 = 24.0;
const VALUES: f64 = 110.0;
/// Approximate width of a character; all bars leave room for the longest label.
const CHARACTER: f64 = 6.9;
const MIN_LABELS: f64 = 120.0;

/// A rate to be drawn.
pub(in crate::report) struct Bar {
    pub(in crate::report) label: String,
    /// The group that decides its color.
    pub(in crate::report) group: usize,
    /// Between 0 and 1.
    pub(in crate::report) rate: f64,
    pub(in crate::report) interval: Option<Interval>,
}

/// Horizontal bars from zero with 95 % intervals; `name` is read out in place of the drawing.
pub(in crate::report) fn bar_chart(name: &str, bars: &[Bar]) -> Markup {
    let highest = bars.iter().map(|bar| bar.interval.map_or(bar.rate, |i| i.high)).fold(0.01, f64::max);
    let longest = bars.iter().map(|bar| bar.label.chars().count()).max().unwrap_or(0);
    let labels = (16.0 + CHARACTER * longest as f64).ceil().max(MIN_LABELS);
    let width = labels + BARS + VALUES;
    let x = |rate: f64| coordinate(labels + BARS * rate / highest);
    let height = ROW * bars.len() as f64 + 8.0;
    html! {
        svg class="chart wide" viewBox=(format!("0 0 {width} {height}")) role="img" aria-label=(name) {
            @for (i, bar) in bars.iter().enumerate() {
                @let top = ROW * i as f64 + 4.0;
                @let middle = top + ROW / 2.0;
                text class="tick" x=(labels - 8.0) y=(middle) dy="0.32em" text-anchor="end" { (bar.label) }
                rect x=(labels) y=(top + 4.0) width=(coordinate(BARS * bar.rate / highest)) height=(ROW - 8.0)
                    fill=(color(bar.group)) fill-opacity="0.75" {}
                @if let Some(interval) = bar.interval {
                    path class="whisker" d=(format!(
                        "M{low} {middle}L{high} {middle}M{low} {a}L{low} {b}M{high} {a}L{high} {b}",
                        low = x(interval.low), high = x(interval.high), a = middle - 4.0, b = middle + 4.0)) {}
                }
                text class="tick" x=(width - VALUES + 8.0) y=(middle) dy="0.32em" { (percent(bar.rate)) }
            }
            line class="axis" x1=(labels) x2=(labels) y1="0" y2=(height) {}
        }
    }
}
