//! Results that were made from bytes which are not there any more.
//!
//! A stage that is done again with the same settings may write other bytes, such as after a change of the program. What
//! read the former bytes then runs again, too. Models that were trained on them are kept, with a warning: training them
//! again can take hours, so the user decides.

use super::failure::Result;
use super::kind::StageKind;
use super::plan::{Action, PlannedStage, begun, check_writable};
use super::record::StageRecord;
use super::stage::StageContext;

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

/// Takes into account what the stages before wrote, which was not known when `planned` was made: reuses nothing, and
/// resumes nothing, that was made from other bytes.
///
/// # Errors
/// When it must run again and would overwrite what is not its own.
pub(super) fn revise(planned: &mut PlannedStage<'_>, context: &StageContext<'_>) -> Result<()> {
    let kind = planned.stage.kind();
    let earlier = match planned.action {
        Action::Reuse => StageRecord::done(context.root, kind)?,
        Action::Resume => begun(context.root, kind)?,
        Action::Run(_) => None,
    };
    let Some((producer, earlier)) =
        earlier.and_then(|earlier| Some((planned.expected.rewritten_since(&earlier)?.to_owned(), earlier)))
    else {
        return Ok(());
    };
    if planned.action == Action::Reuse && (is_kept(kind, &earlier) || !planned.is_selected) {
        context.progress.warn(&format!(
            "{kind} is kept, but {producer}, which it read, has written other bytes since; rebuild it with --redo \
             {kind}"
        ));
        return Ok(());
    }
    planned.action = Action::Run(why(&producer));
    planned.kept = check_writable(context.root, planned.stage.as_ref(), &planned.expected, &planned.action, false)?;
    context.progress.note(&format!("{kind} runs again: {}", why(&producer)));
    Ok(())
}
