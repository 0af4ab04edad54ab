//! Batches for tests: scenes collated with their own scales.

use super::{Collator, FutureValidity, NormalizerFit, SceneBatch, SceneView, StateParametrization};
use crate::scene::{ObservationMask, Scene};
use candle_core::Device;

/// A collator with the scales of these scenes, without surroundings.
pub(crate) fn collator<'a>(
    scenes: impl IntoIterator<Item = &'a Scene>,
    parametrization: StateParametrization,
) -> Collator {
    let (mut fit, mut n_timesteps) = (NormalizerFit::default(), 0);
    for scene in scenes {
        fit.add(scene);
        n_timesteps = scene.n_timesteps;
    }
    Collator { normalizer: fit.finish(parametrization, 3), n_timesteps, max_agents: 8, max_lanes: 16, sight: None }
}

impl Collator {
    /// One scene under a mask, seen from its ego agent.
    pub(crate) fn masked(&self, scene: &Scene, mask: &ObservationMask, validity: FutureValidity) -> SceneBatch {
        self.collate(&[SceneView { scene, ego_idx: scene.ego_idx, mask }], validity, &Device::Cpu).unwrap()
    }

    /// Scenes with an observed history, each seen from its ego agent.
    pub(crate) fn predictive(&self, scenes: &[&Scene], validity: FutureValidity) -> SceneBatch {
        let mask = |s: &&Scene| ObservationMask::predictive(s.tracks.len(), s.n_timesteps, s.n_history);
        let masks: Vec<_> = scenes.iter().map(mask).collect();
        let views: Vec<_> =
            scenes.iter().zip(&masks).map(|(scene, mask)| SceneView { scene, ego_idx: scene.ego_idx, mask }).collect();
        self.collate(&views, validity, &Device::Cpu).unwrap()
    }
}
