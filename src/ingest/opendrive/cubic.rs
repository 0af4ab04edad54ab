//! The piecewise cubic functions of a road: widths and offsets of lanes.

use crate::ingest::error::Malformed;
use crate::ingest::xml_tree::Element;

/// a + b d + c d² + d d³ of the distance d from `start_m`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cubic {
    pub(super) start_m: f64,
    pub(super) coefficients: [f64; 4],
}

impl Cubic {
    /// The function of an element that has its start in the attribute `start`.
    pub(super) fn of(element: &Element, start: &str) -> Result<Self, Malformed> {
        let mut coefficients = [0.0; 4];
        for (coefficient, name) in coefficients.iter_mut().zip(["a", "b", "c", "d"]) {
            *coefficient = element.float(name, Some(0.0))?;
        }
        Ok(Self { start_m: element.float(start, Some(0.0))?, coefficients })
    }
}

/// a + b x + c x² + d x³.
pub(super) fn cubic([a, b, c, d]: [f64; 4], x: f64) -> f64 {
    a + x * (b + x * (c + x * d))
}

pub(super) fn cubic_slope([_, b, c, d]: [f64; 4], x: f64) -> f64 {
    b + x * (2.0 * c + x * 3.0 * d)
}

/// The value at `s_m` of functions by ascending start: that of the last one that has begun; before the first, 0.
pub(super) fn value_at(functions: &[Cubic], s_m: f64) -> f64 {
    begun(functions, s_m).map_or(0.0, |function| cubic(function.coefficients, s_m - function.start_m))
}

/// The largest second derivative between two distances, if no function begins between them.
pub(super) fn bend_between(functions: &[Cubic], [from_m, to_m]: [f64; 2]) -> f64 {
    begun(functions, 0.5 * (from_m + to_m)).map_or(0.0, |function| {
        let [_, _, c, d] = function.coefficients;
        let bend = |s_m: f64| (2.0 * c + 6.0 * d * (s_m - function.start_m)).abs();
        bend(from_m).max(bend(to_m))
    })
}

fn begun(functions: &[Cubic], s_m: f64) -> Option<&Cubic> {
    let n_begun = functions.partition_point(|function| function.start_m <= s_m);
    n_begun.checked_sub(1).and_then(|last| functions.get(last))
}
