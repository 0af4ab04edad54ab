//! When was each stage of a run at work, and when were the large files of its outputs seen whole?

use super::clock::{peak_memory_bytes, utc_now};
use super::kind::StageKind;
use super::record::StageRecord;
use crate::store::{read_json, write_record};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

/// Name of the file for times and other facts that differ between equal runs.
pub const TIMINGS_FILE: &str = "timings.json";

/// The content of `timings.json`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Timings {
    /// One entry for each time that a stage was at work, oldest first; a stage that was interrupted has several.
    pub stages: BTreeMap<String, Vec<StageTiming>>,
    /// By stage and output, hashes of sizes and times of large files that were seen whole. While these stay, planning
    /// does not read the files again.
    #[serde(default)]
    pub outputs: BTreeMap<String, BTreeMap<String, String>>,
}

/// A period in which a stage was at work.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StageTiming {
    /// When it began, UTC.
    pub started: String,
    /// When it was done, UTC; `None` if it was interrupted.
    pub finished: Option<String>,
    /// Its duration, seconds.
    pub seconds: Option<f64>,
    /// Number of worker threads.
    pub n_threads: usize,
    /// The peak memory of the process by then, bytes.
    pub peak_memory_bytes: Option<u64>,
}

impl Timings {
    /// Those of the folder `root`. They inform people and save reading, and no result depends on them: unreadable ones
    /// are started anew.
    pub fn read(root: &Path) -> Self {
        read_json(&root.join(TIMINGS_FILE)).unwrap_or_default()
    }

    /// The total time that the stage was at work, seconds; `None` if unknown, such as after an interruption.
    pub(super) fn seconds_spent(&self, stage: &StageKind) -> Option<f64> {
        self.stages.get(stage.name)?.iter().map(|timing| timing.seconds).sum()
    }

    /// By output of a finished stage, a hash of the times at which its large files were written that were seen whole.
    pub(super) fn times_seen(&self, stage: &StageKind) -> BTreeMap<String, String> {
        self.outputs.get(stage.name).cloned().unwrap_or_default()
    }
}

/// Keeps `timings.json`.
pub(super) struct StageClock<'a> {
    root: &'a Path,
    timings: Timings,
    began: Instant,
}

impl<'a> StageClock<'a> {
    pub(super) fn open(root: &'a Path) -> Self {
        Self { root, timings: Timings::read(root), began: Instant::now() }
    }

    pub(super) fn begin(&mut self, stage: &StageKind) -> anyhow::Result<()> {
        self.began = Instant::now();
        self.timings.stages.entry(stage.to_string()).or_default().push(StageTiming {
            started: utc_now(),
            finished: None,
            seconds: None,
            n_threads: rayon::current_num_threads(),
            peak_memory_bytes: None,
        });
        self.save()
    }

    /// Marks the end of the stage that began last.
    pub(super) fn end(&mut self, stage: &StageKind) -> anyhow::Result<()> {
        let Some(entry) = self.timings.stages.entry(stage.to_string()).or_default().last_mut() else {
            return self.begin(stage);
        };
        entry.finished = Some(utc_now());
        entry.seconds = Some(self.began.elapsed().as_secs_f64());
        entry.peak_memory_bytes = peak_memory_bytes();
        self.save()
    }

    /// Notes that the outputs of a stage were seen whole.
    pub(super) fn keep_times(&mut self, record: &StageRecord) -> anyhow::Result<()> {
        let before = self.timings.outputs.insert(record.stage.to_string(), record.times.clone());
        if before.unwrap_or_default() == record.times { Ok(()) } else { self.save() }
    }

    fn save(&self) -> anyhow::Result<()> {
        write_record(&self.root.join(TIMINGS_FILE), &self.timings)?;
        Ok(())
    }
}
