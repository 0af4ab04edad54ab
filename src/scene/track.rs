//! One tracked road user.

use super::{AgentClass, Extent, State, TrackId, Trajectory};
use crate::geometry::OrientedBox;
use crate::settings::named;
use serde::{Deserialize, Serialize};

/// The role of a track in its dataset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TrackRole {
    /// The agent of interest: Argoverse's AGENT or focal track, INTERACTION's `interesting_agent`.
    Focal,
    /// To be predicted and scored: INTERACTION's `track_to_predict`, Argoverse 2's scored tracks.
    Scored,
    /// The vehicle that carried the sensors.
    Recorder,
    /// A vehicle that stands for minutes: an obstacle to others.
    Parked,
    /// Everybody else.
    Context,
}

named! { TrackRole {
    Focal = "focal", Scored = "scored", Recorder = "recorder", Parked = "parked", Context = "context",
} }

/// One road user of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Track {
    /// The recording's name for it.
    pub id: TrackId,
    /// Kind of road user.
    pub class: AgentClass,
    /// Its role in the dataset.
    pub role: TrackRole,
    /// Size, where the recording gives one.
    pub extent: Option<Extent>,
    /// Its states; as many timesteps as the scene has.
    pub trajectory: Trajectory,
}

impl Track {
    /// Whether it is a vehicle that stands for minutes. It comes behind all others where there is no room for all, and
    /// nothing is asked of it.
    pub fn is_parked(&self) -> bool {
        self.role == TrackRole::Parked
    }

    /// The recorded size, or the nominal one of its class.
    pub fn extent_or_nominal(&self) -> Extent {
        self.extent.unwrap_or_else(|| self.class.nominal_extent())
    }

    /// The recorded size, or the least size of the class. The recorder is a vehicle, and so is the focal agent of a
    /// dataset without classes: Argoverse 1 looked for vehicles that cross, turn, change lanes or drive in dense
    /// traffic (Chang et al. 2019).
    pub fn extent_or_least(&self) -> Extent {
        let is_vehicle =
            self.class == AgentClass::Unknown && matches!(self.role, TrackRole::Focal | TrackRole::Recorder);
        let class = if is_vehicle { AgentClass::Vehicle } else { self.class };
        self.extent.unwrap_or_else(|| class.least_extent())
    }

    /// The footprint of the agent in `state`.
    pub fn footprint(&self, state: &State) -> OrientedBox {
        let Extent { length_m, width_m } = self.extent_or_nominal();
        OrientedBox { center: state.position, heading_rad: state.heading_rad, length_m, width_m }
    }

    /// The footprint at `timestep`, if the agent was tracked then.
    pub fn footprint_at(&self, timestep: usize) -> Option<OrientedBox> {
        self.trajectory.get(timestep).map(|state| self.footprint(state))
    }
}
