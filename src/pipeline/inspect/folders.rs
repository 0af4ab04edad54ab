//! Folders: runs, scene stores, samples, corpora, models.

use super::{Description, checkpoint, requests};
use crate::engine::begun;
use crate::engine::run_folder::{RUN_FILE, RunManifest, Timings};
use crate::engine::{Result, StageKind, StageRecord};
use crate::pipeline::layout::SAMPLES;
use crate::pipeline::stages::SampleManifest;
use crate::pipeline::{KINDS, StageId};
use crate::store::{CorpusManifest, SceneManifest, SceneStore, TableEntry, read_json};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// A run folder, or a folder that stages wrote into one by one.
pub(super) fn run(path: &Path) -> Result<Option<Description>> {
    let found = |read: &dyn Fn(&'static StageKind) -> Result<Option<StageRecord>>| {
        KINDS.iter().filter_map(|kind| read(kind).transpose()).collect::<Result<Vec<StageRecord>>>()
    };
    let (records, started) = (found(&|kind| StageRecord::done(path, kind))?, found(&|kind| begun(path, kind))?);
    let manifest: Option<RunManifest> = read_json(&path.join(RUN_FILE)).ok();
    if !path.is_dir() || (records.is_empty() && started.is_empty() && manifest.is_none()) {
        return Ok(None);
    }
    let timings = Timings::read(path);
    let mut description = Description::new("run folder");
    if let Some(manifest) = &manifest {
        description = description.with("pipeline", manifest.pipeline.as_str());
    }
    if let Some(evaluated) = records.iter().find(|record| record.stage == StageId::Evaluate.name()) {
        let results: Map<String, Value> = ["n_scenarios", "n_verified", "n_new", "n_valid", "n_accepted", "n_kept"]
            .into_iter()
            .map(|name| (name.to_owned(), evaluated.summary[name].clone()))
            .collect();
        description = description.with("results", results);
    }
    let mut stages = Map::new();
    for record in records {
        let seconds: f64 =
            timings.stages.get(&record.stage).into_iter().flatten().filter_map(|timing| timing.seconds).sum();
        let n_bytes: u64 = record.outputs.values().map(|output| output.n_bytes).sum();
        let outputs: Vec<&String> = record.outputs.keys().collect();
        let state = json!({
            "status": "done",
            "seconds": (seconds * 10.0).round() / 10.0,
            "n_bytes": n_bytes,
            "outputs": outputs,
            "summary": without_long_lists(record.summary),
        });
        stages.insert(record.stage.to_string(), state);
    }
    for record in started {
        // A stage that was begun again still has its earlier outputs.
        stages.entry(record.stage.to_string()).or_insert_with(|| json!({ "status": "unfinished" }));
    }
    let requests = requests::describe(&path.join(SAMPLES))?;
    description.entries.extend(requests.map(|requests| ("requests".to_owned(), requests)));
    description = description.with("stages", stages);
    if let Some(manifest) = manifest {
        description = description
            .with("seed", manifest.seed)
            .with("djinn_version", manifest.djinn_version)
            .with("revision", manifest.revision)
            .with("device", manifest.device)
            .with_json("inputs", &manifest.inputs)?;
    }
    Ok(Some(description))
}

/// Detailed statistics belong to the stage's own files.
fn without_long_lists(summary: Value) -> Value {
    let Value::Object(object) = summary else { return summary };
    let is_short = |value: &Value| value.to_string().len() < 300;
    Value::Object(object.into_iter().filter(|(_, value)| is_short(value)).collect())
}

pub(super) fn scenes(path: &Path) -> Result<Option<Description>> {
    let is_store = |manifest: &Value| manifest.get("scene_schema").is_some();
    if !read_json::<Value>(&path.join("manifest.json")).is_ok_and(|manifest| is_store(&manifest)) {
        return Ok(None);
    }
    let manifest = SceneManifest::read(path)?;
    let store = SceneStore::open(path)?;
    let (mut by_part, mut by_dataset) = (BTreeMap::<String, u64>::new(), BTreeMap::<&str, u64>::new());
    for entry in store.index().iter() {
        *by_part.entry(format!("{}/{}", entry.split.name(), entry.place)).or_default() += 1;
        *by_dataset.entry(entry.dataset.name()).or_default() += 1;
    }
    let mut description = Description::new("scene store")
        .with("schema", manifest.scene_schema)
        .with("n_scenes", manifest.n_scenes)
        .with("n_agents", manifest.n_agents)
        .with("n_maps", manifest.n_maps)
        .with("n_shards", manifest.shards.len())
        .with("n_bytes", manifest.n_bytes)
        .with("fingerprint", store.fingerprint())
        .with_json("scenes_by_dataset", &by_dataset)?
        .with_json("scenes_by_part", &by_part)?;
    if !store.is_empty() {
        let first = store.scene(0)?;
        let shape = json!({
            "id": first.id.0,
            "dt_s": first.dt_s,
            "n_history": first.n_history,
            "n_future": first.n_timesteps.saturating_sub(first.n_history),
            "n_agents": first.tracks.len(),
            "n_lanes": first.lanes.lanes().len(),
        });
        description = description.with("first_scene", shape);
    }
    for key in ["rejects", "dropped", "assumed"] {
        let counts = manifest.report.get(key).cloned().unwrap_or_default();
        if counts.as_object().is_some_and(|counts| !counts.is_empty()) {
            description = description.with(key, counts);
        }
    }
    Ok(Some(description))
}

