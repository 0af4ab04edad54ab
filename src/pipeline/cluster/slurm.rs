//! The jobs as scripts for Slurm's `sbatch`.
//!
//! A script starts the program, passes signals on to it, and requeues its job if the program was stopped or died, as
//! often as the configuration allows. Nothing depends on a signal: some sites send none, and other workers sample the
//! shards of a killed one.

use super::config::NOTICE_S;
use super::feed::{complaint, feed};
use super::jobs::WORKER;
use super::{ClusterConfig, Completion, Job, JobGraph};
use crate::engine::{Classify, Failure, Result};
use crate::files::for_shell;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;

/// The folder of the jobs' outputs, in the run folder.
const OUTPUTS: &str = "slurm";

/// The body of each script: it runs the command, passes signals on and requeues the job.
const BODY: &str = include_str!("job.sh");

/// A submitted job.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Submitted {
    /// Its name.
    pub name: &'static str,
    /// Its number in Slurm.
    pub id: String,
}

/// The script of a job.
pub fn script(graph: &JobGraph, job: &Job, cluster: &ClusterConfig) -> String {
    let number = if job.workers.is_some() { "%A_%a" } else { "%j" };
    let output = graph.run_folder.join(OUTPUTS).join(format!("{}-{number}.txt", job.name));
    let mut directives = vec![
        format!("--job-name={}", for_shell(&format!("djinn-{}-{}", graph.pipeline, job.name))),
        format!("--chdir={}", for_shell(&graph.directory.to_string_lossy())),
        format!("--output={}", for_shell(&graph.directory.join(output).to_string_lossy())),
        "--open-mode=append".to_owned(),
        "--requeue".to_owned(),
        format!("--signal=B:USR1@{NOTICE_S}"),
    ];
    directives.extend(job.workers.map(|n_workers| format!("--array=1-{n_workers}")));
    let known = [("partition", &cluster.partition), ("time", &cluster.time), ("mem", &cluster.memory)];
    directives
        .extend(known.iter().filter(|(_, value)| !value.is_empty()).map(|(key, value)| format!("--{key}={value}")));
    directives.extend((cluster.cpus > 0).then(|| format!("--cpus-per-task={}", cluster.cpus)));
    directives.extend((job.computes && cluster.gpus > 0).then(|| format!("--gres=gpu:{}", cluster.gpus)));
    let mut text = "#!/bin/bash\n".to_owned();
    for directive in directives {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "#SBATCH {directive}");
    }
    // Slurm reads directives up to the first command.
    let (more, commands): (Vec<&String>, Vec<&String>) =
        cluster.lines.iter().partition(|line| line.starts_with("#SBATCH"));
    more.into_iter().chain(commands).for_each(|line| text.push_str(&format!("{line}\n")));
    let words: Vec<String> = job.command.iter().map(|word| shell_word(word)).collect();
    let body = BODY.replace("@RETRIES@", &graph.retries.to_string());
    text.push_str(&format!("\n{}", body.replace("@COMMAND@", &words.join(" "))));
    text
}

/// Submits the jobs to Slurm, each with its dependencies. Returns them with the numbers that Slurm assigned.
///
/// # Errors
/// When `sbatch` cannot be started or refuses a job.
pub fn submit(graph: &JobGraph, cluster: &ClusterConfig) -> Result<Vec<Submitted>> {
    fs_err::create_dir_all(graph.directory.join(&graph.run_folder).join(OUTPUTS)).blame_input()?;
    let mut ids: BTreeMap<&str, String> = BTreeMap::new();
    let mut submitted = Vec::new();
    for job in &graph.jobs {
        let mut args = vec!["--parsable".to_owned()];
        if !job.after.is_empty() {
            let dependency = |after: &super::Dependency| {
                let condition = match after.condition {
                    Completion::Succeeded => "afterok",
                    Completion::Ended => "afterany",
                };
                ids.get(after.job).map(|id| format!("{condition}:{id}"))
            };
            let dependencies: Vec<String> = job.after.iter().filter_map(dependency).collect();
            args.push(format!("--dependency={}", dependencies.join(",")));
            // Without this, a job whose dependency failed would wait forever.
            args.push("--kill-on-invalid-dep=yes".to_owned());
        }
        let id = sbatch(&args, &script(graph, job, cluster)).map_err(|failure| {
            let earlier: Vec<&str> = submitted.iter().map(|Submitted { id, .. }| id.as_str()).collect();
            match earlier.is_empty() {
                true => failure,
                false => failure.with_hint(format!(
                    "jobs were submitted before it, and `scancel {}` cancels them",
                    earlier.join(" ")
                )),
            }
        })?;
        ids.insert(job.name, id.clone());
        submitted.push(Submitted { name: job.name, id });
    }
    Ok(submitted)
}

/// Submits a script. Returns the number of the job.
fn sbatch(args: &[String], script: &str) -> Result<String> {
    let output = feed("sbatch", "Slurm's command that submits jobs", args, script)?;
    let said = String::from_utf8_lossy(&output.stdout);
    // `1234` or, in a federation, `1234;cluster`.
    let id = said.trim().split(';').next().unwrap_or_default();
    let is_id = !id.is_empty() && id.bytes().all(|byte| byte.is_ascii_digit());
    if output.status.success() && is_id {
        return Ok(id.to_owned());
    }
    Err(Failure::input_message(format_args!("sbatch {} refused a job: {}", args.join(" "), complaint(&output))))
}

/// All scripts, for people to read.
pub fn describe(graph: &JobGraph, cluster: &ClusterConfig) -> String {
    let mut text = String::new();
    for job in &graph.jobs {
        let after: Vec<String> = (job.after.iter())
            .map(|after| match after.condition {
                Completion::Succeeded => format!("{} has succeeded", after.job),
                Completion::Ended => format!("{} has ended", after.job),
            })
            .collect();
        let when = if after.is_empty() { "at once".to_owned() } else { format!("when {}", after.join(" and ")) };
        let _ = write!(text, "### {}: {when}\n{}\n", job.name, script(graph, job, cluster));
    }
    text
}

/// A word of a command. The number of a worker becomes the index of the job in its array.
fn shell_word(word: &str) -> String {
    let with_number = word.split(WORKER).map(for_shell).collect::<Vec<_>>().join("\"$SLURM_ARRAY_TASK_ID\"");
    if word.contains(WORKER) { with_number.replace("''", "") } else { with_number }
}

/// The folder of the jobs' outputs.
pub fn outputs(graph: &JobGraph) -> PathBuf {
    graph.run_folder.join(OUTPUTS)
}
