//! Which jobs does a pipeline come to, and which waits for which?

use super::ClusterConfig;
use crate::pipeline::config::PipelineConfig;
use crate::pipeline::parts;
use crate::pipeline::{Result, StageId};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Where a worker's number, from 1, stands in a command.
pub(super) const WORKER: &str = "{worker}";

/// What is submitted.
#[derive(Debug)]
pub struct Submission<'a> {
    /// The pipeline file.
    pub pipeline: &'a Path,
    /// Overrides of its settings.
    pub overrides: &'a [String],
    /// The name of the run.
    pub run: &'a str,
    /// The folder of the run.
    pub root: &'a Path,
    /// The configuration, overrides among it.
    pub config: &'a PipelineConfig,
}

/// The jobs, in an order in which each comes after those that it waits for.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct JobGraph {
    /// The name of the pipeline.
    pub pipeline: String,
    /// The folder in which the commands run: relative paths begin there.
    pub directory: PathBuf,
    /// The folder of the run.
    pub run_folder: PathBuf,
    /// How often a job may be started again.
    pub retries: u32,
    /// Exit codes with which a job has come to its end. With 75 it was stopped or has nothing to begin with yet; with that and all
    /// others it is to be started again.
    pub final_exit_codes: [u8; 3],
    /// The jobs.
    pub jobs: Vec<Job>,
}

/// A command that one process runs, or several with a number each.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Job {
    /// Its name.
    pub name: &'static str,
    /// The program and its arguments. `{worker}` stands for the number of the worker, from 1.
    pub command: Vec<String>,
    /// Number of workers; `None` for one process without a number.
    pub workers: Option<usize>,
    /// Whether it computes with networks.
    pub computes: bool,
    /// What it waits for.
    pub after: Vec<Dependency>,
}

/// A job that another one waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Dependency {
    /// Its name.
    pub job: &'static str,
    /// How it must have ended.
    pub condition: Condition,
}

/// How a job must have ended for the next one to begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Condition {
    /// With exit code 0.
    Succeeded,
    /// Anyhow: the next job looks by itself whether everything is there. One of many workers may be lost without harm.
    Ended,
}

impl JobGraph {
    /// The jobs of a submission.
    ///
    /// # Errors
    /// When the current folder or the program cannot be found.
    pub fn new(submission: &Submission<'_>, cluster: &ClusterConfig) -> Result<Self> {
        let Submission { config, .. } = submission;
        let command = Command::new(submission, cluster)?;
        let stages: Vec<StageId> =
            StageId::ALL.into_iter().filter(|stage| (stage.facts().is_configured)(config)).collect();
        // Requests decide as they go: one process samples for them.
        let has_parts = config.generate.as_ref().is_some_and(|generate| !generate.sweeps.is_empty());
        let mut jobs = Vec::new();
        let mut add = |name, stages: &[StageId], args: &[&str], workers, after: &[Dependency]| {
            let selection = stages.iter().flat_map(|stage| ["--stage", stage.name()]);
            let args: Vec<&str> = selection.chain(args.iter().copied()).collect();
            let computes = stages.is_empty() || stages.iter().any(|stage| stage.computes());
            jobs.push(Job { name, command: command.with(&args), workers, computes, after: after.to_vec() });
        };
        let succeeded = |job| Dependency { job, condition: Condition::Succeeded };
        if has_parts {
            let (before, rest): (Vec<StageId>, Vec<StageId>) =
                stages.into_iter().partition(|stage| *stage < parts::STAGE);
            let rest: Vec<StageId> = rest.into_iter().filter(|stage| *stage != parts::STAGE).collect();
            if !before.is_empty() {
                add("prepare", &before, &[], None, &[]);
            }
            let generate = [parts::STAGE];
            let after_prepare = [succeeded("prepare")];
            add("plan", &generate, &["--part", "plan"], None, if before.is_empty() { &[] } else { &after_prepare });
            let number = format!("{WORKER}/{}", cluster.workers);
            let work = ["--part", "work", "--worker", &number];
            add("work", &generate, &work, Some(cluster.workers), &[succeeded("plan")]);
            let ended = Dependency { job: "work", condition: Condition::Ended };
            add("seal", &generate, &["--part", "seal"], None, &[succeeded("plan"), ended]);
            if !rest.is_empty() {
                add("finish", &rest, &[], None, &[succeeded("seal")]);
            }
        } else {
            add("run", &[], &[], None, &[]);
        }
        Ok(Self {
            pipeline: config.run.name.clone(),
            directory: std::env::current_dir()?,
            run_folder: submission.root.to_owned(),
            retries: cluster.retries,
            final_exit_codes: [0, 1, 3],
            jobs,
        })
    }
}

/// `djinn run` with what all jobs have in common.
struct Command {
    words: Vec<String>,
}

impl Command {
    fn new(submission: &Submission<'_>, cluster: &ClusterConfig) -> Result<Self> {
        let Submission { pipeline, overrides, run, config, .. } = submission;
        let mut words: Vec<String> = cluster.container.split_whitespace().map(str::to_owned).collect();
        if words.is_empty() {
            words.push(std::env::current_exe()?.to_string_lossy().into_owned());
        }
        words.extend(["run".to_owned(), pipeline.to_string_lossy().into_owned()]);
        words.extend(overrides.iter().flat_map(|set| ["--set".to_owned(), set.clone()]));
        words.extend(["--output".to_owned(), config.run.output.to_string_lossy().into_owned()]);
        words.extend(["--run".to_owned(), (*run).to_owned()]);
        if cluster.cpus > 0 {
            words.extend(["--threads".to_owned(), cluster.cpus.to_string()]);
        }
        Ok(Self { words })
    }

    fn with(&self, args: &[&str]) -> Vec<String> {
        self.words.iter().cloned().chain(args.iter().map(|arg| (*arg).to_owned())).collect()
    }
}
