//! Runs planned stages.

use super::device::ComputeChoice;
use super::failure::{Failure, Result};
use super::inputs::check_inputs;
use super::kept_models::kept;
use super::kind::StageKind;
use super::outdated;
use super::planned::{Action, PlannedStage};
use super::record::StageRecord;
use super::shards::{self, Gathering, Makers};
use super::stage::{StageContext, Work};
use super::work_folder::WorkFolder;
use crate::progress::Progress;

/// Runs the stages that must run. Returns the records of all stages, and calls `after` with each as soon as it is done.
/// `compute` is what the context has opened.
pub(super) fn execute(
    planned: Vec<PlannedStage<'_>>,
    (compute, makers): (ComputeChoice, Makers),
    context: &StageContext<'_>,
    after: &mut dyn FnMut(&StageRecord) -> anyhow::Result<()>,
    around: &mut dyn FnMut(&'static StageKind, Moment) -> anyhow::Result<()>,
) -> Result<Vec<StageRecord>> {
    let mut records = Vec::new();
    for mut planned in planned {
        planned.expected.learn_contents(&records);
        revise(&mut planned, context)?;
        let kind = planned.stage.kind();
        let record = if planned.action == Action::Reuse {
            let PlannedStage { expected, earlier, .. } = planned;
            let done = earlier.done.unwrap_or_else(|| expected.clone());
            shards::clean_up(context.root, kind, &done)?;
            done.with_inputs_of(context.root, kind, &expected)?.seen(expected.times)
        } else {
            if context.progress.must_stop() {
                return Err(Failure::later(format_args!("stopped before stage {kind}")));
            }
            around(kind, Moment::Start)?;
            let named = Named { stage: kind, inner: context.progress };
            let context = StageContext { progress: &named, ..*context };
            let record = run_stage(&planned, (compute, makers), &context).map_err(|failure| failure.of_stage(kind))?;
            around(kind, Moment::End)?;
            record
        };
        after(&record)?;
        records.push(record);
    }
    Ok(records)
}

/// Takes into account what earlier stages wrote, which was unknown when `planned` was made: nothing made from other
/// bytes is reused or resumed.
///
/// # Errors
/// When the stage must run again and would replace a model whose training was long.
fn revise(planned: &mut PlannedStage<'_>, context: &StageContext<'_>) -> Result<()> {
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

/// When a time is taken, relative to a stage's work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Moment {
    /// Before its work.
    Start,
    /// After its outputs are whole.
    End,
}

/// Prefixes the names of phases with the stage.
struct Named<'a> {
    stage: &'static StageKind,
    inner: &'a dyn Progress,
}

impl Progress for Named<'_> {
    fn start(&self, phase: &str, total: u64, unit: &str) {
        let stage = self.stage.command;
        let is_whole = stage.split(' ').any(|word| word == phase);
        let name = if is_whole { stage.to_owned() } else { format!("{stage}: {phase}") };
        self.inner.start(&name, total, unit);
    }

    fn advance(&self, n: u64) {
        self.inner.advance(n);
    }

    fn note(&self, message: &str) {
        self.inner.note(message);
    }

    fn warn(&self, message: &str) {
        self.inner.warn(message);
    }

    fn finish(&self) {
        self.inner.finish();
    }

    fn must_stop(&self) -> bool {
        self.inner.must_stop()
    }
}

fn run_stage(
    planned: &PlannedStage<'_>,
    made: (ComputeChoice, Makers),
    context: &StageContext<'_>,
) -> Result<StageRecord> {
    let PlannedStage { stage, expected, action, kept, .. } = planned;
    match stage.work() {
        Work::Whole(whole) => {
            let work = match action {
                Action::Resume => WorkFolder::resume(context.root, stage.kind(), expected)?,
                _ => WorkFolder::begin(context.root, stage.kind(), expected)?,
            };
            check_inputs(stage.as_ref())?;
            let summary = whole.run(&StageContext { root: work.path(), ..*context })?;
            work.finish(expected.clone(), stage.outputs(), summary, kept)
        }
        Work::Sharded(sharded) => {
            check_inputs(stage.as_ref())?;
            let folder = shards::ready(planned, sharded, made, context)?;
            let work = WorkFolder::begin(context.root, stage.kind(), expected)?;
            let summary =
                sharded.finish(&mut Gathering::new(&folder), &StageContext { root: work.path(), ..*context })?;
            let record = work.finish(expected.clone(), stage.outputs(), summary, kept)?;
            shards::clean_up(context.root, stage.kind(), &record)?;
            Ok(record)
        }
    }
}
