//! Where do vehicles drive at a place, whatever its lanes are?

use crate::geometry::Vec2;
use crate::scene::Scene;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// The side of a cell, meters.
const CELL_M: f64 = 1.0;
/// Cells whose middle is this close to where the center of a vehicle was, meters, are driven on: most of the
/// half width of a lane.
const HALF_WIDTH_M: f64 = 1.5;

/// The cells of the recording's frame that centers of vehicles come near.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct DrivenArea(BTreeSet<[i32; 2]>);

impl DrivenArea {
    /// The area with the way of these agents of a recorded scene.
    #[must_use]
    pub(super) fn with(mut self, scene: &Scene, agents: impl Iterator<Item = usize>) -> Self {
        for agent_idx in agents {
            let mut last: Option<Vec2> = None;
            for (_, state) in scene.tracks[agent_idx].trajectory.valid() {
                let here = scene.world_from_scene.point(state.position);
                if !here.is_finite() {
                    last = None;
                    continue;
                }
                let moved_m = last.map_or(f64::INFINITY, |last| here.distance(last));
                if moved_m < CELL_M / 2.0 {
                    continue;
                }
                // Between two timesteps, too, but not across a gap.
                let n = if moved_m < 5.0 { (moved_m / CELL_M).ceil() as usize } else { 1 };
                let from = last.filter(|_| n > 1).unwrap_or(here);
                (1..=n).for_each(|i| self.add(from.lerp(here, i as f64 / n as f64)));
                last = Some(here);
            }
        }
        self
    }

    fn add(&mut self, point: Vec2) {
        let range = |v: f64| {
            let cell = |v: f64| (v / CELL_M - 0.5).round() as i32;
            cell(v - HALF_WIDTH_M)..=cell(v + HALF_WIDTH_M)
        };
        let middle = |cell: i32| (f64::from(cell) + 0.5) * CELL_M;
        for x in range(point.x) {
            let near = range(point.y).filter(|y| Vec2::new(middle(x), middle(*y)).distance(point) <= HALF_WIDTH_M);
            self.0.extend(near.map(|y| [x, y]));
        }
    }

    /// What belongs to either area.
    #[must_use]
    pub fn joined(mut self, other: Self) -> Self {
        self.0.extend(other.0);
        self
    }

    /// The distance of a point in the recording's frame from the area, meters; 0 within. NaN if the point is NaN.
    pub(super) fn distance_m(&self, point: Vec2) -> f64 {
        if !point.is_finite() {
            return f64::NAN;
        }
        let cell = [point.x, point.y].map(|v| (v / CELL_M).floor() as i32);
        if self.0.contains(&cell) {
            return 0.0;
        }
        let beyond_m =
            |v: f64, cell: i32| (f64::from(cell) * CELL_M - v).max(v - f64::from(cell + 1) * CELL_M).max(0.0);
        let distances = self.0.iter().map(|[x, y]| beyond_m(point.x, *x).hypot(beyond_m(point.y, *y)));
        distances.fold(f64::INFINITY, f64::min)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{Drive, scene};

    #[test]
    fn the_way_of_a_vehicle_is_as_wide_as_most_of_a_lane_and_has_no_gaps() {
        let scene = scene(&[Drive::straight(0.0, 0.0, 0.0, 12.0), Drive::straight(0.0, 40.0, 0.0, 0.0)]);
        let area = DrivenArea::default().with(&scene, 0..2);
        let states = scene.tracks[0].trajectory.valid();
        let way: Vec<Vec2> = states.map(|(_, state)| scene.world_from_scene.point(state.position)).collect();
        let across = scene.world_from_scene.point(Vec2::new(0.0, 1.0)) - scene.world_from_scene.point(Vec2::ZERO);
        for pair in way.windows(2) {
            for part in [0.0, 0.25, 0.5, 0.75] {
                let on = pair[0].lerp(pair[1], part);
                assert_eq!([on, on + across * 0.7].map(|point| area.distance_m(point)), [0.0; 2]);
                // Cells stick out by at most half of their diagonal.
                let aside_m = area.distance_m(on + across * 6.0);
                assert!((6.0 - HALF_WIDTH_M - 0.71..=6.0 - HALF_WIDTH_M + 0.5).contains(&aside_m), "{aside_m}");
            }
        }
        let stood = scene.world_from_scene.point(Vec2::new(0.0, 40.0));
        assert_eq!(area.distance_m(stood), 0.0);
        assert!(area.distance_m(Vec2::new(f64::NAN, 0.0)).is_nan());
        assert_eq!(DrivenArea::default().distance_m(stood), f64::INFINITY);
        let read: DrivenArea = serde_json::from_str(&serde_json::to_string(&area).unwrap()).unwrap();
        assert_eq!((read.clone(), read.joined(area.clone())), (area.clone(), area));
    }
}
