//! How are charts and scenes drawn? Inline SVG whose colors tell apart for color-blind eyes and whose lines differ in more than color.

mod axes;
mod bars;
mod histogram;
mod line;
mod scene;

pub(super) use bars::{Bar, bar_chart};
pub(super) use histogram::histogram;
pub(super) use line::line_chart;
pub(super) use scene::{role_color, scene_panel};

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
