//! An agent's box, prepared for many tests: do two boxes overlap, and how far apart are they?

use super::{OrientedBox, Vec2};

/// An axis-aligned rectangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Bounds {
    min: Vec2,
    max: Vec2,
}

impl Bounds {
    /// The smallest rectangle around both.
    pub(crate) fn union(self, other: Self) -> Self {
        Self {
            min: Vec2::new(self.min.x.min(other.min.x), self.min.y.min(other.min.y)),
            max: Vec2::new(self.max.x.max(other.max.x), self.max.y.max(other.max.y)),
        }
    }

    /// The smallest rectangle around `points`. `None` when there are none.
    pub(crate) fn around(points: impl IntoIterator<Item = Vec2>) -> Option<Self> {
        points.into_iter().map(|point| Self { min: point, max: point }).reduce(Self::union)
    }

    /// Whether the gaps between the rectangles along x and along y are both at most `gap_m`. If not, anything in one is
    /// farther than `gap_m` from anything in the other.
    pub(crate) fn is_within(&self, other: &Self, gap_m: f64) -> bool {
        self.min.x - other.max.x <= gap_m
            && other.min.x - self.max.x <= gap_m
            && self.min.y - other.max.y <= gap_m
            && other.min.y - self.max.y <= gap_m
    }

    /// Whether `point` lies in the rectangle grown by `margin_m` on every side.
    pub(crate) fn contains(&self, point: Vec2, margin_m: f64) -> bool {
        self.is_within(&Self { min: point, max: point }, margin_m)
    }
}

/// An [`OrientedBox`] with its direction, corners and bounds computed once. Mining tests each box against
/// hundreds of others, and trigonometry would take most of that time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Footprint {
    /// Center, meters.
    pub(crate) center: Vec2,
    /// Unit vector along the heading.
    pub(crate) forward: Vec2,
    /// Half the side along the heading, meters.
    pub(crate) half_length_m: f64,
    /// Half the side across the heading, meters.
    pub(crate) half_width_m: f64,
    /// Half the diagonal, meters.
    pub(crate) radius_m: f64,
    /// The corners, in the order of [`OrientedBox::corners`].
    pub(crate) corners: [Vec2; 4],
    /// The axis-aligned rectangle around the box.
    pub(crate) bounds: Bounds,
}

impl Footprint {
    pub(crate) fn new(oriented_box: &OrientedBox) -> Self {
        let OrientedBox { center, heading_rad, length_m, width_m } = *oriented_box;
        Self::along(center, Vec2::from_angle(heading_rad), [length_m, width_m])
    }

    /// Prepares a box of this length and width along the unit vector `forward`.
    pub(crate) fn along(center: Vec2, forward: Vec2, [length_m, width_m]: [f64; 2]) -> Self {
        let (half_length_m, half_width_m) = (length_m / 2.0, width_m / 2.0);
        let (ahead, left) = (forward * half_length_m, forward.left() * half_width_m);
        let corners = [center + ahead + left, center - ahead + left, center - ahead - left, center + ahead - left];
        let [first, rest @ ..] = corners.map(|corner| Bounds { min: corner, max: corner });
        Self {
            center,
            forward,
            half_length_m,
            half_width_m,
            radius_m: Vec2::new(half_length_m, half_width_m).norm(),
            corners,
            bounds: rest.into_iter().fold(first, Bounds::union),
        }
    }

    /// Distance between the centers, squared, in m².
    fn center_distance_squared(&self, other: &Self) -> f64 {
        (other.center - self.center).norm_squared()
    }

    /// Whether the two boxes share a point (separating-axis test). Touching boxes overlap.
    pub(crate) fn overlaps(&self, other: &Self) -> bool {
        let reach = self.radius_m + other.radius_m;
        if self.center_distance_squared(other) > reach * reach {
            return false;
        }
        let between = other.center - self.center;
        let cos = self.forward.dot(other.forward).abs();
        let sin = self.forward.cross(other.forward).abs();
        between.dot(self.forward).abs() <= self.half_length_m + other.half_length_m * cos + other.half_width_m * sin
            && self.forward.cross(between).abs()
                <= self.half_width_m + other.half_length_m * sin + other.half_width_m * cos
            && between.dot(other.forward).abs()
                <= other.half_length_m + self.half_length_m * cos + self.half_width_m * sin
            && other.forward.cross(between).abs()
                <= other.half_width_m + self.half_length_m * sin + self.half_width_m * cos
    }

