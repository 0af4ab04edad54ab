//! Renders the jobs as a JobSet of Kubernetes: one object, with the dependencies between its jobs.
//!
//! Needs JobSet 0.8 or later, whose jobs can wait for each other, and Kubernetes 1.31 or later, where the success of
//! one worker can end its job. Older versions start jobs too early or too often, which does no harm: such a job ends
//! with 75.

use super::config::NOTICE_S;
use super::feed::{complaint, feed};
use super::jobs::WORKER;
use super::{ClusterConfig, Job, JobGraph};
use crate::engine::{Failure, Result};
use serde_json::{Value, json};
use std::path::Path;

/// The name of the program in the image, and of the objects that are named for it.
const PROGRAM: &str = "djinn";
/// The group of the image's user, which gets access to the volumes.
const GROUP: u32 = 65_532;
/// The number of a worker, from 0; Kubernetes substitutes it.
const INDEX: &str = "$(JOB_COMPLETION_INDEX)";
/// The longest name of a JobSet: names of pods have at most 63 characters, of which `-evaluate-work-0-99999-abcde`
/// takes 28.
const NAME_LETTERS: usize = 35;

/// The JobSet, as JSON, which `kubectl` reads like YAML.
///
/// # Errors
/// When the settings lack an image, or no volume holds the files.
pub fn manifest(graph: &JobGraph, cluster: &ClusterConfig) -> Result<String> {
    if cluster.image.is_empty() {
        return Err(Failure::input_message(
            "cluster.image is empty, expected the container image that Kubernetes runs",
        )
        .with_hint(
            "build one from the Containerfile, push it to a registry that the cluster can reach, and name it here",
        ));
    }
    let run_folder = graph.directory.join(&graph.run_folder);
    [graph.directory.as_path(), &run_folder].into_iter().try_for_each(|folder| is_mounted(folder, cluster))?;
    let memory = memory(&cluster.memory)?;
    let jobs: Vec<Value> =
        graph.jobs.iter().map(|job| replicated_job(graph, job, cluster, memory.as_deref())).collect();
    let mut metadata = json!({"name": name(graph), "labels": {"app.kubernetes.io/name": PROGRAM}});
    if !cluster.partition.is_empty() {
        metadata["labels"]["kueue.x-k8s.io/queue-name"] = json!(cluster.partition);
    }
    let document = json!({
        "apiVersion": "jobset.x-k8s.io/v1alpha2",
        "kind": "JobSet",
        "metadata": metadata,
        "spec": {"replicatedJobs": jobs},
    });
    Ok(format!("{document:#}\n"))
}

/// Submits the JobSet to Kubernetes. Returns the output of `kubectl`.
///
/// # Errors
/// As for [`manifest`], and if `kubectl` cannot be started or the cluster refuses the JobSet.
pub fn submit(graph: &JobGraph, cluster: &ClusterConfig) -> Result<String> {
    let args = ["apply", "-f", "-"].map(str::to_owned);
    let output = feed("kubectl", "the command that talks to Kubernetes", &args, &manifest(graph, cluster)?)?;
    let again = format!("if its jobs are finished, run `kubectl delete jobset {}`, and submit again", name(graph));
    let said = String::from_utf8_lossy(&output.stdout);
    if output.status.success() {
        return match said.contains("unchanged") {
            true => Err(Failure::input_message(format_args!("{} already exists", said.trim())).with_hint(again)),
            false => Ok(said.into_owned()),
        };
    }
    let why = complaint(&output);
    let failure = Failure::input_message(format_args!("kubectl {} failed: {why}", args.join(" ")));
    Err(match () {
        () if why.contains("no matches for kind") => failure.with_hint("install JobSet 0.8 or later in the cluster"),
        () if why.contains("immutable") => failure.with_hint(again),
        () => failure,
    })
}

/// The name of the JobSet: the name of the pipeline, cut to fit, and a hash of the run folder, so that no two run
/// folders share a name.
pub fn name(graph: &JobGraph) -> String {
    let folder = graph.directory.join(&graph.run_folder);
    let mark = &blake3::hash(folder.to_string_lossy().as_bytes()).to_hex()[..6];
    let letters: String = (graph.pipeline.to_lowercase().chars())
        .map(|c| if c.is_ascii_alphanumeric() { c } else { '-' })
        .take(NAME_LETTERS - PROGRAM.len() - mark.len() - 2)
        .collect();
    match letters.trim_matches('-') {
        "" => format!("{PROGRAM}-{mark}"),
        letters => format!("{PROGRAM}-{letters}-{mark}"),
    }
}

