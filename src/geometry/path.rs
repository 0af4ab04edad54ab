//! A polyline for many questions: projections look at few of its segments, and stations are known.

use super::{Polyline, Projection, SegmentIndex, Vec2};

/// A [`Polyline`] with an index of its segments.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    line: Polyline,
    /// The distance along the line to each point, meters.
    stations_m: Vec<f64>,
    index: SegmentIndex,
}

impl Path {
    /// The path through the points of `line`.
    pub fn new(line: Polyline) -> Self {
        let mut stations_m = Vec::with_capacity(line.0.len().max(1));
        stations_m.push(0.0);
        for (i, pair) in line.0.windows(2).enumerate() {
            stations_m.push(stations_m[i] + pair[0].distance(pair[1]));
        }
        let index = SegmentIndex::new(line.0.windows(2).map(|pair| [pair[0], pair[1]]));
        Self { line, stations_m, index }
    }

    /// The same path in the other direction.
    #[must_use]
    pub fn reversed(self) -> Self {
        Self::new(Polyline(self.line.0.into_iter().rev().collect()))
    }

    /// Its points.
    pub fn points(&self) -> &[Vec2] {
        &self.line.0
    }

    /// Length, meters.
    pub fn length_m(&self) -> f64 {
        self.stations_m[self.stations_m.len() - 1]
    }

    /// Whether `point` may be within `reach_m` of the path: quicker than a projection.
    pub fn may_come_within(&self, point: Vec2, reach_m: f64) -> bool {
        self.index.may_come_within(point, reach_m)
    }

    /// The closest point of the path to `point`: exactly [`Polyline::project`].
    pub fn project(&self, point: Vec2) -> Option<Projection> {
        let distance_squared = |i: usize| Some(self.line.foot(i, point)?.distance_squared);
        let (i, _) = self.index.nearest(point, |squared| squared, distance_squared)?;
        Some(self.line.projection(point, i, self.line.foot(i, point)?, self.stations_m[i]))
    }

    /// The point `station_m` along the path, held at its ends, and the direction there, radians. `None` with fewer than
    /// two distinct points.
    pub fn pose_at(&self, station_m: f64) -> Option<(Vec2, f64)> {
        let last = self.stations_m.partition_point(|station| *station < self.length_m());
        let after = self.stations_m.partition_point(|station| *station < station_m).clamp(1, last.max(1));
        // Behind points that coincide with the first.
        let after = after + self.stations_m[after..].iter().take_while(|station| **station <= 0.0).count();
        let (from, to) = (*self.line.0.get(after - 1)?, *self.line.0.get(after)?);
        let length_m = self.stations_m[after] - self.stations_m[after - 1];
        let share = ((station_m - self.stations_m[after - 1]) / length_m).clamp(0.0, 1.0);
        Some((from.lerp(to, share), (to - from).angle()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_path_answers_as_its_polyline_does(
            steps in prop::collection::vec((-3.0..3.0f64, -3.0..3.0f64, 0..4u8), 0..200),
            points in prop::collection::vec((-30.0..30.0f64, -30.0..30.0f64), 1..20),
            station_m in -5.0..200.0f64,
        ) {
            // Loops, points that repeat, and steps on a grid, on which many segments are equally near.
            let mut at = Vec2::new(1e5, -2e5);
            let line = steps.iter().map(|(x, y, kind)| {
                at = at + match kind { 0 => Vec2::ZERO, 1 => Vec2::new(x.round(), y.round()), _ => Vec2::new(*x, *y) };
                at
            });
            let line = Polyline(line.collect());
            let path = Path::new(line.clone());
            for (x, y) in points {
                for point in [Vec2::new(1e5 + x, y - 2e5), Vec2::new(1e5 + x.round(), y.round() - 2e5)] {
                    prop_assert_eq!(path.project(point), line.project(point));
                }
            }
            prop_assert_eq!(path.length_m(), line.length_m());
            if let Some((point, _)) = path.pose_at(station_m) {
                prop_assert!(point.distance(line.point_at(station_m).unwrap()) < 1e-9);
            }
        }
    }
}
