//! Charts and scenes as inline SVG, with colors for color-blind readers and lines that differ in more than color.

mod axes;
mod bars;
mod file;
mod histogram;
mod line;
mod rates;
mod scene;

pub(super) use bars::{Bar, bar_chart};
pub(super) use file::{chart_file, distribution_file, scene_file};
pub(super) use histogram::{histogram, histogram_plot};
pub(super) use line::{line_chart, line_plot};
pub(super) use rates::{RateMark, rate_chart};
pub(super) use scene::{CONTEXT, GENERATED_CONTEXT, role_color, scene_panel};

use super::number::coordinate;

/// Okabe and Ito's palette without its yellow, which is too light on white; the order keeps neighbors far apart.
const PALETTE: [&str; 7] = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000"];

/// Dash patterns that go with the palette, so that curves can be told apart without color.
const DASHES: [&str; 7] = ["none", "7 3", "2 2", "9 3 2 3", "4 4", "12 3", "1 3"];

/// The color of the i-th series.
fn color(i: usize) -> &'static str {
    PALETTE[i % PALETTE.len()]
}

/// The dash pattern of the i-th series.
fn dash(i: usize) -> &'static str {
    DASHES[i % DASHES.len()]
}

/// The `d` attribute of the mark of the i-th series around a point: a disk, a square, a triangle, a diamond.
fn marker(i: usize, [x, y]: [f64; 2]) -> String {
    let [x, y] = [x, y].map(coordinate);
    let shape = match i % 4 {
        0 => "m-2.6 0a2.6 2.6 0 1 0 5.2 0a2.6 2.6 0 1 0 -5.2 0",
        1 => "m-2.5 -2.5h5v5h-5",
        2 => "m0 -3.2l3 5.2h-6",
        _ => "m0 -3.4l3.4 3.4l-3.4 3.4l-3.4 -3.4",
    };
    format!("M{x} {y}{shape}Z")
}

/// The `d` attribute of an open path through points.
fn path(points: impl IntoIterator<Item = [f64; 2]>) -> String {
    let mut d = String::new();
    for [x, y] in points {
        d.push(if d.is_empty() { 'M' } else { 'L' });
        d.push_str(&coordinate(x));
        d.push(' ');
        d.push_str(&coordinate(y));
    }
    d
}
