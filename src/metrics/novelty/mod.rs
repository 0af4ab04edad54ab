//! How new is a scenario? Its distance from recorded events of its kind, and from the scenarios before it.
//!
//! [`EventSpace`] compares events by their parameters, [`PairPath`] scenarios by the paths of those who were asked; [`PathIndex`] finds
//! the nearest of many.

mod event_space;
mod nearest;
mod pair_path;

pub use event_space::EventSpace;
pub use pair_path::{DUPLICATE_DISTANCE_M, PairPath, PathIndex};