/// One job of the JobSet.
fn replicated_job(graph: &JobGraph, job: &Job, cluster: &ClusterConfig, memory: Option<&str>) -> Value {
    let n_pods = job.workers.unwrap_or(1);
    let mut spec = json!({
        "completionMode": "Indexed",
        "completions": n_pods,
        "parallelism": n_pods,
        "podFailurePolicy": {"rules": [
            {"action": "FailJob", "onExitCodes": {"operator": "In", "values": [1, 3]}},
            {"action": "Ignore", "onExitCodes": {"operator": "In", "values": [75]}},
            {"action": "Ignore", "onPodConditions": [{"type": "DisruptionTarget", "status": "True"}]},
        ]},
        "template": {"spec": pod(graph, job, cluster, memory)},
    });
    match job.workers {
        // A worker ends with 0 once every shard is finished or given up, so nothing is left for lost or late workers.
        Some(_) => {
            spec["backoffLimitPerIndex"] = json!(graph.retries);
            spec["successPolicy"] = json!({"rules": [{"succeededCount": 1}]});
        }
        None => spec["backoffLimit"] = json!(graph.retries),
    }
    let mut replicated = json!({"name": job.name, "replicas": 1, "template": {"spec": spec}});
    // A job of a JobSet can wait for only one other. The last dependency is enough, because it has waited for the
    // others.
    if let Some(last) = job.after.last() {
        replicated["dependsOn"] = json!([{"name": last.job, "status": "Complete"}]);
    }
    replicated
}

fn pod(graph: &JobGraph, job: &Job, cluster: &ClusterConfig, memory: Option<&str>) -> Value {
    let volume = |i: usize| format!("volume-{i}");
    let mounts = cluster.volumes.values().enumerate();
    let mounts: Vec<Value> = mounts.map(|(i, folder)| json!({"name": volume(i), "mountPath": folder})).collect();
    let claims = cluster.volumes.keys().enumerate();
    let claims: Vec<Value> =
        claims.map(|(i, claim)| json!({"name": volume(i), "persistentVolumeClaim": {"claimName": claim}})).collect();
    json!({
        "restartPolicy": "Never",
        "terminationGracePeriodSeconds": NOTICE_S,
        "securityContext": {
            "runAsNonRoot": true,
            "fsGroup": GROUP,
            "fsGroupChangePolicy": "OnRootMismatch",
            "seccompProfile": {"type": "RuntimeDefault"},
        },
        "containers": [{
            "name": PROGRAM,
            "image": cluster.image,
            "command": job.command.iter().map(|word| argument(word)).collect::<Vec<_>>(),
            "workingDir": graph.directory,
            "resources": resources(job, cluster, memory),
            "securityContext": {"allowPrivilegeEscalation": false, "capabilities": {"drop": ["ALL"]}},
            "volumeMounts": mounts,
        }],
        "volumes": claims,
    })
}

/// The resources of a pod. GPUs and memory get limits, cores only a request: using idle cores beyond it does no harm.
fn resources(job: &Job, cluster: &ClusterConfig, memory: Option<&str>) -> Value {
    let (mut requests, mut limits) = (json!({}), json!({}));
    if cluster.cpus > 0 {
        requests["cpu"] = json!(cluster.cpus.to_string());
    }
    if let Some(memory) = memory {
        requests["memory"] = json!(memory);
        limits["memory"] = json!(memory);
    }
    if job.computes && cluster.gpus > 0 {
        limits["nvidia.com/gpu"] = json!(cluster.gpus.to_string());
    }
    json!({"requests": requests, "limits": limits})
}

/// A word of a command, with every `$` escaped for Kubernetes except for the number of the worker.
fn argument(word: &str) -> String {
    word.replace('$', "$$").replace(WORKER, INDEX)
}

/// Converts memory from Slurm's notation (`16G`) to that of Kubernetes (`16Gi`). Without a unit, Slurm means megabytes.
/// `None` if nothing is set.
fn memory(text: &str) -> Result<Option<String>> {
    if text.is_empty() {
        return Ok(None);
    }
    let number = text.trim_end_matches(|c: char| "KMGTkmgt".contains(c));
    let unit = match text[number.len()..].to_uppercase().as_str() {
        "" => "M".to_owned(),
        unit => unit.to_owned(),
    };
    if unit.len() > 1 || number.is_empty() || !number.bytes().all(|byte| byte.is_ascii_digit()) {
        let expected = "expected a whole number with K, M, G or T, such as 16G";
        return Err(Failure::input_message(format_args!("cluster.memory is \"{text}\", {expected}")));
    }
    Ok(Some(format!("{number}{unit}i")))
}

/// Whether jobs find `folder`.
fn is_mounted(folder: &Path, cluster: &ClusterConfig) -> Result<()> {
    if cluster.volumes.values().any(|mounted| folder.starts_with(mounted)) {
        return Ok(());
    }
    let volumes: Vec<String> = cluster.volumes.iter().map(|(claim, mounted)| format!("{claim} at {mounted}")).collect();
    let volumes = if volumes.is_empty() { "none".to_owned() } else { volumes.join(", ") };
    let message =
        format_args!("{} is in none of the volumes of the jobs (cluster.volumes: {volumes})", folder.display());
    Err(Failure::input_message(message).with_hint(
        "submit from a folder in a volume, and name its claim and mount path: \
         cluster.volumes = { CLAIM = \"/FOLDER\" }",
    ))
}