    /// Smallest distance between the two boxes, meters; 0 when they overlap.
    pub(crate) fn distance_m(&self, other: &Self) -> f64 {
        if self.overlaps(other) {
            return 0.0;
        }
        // Two disjoint convex polygons are closest at a corner of one of them.
        let from_other = other.corners.iter().map(|corner| self.distance_squared_to(*corner));
        let from_self = self.corners.iter().map(|corner| other.distance_squared_to(*corner));
        from_other.chain(from_self).fold(f64::INFINITY, f64::min).sqrt()
    }

    /// Whether the two boxes are less than `limit_m` apart; never at a limit of 0, since boxes that overlap are 0
    /// apart.
    pub(crate) fn is_closer_than(&self, other: &Self, limit_m: f64) -> bool {
        if limit_m <= 0.0 {
            return false;
        }
        let between = self.center_distance_squared(other);
        let far = limit_m + self.radius_m + other.radius_m;
        if between >= far * far {
            return false;
        }
        // The circles inscribed in the boxes are never closer than the boxes.
        let near = limit_m + self.inner_radius_m() + other.inner_radius_m();
        between < near * near || self.distance_m(other) < limit_m
    }

    /// A lower bound of the distance between the two boxes, meters: the distance between the circles around them.
    pub(crate) fn distance_lower_bound_m(&self, other: &Self) -> f64 {
        self.center_distance_squared(other).sqrt() - self.radius_m - other.radius_m
    }

    fn inner_radius_m(&self) -> f64 {
        self.half_length_m.min(self.half_width_m)
    }

    /// Squared distance from the box to a point, in m²; 0 inside.
    fn distance_squared_to(&self, point: Vec2) -> f64 {
        let from_center = point - self.center;
        let along = (from_center.dot(self.forward).abs() - self.half_length_m).max(0.0);
        let across = (self.forward.cross(from_center).abs() - self.half_width_m).max(0.0);
        Vec2::new(along, across).norm_squared()
    }

    /// Half the extent of the box along the unit vector `axis`, meters.
    pub(crate) fn half_extent_m(&self, axis: Vec2) -> f64 {
        self.forward.dot(axis).abs() * self.half_length_m + self.forward.cross(axis).abs() * self.half_width_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_box() -> impl Strategy<Value = OrientedBox> {
        (-9.0..9.0f64, -9.0..9.0f64, -4.0..4.0f64, 0.5..12.0f64, 0.5..3.0f64).prop_map(
            |(x, y, h, length_m, width_m)| OrientedBox { center: Vec2::new(x, y), heading_rad: h, length_m, width_m },
        )
    }

    proptest! {
        #[test]
        fn bounds_of_distances_hold(
            a in any_box(),
            b in any_box(),
            limit_m in prop_oneof![Just(0.0), 0.1..6.0f64],
        ) {
            let (fa, fb) = (Footprint::new(&a), Footprint::new(&b));
            let distance_m = fa.distance_m(&fb);
            prop_assert_eq!(fa.is_closer_than(&fb, limit_m), distance_m < limit_m);
            prop_assert!(fa.distance_lower_bound_m(&fb) <= distance_m + 1e-9);
            prop_assert!(fa.bounds.is_within(&fb.bounds, distance_m + 1e-9));
        }

        #[test]
        fn bounds_and_extents_hold_the_corners(a in any_box(), angle in -4.0..4.0f64) {
            let footprint = Footprint::new(&a);
            let axis = Vec2::from_angle(angle);
            let reach = a.corners().iter().map(|c| (*c - a.center).dot(axis)).fold(f64::MIN, f64::max);
            prop_assert!((footprint.half_extent_m(axis) - reach).abs() < 1e-9);
            prop_assert!(a.corners().iter().all(|corner| footprint.bounds.contains(*corner, 1e-9)));
        }
    }

    #[test]
    fn bounds_measure_gaps_per_axis() {
        let at = |x: f64, y: f64| Bounds { min: Vec2::new(x, y), max: Vec2::new(x + 1.0, y + 1.0) };
        assert!(at(0.0, 0.0).is_within(&at(3.0, 0.0), 2.0));
        assert!(!at(0.0, 0.0).is_within(&at(3.0, 0.0), 1.9));
        assert!(!at(0.0, 0.0).is_within(&at(0.0, -3.0), 1.9));
        assert!(at(0.0, 0.0).contains(Vec2::new(1.5, 0.5), 0.6) && !at(0.0, 0.0).contains(Vec2::new(1.5, 0.5), 0.4));
    }
}
