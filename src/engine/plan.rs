//! Decides which stages must run, and which are reused or resumed.

use super::earlier::Earlier;
use super::earlier_runs::left;
use super::failure::{Failure, Result};
use super::inputs::{check_overlaps, expected_on, identify_inputs};
use super::kept_models::kept;
use super::kind::StageKind;
use super::outdated;
use super::ownership;
use super::planned::{Action, PlannedStage};
use super::record::StageRecord;
use super::stage::{Stage, StageContext};
use super::work_folder::work_path;
use std::path::Path;

/// Decides on every stage, in order; those in `redo` are done again even if they are up to date. `root` is the folder
/// in which they write. Reads recordings to fingerprint them, and writes nothing.
///
/// # Errors
/// When a section is invalid, an input is missing, an output of a stage that may run overlaps an input or holds files
/// that the stage did not write, or a trained model would be replaced without a request.
pub fn plan<'a>(
    root: &Path,
    kinds: &'static [StageKind],
    stages: Vec<Box<dyn Stage + 'a>>,
    redo: &[&'static StageKind],
) -> Result<Vec<PlannedStage<'a>>> {
    // All sections are checked before recordings are read, so that mistakes are found at once.
    stages.iter().try_for_each(|stage| stage.check())?;
    if let Some(stage) = redo.iter().find(|kind| !stages.iter().any(|stage| stage.kind() == **kind)) {
        return Err(Failure::input_message(format_args!("--redo {stage}: the pipeline has no such stage")));
    }
    check_overlaps(root, &stages)?;
    ownership::check_root(root, kinds)?;
    let mut planned: Vec<PlannedStage<'a>> = Vec::new();
    // Stages that are up to date now may have to run once earlier ones have written.
    let mut may_run: Vec<&StageKind> = Vec::new();
    for stage in stages {
        let earlier = left(root, stage.kind())?;
        let (inputs, missing) = identify_inputs(root, &planned, stage.as_ref(), earlier.done.as_ref())?;
        let mut expected = expected_on(stage.as_ref(), inputs)?;
        let is_requested = redo.contains(&stage.kind());
        let action = decide(root, &earlier, &mut expected, is_requested)?;
        if let Some(failure) = missing.filter(|_| action != Action::Reuse) {
            return Err(failure);
        }
        let is_kept = earlier.done.as_ref().is_some_and(|done| outdated::is_kept(stage.kind(), done));
        let reads_anew = stage.inputs().iter().any(|input| input.producer.is_some_and(|kind| may_run.contains(&kind)));
        if action != Action::Reuse || (reads_anew && !is_kept) {
            ownership::check_work(&work_path(root, stage.kind()))?;
            ownership::check_outputs(root, earlier.done.as_ref(), stage.outputs())?;
            may_run.push(stage.kind());
        }
        let kept = match &action {
            Action::Reuse => Vec::new(),
            // The user who began the training has requested it already.
            Action::Resume => kept(root, &earlier, &expected, "", true)?,
            Action::Run(why) => kept(root, &earlier, &expected, why, is_requested)?,
        };
        planned.push(PlannedStage { stage, expected, action, earlier, kept, is_selected: true, is_requested });
    }
    Ok(planned)
}

/// The planned stages that are `selected`, and the finished ones before them.
///
/// # Errors
/// When a selected stage is not in the pipeline, or reads from one that is neither done nor selected
/// (`Blame::Later`).
pub fn select<'a>(planned: Vec<PlannedStage<'a>>, selected: &[&'static StageKind]) -> Result<Vec<PlannedStage<'a>>> {
    if let Some(stage) = selected.iter().find(|kind| !planned.iter().any(|planned| planned.stage.kind() == **kind)) {
        return Err(Failure::input_message(format_args!("--stage {stage}: the pipeline has no such stage")));
    }
    let is_ready =
        |planned: &PlannedStage<'_>| planned.action == Action::Reuse || selected.contains(&planned.stage.kind());
    for PlannedStage { stage, .. } in planned.iter().filter(|planned| selected.contains(&planned.stage.kind())) {
        let producers: Vec<&StageKind> = stage.inputs().iter().filter_map(|input| input.producer).collect();
        let waits_for = planned.iter().find(|other| producers.contains(&other.stage.kind()) && !is_ready(other));
        if let Some(PlannedStage { expected, action, .. }) = waits_for {
            let producer = &expected.stage;
            return Err(Failure::later(format_args!("stage {} waits for stage {producer}: {action}", stage.kind()))
                .with_hint(format!("run --stage {producer} first; this command can be repeated until then")));
        }
    }
    let marked = planned.into_iter().filter(is_ready).map(|planned| {
        let is_selected = selected.contains(&planned.stage.kind());
        PlannedStage { is_selected, ..planned }
    });
    Ok(marked.collect())
}

/// Takes into account what earlier stages wrote, which was unknown when `planned` was made: nothing made from other
/// bytes is reused or resumed.
///
/// # Errors
/// When the stage must run again and would replace a model whose training was long.
pub(super) fn revise(planned: &mut PlannedStage<'_>, context: &StageContext<'_>) -> Result<()> {
    let kind = planned.stage.kind();
    let earlier = match planned.action {
        Action::Reuse => planned.earlier.done.as_ref(),
        Action::Resume => planned.earlier.begun.as_ref(),
        Action::Run(_) => None,
    };
    let Some((producer, earlier)) =
        earlier.and_then(|earlier| Some((planned.expected.rewritten_since(earlier)?.to_owned(), earlier)))
    else {
        return Ok(());
    };
    if planned.action == Action::Reuse && (outdated::is_kept(kind, earlier) || !planned.is_selected) {
        context.progress.warn(&format!(
            "{kind} is kept, but {producer}, which it read, has written other bytes since; rebuild it with --redo \
             {kind}"
        ));
        return Ok(());
    }
    let why = outdated::why(&producer);
    planned.kept = kept(context.root, &planned.earlier, &planned.expected, &why, false)?;
    context.progress.note(&format!("{kind} runs again: {why}"));
    planned.action = Action::Run(why);
    Ok(())
}

/// The action for a stage. `expected` gets the fingerprint of earlier work on the same contents and, if the stage is
/// reused, the times at which its outputs were last verified.
fn decide(root: &Path, earlier: &Earlier, expected: &mut StageRecord, is_requested: bool) -> Result<Action> {
    // Files may have been moved. Later stages keep their fingerprints, too.
    if let Some(same) = earlier.done.iter().chain(&earlier.begun).find(|earlier| expected.is_same_work(earlier)) {
        expected.fingerprint.clone_from(&same.fingerprint);
    }
    let stage = earlier.stage;
    let why = match &earlier.done {
        Some(_) if is_requested || earlier.is_redone => "requested by --redo".to_owned(),
        Some(done) if done.fingerprint != expected.fingerprint => expected.changes_since(stage, done),
        Some(done) => match done.whole_since(root, &earlier.times_seen)? {
            Err(name) => format!("{name} is missing or was changed"),
            Ok(times) => {
                expected.times = times;
                match expected.rewritten_since(done) {
                    Some(producer) if !outdated::is_kept(stage, done) => outdated::why(producer),
                    _ => return Ok(Action::Reuse),
                }
            }
        },
        None => match &earlier.begun {
            Some(started) if started.fingerprint != expected.fingerprint => expected.changes_since(stage, started),
            _ => "not done yet".to_owned(),
        },
    };
    Ok(match &earlier.begun {
        Some(begun) if outdated::can_resume(expected, begun) => Action::Resume,
        _ => Action::Run(why),
    })
}
