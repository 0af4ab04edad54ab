//! Results that were made from bytes which are not there any more.
//!
//! A stage that is done again with the same settings may write other bytes, such as after a change of the program. What
//! read the former bytes then runs again, too. Models that were trained on them are kept, with a warning: training them
//! again can take hours, so the user decides.

use super::kind::StageKind;
use super::record::StageRecord;

/// Why a stage runs that read what `producer` wrote before.
pub(super) fn why(producer: &str) -> String {
    format!("{producer} wrote other bytes than before")
}

/// Whether its results stay although they are stale: a trained model.
pub(super) fn is_kept(stage: &StageKind, done: &StageRecord) -> bool {
    stage.trains && done.summary["trained"] == true
}

/// Whether the work that was begun goes on from what `expected` reads.
pub(super) fn can_resume(expected: &StageRecord, begun: &StageRecord) -> bool {
    begun.fingerprint == expected.fingerprint && expected.rewritten_since(begun).is_none()
}
