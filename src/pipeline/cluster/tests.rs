//! Which jobs wait for which, what do the scripts contain, and what do they do?

use super::{ClusterConfig, JobGraph, Submission, cautions, slurm};
use crate::engine::Blame;
use crate::pipeline::config::{PipelineConfig, parse};
use std::path::Path;
use std::process::Command;

const PIPELINE: &str = "[run]\nname = 'night drive'\n[ingest]\ndataset = 'interaction'\ninputs = ['a.zip']\n\
    [train.denoiser]\n[generate]\n\
    [[generate.sweeps]]\nname = 'plain'\n[evaluate]\n";
const CLUSTER: &str = "[cluster]\nworkers = 7\nretries = 3\npartition = 'gpu'\ntime = '04:00:00'\ngpus = 1\ncpus = 8\n\
    memory = '16G'\ncontainer = 'apptainer exec --nv /images/djinn.sif djinn'\n\
    lines = ['module load cuda', '#SBATCH --account=traffic']\n";

fn graph(text: &str, overrides: &[String]) -> (JobGraph, ClusterConfig) {
    let config: PipelineConfig = parse(None, text, &[]).unwrap();
    let cluster = config.cluster.clone().unwrap_or_default();
    let (pipeline, root) = (Path::new("own/night's.toml"), Path::new("/data/out/night drive/main"));
    let submission = Submission { pipeline, overrides, run: "main", root, config: &config };
    let graph = JobGraph { directory: "/home/ada".into(), ..JobGraph::new(&submission, &cluster).unwrap() };
    (graph, cluster)
}

#[test]
fn a_folder_whose_name_would_become_a_command_is_refused() {
    let config: PipelineConfig = parse(None, PIPELINE, &[]).unwrap();
    for root in ["/data/o\ntouch x\n#/main", "/data/\r/main", "/data/\u{1b}[2J/main"] {
        let (pipeline, root) = (Path::new("p.toml"), Path::new(root));
        let submission = Submission { pipeline, overrides: &[], run: "main", root, config: &config };
        let failure = JobGraph::new(&submission, &ClusterConfig::default()).unwrap_err();
        let said = format!("{failure:?}");
        assert!(failure.blame == Blame::Input && said.contains("line break"), "{said}");
        assert!(!said.contains(char::is_control), "{said}");
    }
}

/// Compares with a file; `DJINN_UPDATE_GOLDEN=1 cargo test --lib cluster::` rewrites it.
fn assert_golden(name: &str, found: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name);
    if std::env::var_os("DJINN_UPDATE_GOLDEN").is_some() {
        fs_err::write(&path, found).unwrap();
    }
    assert_eq!(found, fs_err::read_to_string(&path).unwrap());
}

#[test]
fn scripts_are_as_they_were_read_and_found_good() {
    let (graph, cluster) = graph(&format!("{PIPELINE}{CLUSTER}"), &["ingest.limit=10".to_owned()]);
    assert_golden("slurm.txt", &slurm::describe(&graph, &cluster));
}

#[test]
fn jobs_wait_for_what_they_read() {
    let names = |text: &str| graph(text, &[]).0.jobs.iter().map(|job| job.name).collect::<Vec<_>>();
    let of_evaluation = ["evaluate-plan", "evaluate-work", "evaluate-seal"];
    assert_eq!(names(PIPELINE), [&["prepare", "plan", "work", "seal"][..], &of_evaluation].concat());
    assert_eq!(names(&format!("{PIPELINE}[report]\n")).last(), Some(&"finish"));
    // One worker does not measure before one process would.
    let one = format!("{PIPELINE}[cluster]\nworkers = 1\n");
    assert_eq!(names(&one), ["prepare", "plan", "work", "seal", "finish"]);
    // Without stages in parts, one process runs all of them.
    assert_eq!(names("[ingest]\ndataset = 'interaction'\ninputs = ['a']\n[report]\n"), ["run"]);
    assert_eq!(names("[generate]\n[[generate.sweeps]]\nname = 'plain'\n"), ["plan", "work", "seal"]);
    assert_eq!(names("[mine]\n[evaluate]\n"), [&["prepare"][..], &of_evaluation].concat());
    let (graph, _) = graph(PIPELINE, &[]);
    let computing: Vec<&str> = graph.jobs.iter().filter(|job| job.computes).map(|job| job.name).collect();
    assert_eq!(computing, ["prepare", "plan", "work", "seal"], "evaluation needs no GPU");
    let json = serde_json::to_value(&graph).unwrap();
    assert_eq!(json["final_exit_codes"], serde_json::json!([0, 1, 3]));
    assert_eq!(json["jobs"][2]["workers"], 4);
    let expected =
        serde_json::json!([{"job": "plan", "condition": "succeeded"}, {"job": "work", "condition": "ended"}]);
    assert_eq!(json["jobs"][3]["after"], expected);
    let command = json["jobs"][2]["command"].as_array().unwrap();
    assert!(
        command.ends_with(&["--part".into(), "work".into(), "--worker".into(), "{worker}/4".into()]),
        "{command:?}"
    );
}

