//! Whole runs compared with those of yesterday: which scenes they sample, what they count, and some figures.
//!
//! `DJINN_UPDATE_GOLDEN=1 cargo test --test it pipelines` writes the expectations in `tests/golden/` anew.

use crate::support::json;
use djinn::store::SceneStore;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// Other processors add in another order, which a few training steps magnify: figures of samples may differ so much.
const TOLERANCE: f64 = 0.02;
/// Figures that change with the samples, without jumps.
const METRICS: [&str; 6] =
    ["min_fde_m", "min_scene_ade_m", "mfd_m", "pair_min_distance_m", "realism_kinematic", "realism_meta_metric"];

/// Demands that the run in the folder `root` is as its pipeline's golden file says.
pub(crate) fn check(pipeline: &str, root: &Path) {
    let found = json!({ "counts": counts(root), "scenes": scenes(root), "figures": figures(root) });
    let path = Path::new("tests/golden").join(format!("run_{pipeline}.json"));
    if std::env::var_os("DJINN_UPDATE_GOLDEN").is_some() {
        fs_err::write(&path, serde_json::to_string_pretty(&found).unwrap() + "\n").unwrap();
        return;
    }
    let expected = json(&path);
    for part in ["counts", "scenes"] {
        assert_eq!(found[part], expected[part], "{part} of {}", path.display());
    }
    let [found, expected] = [&found, &expected].map(|run| run["figures"].as_object().unwrap());
    assert!(found.keys().eq(expected.keys()), "{:?}\n{:?}", found.keys(), expected.keys());
    for (name, expected) in expected {
        let (found, expected) = (found[name].as_f64().unwrap(), expected.as_f64().unwrap());
        let is_near = (found - expected).abs() <= TOLERANCE * (1.0 + expected.abs());
        assert!(is_near, "{name} is {found}, expected {expected} as in {}", path.display());
    }
}

/// Counts that no rounding changes: of scenes by split, of events, and of what models learn from.
fn counts(root: &Path) -> Map<String, Value> {
    let mut counts = Map::new();
    let store = SceneStore::open(&root.join("scenes")).unwrap();
    for entry in store.index().iter() {
        let n = counts.entry(format!("scenes of {}", entry.split.name())).or_insert(json!(0));
        *n = json!(n.as_u64().unwrap() + 1);
    }
    for (stage, keys) in [
        ("ingest", &["n_agents", "n_rejects"][..]),
        ("mine", &["n_events", "n_positive"]),
        ("train_denoiser", &["n_train_scenes", "n_held_out_scenes", "n_parameters"]),
        ("train_classifier", &["n_positive", "n_negative"]),
    ] {
        let summary = json(&root.join(format!("{stage}.done.json")))["summary"].take();
        counts.extend(keys.iter().map(|key| (format!("{stage} {key}"), summary[key].clone())));
    }
    counts
}

/// The ids of the scenes that sweeps continue, and that requests may continue.
fn scenes(root: &Path) -> BTreeMap<String, Vec<Value>> {
    let mut scenes: BTreeMap<String, Vec<Value>> = BTreeMap::new();
    let ids = |cells: &Value| -> Vec<Value> {
        cells.as_array().unwrap().iter().map(|cell| cell["scene_id"].clone()).collect()
    };
    for shard in json(&root.join("samples/plan.json"))["shards"].as_array().unwrap() {
        scenes.entry(format!("sweep {}", shard["sweep_idx"])).or_default().extend(ids(&shard["cells"]));
    }
    let pool = root.join("samples/request-00-pool.json");
    if pool.exists() {
        scenes.insert("request 0".to_owned(), ids(&json(&pool)["cells"]));
    }
    scenes
}

/// Figures of recorded, extrapolated and sampled traffic.
fn figures(root: &Path) -> BTreeMap<String, Value> {
    let metrics = json(&root.join("metrics.json"));
    let row = |row: &Value| {
        let [group, sweep, place, metric] = ["group", "sweep", "place", "metric"].map(|key| row[key].as_str());
        // Which arms a request tries, and how often, depends on the last digits, and closed loops magnify them.
        let is_open = !sweep?.contains('/') && sweep? != "closed_loops";
        let is_chosen = place == Some("") && is_open && METRICS.contains(&metric?);
        let name = format!("{} {} {} {}", group?, sweep?, row["strength"], metric?);
        (is_chosen && row["value"].as_f64() != Some(0.0)).then(|| (name, row["value"].clone()))
    };
    metrics["aggregates"].as_array().unwrap().iter().filter_map(row).collect()
}
