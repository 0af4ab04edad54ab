//! How many shards are done, running and missing, and how long will the rest take?

use super::folder::ShardFolder;
use super::tries::Tries;
use crate::engine::{Result, StageKind};
use serde::Serialize;
use std::fmt::Write;
use std::path::Path;
use std::time::Duration;

/// If a shard was begun longer ago than this many times the usual time of a shard, and longer ago than [`AT_LEAST`],
/// its worker is presumed dead.
const MANY: f64 = 5.0;
/// Before any shard is done, its usual time is unknown.
const AT_LEAST: Duration = Duration::from_secs(120);

/// The shards of a plan.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ShardStatus {
    /// Name of the kind of stage.
    pub stage: &'static str,
    /// Number of shards in the plan.
    pub n_shards: usize,
    /// Finished ones among them.
    pub n_done: usize,
    /// Shards that were begun recently.
    pub n_running: usize,
    /// Shards that are neither done nor running.
    pub n_missing: usize,
    /// Names of the shards that no worker will try again, with the reason.
    pub given_up: Vec<String>,
    /// The time that one worker takes for a shard, seconds; `None` before one is done.
    pub seconds_a_shard: Option<f64>,
    /// The time that the present workers need for the rest, seconds; `None` if it is unknown or there are no workers.
    pub seconds_left: Option<f64>,
}

/// The shards of the plan in the run folder `root`, if there is one; of the last stage that has one.
pub fn shard_status(root: &Path, kinds: &'static [StageKind]) -> Result<Option<ShardStatus>> {
    for stage in kinds.iter().rev() {
        if let Some(folder) = ShardFolder::all(root, stage)?.first() {
            return Ok(Some(status_of(stage, folder)?));
        }
    }
    Ok(None)
}

fn status_of(stage: &'static StageKind, folder: &ShardFolder) -> Result<ShardStatus> {
    let n_shards = folder.n_shards()?;
    let (mut seconds, mut unfinished) = (Vec::new(), Vec::new());
    let tried = folder.tried()?;
    for idx in 0..n_shards {
        match folder.seconds(idx) {
            Some(took) => seconds.push(took),
            None if tried.contains(&folder.shard_name(idx)) => unfinished.push((idx, folder.tries(idx))),
            None => unfinished.push((idx, Tries::default())),
        }
    }
    let n_done = seconds.len();
    let mean = (n_done > 0).then(|| seconds.iter().sum::<f64>() / n_done as f64);
    let patience = AT_LEAST.max(Duration::from_secs_f64(MANY * mean.unwrap_or(0.0)));
    let (given_up, left): (Vec<_>, Vec<_>) = unfinished.into_iter().partition(|(_, tries)| tries.are_over());
    let n_running = left.iter().filter(|(_, tries)| tries.age.is_some_and(|age| age < patience)).count();
    let describe = |(idx, tries): &(usize, Tries)| format!("{} ({})", folder.shard_name(*idx), tries.describe());
    Ok(ShardStatus {
        stage: stage.name,
        n_shards,
        n_done,
        n_running,
        n_missing: left.len() - n_running,
        given_up: given_up.iter().map(describe).collect(),
        seconds_a_shard: mean,
        seconds_left: mean.filter(|_| n_running > 0).map(|mean| mean * left.len() as f64 / n_running as f64),
    })
}

impl ShardStatus {
    /// The progress as lines for people.
    pub fn text(&self) -> String {
        let Self { n_shards, n_done, n_running, n_missing, given_up, seconds_a_shard, seconds_left, .. } = self;
        let mut text = format!(
            "shards            {n_done} of {n_shards} done, {n_running} running, {n_missing} missing, {} given up\n",
            given_up.len()
        );
        // Writing to a string cannot fail.
        let _ = match (seconds_left, seconds_a_shard) {
            (Some(left), _) => writeln!(text, "time left         {}", duration(*left)),
            (None, Some(mean)) if *n_missing > 0 => {
                writeln!(text, "time left         unknown: no worker is at work; a shard takes one {}", duration(*mean))
            }
            _ => Ok(()),
        };
        given_up.iter().for_each(|name| text.push_str(&format!("given up          {name}\n")));
        text
    }
}

/// `40 s`, `12 min`, `3.4 h`.
fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 100.0 => format!("{s:.0} s"),
        s if s < 6_000.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3_600.0),
    }
}
