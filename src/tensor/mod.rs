//! Converts scenes to tensors and back: frames, scales, masks and inputs of the network.
//!
//! Two parametrizations of states: `scene` is the paper's, `motion` the change from timestep to timestep of an agent's
//! motion relative to a kinematic reference that follows from its observed states, which turns a small error of the
//! network into a small error of velocity instead of a jerk. Diffused values have no meaning by themselves:
//! [`SceneBatch::decode`] turns them into meters and radians, linearly.
//!
//! Decoded samples are finished like recordings: standing agents are still (`ending`), vehicles do not drive on
//! backward (`forward`), and agents that keep their lanes to the millimeter continue to do so (`lane_keeping`).
//!
//! With a `Sight`, the collator also looks around each agent: lane pieces that it can reach, in its own frame, and the
//! modes of its motion.

mod agent_frame;
mod agent_row;
mod batch_buffers;
mod collate;
mod continuation;
mod eigen;
mod ending;
mod features;
mod forward;
mod hidden_states;
mod lane_keeping;
mod lane_pieces;
mod mask_sampler;
mod motion;
mod motion_modes;
mod normalizer;
mod observation_errors;
mod pair_features;
mod reference;
mod repeated_rows;
mod scene_batch;
mod scene_view;
mod sight;
mod surroundings;
#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
mod texture;

pub use agent_frame::AgentFrame;
pub use collate::Collator;
pub use features::{FeatureLayout, LANE_POINTS};
pub use forward::LeastProgress;
pub use lane_pieces::{LanePiece, LanePoint, PIECE_FLAGS, PIECE_POINTS};
pub use mask_sampler::{MaskSampler, MaskTask, TaskWeights};
pub use motion_modes::MotionCovariance;
pub use normalizer::{Normalizer, NormalizerFit, StateParametrization};
pub use pair_features::PairFeatures;
pub use repeated_rows::RepeatedRows;
pub use scene_batch::{SceneBatch, SceneTensors, Surroundings};
pub use scene_view::{FutureValidity, SceneView};
pub use sight::Sight;
pub use surroundings::{AgentSurroundings, RowSurroundings, SeenPiece, SurroundingsLayout};
