//! Paths through the plane: length, points along them, projection onto them, resampling.

use super::Vec2;

/// An ordered series of points.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Polyline(pub Vec<Vec2>);

/// The projection of a point onto a polyline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projection {
    /// Distance along the polyline to the closest point, meters.
    pub station_m: f64,
    /// Signed distance from the polyline, meters; positive to its left.
    pub offset_m: f64,
    /// Direction of the polyline there, radians.
    pub heading_rad: f64,
    /// The closest point itself.
    pub point: Vec2,
}

impl Polyline {
    /// Length, meters.
    pub fn length_m(&self) -> f64 {
        self.lengths_m().sum()
    }

    fn lengths_m(&self) -> impl Iterator<Item = f64> {
        self.0.windows(2).map(|pair| pair[0].distance(pair[1]))
    }

    /// The point `station_m` along the polyline, held at its ends. `None` when there are no points.
    pub fn point_at(&self, station_m: f64) -> Option<Vec2> {
        self.point_along(self.lengths_m(), station_m)
    }

    /// The point `station_m` along the polyline, whose segments have these lengths.
    fn point_along(&self, lengths_m: impl Iterator<Item = f64>, station_m: f64) -> Option<Vec2> {
        let mut left_m = station_m.max(0.0);
        for (pair, length_m) in self.0.windows(2).zip(lengths_m) {
            if left_m <= length_m && length_m > 0.0 {
                return Some(pair[0].lerp(pair[1], left_m / length_m));
            }
            left_m -= length_m;
        }
        self.0.last().copied()
    }

    /// `n_points` points at equal distances from the first to the last. Empty when there are no points or `n_points`
    /// is 0.
    pub fn resampled(&self, n_points: usize) -> Self {
        // Their roots would take most of the time.
        let lengths_m: Vec<f64> = self.lengths_m().collect();
        let spacing_m = lengths_m.iter().sum::<f64>() / (n_points.max(2) - 1) as f64;
        let point = |i: usize| self.point_along(lengths_m.iter().copied(), i as f64 * spacing_m);
        Self((0..n_points).filter_map(point).collect())
    }

    /// The closest point of the polyline to `point`. `None` with fewer than two distinct points.
    pub fn project(&self, point: Vec2) -> Option<Projection> {
        // Roots and angles are taken of the closest segment alone: this runs for every agent, timestep and lane.
        let mut best: Option<(usize, Foot)> = None;
        for i in 0..self.0.len().saturating_sub(1) {
            let Some(foot) = self.foot(i, point) else { continue };
            if best.is_none_or(|(_, least)| foot.distance_squared < least.distance_squared) {
                best = Some((i, foot));
            }
        }
        let (i, foot) = best?;
        Some(self.projection(point, i, foot, self.0[..=i].windows(2).map(|pair| pair[0].distance(pair[1])).sum()))
    }

    /// The point of a segment that is closest to `point`. `None` if it has no length.
    pub(super) fn foot(&self, segment: usize, point: Vec2) -> Option<Foot> {
        let (along, from_start) = (self.0[segment + 1] - self.0[segment], point - self.0[segment]);
        let length_squared = along.norm_squared();
        if length_squared == 0.0 {
            return None;
        }
        let share = (along.dot(from_start) / length_squared).clamp(0.0, 1.0);
        Some(Foot { distance_squared: (from_start - along * share).norm_squared(), share })
    }

    /// The projection onto a segment that begins after `before_m`.
    pub(super) fn projection(&self, point: Vec2, segment: usize, foot: Foot, before_m: f64) -> Projection {
        let (start, along) = (self.0[segment], self.0[segment + 1] - self.0[segment]);
        let offset_m = foot.distance_squared.sqrt();
        Projection {
            station_m: before_m + along.norm() * foot.share,
            offset_m: if along.cross(point - start) < 0.0 { -offset_m } else { offset_m },
            heading_rad: along.angle(),
            point: start + along * foot.share,
        }
    }
}

/// The point of a segment that is closest to another point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Foot {
    pub(super) distance_squared: f64,
    /// The share of the segment before it.
    share: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corner() -> Polyline {
        Polyline(vec![Vec2::new(0.0, 0.0), Vec2::new(10.0, 0.0), Vec2::new(10.0, 10.0)])
    }

    #[test]
    fn resampling_keeps_ends_and_spacing() {
        let resampled = corner().resampled(5);
        assert_eq!(resampled.0.len(), 5);
        assert_eq!(resampled.0[0], Vec2::new(0.0, 0.0));
        assert!(resampled.0[2].distance(Vec2::new(10.0, 0.0)) < 1e-12);
        assert!(resampled.0[4].distance(Vec2::new(10.0, 10.0)) < 1e-12);
    }

    #[test]
    fn projection_has_station_and_side() {
        let p = corner().project(Vec2::new(9.0, 4.0)).expect("two segments");
        assert!((p.station_m - 14.0).abs() < 1e-12 && (p.offset_m - 1.0).abs() < 1e-12);
        let p = corner().project(Vec2::new(4.0, -2.0)).expect("two segments");
        assert!((p.station_m - 4.0).abs() < 1e-12 && (p.offset_m + 2.0).abs() < 1e-12);
    }

    #[test]
    fn degenerate_lines_project_nowhere() {
        assert!(Polyline(vec![Vec2::ZERO, Vec2::ZERO]).project(Vec2::ZERO).is_none());
        assert!(Polyline::default().point_at(1.0).is_none());
    }
}