pub(super) fn samples(path: &Path) -> Result<Option<Description>> {
    let is_samples = |manifest: &Value| manifest.get("sampled_with").is_some();
    if !read_json::<Value>(&path.join("manifest.json")).is_ok_and(|manifest| is_samples(&manifest)) {
        return Ok(None);
    }
    let manifest = SampleManifest::read(path)?;
    let mut by_sweep = BTreeMap::<&str, [u64; 2]>::new();
    for shard in &manifest.shards {
        let [n_scenarios, n_verified] = by_sweep.entry(&shard.sweep).or_default();
        *n_scenarios += shard.n_scenarios;
        *n_verified += shard.n_verified;
    }
    let by_sweep: Map<String, Value> = by_sweep
        .into_iter()
        .map(|(sweep, [n, verified])| (sweep.to_owned(), json!({ "n_scenarios": n, "n_verified": verified })))
        .collect();
    let mut description = Description::new("generated scenarios")
        .with("n_scenarios", manifest.n_scenarios)
        .with("n_verified", manifest.n_verified)
        .with("n_rejected", manifest.n_rejected)
        .with("n_shards", manifest.shards.len())
        .with("sweeps", by_sweep);
    let requests = requests::describe(path)?;
    description.entries.extend(requests.map(|requests| ("requests".to_owned(), requests)));
    Ok(Some(description.with_json("sampled_with", &manifest.sampled_with)?))
}

pub(super) fn corpus(path: &Path) -> Result<Option<Description>> {
    let is_corpus = |manifest: &Value| manifest.get("scenarios_by_sweep").is_some();
    if !read_json::<Value>(&path.join("manifest.json")).is_ok_and(|manifest| is_corpus(&manifest)) {
        return Ok(None);
    }
    let manifest = CorpusManifest::read(path)?;
    let table = |name: &String, table: &TableEntry| {
        let n_files = table.files.len();
        let entry =
            json!({ "schema": table.schema, "n_rows": table.n_rows, "n_bytes": table.n_bytes, "n_files": n_files });
        (name.clone(), entry)
    };
    let tables: Map<String, Value> = manifest.tables.iter().map(|(name, entry)| table(name, entry)).collect();
    let mut by_partition = Map::new();
    for count in &manifest.scenarios_by_partition {
        let name = format!("{} at {}", count.behavior, count.place);
        let counts = json!({ "n_scenarios": count.n_scenarios, "n_verified": count.n_verified, "n_new": count.n_new });
        by_partition.insert(name, counts);
    }
    let description = Description::new("corpus")
        .with("schema", manifest.schema.as_str())
        .with("n_scenarios", manifest.n_scenarios)
        .with("n_verified", manifest.n_verified)
        .with("n_new", manifest.n_new)
        .with("n_recordings", manifest.n_recordings)
        .with("n_maps", manifest.n_maps)
        .with("n_bytes", manifest.n_bytes())
        .with("scenarios_by_partition", by_partition)
        .with_json("scenarios_by_dataset", &manifest.scenarios_by_dataset)?
        .with_json("scenarios_by_sweep", &manifest.scenarios_by_sweep)?
        .with("tables", tables)
        .with_json("sources", &manifest.sources)?
        .with_json("notes", &manifest.notes)?
        .with_json("history", &manifest.history)?;
    Ok(Some(description))
}

/// The folder of a trained model is described by its checkpoint.
pub(super) fn model(path: &Path) -> Result<Option<Description>> {
    let file = path.join("model.safetensors");
    if path.is_dir() && file.exists() { checkpoint::describe(&file) } else { Ok(None) }
}
