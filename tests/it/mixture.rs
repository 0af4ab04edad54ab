//! Can a denoiser be trained on the scenes of several runs, and is what cannot work refused with what to do?

use crate::support::{Workspace, assert_same, djinn, files, json};
use djinn::model::TrainedDenoiser;
use serde_json::Value;

/// Argoverse 1, cut to the timesteps of INTERACTION or not.
fn argoverse(n_history: usize) -> String {
    format!(
        "[run]\nseed = 3\n[ingest]\ndataset = \"argoverse1\"\n\
         inputs = [\"../fixtures/recordings/argoverse1\"]\nn_history = {n_history}\n"
    )
}

const MIXED: &str = r#"
[run]
seed = 3
[ingest]
dataset = "interaction"
inputs = ["../fixtures/recordings/interaction/FIX-multi-v1_2.zip"]
splits = ["train", "val"]
limit = 30
[train.denoiser]
preset = "tiny"
network = { layers = "TAM", width = 16, n_heads = 2, feed_forward = 16, geometry = { relation_width = 8 } }
objectives = [{ kind = "acceleration_limit", limit_mps2 = 8.0 }]
steps = 4
batch_size = 4
evaluate_every = 2
save_every = 2
n_eval_scenes = 2
max_agents = 6
max_lanes = 8
"#;

/// A workspace with ingested scenes of Argoverse 1 in `other/scenes`.
fn workspace(n_history: usize) -> Workspace {
    let workspace = Workspace::new();
    workspace.put("argoverse.toml", &argoverse(n_history));
    workspace.put("mixed.toml", MIXED);
    djinn(&["run", &workspace.arg("argoverse.toml"), "--output", &workspace.arg("raw")]).expect(0);
    fs_err::rename(workspace.path("raw/argoverse/main"), workspace.path("other")).unwrap();
    workspace
}

/// Runs the mixed pipeline with more scenes from `scenes`, expecting an exit code.
fn mix(workspace: &Workspace, output: &str, scenes: &str, more: &[&str], code: i32) -> String {
    let data = format!("train.denoiser.data=[{{ scenes = \"{}\", weight = 3.0 }}]", workspace.arg(scenes));
    let (pipeline, output) = (workspace.arg("mixed.toml"), workspace.arg(output));
    let more = more.iter().flat_map(|set| ["--set", set]);
    let args: Vec<&str> = ["run", &pipeline, "--output", &output, "--set", &data].into_iter().chain(more).collect();
    djinn(&args).expect(code).stderr
}

#[test]
fn a_denoiser_learns_from_the_scenes_of_two_datasets() {
    let workspace = workspace(10);
    mix(&workspace, "a", "other/scenes", &[], 0);
    mix(&workspace, "b", "other/scenes", &["run.threads=1"], 0);
    let model = |output: &str| workspace.path(output).join("mixed/main/denoiser");
    assert_same(&files(&model("a")), &files(&model("b")));
    let file = model("a").join("model.safetensors");
    let spec = TrainedDenoiser::read(&file, &djinn::nn::Compute::cpu()).unwrap().spec;
    // The data set with recorded headings decides; those of Argoverse are left out.
    assert_eq!((spec.normalizer.state_dim, spec.objectives[0]["kind"].as_str()), (3, Some("acceleration_limit")));
    let told = djinn(&["inspect", file.to_str().unwrap()]).expect(0).stdout;
    for part in ["acceleration_limit", "map_turned", "losses by place"] {
        assert!(told.contains(part), "{part} is not in\n{told}");
    }
    // The weights alone make another model; a moved folder does not.
    mix(&workspace, "c", "other/scenes", &["train.denoiser.own_weight=0.5"], 0);
    assert_ne!(files(&model("a"))["model.safetensors"], files(&model("c"))["model.safetensors"]);
    fs_err::rename(workspace.path("other"), workspace.path("moved")).unwrap();
    let again = mix(&workspace, "a", "moved/scenes", &[], 0);
    assert!(!again.contains("train denoiser"), "{again}");
}

