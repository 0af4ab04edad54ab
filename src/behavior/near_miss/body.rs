//! A road user in the analysis of near misses: its box, the inner part of the box, and the path that it drives.

use super::config::{MIN_OVERLAP_M, NearMiss};
use crate::behavior::driven_path::DrivenPath;
use crate::behavior::footprint::Footprint;
use crate::behavior::swept_boxes::SweptBoxes;
use crate::geometry::{OrientedBox, Vec2};
use crate::scene::{Extent, Scene, State, Track};
use std::f64::consts::FRAC_PI_6;

/// Step of the motion of agents along their paths, seconds.
const PATH_STEP_S: f64 = 0.1;
/// An agent that is where another was, with a heading within this of the other's, follows it, radians.
pub(super) const FOLLOWING_RAD: f64 = FRAC_PI_6;

/// One road user.
pub(super) struct Body<'a> {
    pub(super) agent_idx: usize,
    pub(super) track: &'a Track,
    /// Its boxes; of half the nominal size if none is recorded, because whole ones overlap where no agents touch.
    pub(super) outer: SweptBoxes,
    /// The inner parts of the boxes: if these overlap, the agents do more than graze.
    pub(super) inner: SweptBoxes,
    inner_extent: Extent,
    /// The way that it drives over the whole scene.
    path: DrivenPath,
}

impl<'a> Body<'a> {
    /// The agent at this index. `None` if it cannot take part.
    pub(super) fn new(scene: &'a Scene, agent_idx: usize, behavior: &NearMiss) -> Option<Self> {
        let track = &scene.tracks[agent_idx];
        if !track.class.is_road_user() || (behavior.recorded_sizes && track.extent.is_none()) {
            return None;
        }
        let [extent, inner_extent] = extents(track);
        let sweep = |extent: Extent| SweptBoxes::new(&Track { extent: Some(extent), ..track.clone() });
        let (first, _) = track.trajectory.valid().find(|(_, state)| state.is_finite())?;
        Some(Self {
            agent_idx,
            track,
            outer: sweep(extent)?,
            inner: sweep(inner_extent)?,
            inner_extent,
            path: DrivenPath::from(track, first)?,
        })
    }

    pub(super) fn state(&self, timestep: usize) -> Option<&State> {
        self.track.trajectory.get(timestep)
    }

    /// The last timestep at which it is tracked.
    pub(super) fn last_timestep(&self) -> Option<usize> {
        self.track.trajectory.valid().next_back().map(|(timestep, _)| timestep)
    }

    /// Its inner part if it continues from `timestep` along the path that it drives, at its speed at that time.
    fn moved_on(&self, timestep: usize) -> Option<impl Fn(f64) -> OrientedBox> {
        let speed_mps = self.state(timestep)?.speed_mps();
        let path = DrivenPath::from(self.track, timestep)?;
        let Extent { length_m, width_m } = self.inner_extent;
        Some(move |time_s: f64| {
            let (center, heading_rad) = path.pose_at(speed_mps * time_s);
            OrientedBox { center, heading_rad, length_m, width_m }
        })
    }

    /// When the inner parts of the two first touch if both continue along the paths that they drive, at their speeds at
    /// `timestep`, seconds; `None` if they do not within `limit_s`.
    pub(super) fn time_along_paths_s(&self, other: &Self, timestep: usize, limit_s: f64) -> Option<f64> {
        let (own, others) = (self.moved_on(timestep)?, other.moved_on(timestep)?);
        let times_s = (0..=(limit_s / PATH_STEP_S).floor() as usize).map(|step| step as f64 * PATH_STEP_S);
        times_s.into_iter().find(|time_s| own(*time_s).overlaps(&others(*time_s)))
    }

    /// Whether its inner part at `timestep` overlaps that of the other at `later`, and the two cross: on different
    /// courses, and neither along the path that the other drives through this place.
    pub(super) fn crosses(&self, timestep: usize, other: &Self, later: usize) -> bool {
        self.inner.at(timestep).zip(other.inner.at(later)).is_some_and(|(own, others)| {
            own.overlaps(others)
                && is_another_course(own.forward, others.forward)
                && self.is_passed_across(others)
                && other.is_passed_across(own)
        })
    }

    /// Whether an agent there is on a different course than the path that this agent drives through that place.
    fn is_passed_across(&self, place: &Footprint) -> bool {
        let along = self.path.project(place.center).map(|projection| Vec2::from_angle(projection.heading_rad));
        along.is_none_or(|along| is_another_course(along, place.forward))
    }
}

/// The box of an agent, of half the nominal size if none is recorded, and its inner part.
pub(super) fn extents(track: &Track) -> [Extent; 2] {
    let nominal = track.extent_or_nominal();
    let half = Extent { length_m: nominal.length_m / 2.0, width_m: nominal.width_m / 2.0 };
    let extent = track.extent.unwrap_or(half);
    // Each of the two boxes shrinks by half of the required overlap.
    let inside = |side_m: f64| (side_m - MIN_OVERLAP_M / 2.0).max(side_m / 2.0);
    [extent, Extent { length_m: inside(extent.length_m), width_m: inside(extent.width_m) }]
}

fn is_another_course(one: Vec2, other: Vec2) -> bool {
    one.dot(other) < FOLLOWING_RAD.cos()
}
