//! References to an agent in configurations, which apply to any scene.

use super::{Roles, Scene};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fmt;

/// One agent of a scene: `"ego"`, `{ role = "other" }` or `{ track = "12" }`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AgentRef {
    /// The agent at the center: the one with the first role of the requested behavior, else the scene's ego agent.
    Ego,
    /// The agent with this role in the requested behavior.
    Role(String),
    /// The agent with this track id in the recording.
    Track(String),
}

impl fmt::Display for AgentRef {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Ego => f.write_str("ego"),
            Self::Role(role) => write!(f, "with the role {role}"),
            Self::Track(track) => write!(f, "of track {track}"),
        }
    }
}

impl AgentRef {
    /// The index of the agent among the tracks of `scene`, in which agent `ego_idx` is at the center and tracks have
    /// `roles`. `None` if there is no such agent.
    pub fn resolve(&self, scene: &Scene, ego_idx: usize, roles: &Roles) -> Option<usize> {
        match self {
            Self::Ego => Some(ego_idx).filter(|idx| *idx < scene.tracks.len()),
            Self::Role(name) => scene.track_idx(roles.track(name)?),
            Self::Track(id) => scene.tracks.iter().position(|track| track.id.0 == *id),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{Drive, scene};

    #[test]
    fn agents_are_found_by_place_role_and_name() {
        let scene = scene(&[Drive::straight(0.0, 0.0, 0.0, 5.0), Drive::straight(0.0, 4.0, 0.0, 5.0)]);
        let roles = Roles::from([("other", "1")]);
        let found = |agent: AgentRef| agent.resolve(&scene, 1, &roles);
        assert_eq!(found(AgentRef::Ego), Some(1));
        assert_eq!(found(AgentRef::Role("other".to_owned())), Some(0));
        assert_eq!(found(AgentRef::Track("2".to_owned())), Some(1));
        assert_eq!(found(AgentRef::Track("3".to_owned())), None);
        assert_eq!(found(AgentRef::Role("ego".to_owned())), None);
    }
}
