//! Does a pipeline train a denoiser that is conditioned on mined events, distill it, and use both for events in sweeps
//! and requests?

use crate::support::{SMALL_PIPELINE, Workspace, assert_same, djinn, files};
use djinn::model::DenoiserSpec;
use djinn::nn::read_checkpoint;
use djinn::pipeline::stages::{SampleManifest, read_requests};
use djinn::scenario::ScenarioRecord;
use djinn::store::SceneStore;
use std::collections::BTreeMap;
use std::path::Path;

const EVENTS: &str = "events = { behaviors = [\"cut_in_paper\"], share = 0.5 }";

const SAMPLING: &str = r#"
[[generate.sweeps]]
name = "told"
behavior = "cut_in_paper"
n_scenes = 3
n_samples = 2
pairs = { only_feasible = false }
classifier_free = { event = true, weights = [0.0, 1.0, 2.0] }

[[generate.sweeps]]
name = "distilled"
model = "distilled"
sampler = { kind = "euler", n_steps = 2 }
behavior = "cut_in_paper"
n_scenes = 2
n_samples = 2
pairs = { only_feasible = false }
classifier_free = { event = true }
strengths = [2.0]
classifier_scope = "none"
objectives = [{ kind = "target_speed", agents = "ego", speed_mps = 5.0 }]

[[generate.arms]]
name = "unguided"
n_samples = 2

[[generate.arms]]
name = "told"
n_samples = 2
classifier_free = { event = true, weights = [1.0, 2.0] }

[[generate.requests]]
name = "left"
behavior = "cut_in_paper"
buckets = { relative_speed_mps = [-30, 0, 30], side = ["left", "right"] }
per_bucket = 50
arms = ["unguided", "told"]
n_scenes = 4
pairs = { only_feasible = false }
budget = { n_samples = 24 }

"#;

fn pipeline() -> String {
    let distill = format!(
        "[train.distill]\nmethod = {{ n_steps = 2, grid = {{ sigma_max = 80, sigma_min = 0.5 }}, teacher_steps = 1 }}\n\
         steps = 2\nbatch_size = 2\nevaluate_every = 2\nsave_every = 2\nn_eval_scenes = 2\n{EVENTS}\n"
    );
    let sampling = SAMPLING.replace(
        "sampler = { kind = \"euler\", n_steps = 2 }",
        "sampler = { kind = \"euler\", n_steps = 2, grid = { sigma_max = 80, sigma_min = 0.5 } }",
    );
    let (before, after) = SMALL_PIPELINE.split_once("[train.classifier]").unwrap();
    let (_, after) = after.split_once("[generate]").unwrap();
    let (generate, rest) = after.split_once("[[generate.sweeps]]").unwrap();
    let (_, rest) = rest.split_once("[evaluate]").unwrap();
    let before = before.replace("\"cut_in\"", "\"cut_in_paper\"");
    format!("{before}{EVENTS}\n\n{distill}\n[generate]{generate}{sampling}[evaluate]{rest}")
}

fn records(root: &Path) -> Vec<ScenarioRecord> {
    let (samples, store) = (root.join("samples"), SceneStore::open(&root.join("scenes")).unwrap());
    let manifest = SampleManifest::read(&samples).unwrap();
    manifest.shards.iter().flat_map(|shard| SampleManifest::read_shard(&samples, shard, &store).unwrap()).collect()
}

fn told(record: &ScenarioRecord) -> BTreeMap<String, f64> {
    let settings: serde_json::Value = serde_json::from_str(&record.scenario.provenance.settings).unwrap();
    serde_json::from_value(settings["told"].clone()).unwrap_or_default()
}