#[test]
fn rounds_too_small_for_the_workers_are_told() {
    let request = "[[generate.arms]]\nname = 'plain'\n[[generate.requests]]\nname = 'tight'\nbehavior = 'cut_in'\n\
        buckets = { gap_m = [0, 10] }\nper_bucket = 1\narms = ['plain']\nbudget = { n_samples = 9 }\n";
    let said = |more: &str, workers: usize| {
        let text = format!("[generate]\n{request}{more}[cluster]\nworkers = {workers}\n");
        let config: PipelineConfig = parse(None, &text, &[]).unwrap();
        cautions(&config, &config.cluster.clone().unwrap())
    };
    let [caution] = &said("", 7)[..] else { panic!("one request") };
    assert!(caution.starts_with("request tight has 4 shards a round for 7 workers") && caution.contains("28 or more"));
    assert!(caution.contains("generate.requests.0.shards_per_round"), "{caution}");
    assert!(said("", 1).is_empty() && said("shards_per_round = 28\n", 7).is_empty());
}

/// Runs the script of the workers with a program that ends in this way, and returns the exit code and what was queued
/// again.
#[cfg(unix)]
fn run_script(program: &str, restarts: &str, signal: Option<&str>) -> (i32, String) {
    let (graph, cluster) = graph(&format!("{PIPELINE}[cluster]\nretries = 3\ncontainer = 'djinn'\n"), &[]);
    let work = graph.jobs.iter().find(|job| job.name == "work").unwrap();
    run_text(&slurm::script(&graph, work, &cluster), program, restarts, signal)
}

/// [`run_script`] with the text of a script.
#[cfg(unix)]
fn run_text(script: &str, program: &str, restarts: &str, signal: Option<&str>) -> (i32, String) {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    // Two tasks, as Slurm starts them; it answers SIGTERM by killing them.
    let srun = "trap 'kill -9 $a $b' TERM; trap 'kill -USR1 $a $b' USR1\nwhile [[ $1 = --* ]]; do shift; done\n\
        SLURM_PROCID=0 \"$@\" & a=$!; SLURM_PROCID=1 \"$@\" & b=$!\n\
        worst=0; for task in $a $b; do while :; do wait $task; code=$?; kill -0 $task 2>/dev/null || break; done; \
        [ $code -gt $worst ] && worst=$code; done; exit $worst";
    let scontrol = "[ \"$1\" = show ] && echo one && echo two && exit; echo \"$@\" >> scontrol.txt";
    for (name, text) in [("djinn", program), ("scontrol", scontrol), ("srun", srun)] {
        fs_err::write(path(name), format!("#!/bin/bash\n{text}\n")).unwrap();
        fs_err::set_permissions(path(name), PermissionsExt::from_mode(0o755)).unwrap();
    }
    fs_err::write(path("job.sh"), script).unwrap();
    let variables = [("SLURM_JOB_ID", "13"), ("SLURM_ARRAY_JOB_ID", "12"), ("SLURM_ARRAY_TASK_ID", "3")];
    let path_variable = format!("{}:{}", folder.path().display(), std::env::var("PATH").unwrap());
    let mut child = Command::new("bash")
        .arg("job.sh")
        .current_dir(folder.path())
        .env("PATH", path_variable)
        .env("SLURM_RESTART_COUNT", restarts)
        .envs(variables)
        .spawn()
        .unwrap();
    if let Some(signal) = signal {
        while !path("begun").exists() {
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        assert!(Command::new("kill").args(["-s", signal, &child.id().to_string()]).status().unwrap().success());
    }
    let code = child.wait().unwrap().code().unwrap();
    (code, fs_err::read_to_string(path("scontrol.txt")).unwrap_or_default())
}

#[cfg(unix)]
#[test]
fn a_job_that_was_stopped_or_died_is_queued_again_so_often_and_no_other() {
    let requeued = "requeue 12_3\n";
    for (code, queued) in [(0, ""), (1, ""), (2, requeued), (3, ""), (75, requeued), (137, requeued)] {
        assert_eq!(run_script(&format!("exit {code}"), "0", None), (code, queued.to_owned()));
    }
    assert_eq!(run_script("exit 75", "2", None), (75, requeued.to_owned()));
    assert_eq!(run_script("exit 75", "3", None), (75, String::new()), "so often and no more");
    assert_eq!(run_script("kill -9 $$", "0", None), (137, requeued.to_owned()));
    let found = run_script("[ \"${*: -1}\" = 3/4 ]; exit $?", "0", None);
    assert_eq!(found, (0, String::new()), "the number of the worker");
    // A notice from Slurm to the script reaches the program, and the script waits for it.
    let stops = "trap 'sleep 0.3; exit 75' TERM; touch begun; while :; do sleep 0.05; done";
    for signal in ["USR1", "TERM"] {
        assert_eq!(run_script(stops, "1", Some(signal)), (75, requeued.to_owned()), "{signal}");
    }
}
