//! Which jobs does a pipeline need, and which of them wait for which?

use super::ClusterConfig;
use crate::engine::{Failure, Result};
use crate::generate::RequestConfig;
use crate::pipeline::StageId;
use crate::pipeline::config::PipelineConfig;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// With this many shards per worker and round, workers wait only briefly at the end of a round.
const SHARDS_PER_WORKER: usize = 4;
/// Stands for a worker's number, from 1, in a command.
pub(super) const WORKER: &str = "{worker}";

/// A pipeline and how it is submitted.
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
    /// The configuration, with the overrides applied.
    pub config: &'a PipelineConfig,
}

/// The jobs; each comes after those that it waits for.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct JobGraph {
    /// The name of the pipeline.
    pub pipeline: String,
    /// The folder in which the commands run; relative paths are relative to it.
    pub directory: PathBuf,
    /// The folder of the run.
    pub run_folder: PathBuf,
    /// How often a job may be started again.
    pub retries: u32,
    /// Exit codes that are final. 75 means that the job was stopped or that an input is not ready yet; after 75 and all
    /// other codes the job is started again.
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
    /// The jobs that it waits for.
    pub after: Vec<Dependency>,
}

/// A job that another one waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Dependency {
    /// Its name.
    pub job: &'static str,
    /// How it must have ended.
    pub condition: Completion,
}

/// How a job must have ended for the next one to begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Completion {
    /// With exit code 0.
    Succeeded,
    /// Ended in any way: the next job checks for itself that its inputs exist, and losing one of many workers does no
    /// harm.
    Ended,
}

impl JobGraph {
    /// The jobs of a submission.
    ///
    /// # Errors
    /// When the current folder or the program cannot be found, and when the name of a folder cannot stand in a script.
    pub fn new(submission: &Submission<'_>, cluster: &ClusterConfig) -> Result<Self> {
        let Submission { config, .. } = submission;
        let directory = std::env::current_dir()?;
        // The text after a line break in a directive of a script would be a command.
        let holds_control = |path: &&&Path| path.to_string_lossy().contains(char::is_control);
        if let Some(path) = [&directory, submission.root].iter().find(holds_control) {
            let message =
                format!("{path:?} has a line break or another control character in its name, and jobs would run there");
            return Err(Failure::input_message(message).with_hint("submit from, and to, folders with other names"));
        }
        let command = Command::new(submission, cluster)?;
        let stages: Vec<StageId> = StageId::ALL.into_iter().filter(|stage| stage.is_configured(config)).collect();
        let mut jobs = Jobs { command, n_workers: cluster.workers, jobs: Vec::new() };
        let mut alone: Vec<StageId> = Vec::new();
        for stage in stages {
            match names_in_parts(stage, cluster.workers) {
                None => alone.push(stage),
                Some(names) => {
                    jobs.add_alone("prepare", &std::mem::take(&mut alone));
                    jobs.add_parts(stage, names);
                }
            }
        }
        match jobs.jobs.is_empty() {
            true => jobs.add("run", &[], &[], None, Vec::new()),
            false => jobs.add_alone("finish", &alone),
        }
        Ok(Self {
            pipeline: config.run.name.clone(),
            directory,
            run_folder: submission.root.to_owned(),
            retries: cluster.retries,
            final_exit_codes: [0, 1, 3],
            jobs: jobs.jobs,
        })
    }
}

/// Warns of settings that make poor use of the workers.
pub fn cautions(config: &PipelineConfig, cluster: &ClusterConfig) -> Vec<String> {
    let requests = config.generate.iter().flat_map(|generate| &generate.requests).enumerate();
    let enough = SHARDS_PER_WORKER * cluster.workers;
    let too_few = requests.filter(|(_, request)| cluster.workers > 1 && request.shards_per_round < enough);
    let caution = |(idx, request): (usize, &RequestConfig)| {
        format!(
            "request {} has {} shards a round for {} workers, most of which will be idle; {enough} or more keep them \
             busy (generate.requests.{idx}.shards_per_round, which changes what is sampled)",
            request.name, request.shards_per_round, cluster.workers
        )
    };
    too_few.map(caution).collect()
}

/// The names of the jobs of a stage that is run in parts; `None` for a stage that one process runs.
fn names_in_parts(stage: StageId, n_workers: usize) -> Option<[&'static str; 3]> {
    match stage {
        StageId::Generate => Some(["plan", "work", "seal"]),
        StageId::Evaluate if n_workers > 1 => Some(["evaluate-plan", "evaluate-work", "evaluate-seal"]),
        _ => None,
    }
}

/// A chain of jobs, each of which waits for those before it.
struct Jobs {
    command: Command,
    n_workers: usize,
    jobs: Vec<Job>,
}

impl Jobs {
    fn add_parts(&mut self, stage: StageId, [plan, work, seal]: [&'static str; 3]) {
        let (after, number) = (self.after_last(), format!("{WORKER}/{}", self.n_workers));
        let planned = Dependency { job: plan, condition: Completion::Succeeded };
        self.add(plan, &[stage], &["--part", "plan"], None, after);
        self.add(work, &[stage], &["--part", "work", "--worker", &number], Some(self.n_workers), vec![planned]);
        let ended = Dependency { job: work, condition: Completion::Ended };
        self.add(seal, &[stage], &["--part", "seal"], None, vec![planned, ended]);
    }

    /// Adds the job of one process that runs these stages, if there are any.
    fn add_alone(&mut self, name: &'static str, stages: &[StageId]) {
        if !stages.is_empty() {
            self.add(name, stages, &[], None, self.after_last());
        }
    }

    fn after_last(&self) -> Vec<Dependency> {
        let last = self.jobs.last();
        last.map(|job| Dependency { job: job.name, condition: Completion::Succeeded }).into_iter().collect()
    }

    /// Adds a job that runs these stages, or all of the pipeline if there are none.
    fn add(
        &mut self,
        name: &'static str,
        stages: &[StageId],
        args: &[&str],
        workers: Option<usize>,
        after: Vec<Dependency>,
    ) {
        let selection = stages.iter().flat_map(|stage| ["--stage", stage.name()]);
        let args: Vec<&str> = selection.chain(args.iter().copied()).collect();
        let computes = stages.is_empty() || stages.iter().any(|stage| stage.kind().computes);
        self.jobs.push(Job { name, command: self.command.with(&args), workers, computes, after });
    }
}

/// `djinn run` with the arguments that all jobs share.
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
