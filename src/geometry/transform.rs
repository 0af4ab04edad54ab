//! Rigid transforms between frames, named `a_from_b`.

use super::{Vec2, wrap_angle};

/// A rigid transform of the plane. `a_from_b` takes coordinates in frame `b` to frame `a`: rotate, then translate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transform2 {
    /// The origin of `b` in `a`, meters.
    pub translation: Vec2,
    rotation_rad: f64,
    /// The x axis of `b` in `a`: sines and cosines are taken once.
    along: Vec2,
}

impl Transform2 {
    /// The transform that changes nothing.
    pub const IDENTITY: Self = Self { translation: Vec2::ZERO, rotation_rad: 0.0, along: Vec2::new(1.0, 0.0) };

    /// The transform from the frame of a body at `position` with `heading_rad` to the frame these are given in.
    pub fn from_pose(position: Vec2, heading_rad: f64) -> Self {
        Self { translation: position, rotation_rad: heading_rad, along: Vec2::from_angle(heading_rad) }
    }

    /// Direction of the x axis of `b` in `a`, radians.
    pub const fn rotation_rad(&self) -> f64 {
        self.rotation_rad
    }

    /// Transforms a point.
    pub fn point(&self, point: Vec2) -> Vec2 {
        self.vector(point) + self.translation
    }

    /// Transforms a displacement or velocity: rotation only.
    pub fn vector(&self, vector: Vec2) -> Vec2 {
        let Vec2 { x: cos, y: sin } = self.along;
        Vec2::new(cos * vector.x - sin * vector.y, sin * vector.x + cos * vector.y)
    }

    /// Transforms a heading; the result lies in (-π, π].
    pub fn heading(&self, heading_rad: f64) -> f64 {
        wrap_angle(heading_rad + self.rotation_rad)
    }

    /// `b_from_a` for `self` = `a_from_b`.
    pub fn inverse(&self) -> Self {
        let rotation_rad = wrap_angle(-self.rotation_rad);
        Self::from_pose((-self.translation).rotated(-self.rotation_rad), rotation_rad)
    }

    /// `a_from_c` for `self` = `a_from_b` and `b_from_c`.
    pub fn compose(&self, b_from_c: &Self) -> Self {
        let rotation_rad = wrap_angle(self.rotation_rad + b_from_c.rotation_rad);
        Self::from_pose(self.point(b_from_c.translation), rotation_rad)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn transform() -> impl Strategy<Value = Transform2> {
        (-1e4..1e4f64, -1e4..1e4f64, -4.0..4.0f64)
            .prop_map(|(x, y, r)| Transform2::from_pose(Vec2::new(x, y), wrap_angle(r)))
    }

    proptest! {
        #[test]
        fn inverse_undoes(t in transform(), x in -1e4..1e4f64, y in -1e4..1e4f64) {
            let p = Vec2::new(x, y);
            prop_assert!(t.inverse().point(t.point(p)).distance(p) < 1e-7);
        }

        #[test]
        fn composition_is_application_in_turn(
            a in transform(),
            b in transform(),
            x in -1e3..1e3f64,
            y in -1e3..1e3f64,
        ) {
            let p = Vec2::new(x, y);
            prop_assert!(a.compose(&b).point(p).distance(a.point(b.point(p))) < 1e-7);
        }
    }
}
