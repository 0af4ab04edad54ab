//! The last part: one process publishes what the workers sampled, as if it had sampled everything itself.

use super::folder::PartsFolder;
use super::identity::Identity;
use super::tries::Tries;
use crate::generate::{Plan, ResolvedGeneration};
use crate::pipeline::graph::{Action, PlannedStage};
use crate::pipeline::layout::SAMPLES;
use crate::pipeline::run::RunFolder;
use crate::pipeline::stages::{Generate, SampleFolder, SampleSidecar, shard_name};
use crate::pipeline::work::Work;
use crate::pipeline::{ComputeChoice, Failure, Result, Stage};
use std::path::Path;

/// The most shards that a message names.
const SHOWN: usize = 5;

/// Takes over the shards of the workers into the work of the stage that is `planned`, which then only finishes it: it runs next, and
/// [`sealed`] after it. Requests, which decide as they go, it fulfills by itself.
///
/// # Errors
/// When shards are missing: [`Blame::Later`](crate::pipeline::Blame::Later) while they may still come, a fault once all of them are given
/// up. When there is no plan, or it is another one.
pub fn seal(
    folder: &RunFolder,
    planned: &mut PlannedStage<'_>,
    generate: &Generate<'_>,
    compute: ComputeChoice,
) -> Result<()> {
    if planned.action == Action::Reuse {
        return Ok(());
    }
    let root = folder.root();
    let Some(parts) = PartsFolder::of(root, &Identity::own(planned.expected.clone(), compute)?)? else {
        return Err(Failure::later(format_args!("{} holds no plan to seal yet", root.display()))
            .with_hint("run the parts plan and work first; this command can be repeated until then"));
    };
    let plan = parts.plan()?;
    let shards = collected(&parts, &plan, &generate.resolve()?)?;
    let work = match planned.action {
        Action::Resume => Work::resume(root, &planned.expected, generate.outputs())?,
        _ => Work::begin(root, &planned.expected)?,
    };
    let samples = SampleFolder::open_for_writing(&work.path().join(SAMPLES))?;
    samples.write_plan(&plan)?;
    for (idx, shard) in &shards {
        parts.publish(*idx, shard, &samples)?;
    }
    planned.action = Action::Resume;
    Ok(())
}

/// Removes the plans and shards in `root`, once they are published. What workers logged goes to the log of the run.
///
/// # Errors
/// Those of the file system; when somebody else put files there.
pub fn sealed(root: &Path) -> Result<()> {
    for parts in PartsFolder::all(root)? {
        parts.append_logs(&root.join(crate::pipeline::log::LOG_FILE))?;
        parts.discard()?;
    }
    Ok(())
}

/// The shards that one process would have written, with their indices.
pub(super) fn collected(
    parts: &PartsFolder,
    plan: &Plan,
    resolved: &ResolvedGeneration,
) -> Result<Vec<(usize, SampleSidecar)>> {
    let (mut found, mut missing, mut given_up) = (Vec::new(), Vec::new(), Vec::new());
    let mut n_verified = vec![0; resolved.n_sweeps];
    for shard in &plan.shards {
        if !shard.is_wanted(resolved, n_verified[shard.sweep_idx]) {
            continue;
        }
        match parts.verified(shard.idx)? {
            Some(finished) => {
                n_verified[shard.sweep_idx] += finished.shard.n_verified as usize;
                found.push((shard.idx, finished.shard));
            }
            None => {
                let tries = Tries::of(parts, shard.idx);
                let name = shard_name(shard.idx);
                match tries.are_over() {
                    true => given_up.push(format!("{name} ({})", tries.describe())),
                    false => missing.push(name),
                }
            }
        }
    }
    let n_shards = plan.shards.len();
    let given_up_text = few(&given_up);
    match (missing.is_empty(), given_up.is_empty()) {
        (true, true) => Ok(found),
        (true, false) => Err(Failure::fault(anyhow::anyhow!(
            "{} of {n_shards} shards are given up: {given_up_text}",
            given_up.len()
        ))
        .with_hint(format!(
            "find out why in {}, mend it, remove the marks samples-*.try-* there, and run workers again",
            parts.dir().display()
        ))),
        (false, none_given_up) => {
            let more = match none_given_up {
                true => String::new(),
                false => format!("; {} more are given up: {given_up_text}", given_up.len()),
            };
            Err(Failure::later(format_args!(
                "{} of {n_shards} shards are missing: {}{more}",
                missing.len(),
                few(&missing)
            ))
            .with_hint("run workers until none is missing, then seal again"))
        }
    }
}

/// The first few names, and how many more there are.
fn few(names: &[String]) -> String {
    let shown = names.iter().take(SHOWN).cloned().collect::<Vec<_>>().join(", ");
    let n_more = names.len().saturating_sub(SHOWN);
    if n_more == 0 { shown } else { format!("{shown} and {n_more} more") }
}
