//! What did earlier runs leave of a stage?

use super::kind::StageKind;
use super::record::StageRecord;
use std::collections::BTreeMap;

/// What earlier runs left of a stage. It is read when the stage is planned, and holds until the stage runs.
pub(super) struct Earlier {
    pub(super) stage: &'static StageKind,
    /// The record of the finished stage, if there is one.
    pub(super) done: Option<StageRecord>,
    /// The record of unfinished work on it, if there is any.
    pub(super) begun: Option<StageRecord>,
    /// Whether workers share a plan to do it again.
    pub(super) is_redone: bool,
    /// By output, a hash of the times at which its large files were written that were seen whole.
    pub(super) times_seen: BTreeMap<String, String>,
    /// The total time that it was at work, seconds; `None` if unknown, such as after an interruption.
    pub(super) seconds_spent: Option<f64>,
}
