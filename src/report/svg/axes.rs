//! The axes of charts, with their ticks.

use crate::report::number::{coordinate, tick};
use maud::{Markup, html};

/// Size of every chart, SVG user units.
pub(super) const WIDTH: f64 = 390.0;
/// Height of line charts and histograms.
pub(super) const HEIGHT: f64 = 240.0;
const LEFT: f64 = 56.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 12.0;
const BOTTOM: f64 = 46.0;

/// One axis: its range, linear or logarithmic.
#[derive(Debug, Clone, Copy)]
pub(super) struct PlotAxis {
    low: f64,
    high: f64,
    log: bool,
}

impl PlotAxis {
    /// An axis over finite `values`, widened to whole ticks unless it is logarithmic.
    pub(super) fn over(values: impl Iterator<Item = f64>, log: bool) -> Self {
        let usable = values.filter(|v| v.is_finite() && (!log || *v > 0.0));
        let (low, high) = usable.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        if low > high {
            return Self { low: if log { 0.1 } else { 0.0 }, high: 1.0, log };
        }
        if log {
            let (low, high) = if high / low < 1.01 { (low / 2.0, high * 2.0) } else { (low, high) };
            return Self { low, high, log };
        }
        let (low, high) = if high - low < 1e-9 * high.abs().max(1e-9) {
            // Values that are constant and not negative, such as a share of 0, get no negative part of an axis.
            let least = if low >= 0.0 { 0.0 } else { f64::NEG_INFINITY };
            ((low - 0.5 * low.abs().max(1.0)).max(least), high + 0.5 * high.abs().max(1.0))
        } else {
            (low, high)
        };
        let step = nice_step(high - low);
        Self { low: (low / step).floor() * step, high: (high / step).ceil() * step, log }
    }

    /// An axis with these ends.
    pub(super) const fn exactly(low: f64, high: f64) -> Self {
        Self { low, high, log: false }
    }

    /// The position of `value`: 0 at the low end, 1 at the high end.
    fn share(&self, value: f64) -> f64 {
        if self.log {
            (value.max(f64::MIN_POSITIVE) / self.low).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        }
    }

    /// Tick positions with their labels.
    fn ticks(&self) -> Vec<(f64, String)> {
        if self.log {
            let (first, last) = (self.low.log10().ceil() as i32, self.high.log10().floor() as i32);
            return (first..=last).map(|e| 10f64.powi(e)).map(|v| (v, tick(v, v))).collect();
        }
        let step = nice_step(self.high - self.low);
        let first = (self.low / step - 1e-6).ceil() as i64;
        let last = (self.high / step + 1e-6).floor() as i64;
        (first..=last).map(|i| i as f64 * step).map(|v| (v, tick(v, step))).collect()
    }
}

/// 1, 2 or 5 times a power of ten, about a fifth of `span`.
fn nice_step(span: f64) -> f64 {
    let raw = span / 5.0;
    let power = 10f64.powf(raw.log10().floor());
    let leading = raw / power;
    power
        * if leading < 1.5 {
            1.0
        } else if leading < 3.5 {
            2.0
        } else if leading < 7.5 {
            5.0
        } else {
            10.0
        }
}

/// The plotting area with its two axes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plot {
    pub(super) x: PlotAxis,
    pub(super) y: PlotAxis,
}

impl Plot {
    /// Maps values to a point of the drawing.
    pub(super) fn point(&self, x: f64, y: f64) -> [f64; 2] {
        [LEFT + (WIDTH - LEFT - RIGHT) * self.x.share(x), HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * self.y.share(y)]
    }

    /// The chart: grid, ticks and labels around `inner`. `name` is read out in place of the drawing.
    pub(super) fn draw(&self, name: &str, x_label: &str, y_label: &str, inner: &Markup) -> Markup {
        let (right, bottom) = (WIDTH - RIGHT, HEIGHT - BOTTOM);
        html! {
            svg class="chart" viewBox=(format!("0 0 {WIDTH} {HEIGHT}")) role="img" aria-label=(name) {
                @for (value, label) in self.y.ticks() {
                    @let y = coordinate(self.point(0.0, value)[1]);
                    line class="grid" x1=(LEFT) x2=(right) y1=(y) y2=(y) {}
                    text class="tick" x=(LEFT - 6.0) y=(y) dy="0.32em" text-anchor="end" { (label) }
                }
                @for (value, label) in self.x.ticks() {
                    @let x = coordinate(self.point(value, 0.0)[0]);
                    line class="axis" x1=(x) x2=(x) y1=(bottom) y2=(bottom + 4.0) {}
                    text class="tick" x=(x) y=(bottom + 16.0) text-anchor="middle" { (label) }
                }
                line class="axis" x1=(LEFT) x2=(right) y1=(bottom) y2=(bottom) {}
                (inner)
                text class="label" x=((LEFT + right) / 2.0) y=(HEIGHT - 8.0) text-anchor="middle" { (x_label) }
                text class="label" transform=(format!("translate(13 {}) rotate(-90)", (TOP + bottom) / 2.0))
                    text-anchor="middle" { (y_label) }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_end_on_ticks() {
        let axis = PlotAxis::over([0.13, 4.71].into_iter(), false);
        let labels: Vec<String> = axis.ticks().into_iter().map(|(_, label)| label).collect();
        assert_eq!((axis.low, axis.high), (0.0, 5.0));
        assert_eq!(labels, ["0", "1", "2", "3", "4", "5"]);
    }

    #[test]
    fn logarithmic_axes_tick_at_powers_of_ten() {
        let axis = PlotAxis::over([0.002, 80.0, f64::NAN, 0.0].into_iter(), true);
        let ticks: Vec<String> = axis.ticks().into_iter().map(|(_, label)| label).collect();
        assert_eq!(ticks, ["0.01", "0.1", "1", "10"]);
        assert!((axis.share(0.002)).abs() < 1e-12 && (axis.share(80.0) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn degenerate_data_still_has_an_axis() {
        for values in [vec![], vec![3.0], vec![0.0; 4]] {
            let axis = PlotAxis::over(values.into_iter(), false);
            assert!(axis.high > axis.low && axis.ticks().len() >= 2, "{axis:?}");
        }
    }
}
