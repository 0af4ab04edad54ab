//! What is sampled at a time: a scene with the agents that are asked to show something.

use crate::guidance::Target;
use crate::scene::{Roles, SceneId};
use serde::{Deserialize, Serialize};

/// A scene and its requested agents.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// Index of the scene in the store.
    pub scene_idx: usize,
    /// The scene.
    pub scene_id: SceneId,
    /// The requested agents, the same at strength 0; none if no behavior or no particular pair is requested.
    pub roles: Roles,
    /// The targets of its samples' events, used in turn. Empty if the samples have no target.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub targets: Vec<Target>,
}

impl Cell {
    /// The target of this sample's event.
    pub(super) fn target(&self, sample_idx: usize) -> Target {
        let n_targets = self.targets.len().max(1);
        self.targets.get(sample_idx % n_targets).cloned().unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_of_a_pair_aim_at_its_targets_in_turn() {
        let targets: Vec<Target> = [1.0, 2.0].map(|gap_m| Target::from([("gap_m".to_owned(), [gap_m; 2])])).into();
        let cell = Cell { scene_idx: 0, scene_id: "a".into(), roles: Roles::default(), targets: Vec::new() };
        assert_eq!(cell.target(1), Target::new());
        let cell = Cell { targets, ..cell };
        assert_eq!([0, 1, 2, 3].map(|sample| cell.target(sample)["gap_m"][0]), [1.0, 2.0, 1.0, 2.0]);
    }
}
