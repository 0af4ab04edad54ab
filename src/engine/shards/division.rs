//! The decisions made before any shard.

use crate::engine::{Failure, Result};
use serde::Serialize;
use serde_json::Value;

/// The decisions made before any shard.
pub struct Division {
    pub(super) n_shards: usize,
    pub(super) decisions: Value,
}

impl Division {
    /// Number of shards that are known from the start, and the decisions that making and finishing them need.
    pub fn new(n_shards: usize, decisions: &impl Serialize) -> Result<Self> {
        Ok(Self { n_shards, decisions: serde_json::to_value(decisions).map_err(Failure::fault)? })
    }
}
