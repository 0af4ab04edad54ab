//! Rates with their intervals on a logarithmic axis, one row each.

use super::color;
use crate::report::number::{coordinate, value};
use crate::statistics::Interval;
use maud::{Markup, html};

const PLOT: f64 = 420.0;
const ROW: f64 = 22.0;
const CHARACTER: f64 = 6.9;
const VALUES: f64 = 120.0;
/// The lower end of an interval without one is drawn so many powers of ten below the upper one.
const OPEN_DECADES: f64 = 2.0;

/// A rate to be drawn.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::report) struct RateMark {
    pub(in crate::report) label: String,
    /// 0 where nothing was found: only what that allows is drawn.
    pub(in crate::report) rate: f64,
    pub(in crate::report) interval: Interval,
    /// Whether it is extrapolated, which is drawn hollow.
    pub(in crate::report) is_extrapolated: bool,
}

/// The rates below each other; `name` is read out in place of the drawing.
pub(in crate::report) fn rate_chart(name: &str, unit: &str, marks: &[RateMark]) -> Markup {
    let low_of = |mark: &RateMark| match mark.interval.low > 0.0 {
        true => mark.interval.low.log10(),
        false => mark.interval.high.log10() - OPEN_DECADES,
    };
    let least = marks.iter().map(low_of).fold(f64::INFINITY, f64::min).floor();
    let most = marks.iter().map(|mark| mark.interval.high.log10()).fold(f64::NEG_INFINITY, f64::max).ceil();
    let (least, most) = if least < most { (least, most) } else { (-1.0, 1.0) };
    let longest = marks.iter().map(|mark| mark.label.chars().count()).max().unwrap_or(0);
    let labels = (16.0 + CHARACTER * longest as f64).ceil();
    let (width, bottom) = (labels + PLOT + VALUES, ROW * marks.len() as f64 + 8.0);
    let x = |log: f64| coordinate(labels + PLOT * (log - least) / (most - least));
    html! {
        svg class="chart wide" viewBox=(format!("0 0 {width} {}", bottom + 36.0)) role="img" aria-label=(name) {
            @for decade in least as i32..=most as i32 {
                @let at = x(f64::from(decade));
                line class="grid" x1=(at) x2=(at) y1="0" y2=(bottom) {}
                text class="tick" x=(at) y=(bottom + 14.0) text-anchor="middle" { (value(10f64.powi(decade))) }
            }
            @for (i, mark) in marks.iter().enumerate() {
                @let middle = ROW * (i as f64 + 0.5) + 4.0;
                // Where none was found, the bar comes from beyond the axis: its end would look like a least rate.
                @let low = if mark.interval.low > 0.0 { low_of(mark) } else { least };
                @let (low, high) = (x(low), x(mark.interval.high.log10()));
                text class="tick" x=(labels - 8.0) y=(middle) dy="0.32em" text-anchor="end" { (mark.label) }
                @let (above, below) = (middle - 4.0, middle + 4.0);
                path class="whisker" d=(format!("M{low} {middle}L{high} {middle}M{high} {above}L{high} {below}")) {}
                @if mark.rate > 0.0 {
                    circle cx=(x(mark.rate.log10())) cy=(middle) r="4" stroke=(color(0)) stroke-width="1.5"
                        fill=(if mark.is_extrapolated { "none" } else { color(0) }) {}
                }
                text class="tick" x=(labels + PLOT + 8.0) y=(middle) dy="0.32em" {
                    @if mark.rate > 0.0 { (value(mark.rate)) } @else { "below " (value(mark.interval.high)) }
                }
            }
            text class="label" x=(labels + PLOT / 2.0) y=(bottom + 30.0) text-anchor="middle" { (unit) }
        }
    }
}