#[test]
fn mined_events_are_told_asked_for_and_generated_again() {
    let workspace = Workspace::new();
    fs_err::write(workspace.path("small.toml"), pipeline()).unwrap();
    workspace.run("out", &["--threads", "1"]).expect(0);
    let root = workspace.run_folder("out");

    for model in ["denoiser", "distilled"] {
        let path = root.join(model).join("model.safetensors");
        let checkpoint = read_checkpoint::<DenoiserSpec>(&path, &candle_core::Device::Cpu).unwrap();
        let known = checkpoint.metadata.events.unwrap();
        assert_eq!((known.names(), known.behaviors[0].roles.len()), ("cut_in_paper".to_owned(), 2));
        let weight = &checkpoint.tensors["input.event.weight"];
        assert_eq!(weight.dims(), [16, known.n_inputs()]);
        assert!(weight.abs().unwrap().max_all().unwrap().to_scalar::<f32>().unwrap() > 0.0, "{model} has learned");
    }

    let all = records(&root);
    let mut by_sweep: BTreeMap<&str, Vec<&ScenarioRecord>> = BTreeMap::new();
    all.iter().for_each(|record| by_sweep.entry(&record.sweep).or_default().push(record));
    let names: Vec<&str> = by_sweep.keys().copied().collect();
    assert_eq!(names, ["distilled", "left/told@1", "left/told@2", "left/unguided", "told"]);
    for record in &all {
        let is_told = record.sweep != "left/unguided" && record.scenario.provenance.guidance.level.weight != 0.0;
        assert_eq!(!told(record).is_empty(), is_told, "{}", record.scenario.provenance.settings);
    }
    let kind = |sweep: &str| by_sweep[sweep].last().unwrap().scenario.provenance.guidance.kind.as_str();
    assert_eq!((kind("told"), kind("distilled")), ("event", "target_speed+event"));
    // Samples of an arm are conditioned on an event in a bucket, on both of its parameters.
    for record in &by_sweep["left/told@1"] {
        let told = told(record);
        assert!((-30.0..30.0).contains(&told["relative_speed_mps"]) && told["side"].abs() == 1.0, "{told:?}");
    }
    let summary = read_requests(&root.join("samples")).unwrap().remove(0);
    assert!(summary.arms.iter().all(|arm| arm.total.n_samples > 0), "{summary:?}");

    for sweep in names {
        let id = &by_sweep[sweep].last().unwrap().scenario.id;
        let again = djinn(&["regenerate", id, "--from", root.to_str().unwrap()]).expect(0);
        assert!(again.stdout.contains("identical"), "{sweep}: {}", again.stdout);
    }
    workspace.run("two", &["--threads", "2"]).expect(0);
    assert_same(&files(&root), &files(&workspace.run_folder("two")));
    stages_alone_take_the_events(&workspace, &root);
    what_does_not_fit_is_refused(&workspace);
}

/// Trained by themselves, with every input named, models have the same bytes.
fn stages_alone_take_the_events(workspace: &Workspace, root: &Path) {
    let (pipeline, alone) = (workspace.path("small.toml"), workspace.path("alone"));
    let input = |name: &str| root.join(name).to_str().unwrap().to_owned();
    let (scenes, events, denoiser) = (input("scenes"), input("events.parquet"), input("denoiser"));
    let inputs = ["--scenes", &scenes, "--events", &events, "--denoiser", &denoiser];
    for (stage, folder, n_inputs) in [("denoiser", "denoiser", 4), ("distill", "distilled", 6)] {
        let mut arguments = vec!["train", stage, "--config", pipeline.to_str().unwrap(), "-o", alone.to_str().unwrap()];
        arguments.extend(&inputs[..n_inputs]);
        djinn(&arguments).expect(0);
        let model = |root: &Path| fs_err::read(root.join(folder).join("model.safetensors")).unwrap();
        assert_eq!(model(root), model(&alone), "{stage}");
    }
}

fn what_does_not_fit_is_refused(workspace: &Workspace) {
    let refusal = |settings: &[&str]| {
        let set = settings.iter().flat_map(|setting| ["--set", setting]);
        workspace.run("out", &set.collect::<Vec<_>>()).expect(1).stderr
    };
    let untrained = refusal(&[
        "mine.behaviors=[{ kind = \"cut_in_paper\" }, { kind = \"near_miss\" }]",
        "generate.sweeps.0.behavior=near_miss",
    ]);
    assert!(untrained.contains("cannot be told of near_miss") && untrained.contains("cut_in_paper"), "{untrained}");
    let unmined = refusal(&["train.denoiser.events.behaviors=[\"near_miss\"]"]);
    let expected =
        "train.denoiser.events.behaviors.0 is \"near_miss\", expected one of mine.behaviors, which are cut_in_paper";
    assert!(unmined.contains(expected), "{unmined}");
    let without = refusal(&["train.distill.events.behaviors=[\"near_miss\"]", "mine.behaviors=[]"]);
    assert!(without.contains("train.distill.events.behaviors"), "{without}");
}
