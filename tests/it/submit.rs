//! The jobs that submitting a pipeline hands to Slurm, and the view of a run from outside.

use crate::support::{Workspace, command, djinn};
use std::os::unix::fs::PermissionsExt;
use std::process::Output;

/// Submits the small pipeline with an `sbatch` that writes down what it gets and behaves like `answer`.
fn submit(workspace: &Workspace, answer: &str, more: &[&str]) -> Output {
    let (bin, pipeline, out) = (workspace.path("bin"), workspace.arg("small.toml"), workspace.arg("out"));
    fs_err::create_dir_all(&bin).unwrap();
    let calls = workspace.arg("calls");
    let stub =
        format!("#!/bin/bash\necho \"$@\" >> {calls}.txt\nn=$(wc -l < {calls}.txt)\ncat > {calls}.$n.sh\n{answer}\n");
    fs_err::write(bin.join("sbatch"), &stub).unwrap();
    fs_err::set_permissions(bin.join("sbatch"), PermissionsExt::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", bin.display(), std::env::var("PATH").unwrap());
    let args = [&["submit", &pipeline, "--output", &out, "--engine"][..], more].concat();
    command(&args).env("PATH", path).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

#[test]
fn jobs_are_submitted_with_what_they_wait_for() {
    let workspace = Workspace::new();
    let printed = submit(&workspace, "exit 1", &["slurm", "--workers", "3", "--dry-run"]);
    let printed = text(&printed.stdout);
    assert!(printed.contains("### seal: when plan has succeeded and work has ended"), "{printed}");
    assert!(!workspace.path("calls.txt").exists() && !workspace.path("out").exists(), "a dry run does nothing");

    let output =
        submit(&workspace, "echo $((100 + n))", &["slurm", "--workers", "3", "--set", "cluster.partition=night"]);
    assert_eq!(
        (output.status.code(), text(&output.stdout).as_str()),
        (
            Some(0),
            "prepare\t101\nplan\t102\nwork\t103\nseal\t104\nevaluate-plan\t105\nevaluate-work\t106\n\
             evaluate-seal\t107\nfinish\t108\n"
        )
    );
    assert!(text(&output.stderr).contains("djinn status"), "{}", text(&output.stderr));
    let calls = fs_err::read_to_string(workspace.path("calls.txt")).unwrap();
    let expected = [
        "--parsable",
        "--parsable --dependency=afterok:101 --kill-on-invalid-dep=yes",
        "--parsable --dependency=afterok:102 --kill-on-invalid-dep=yes",
        "--parsable --dependency=afterok:102,afterany:103 --kill-on-invalid-dep=yes",
        "--parsable --dependency=afterok:104 --kill-on-invalid-dep=yes",
        "--parsable --dependency=afterok:105 --kill-on-invalid-dep=yes",
        "--parsable --dependency=afterok:105,afterany:106 --kill-on-invalid-dep=yes",
        "--parsable --dependency=afterok:107 --kill-on-invalid-dep=yes",
    ];
    assert_eq!(calls.lines().collect::<Vec<_>>(), expected);
    let work = fs_err::read_to_string(workspace.path("calls.3.sh")).unwrap();
    for part in ["#SBATCH --array=1-3\n", "#SBATCH --partition=night\n", "--worker \"$SLURM_ARRAY_TASK_ID\"/3 &\n"] {
        assert!(work.contains(part), "`{part}` is not in\n{work}");
    }
    assert!(workspace.run_folder("out").join("slurm").is_dir(), "Slurm makes no folders for what jobs print");

    // The jobs as JSON, in which --workers is as good as the setting.
    let graph = submit(&workspace, "exit 1", &["json", "--set", "cluster.workers=5"]);
    let graph: serde_json::Value = serde_json::from_slice(&graph.stdout).unwrap();
    assert_eq!((graph["jobs"][2]["name"].as_str(), graph["jobs"][2]["workers"].as_u64()), (Some("work"), Some(5)));
}

#[test]
fn a_refusal_names_what_was_submitted_before_it() {
    let workspace = Workspace::new();
    let answer =
        "[ $n -lt 3 ] && echo \"$((100 + n));east\" && exit\necho 'sbatch: error: invalid account' >&2\nexit 1";
    let output = submit(&workspace, answer, &["slurm"]);
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("refused a job: sbatch: error: invalid account"), "{said}");
    assert!(said.contains("scancel 101 102"), "{said}");
    // Mistakes are found before anything is handed over, and so is that there is no Slurm.
    let output = submit(&workspace, "exit 1", &["slurm", "--set", "generate.sweeps.0.n_scenes=0"]);
    assert!(output.status.code() == Some(1) && text(&output.stderr).contains("n_scenes"), "{}", text(&output.stderr));
    let missing =
        command(&["submit", &workspace.arg("small.toml"), "--engine", "slurm", "--output", &workspace.arg("out")])
            .env("PATH", workspace.path("nowhere"))
            .output()
            .unwrap();
    assert!(missing.status.code() == Some(1), "{}", text(&missing.stderr));
    assert!(text(&missing.stderr).contains("--dry-run"), "{}", text(&missing.stderr));
}

#[test]
fn the_state_of_a_run_is_seen_from_its_folder() {
    let workspace = Workspace::new();
    let folder = workspace.run_folder("out");
    let folder = folder.to_str().unwrap();
    assert!(djinn(&["status", folder]).expect(1).stderr.contains("is not a run folder"));
    let stages = ["--stage", "ingest", "--stage", "mine", "--stage", "train_denoiser", "--stage", "train_classifier"];
    workspace.run("out", &stages).expect(0);
    workspace.run("out", &["--stage", "generate", "--part", "plan"]).expect(0);
    let said = djinn(&["status", folder]).expect(0).stdout;
    for part in
        ["ingest            done\n", "generate          begun\n", "shards            0 of 4 done, 0 running, 4 missing"]
    {
        assert!(said.contains(part), "`{part}` is not in\n{said}");
    }
    workspace.run("out", &["--stage", "generate", "--part", "work", "--worker", "1/1"]).expect(0);
    let printed = djinn(&["status", folder, "--json"]).expect(0).stdout;
    let status: serde_json::Value = serde_json::from_str(&printed).unwrap();
    assert_eq!((status["shards"]["n_done"].as_u64(), status["shards"]["n_missing"].as_u64()), (Some(4), Some(0)));
}
