//! Does the map of a place show the whole road? Measured by the positions of recorded vehicles.

use super::check::exceeds;
use super::{Check, DrivenArea, Judged, MapGaps, ValidityConfig, offroad};
use crate::scene::{Roles, Scene};
use serde::{Deserialize, Serialize};

/// One timestep in this many is counted; neighboring timesteps are redundant.
const STRIDE: usize = 5;

/// How well the recorded vehicles of a place keep to its lanes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MapFit {
    /// Number of recorded scenes.
    pub n_scenes: u64,
    /// Number of scenes in which a vehicle leaves the road.
    pub n_scenes_leaving: u64,
    /// Number of counted states of vehicles.
    pub n_states: u64,
    /// Number of states off the road.
    pub n_states_off: u64,
}

impl MapFit {
    /// The counts of a recorded scene: every fifth state of its vehicles, and whether it passes the check of
    /// departures, where maps have these gaps.
    pub fn of(scene: &Scene, config: &ValidityConfig, map_gaps: &MapGaps) -> Self {
        let judged = Judged::future_of(scene, Roles::none()).with_gaps(map_gaps);
        let off_road_m = offroad::off_road_m(scene, map_gaps);
        let states = vehicles(&judged).flat_map(|agent_idx| scene.tracks[agent_idx].trajectory.valid());
        let positions: Vec<_> =
            states.filter(|(timestep, _)| timestep % STRIDE == 0).map(|(_, s)| s.position).collect();
        Self {
            n_scenes: 1,
            n_scenes_leaving: u64::from(offroad::worst(&judged, config).is_some()),
            n_states: positions.len() as u64,
            n_states_off: positions
                .iter()
                .filter(|position| exceeds(off_road_m(**position), config.offroad_slack_m))
                .count() as u64,
        }
    }

    /// The sum of both.
    #[must_use]
    pub const fn with(self, other: Self) -> Self {
        Self {
            n_scenes: self.n_scenes + other.n_scenes,
            n_scenes_leaving: self.n_scenes_leaving + other.n_scenes_leaving,
            n_states: self.n_states + other.n_states,
            n_states_off: self.n_states_off + other.n_states_off,
        }
    }

    /// Whether departures from the road can be judged by the map: at most the configured share of the recorded states
    /// lies off the road, and at most that share of the recorded scenes, or a single one, has a departure.
    pub fn allows_offroad(&self, config: &ValidityConfig) -> bool {
        let is_rare = |n: u64, of: u64| n as f64 <= config.max_recorded_offroad * of as f64;
        is_rare(self.n_states_off, self.n_states)
            && (self.n_scenes_leaving <= 1 || is_rare(self.n_scenes_leaving, self.n_scenes))
    }
}

/// The agents that move like vehicles.
fn vehicles<'a>(judged: &'a Judged<'_>) -> impl Iterator<Item = usize> + 'a {
    (0..judged.scene.tracks.len()).filter(|agent_idx| judged.is_vehicle(*agent_idx))
}

impl DrivenArea {
    /// The area with the ways of the vehicles of a recorded scene.
    #[must_use]
    pub fn with_vehicles_of(self, scene: &Scene) -> Self {
        self.with(scene, vehicles(&Judged::future_of(scene, Roles::none())))
    }
}

impl Judged<'_> {
    /// The checks that are not made for the scene: those that the configuration skips, those of motion if the dataset
    /// does not allow them, and that of departures from the road if there is no map, or neither the map nor recorded
    /// vehicles show the whole road.
    pub fn not_checked(&self, config: &ValidityConfig) -> Vec<Check> {
        let is_made = |check: Check| match check {
            _ if config.skip.contains(&check) => false,
            Check::Collision => true,
            Check::Offroad => !self.scene.lanes.is_empty() && self.map_gaps.show_road_of(self.scene),
            _ => config.checks_motion_of(self.scene.source.dataset),
        };
        Check::ALL.into_iter().filter(|check| !is_made(*check)).collect()
    }
}
