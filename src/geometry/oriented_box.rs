//! Rectangles with a heading: overlap and distance.

use super::Vec2;
use super::footprint::Footprint;

/// A rectangle with its center, heading and side lengths, such as a vehicle seen from above.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrientedBox {
    /// Center, meters.
    pub center: Vec2,
    /// Direction of the long side, radians.
    pub heading_rad: f64,
    /// Side along the heading, meters.
    pub length_m: f64,
    /// Side across the heading, meters.
    pub width_m: f64,
}

impl OrientedBox {
    /// The corners: front left, rear left, rear right, front right (counter-clockwise).
    pub fn corners(&self) -> [Vec2; 4] {
        Footprint::new(self).corners
    }

    /// Half the diagonal: no point of the box is farther from its center.
    pub fn radius(&self) -> f64 {
        Vec2::new(self.length_m, self.width_m).norm() / 2.0
    }

    /// Whether `point` lies in the box or on its edge.
    pub fn contains(&self, point: Vec2) -> bool {
        let local = (point - self.center).rotated(-self.heading_rad);
        local.x.abs() <= self.length_m / 2.0 && local.y.abs() <= self.width_m / 2.0
    }

    /// Whether the two boxes share a point (separating-axis test). Touching boxes overlap.
    pub fn overlaps(&self, other: &Self) -> bool {
        let between = other.center - self.center;
        if between.norm() > self.radius() + other.radius() {
            return false;
        }
        Footprint::new(self).overlaps(&Footprint::new(other))
    }

    /// Smallest distance between the two boxes, meters; 0 when they overlap.
    pub fn distance(&self, other: &Self) -> f64 {
        Footprint::new(self).distance_m(&Footprint::new(other))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn car(x: f64, y: f64, heading_rad: f64) -> OrientedBox {
        OrientedBox { center: Vec2::new(x, y), heading_rad, length_m: 4.0, width_m: 2.0 }
    }

    #[test]
    fn known_distances() {
        assert!((car(0.0, 0.0, 0.0).distance(&car(7.0, 0.0, 0.0)) - 3.0).abs() < 1e-12);
        assert!((car(0.0, 0.0, 0.0).distance(&car(0.0, 5.0, 0.0)) - 3.0).abs() < 1e-12);
        assert!((car(0.0, 0.0, 0.0).distance(&car(7.0, 6.0, 0.0)) - 5.0).abs() < 1e-12);
        assert!(car(0.0, 0.0, 0.0).overlaps(&car(2.9, 0.0, std::f64::consts::FRAC_PI_2)));
        assert!(!car(0.0, 0.0, 0.0).overlaps(&car(3.1, 0.0, std::f64::consts::FRAC_PI_2)));
    }

    proptest! {
        #[test]
        fn overlap_is_symmetric_and_means_no_distance(x in -8.0..8.0f64, y in -8.0..8.0f64, h in -3.0..3.0f64) {
            let (a, b) = (car(0.0, 0.0, 0.4), car(x, y, h));
            prop_assert_eq!(a.overlaps(&b), b.overlaps(&a));
            prop_assert!((a.distance(&b) - b.distance(&a)).abs() < 1e-9);
            prop_assert_eq!(a.overlaps(&b), a.distance(&b) == 0.0);
        }

        #[test]
        fn a_contained_corner_means_overlap(x in -4.0..4.0f64, y in -4.0..4.0f64, h in -3.0..3.0f64) {
            let (a, b) = (car(0.0, 0.0, 0.4), car(x, y, h));
            if b.corners().into_iter().any(|corner| a.contains(corner)) {
                prop_assert!(a.overlaps(&b));
            }
        }
    }
}