#[test]
fn scenes_that_cannot_be_mixed_are_refused() {
    let workspace = workspace(20);
    let refused = |scenes: &str, more: &[&str], parts: &[&str]| {
        let told = mix(&workspace, "out", scenes, more, 1);
        parts.iter().for_each(|part| assert!(told.contains(part), "{part} is not in\n{told}"));
    };
    let key = "train.denoiser.data.0.scenes is";
    refused("nowhere", &[], &[key, "expected a folder of ingested scenes", "djinn ingest"]);
    refused("other", &[], &[key, &format!("name {}", workspace.arg("other/scenes"))]);
    refused("other/scenes", &[], &["20 + 30 timesteps", "expected 10 + 30", "n_history = 10"]);
    // The ingest of this run is there by now.
    refused("out/mixed/main/scenes", &[], &[key, "the run's own scenes", "own_weight"]);
    let paper = ["train.denoiser.network={ layers = \"TA\" }"];
    workspace.put("argoverse.toml", &argoverse(10));
    djinn(&["run", &workspace.arg("argoverse.toml"), "--output", &workspace.arg("short")]).expect(0);
    refused("short/argoverse/main/scenes", &paper, &["no recorded headings", "state_dim = 2"]);
    // Without headings, any network learns from both.
    let positions = [&paper[..], &["train.denoiser.state_dim=2"]].concat();
    mix(&workspace, "positions", "short/argoverse/main/scenes", &positions, 0);
}

/// Argoverse 1 alone would be diffused without headings, which the bundled model has.
#[test]
fn a_bundled_model_is_trained_further_on_argoverse_alone_as_it_was_trained() {
    let workspace = Workspace::of(
        r#"
        [ingest]
        dataset = "argoverse1"
        inputs = ["../fixtures/recordings/argoverse1"]
        splits = ["train", "val"]
        n_history = 10

        [train.denoiser]
        start_from = "../../pipelines/models/geometric.safetensors"
        steps = 1
        batch_size = 1
        n_eval_scenes = 1
        "#,
    );
    workspace.run("out", &[]).expect(0);
    let model = workspace.run_folder("out").join("denoiser/model.safetensors");
    assert_eq!(TrainedDenoiser::read(&model, &djinn::nn::Compute::cpu()).unwrap().spec.normalizer.state_dim, 3);
}

#[test]
fn a_training_for_a_time_says_what_it_chose_and_what_that_won() {
    let workspace = Workspace::new();
    workspace.put("mixed.toml", MIXED);
    djinn(&["run", &workspace.arg("mixed.toml"), "--output", &workspace.arg("first")]).expect(0);
    let chosen_by_time =
        |line: &&str| !["steps", "evaluate_every", "save_every", "n_eval"].iter().any(|key| line.starts_with(key));
    let settings: Vec<&str> = MIXED.lines().filter(chosen_by_time).collect();
    let start = workspace.arg("first/mixed/main/denoiser/model.safetensors");
    workspace.put("timed.toml", &format!("{}\nstart_from = \"{start}\"\nfor = \"12 s\"\n", settings.join("\n")));
    let begun = std::time::Instant::now();
    djinn(&["run", &workspace.arg("timed.toml"), "--output", &workspace.arg("second")]).expect(0);
    // In a crowd, tests may have to wait for the processor.
    assert!(begun.elapsed().as_secs() < 60);
    let run = workspace.path("second/timed/main");
    let done: Value = json(&run.join("train_denoiser.done.json"));
    let summary = &done["summary"];
    let (chosen, won) = (&summary["chosen"], summary["won"].as_array().unwrap());
    // Nothing can be tried within half a second.
    assert!(chosen["tried"].as_array().is_some_and(Vec::is_empty) && won.len() > 1, "{summary}");
    assert!(won.iter().all(|line| line["scene_error_m"].as_f64().is_some_and(|error_m| error_m > 0.0)), "{summary}");
    let spec = TrainedDenoiser::read(&run.join("denoiser/model.safetensors"), &djinn::nn::Compute::cpu()).unwrap().spec;
    let loops = &summary["valid_closed_loops"];
    let stays = spec.steps == 4;
    assert!(stays || loops["before"].is_number() && loops["after"].is_number(), "{summary}");
}
