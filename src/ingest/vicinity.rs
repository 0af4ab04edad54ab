//! Which coordinates belong together: those around their middle, wherever the origin of their frame is.

use super::error::Malformed;
use crate::geometry::Vec2;
use crate::settings::in_words;

/// The farthest middle, meters: grids of countries put a zone before their eastings, and double precision still has
/// micrometers there.
const MAX_MIDDLE_M: f64 = 1e8;

/// Places are within kilometers of their middle, meters.
const MAX_FROM_MIDDLE_M: f64 = 1e6;

/// The points within [`MAX_FROM_MIDDLE_M`] of the middle of a map or a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Vicinity {
    middle: Vec2,
}

impl Vicinity {
    const OF_ORIGIN: Self = Self { middle: Vec2::ZERO };

    /// Around the origin if all points are there, otherwise around their median, whatever a few of them are.
    pub(super) fn of<I: Iterator<Item = Vec2>>(points: impl Fn() -> I) -> Self {
        if points().all(|at| Self::OF_ORIGIN.holds(at)) {
            return Self::OF_ORIGIN;
        }
        let (mut x, mut y): (Vec<f64>, Vec<f64>) = points().filter(|at| at.is_finite()).map(|at| (at.x, at.y)).unzip();
        let median = |of: &mut Vec<f64>| {
            let half = of.len().saturating_sub(1) / 2;
            if of.is_empty() { 0.0 } else { *of.select_nth_unstable_by(half, f64::total_cmp).1 }
        };
        let middle = Vec2::new(median(&mut x), median(&mut y));
        if middle.x.abs().max(middle.y.abs()) <= MAX_MIDDLE_M { Self { middle } } else { Self::OF_ORIGIN }
    }

    pub(super) fn holds(&self, at: Vec2) -> bool {
        let from_middle = at - self.middle;
        at.is_finite() && from_middle.x.abs().max(from_middle.y.abs()) <= MAX_FROM_MIDDLE_M
    }

    /// The point, if it belongs to the others.
    pub(super) fn checked(&self, at: Vec2) -> Result<Vec2, Malformed> {
        let Vec2 { x, y } = self.middle;
        match self.holds(at) {
            true => Ok(at),
            false => {
                let what = format!("lies at ({}, {})", in_words(at.x), in_words(at.y));
                Err(format!("{what}, expected at most {MAX_FROM_MIDDLE_M} m from ({x}, {y}), around which most lies")
                    .into())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_belong_to_the_middle_of_all() {
        let utm = [
            (691_000.0, 5_335_000.0),
            (691_200.0, 5_336_000.0),
            (1e308, f64::NAN),
            (691_100.0, 5_335_500.0),
            (0.0, 0.0),
            (691_100.0, 5_335_500.0),
        ];
        let vicinity = Vicinity::of(|| utm.into_iter().map(|(x, y)| Vec2::new(x, y)));
        assert_eq!(vicinity.middle, Vec2::new(691_100.0, 5_335_500.0));
        let holds = |x: f64, y: f64| vicinity.holds(Vec2::new(x, y));
        assert!(holds(0.0, 5_000_000.0) && !holds(0.0, 0.0) && !holds(f64::NAN, 5_335_000.0));
        // Most is at a place that does not exist.
        let far = Vicinity::of(|| [Vec2::new(1e300, 0.0)].into_iter());
        assert_eq!(far, Vicinity::of(std::iter::empty));
    }
}
