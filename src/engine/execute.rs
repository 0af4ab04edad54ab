//! Runs planned stages.

use super::device::ComputeChoice;
use super::failure::{Failure, Result};
use super::inputs::check_inputs;
use super::log::Logged;
use super::plan::revise;
use super::planned::{Action, PlannedStage};
use super::record::StageRecord;
use super::shards::{self, Gathering, Makers};
use super::stage::{StageContext, Work};
use super::timings::StageClock;
use super::work_folder::WorkFolder;

/// Runs the stages that must run. Returns the records of all stages, and calls `after` with each as soon as it is done.
/// `made` begins with what the context has opened. The `log` is the context's progress.
pub(super) fn execute(
    planned: Vec<PlannedStage<'_>>,
    made: (ComputeChoice, Makers),
    context: &StageContext<'_>,
    (log, clock): (&Logged<'_>, &mut StageClock<'_>),
    after: &mut dyn FnMut(&StageRecord) -> anyhow::Result<()>,
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
            log.enter(kind);
            clock.begin(kind)?;
            let record = run_stage(&planned, made, context).map_err(|failure| failure.of_stage(kind))?;
            clock.end(kind)?;
            record
        };
        clock.keep_times(&record)?;
        after(&record)?;
        records.push(record);
    }
    Ok(records)
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
