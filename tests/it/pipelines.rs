//! Every pipeline in `tests/pipelines`: what it gave before, and the same bytes on one thread and on two, after being
//! killed, and by several workers.

use crate::golden;
use crate::support::{Workspace, assert_same, files, start, wait_for_part, write_all};
use std::collections::BTreeMap;
use std::process::Child;
use std::time::{Duration, Instant};

const N_WORKERS: usize = 3;
/// So many workers of a stage are killed.
const N_KILLS: usize = 3;
const IN_SHARDS: [&str; 2] = ["generate", "evaluate"];

fn start_run(workspace: &Workspace, output: &str, more: &[&str]) -> Child {
    start(&workspace.run_args(output, more).iter().map(String::as_str).collect::<Vec<_>>())
}

fn kill(child: &mut Child) {
    child.kill().unwrap();
    child.wait().unwrap();
}

/// Numbers from 0 to 1, the same ones from the same seed.
struct Draws(u64);

impl Draws {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as f64 / (1_u64 << 31) as f64
    }
}

/// Kills the run at moments that fall into different stages, as shares of the time that a whole run takes.
fn killed(workspace: &Workspace, whole: Duration, expected: &BTreeMap<String, Vec<u8>>) {
    for (attempt, moments) in [[0.05, 0.3, 0.3, 0.4], [0.5, 0.12, 0.2, 0.2]].iter().enumerate() {
        let output = format!("killed{attempt}");
        for share in moments {
            let mut child = start_run(workspace, &output, &[]);
            std::thread::sleep(whole.mul_f64(*share));
            kill(&mut child);
        }
        workspace.run(&output, &[]).expect(0);
        assert_same(expected, &files(&workspace.run_folder(&output)));
    }
}

/// Several workers make the shards of a stage. Of the processes that plan, work and seal some are killed.
fn in_parts(workspace: &Workspace, stage: &str, draws: &mut Draws) {
    let output = "workers";
    let part = |part: &str| ["--stage", stage, "--part", part].map(str::to_owned).to_vec();
    let begin = |args: Vec<String>| start_run(workspace, output, &args.iter().map(String::as_str).collect::<Vec<_>>());
    let to_its_end = |name: &str| workspace.run(output, &["--stage", stage, "--part", name]).expect(0);
    let mut planning = begin(part("plan"));
    std::thread::sleep(Duration::from_millis(200));
    kill(&mut planning);
    let began = Instant::now();
    to_its_end("plan");
    let typical = began.elapsed();

    let worker = |k: usize| format!("{}/{N_WORKERS}", k + 1);
    let begin_worker = |k: usize| begin([part("work"), vec!["--worker".to_owned(), worker(k)]].concat());
    let mut workers: Vec<Child> = (0..N_WORKERS).map(begin_worker).collect();
    for _ in 0..N_KILLS {
        std::thread::sleep(typical.mul_f64(0.2 + 1.5 * draws.next()));
        let k = (draws.next() * N_WORKERS as f64) as usize;
        kill(&mut workers[k]);
        workers[k] = begin_worker(k);
    }
    for worker in &mut workers {
        assert_eq!(worker.wait().unwrap().code(), Some(0));
    }
    let mut sealing = begin(part("seal"));
    std::thread::sleep(typical.mul_f64(draws.next()));
    kill(&mut sealing);
    to_its_end("seal");
    let folder = workspace.run_folder(output);
    assert!(!folder.join(format!("{stage}.parts")).exists());
    assert!(fs_err::read_to_string(folder.join("log.txt")).unwrap().contains("worker 00001: "));
    // A late worker finds nothing to do.
    workspace.run(output, &["--stage", stage, "--part", "work", "--worker", "1/2"]).expect(0);
}

/// A worker is killed after its first shard, and a single process goes on.
fn taken_over(workspace: &Workspace, stage: &str) {
    let (output, folder) = ("taken", workspace.run_folder("taken"));
    workspace.run(output, &["--stage", stage, "--part", "plan"]).expect(0);
    let mut worker = start_run(workspace, output, &["--stage", stage, "--part", "work", "--worker", "1/1"]);
    let shard = if stage == "generate" { "samples-00000.json" } else { "figures-00000.json" };
    wait_for_part(&folder, stage, shard);
    kill(&mut worker);
    workspace.run(output, &["--stage", stage]).expect(0);
    assert!(!folder.join(format!("{stage}.parts")).exists());
}

#[test]
fn every_pipeline_writes_the_same_bytes_however_it_is_run() {
    let mut paths: Vec<_> = fs_err::read_dir("tests/pipelines").unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    assert!(paths.len() > 1);
    for (idx, path) in paths.iter().enumerate() {
        let workspace = Workspace::of(&fs_err::read_to_string(path).unwrap());
        let began = Instant::now();
        workspace.run("whole", &["--threads", "1"]).expect(0);
        let whole = began.elapsed();
        let expected = files(&workspace.run_folder("whole"));
        assert!(expected.contains_key("corpus/manifest.json") && expected.contains_key("report.html"));
        golden::check(path.file_stem().unwrap().to_str().unwrap(), &workspace.run_folder("whole"));
        workspace.run("two", &["--threads", "2"]).expect(0);
        assert_same(&expected, &files(&workspace.run_folder("two")));
        killed(&workspace, whole, &expected);

        let before: Vec<&str> = ["ingest", "mine", "train_denoiser", "train_classifier"]
            .iter()
            .flat_map(|stage| ["--stage", stage])
            .collect();
        workspace.run("workers", &before).expect(0);
        write_all(&files(&workspace.run_folder("workers")), &workspace.run_folder("taken"));
        let mut draws = Draws(idx as u64);
        for stage in IN_SHARDS {
            in_parts(&workspace, stage, &mut draws);
            taken_over(&workspace, stage);
        }
        for output in ["workers", "taken"] {
            workspace.run(output, &["--stage", "report"]).expect(0);
            assert_same(&expected, &files(&workspace.run_folder(output)));
        }
    }
}
