//! An agent that continues along one of its ways at constant acceleration, until it may brake.

use crate::behavior::footprint::Footprint;
use crate::behavior::maneuver::{Driver, Pace};
use crate::geometry::Vec2;
use crate::scene::Extent;

/// A drive along a rail; one entry per timestep after the present.
pub(super) struct Drive {
    /// The share of the limits of driving that it uses before anybody brakes.
    pub(super) effort: f64,
    /// Distances driven, meters, and speeds, m/s.
    pub(super) driven_m: Vec<f64>,
    pub(super) speeds_mps: Vec<f64>,
    /// Boxes: the whole, which stay apart, and the inner parts.
    pub(super) outer: Vec<Footprint>,
    pub(super) inner: Vec<Footprint>,
}

impl Drive {
    /// The drive along one of an agent's rails at this pace. `extents` are its box and the inner part of the box.
    pub(super) fn new(driver: &Driver, rail: usize, pace: &Pace, (effort, extents): (f64, [Extent; 2])) -> Self {
        let travel = driver.travel(rail, pace);
        let [outer, inner] = extents.map(|extent| driver.boxes(rail, &travel.driven_m, extent));
        Self { effort, driven_m: travel.driven_m, speeds_mps: travel.speeds_mps, outer, inner }
    }

    /// The drive over these positions, at present and at each timestep after it.
    pub(super) fn over(positions: &[Vec2], extents: [Extent; 2], dt_s: f64) -> Self {
        let steps: Vec<Vec2> = positions.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let boxes = |Extent { length_m, width_m }: Extent| {
            let places = positions[1..].iter().zip(&steps);
            places.map(|(at, step)| Footprint::along(*at, step.unit(), [length_m, width_m])).collect()
        };
        let mut driven_m = 0.0;
        let driven = steps.iter().map(|step| {
            driven_m += step.norm();
            driven_m
        });
        let driven_m = driven.collect();
        let [outer, inner] = extents.map(boxes);
        let speeds_mps = steps.iter().map(|step| step.norm() / dt_s).collect();
        Self { effort: 0.0, driven_m, speeds_mps, outer, inner }
    }

    pub(super) fn velocity(&self, step: usize) -> Vec2 {
        self.outer[step].forward * self.speeds_mps[step]
    }

    /// The first step at which the inner parts of the two touch.
    pub(super) fn meets(&self, other: &Self) -> Option<usize> {
        self.inner.iter().zip(&other.inner).position(|(own, others)| own.overlaps(others))
    }

    /// Whether the boxes of the two always stay this far apart.
    pub(super) fn keeps(&self, other: &Self, distance_m: f64) -> bool {
        !self.outer.iter().zip(&other.outer).any(|(own, others)| own.is_closer_than(others, distance_m))
    }
}
