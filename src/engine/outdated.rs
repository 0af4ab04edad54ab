//! Results that were made from bytes that no longer exist.
//!
//! A stage that is done again with the same settings may write other bytes, for example after a change of the program.
//! Stages that read the former bytes then run again, too. Models trained on them are kept, with a warning: training
//! them again can take hours, so the user decides.

use super::kind::StageKind;
use super::record::StageRecord;

/// The reason to run a stage again that read earlier outputs of `producer`.
pub(super) fn why(producer: &str) -> String {
    format!("{producer} wrote other bytes than before")
}

/// Whether the stage's results stay although they are stale: a trained model.
pub(super) fn is_kept(stage: &StageKind, done: &StageRecord) -> bool {
    stage.trains && done.summary["trained"] == true
}

/// Whether work that was begun as `begun` can go on with the inputs of `expected`.
pub(super) fn can_resume(expected: &StageRecord, begun: &StageRecord) -> bool {
    begun.fingerprint == expected.fingerprint && expected.rewritten_since(begun).is_none()
}
