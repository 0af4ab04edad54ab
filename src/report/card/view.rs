//! The part of the ground in a drawing.

use crate::geometry::Vec2;
use crate::scene::{Roles, Scene};

/// The margin around the tracks of interest, meters.
const MARGIN_M: f64 = 9.0;
/// The least extent of a view in each direction, meters.
const MIN_VIEW_M: Vec2 = Vec2 { x: 60.0, y: 20.0 };

/// An axis-parallel part of the scene frame, meters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewRect {
    /// Least coordinates.
    pub min: [f64; 2],
    /// Greatest coordinates.
    pub max: [f64; 2],
}

impl ViewRect {
    /// The view around the tracks of `roles` in all of `scenes`, which share a frame; around all tracks without roles.
    pub(super) fn around(scenes: &[&Scene], roles: &Roles) -> Self {
        let mut points: Vec<Vec2> = Vec::new();
        for track in scenes.iter().flat_map(|scene| &scene.tracks) {
            if roles.is_empty() || roles.role_of(&track.id).is_some() {
                points.extend(track.trajectory.valid().map(|(_, state)| state.position).filter(|p| p.is_finite()));
            }
        }
        let Some(first) = points.first().copied() else {
            return Self {
                min: [-MIN_VIEW_M.x / 2.0, -MIN_VIEW_M.y / 2.0],
                max: [MIN_VIEW_M.x / 2.0, MIN_VIEW_M.y / 2.0],
            };
        };
        let (mut min, mut max) = ([first.x, first.y], [first.x, first.y]);
        for point in points {
            min = [min[0].min(point.x), min[1].min(point.y)];
            max = [max[0].max(point.x), max[1].max(point.y)];
        }
        for (axis, least) in [MIN_VIEW_M.x, MIN_VIEW_M.y].into_iter().enumerate() {
            let missing = ((least - (max[axis] - min[axis])) / 2.0).max(MARGIN_M);
            min[axis] = (min[axis] - missing).floor();
            max[axis] = (max[axis] + missing).ceil();
        }
        Self { min, max }
    }

    /// Whether drawings of it fit better one below the other than side by side.
    pub fn is_long(&self) -> bool {
        let [width, height] = self.size();
        width > 1.6 * height
    }

    /// Width and height, meters.
    pub fn size(&self) -> [f64; 2] {
        [self.max[0] - self.min[0], self.max[1] - self.min[1]]
    }

    pub(super) fn contains(&self, x: f64, y: f64) -> bool {
        (self.min[0]..=self.max[0]).contains(&x) && (self.min[1]..=self.max[1]).contains(&y)
    }

    /// Whether the bounding box of `points` reaches into the view.
    pub(super) fn touches(&self, points: &[[f64; 2]]) -> bool {
        !points.is_empty()
            && (0..2).all(|axis| {
                points.iter().any(|p| p[axis] <= self.max[axis]) && points.iter().any(|p| p[axis] >= self.min[axis])
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{self, Drive};

    #[test]
    fn the_view_follows_the_roles_and_is_never_too_small() {
        // The ego drives 1.1 s at 85 m/s along x: 93.5 m; the other one stands 400 m away.
        let scene = testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 85.0), Drive::straight(400.0, 0.0, 0.0, 0.0)]);
        let view = ViewRect::around(&[&scene], &Roles::from([("ego", "1")]));
        assert_eq!((view.min, view.max), ([-9.0, -10.0], [103.0, 10.0]));
        assert!(view.contains(50.0, 5.0) && !view.contains(400.0, 0.0));
        assert!(view.touches(&[[-50.0, 0.0], [200.0, 0.0]]) && !view.touches(&[[-50.0, 11.0], [200.0, 12.0]]));
        let all = ViewRect::around(&[&scene], &Roles::default());
        assert_eq!((all.min, all.max), ([-9.0, -10.0], [409.0, 10.0]));
    }
}
