//! Novelty of a scenario: its distance from recorded events of its behavior, and from earlier scenarios.
//!
//! [`EventSpace`] compares events by their parameters, [`PairPath`] scenarios by the paths of the requested agents;
//! [`PathIndex`] finds the nearest of many.

mod event_space;
mod nearest;
mod pair_path;

pub use event_space::EventSpace;
pub use pair_path::{DUPLICATE_DISTANCE_M, PairPath, PathIndex};
