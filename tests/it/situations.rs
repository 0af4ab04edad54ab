//! Do scenarios in situations that nobody recorded come out whole, and alike whatever the threads?

use crate::support::{Workspace, assert_same, djinn, files};
use djinn::scene::SituationKind;
use djinn::store::CorpusReader;

const PIPELINE: &str = r#"
[run]
seed = 7

[ingest]
dataset = "interaction"
inputs = ["../fixtures/recordings/interaction_v1_1"]
n_history = 10
n_future = 30

[mine]
behaviors = [{ kind = "cut_in" }]

[train.denoiser]
checkpoint = "../../pipelines/models/geometric.safetensors"

[train.distill]
checkpoint = "../../pipelines/models/geometric_two_steps.safetensors"

[situations]
continued = 6
populated = 2
horizon_s = 12.0

[generate]
sampler = { kind = "euler", n_steps = 2, grid = { sigma_max = 20, sigma_min = 1.5 } }

[[generate.arms]]
name = "templates"
model = "distilled"
classifier_scope = "none"
template = true
rollout = { horizon_s = 6.0, replan_s = 3.0, ego = "log" }

[[generate.requests]]
name = "cut_ins"
behavior = "cut_in"
buckets = { gap_m = [0, 15], careful_margin_s = [-0.75, 1.5, 2.1] }
per_bucket = 40
arms = ["templates"]
n_scenes = 200
pairs = { max_distance_m = 40.0 }
budget = { n_samples = 60 }

[evaluate]
keep = "all"
"#;

#[test]
fn a_request_is_fulfilled_in_situations_of_closed_loops() {
    let workspace = Workspace::of(PIPELINE);
    workspace.run("out", &["--threads", "1"]).expect(0);
    workspace.run("again", &["--threads", "2"]).expect(0);
    let [root, again] = ["out", "again"].map(|name| workspace.run_folder(name));
    assert_same(&files(&root.join("corpus")), &files(&again.join("corpus")));
    djinn(&["corpus", "validate", root.join("corpus").to_str().unwrap()]).expect(0);

    let corpus = CorpusReader::open(&root.join("corpus")).unwrap();
    let has_both = |idx: usize| {
        let scene = corpus.scenario(idx).unwrap().scenario.scene;
        let n_arrived = scene.tracks.iter().filter(|track| track.id.0.starts_with("arrival_")).count();
        scene.source.situation != SituationKind::Recorded && n_arrived > 1
    };
    // Arrivals of the loop that a scene continues, and its own, which must not have one name.
    assert!((0..corpus.len()).any(has_both), "{} scenarios", corpus.len());
}
