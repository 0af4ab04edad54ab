//! The `[cluster]` section: how many workers, and what their jobs need.

use crate::settings;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The notice that a job gets before the end of its time, seconds: enough for a step of training and saving its state.
pub(super) const NOTICE_S: u32 = 120;

/// How a pipeline is submitted to a cluster (`djinn submit`). Results do not depend on it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ClusterConfig {
    /// Number of jobs that sample, or measure, at once.
    #[schemars(range(min = 1, max = 100_000))]
    pub workers: usize,
    /// How often a job that was stopped or died is started again. A training that exceeds the time limit needs one
    /// retry for each further time limit.
    #[schemars(range(max = 1_000))]
    pub retries: u32,
    /// The partition of Slurm; empty: its default partition.
    pub partition: String,
    /// The time limit of a job as Slurm writes it, such as `04:00:00`; empty: the partition's.
    pub time: String,
    /// GPUs of each job that computes with networks.
    #[schemars(range(max = 64))]
    pub gpus: u32,
    /// Processor cores of each job, and the number of its threads; 0: what the partition gives.
    #[schemars(range(max = 1_024))]
    pub cpus: u32,
    /// Memory of each job as Slurm writes it, such as `16G`; empty: the partition's.
    pub memory: String,
    /// What runs the program in a container, such as `apptainer exec --nv /images/djinn.sif djinn`; empty:
    /// the program that submits.
    pub container: String,
    /// More lines of Slurm's scripts, such as `#SBATCH --account=traffic` or `module load cuda`.
    pub lines: Vec<String>,
}

impl Default for ClusterConfig {
    fn default() -> Self {
        Self {
            workers: 4,
            retries: 10,
            partition: String::new(),
            time: String::new(),
            gpus: 0,
            cpus: 0,
            memory: String::new(),
            container: String::new(),
            lines: Vec::new(),
        }
    }
}

impl ClusterConfig {
    /// Refuses texts that would break the scripts.
    pub fn validate(&self) -> settings::Result {
        for (key, word) in [("partition", &self.partition), ("time", &self.time), ("memory", &self.memory)] {
            settings::printable(key, word)?;
            if word.contains(char::is_whitespace) {
                return Err(settings::Issue::new(key, format_args!("is \"{word}\", expected one word")));
            }
        }
        settings::printable("container", &self.container)?;
        for (i, line) in self.lines.iter().enumerate() {
            settings::printable(&format!("lines.{i}"), line)?;
        }
        Ok(())
    }
}
