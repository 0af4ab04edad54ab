//! Which vehicle of a scenario is its ego?

use super::ScenarioRecord;
use crate::scene::TrackId;
use serde::Serialize;

/// The choice of a scenario's ego: the vehicle that formats mark, and that a driving function may take over.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum EgoChoice {
    /// The subject of the requested event; in scenarios without one, the center of the recorded window.
    #[default]
    Event,
    /// The center of the recorded window, whatever happens.
    Scene,
    /// The track of this name.
    Track(TrackId),
}

impl EgoChoice {
    /// The choice of this name on the command line; whatever is no other choice is the name of a track.
    pub fn from_name(name: &str) -> Self {
        match name {
            "event" => Self::Event,
            "scene" => Self::Scene,
            track => Self::Track(track.into()),
        }
    }

    /// A description, in words that follow "the ego is".
    pub(crate) fn words(&self) -> String {
        match self {
            Self::Event => {
                "the vehicle to which the requested event happens, such as the one that is cut off".to_owned()
            }
            Self::Scene => "the center of the recorded window, whatever happens in the scenario".to_owned(),
            Self::Track(id) => format!("track {id}"),
        }
    }

    /// The ego of a scenario, and whether it is the center because there is no subject. `None` if it has no such track.
    pub(crate) fn of(&self, record: &ScenarioRecord) -> Option<(usize, bool)> {
        let scene = &record.scenario.scene;
        match self {
            Self::Event => Some(record.subject_idx().map_or((scene.ego_idx, true), |subject| (subject, false))),
            Self::Scene => Some((scene.ego_idx, false)),
            Self::Track(id) => scene.track_idx(id).map(|agent_idx| (agent_idx, false)),
        }
    }
}
