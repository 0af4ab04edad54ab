//! From scenes to tensors and back: which numbers does the network see, in which frame, at which scale?

mod collate;
mod features;
mod hidden_states;
mod mask_sampler;
mod motion;
mod normalizer;
mod pair_features;
mod reference;
mod scene_batch;
#[cfg(test)]
mod tests;

pub use collate::{AgentFrame, Collator, FutureValidity, SceneView};
pub use features::{FeatureLayout, LANE_POINTS};
pub use mask_sampler::{MaskSampler, MaskTask, TaskWeights};
pub use normalizer::{Normalizer, NormalizerFit, StateParametrization};
pub use pair_features::PairFeatures;
pub use scene_batch::SceneBatch;
