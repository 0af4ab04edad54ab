//! Are particles and optimized noise the same bytes whatever the threads, workers and interruptions, and again for any row?

use crate::support::{Workspace, assert_same, djinn, files, start};
use djinn::pipeline::stages::SampleManifest;
use djinn::store::sample_ids;
use std::time::Duration;

const SWEEPS: &str = r#"generate.sweeps=[
    { name = "particles", behavior = "cut_in", classifier_scope = "none", n_scenes = 3, n_samples = 4,
      strengths = [0.0, 5.0], guidance = { sigma_hi = 30.0 }, aim = "feasible", objectives = [{ kind = "cut_in" }],
      sampler = { kind = "dpmpp_2m", n_steps = 3, eta = 1.0 }, particles = { n = 2, strength = 10.0 } },
    { name = "optimized", behavior = "cut_in", classifier_scope = "none", n_scenes = 3, n_samples = 2,
      aim = "feasible", objectives = [{ kind = "cut_in" }], sampler = { kind = "euler", n_steps = 2 },
      noise_optimization = { iterations = 2 } },
]"#;

#[test]
fn steered_samples_are_the_same_bytes_however_they_are_made() {
    let workspace = Workspace::new();
    // Inline tables end with their line.
    let sweeps = SWEEPS.split_whitespace().collect::<Vec<_>>().join(" ");
    let settings = &["--set", sweeps.as_str(), "--set", "generate.scenes_per_shard=1"][..];
    let run = |output: &str, more: &[&str]| workspace.run(output, &[settings, more].concat()).expect(0);
    run("one", &["--threads", "1"]);
    let expected = files(&workspace.run_folder("one"));
    let rows = expected.keys().filter(|name| name.starts_with("samples/samples-")).count();
    assert!(rows >= 6, "{:?}", expected.keys());

    // Killed on the way, on two threads.
    let args = workspace.run_args("two", &[settings, &["--threads", "2"]].concat());
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    for moment in [1500, 2500, 700] {
        let mut child = start(&args);
        std::thread::sleep(Duration::from_millis(moment));
        child.kill().unwrap();
        child.wait().unwrap();
    }
    run("two", &["--threads", "2"]);
    assert_same(&expected, &files(&workspace.run_folder("two")));

    // By two workers, the second one first.
    let stages = ["ingest", "mine", "train_denoiser", "train_classifier"];
    stages.iter().for_each(|stage| _ = run("parts", &["--stage", stage]));
    let part = |more: &[&str]| run("parts", &[&["--stage", "generate", "--part"], more].concat());
    part(&["plan"]);
    part(&["work", "--worker", "2/2"]);
    part(&["work", "--worker", "1/2"]);
    part(&["seal"]);
    ["evaluate", "report"].iter().for_each(|stage| _ = run("parts", &["--stage", stage]));
    assert_same(&expected, &files(&workspace.run_folder("parts")));

    let root = workspace.run_folder("one");
    let samples = root.join("samples");
    let shards = SampleManifest::read(&samples).unwrap().shards;
    let ids = shards.iter().flat_map(|shard| sample_ids(&samples.join(&shard.file)).unwrap());
    let mut n_again = 0;
    for id in ids.step_by(3) {
        let again = djinn(&["regenerate", &id, "--from", root.to_str().unwrap()]).expect(0);
        assert!(again.stdout.starts_with("identical"), "{}", again.stdout);
        n_again += 1;
    }
    assert!(n_again >= 6, "{n_again}");
}
