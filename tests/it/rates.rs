//! Do rates of the model and of a planner's failures follow from the settings to the tables, whatever happens?

use crate::drive::{MODEL, planner};
use crate::support::{Workspace, assert_same, djinn, files, json, start};
use djinn::rates::ModeledTraffic;
use djinn::store::read_binary;
use serde_json::Value;
use std::path::Path;

const PIPELINE: &str = r#"
[run]
seed = 7

[ingest]
dataset = "interaction"
inputs = ["../fixtures/recordings/interaction/FIX-multi-v1_2.zip"]
splits = ["train", "val"]
max_agents = 5

[mine]
behaviors = [{ kind = "cut_in", hurry = 1.4 }, { kind = "cut_in_paper" }]
rates = [{ behavior = "cut_in_paper", within = { gap_m = [0, 20] } }]

[train.denoiser]
checkpoint = "../../pipelines/models/geometric.safetensors"

[train.distill]
checkpoint = "../../pipelines/models/geometric_two_steps.safetensors"

[rates]
loops = 24
horizon_s = 6.0
levels = [0.5, 1.0]
copies = 2

[generate]
splits = ["train", "val"]
sampler = { kind = "euler", n_steps = 2, grid = { sigma_max = 20, sigma_min = 1.5 } }

[[generate.sweeps]]
name = "cut_ins"
model = "distilled"
behavior = "cut_in"
classifier_scope = "none"
template = true
aim = "feasible"
n_scenes = 6
n_samples = 2

[evaluate]
keep = "all"
"#;

#[test]
fn rates_of_the_model_and_of_failures_are_those_of_their_parts() {
    let workspace = Workspace::of(PIPELINE);
    workspace.run("out", &["--threads", "1"]).expect(0);
    let root = workspace.run_folder("out");

    // Rates of loops are sums of weights over ways, and both are as many as the figures say.
    let (traffic, modeled) = (
        read_binary::<ModeledTraffic>(&root.join("modeled.bin"), "modeled.v1").unwrap(),
        json(&root.join("modeled.json")),
    );
    assert_eq!((traffic.loops.len(), modeled["n_loops"].as_u64()), (24, Some(24)));
    assert!(modeled["n_futures"].as_u64().unwrap() > 24 * 12 && modeled["reached"][1].as_f64().unwrap() > 0.0);
    let km: f64 = traffic.loops.iter().map(|one| one.motorized_km).sum();
    let events = || traffic.loops.iter().flat_map(|one| &one.events);
    assert!(events().any(|event| event.weight < 1.0) && events().all(|event| [1.0, 0.5, 0.25].contains(&event.weight)));
    let of_all =
        modeled["calibration"].as_array().unwrap().iter().find(|one| one["behavior"] == "cut_in_paper").unwrap();
    let sum: f64 = events().filter(|event| event.behavior == "cut_in_paper").map(|event| event.weight).sum();
    assert!((of_all["modeled"]["value"].as_f64().unwrap() / (1000.0 * sum / km) - 1.0).abs() < 1e-9, "{of_all}");

    // Killed in the midst, with other threads, and alone: the same bytes.
    let made = |folder: &Path| {
        let mut found = files(folder);
        found.retain(|name, _| name.starts_with("modeled"));
        found
    };
    let [config, alone] = [workspace.arg("small.toml"), workspace.arg("alone")];
    let of_run = |name: &str| root.join(name).to_str().unwrap().to_owned();
    let [scenes, events, distilled] = ["scenes", "events.parquet", "distilled"].map(of_run);
    let args = ["rates", "--config", &config, "--scenes", &scenes, "--events", &events, "--output", &alone];
    let args = [&args[..], &["--distilled", &distilled, "--threads", "2"]].concat();
    let mut child = start(&args);
    while !workspace.path("alone/rates.partial").exists() {
        assert!(child.try_wait().unwrap().is_none(), "it ended before it was killed");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(made(&workspace.path("alone")).is_empty());
    djinn(&args).expect(0);
    assert_same(&made(&root), &made(&workspace.path("alone")));

    // Failures of a planner: how often a bucket happens times the share of its scenarios that fail; by loops as well.
    let (corpus, out) = (of_run("corpus"), workspace.arg("driven"));
    let stops = planner("print(json.dumps({'type': 'action', 'acceleration_mps2': -6}))");
    let drive = |corpus: &str, out: &str, more: &[&str]| {
        let fixed = ["drive", corpus, "--ego", &stops, "--model", MODEL, "--out", out, "--rates"];
        djinn(&[&fixed[..], more].concat()).expect(0)
    };
    let loops = ["--scenes", &scenes, "--loops", "8", "--levels", "0.5", "--copies", "2"];
    let said = drive(&corpus, &out, &loops).stdout;
    assert!(said.contains("at FIX_Merging, it fails "), "{said}");
    assert!(said.contains("by loops at FIX_Merging, it fails "), "{said}");
    let report = json(&workspace.path("driven/drive.json"));
    let at = &report["rates"][0];
    let bucket = &at["buckets"][0];
    let number = |value: &Value| value.as_f64().unwrap();
    let share = number(&bucket["n_failed"]) / number(&bucket["n_scenarios"]);
    let rate = number(&bucket["rate"]["value"]);
    assert!((number(&at["per_1000_km"]["value"]) - rate * share).abs() < 1e-9 && rate * share > 0.0, "{at}");
    assert!(said.contains("  in events of the buckets "), "{said}");
    // Every failure of the loops is either in an event of the buckets or of another outcome.
    let loops = &report["split_rates"][0];
    let others: f64 = loops["others"].as_object().unwrap().values().map(|both| number(&both[0]["value"])).sum();
    let all = number(&loops["per_1000_km"]["value"]);
    assert!(all > 0.0 && (others + number(&loops["in_buckets"][0]["value"]) - all).abs() < 1e-6 * all, "{loops}");

    // A sweep that prefers hard events tells nothing of how many of all are failed.
    workspace.run("hard", &["--set", "generate.sweeps.0.aim=hard", "--set", "rates.loops=2"]).expect(0);
    let (corpus, out) = (workspace.run_folder("hard").join("corpus"), workspace.arg("driven_hard"));
    let said = drive(corpus.to_str().unwrap(), &out, &[]).stdout;
    assert!(said.contains("have no rate or aim at hard events") && said.contains("no scenario has a rate"), "{said}");
    let at = json(&workspace.path("driven_hard/drive.json"))["rates"][0].take();
    assert!(at["per_1000_km"].is_null() && at["n_without_rate"].as_u64().unwrap() > 0, "{at}");
}
