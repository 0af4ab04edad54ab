//! Signatures that the next commits fill.

use super::{Error, FileStamp, MetricRow, Result, ScenarioRecord};
use crate::behavior::BehaviorEvent;
use crate::scene::{Dataset, LaneGraph, LaneId, MapId, Scene, SceneId, Split};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

fn later<T>() -> Result<T> {
    Err(Error::Invalid { id: "anything".to_owned(), detail: "not written yet".to_owned() })
}

/// Where maps can be looked up: a scene store or a corpus. Lanes are in the recording's frame.
pub trait MapSource: Sync {
    /// The whole map.
    fn map(&self, id: &MapId) -> Result<LaneGraph>;
    /// These lanes of the map, with connections among them.
    fn lanes(&self, id: &MapId, lane_ids: &[LaneId]) -> Result<LaneGraph>;
}

/// The scene as the store gives it back: states and sizes rounded to single precision. Apply it to generated scenes
/// before they are verified, so that what was verified is what is written.
pub fn as_stored(scene: &Scene) -> Scene {
    scene.clone()
}

/// How scenes are put into shards.
#[derive(Debug, Clone, Copy)]
pub struct SceneWriterOptions {
    /// A shard ends with the batch that brings it to this many scenes.
    pub scenes_per_shard: usize,
}

impl Default for SceneWriterOptions {
    fn default() -> Self {
        Self { scenes_per_shard: 1024 }
    }
}

/// What is known of a finished shard; written beside it, after it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShardSidecar {
    /// Name of the scene file.
    pub file: String,
    /// Number of scenes in it.
    pub n_scenes: u64,
    /// Number of tracks in it.
    pub n_agents: u64,
    /// Its size and hash.
    pub stamp: FileStamp,
    /// Units of input that are done once this shard is, since the start of the job.
    pub units_done: u64,
    /// The caller's report up to here, since the start of the job.
    pub report: serde_json::Value,
}

/// The last file written to a scene store.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneManifest {
    /// Number of scenes.
    pub n_scenes: u64,
    /// Number of tracks.
    pub n_agents: u64,
    /// The caller's report.
    pub report: serde_json::Value,
}

impl SceneManifest {
    /// Reads the manifest of a scene store without opening its shards.
    pub fn read(_dir: &Path) -> Result<Self> {
        later()
    }
}

/// Writes a scene store, shard by shard.
#[derive(Debug)]
pub struct SceneWriter {}

impl SceneWriter {
    /// Begins a store in `dir`, which is created; files of an earlier store there are removed.
    pub fn create(_dir: &Path, _options: SceneWriterOptions) -> Result<Self> {
        later()
    }
    /// Continues after the last finished shard, whose sidecar says how many units are done and what was reported.
    /// `None`: nothing is finished, start at the beginning.
    pub fn resume(_dir: &Path, _options: SceneWriterOptions) -> Result<(Self, Option<ShardSidecar>)> {
        later()
    }
    /// Adds scenes and the maps they need first (maps that are known already are ignored). `units_done` and `report` are
    /// cumulative since the start of the job.
    pub fn write_batch(
        &mut self,
        _scenes: &[Scene],
        _maps: &[(MapId, LaneGraph)],
        _units_done: u64,
        _report: &serde_json::Value,
    ) -> Result<()> {
        later()
    }
    /// Finishes the last shard and writes the manifest.
    pub fn finish(self, _report: &serde_json::Value) -> Result<SceneManifest> {
        later()
    }
}

/// What can be known of a scene without loading it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SceneIndexEntry {
    /// The scene.
    pub id: SceneId,
    /// Its dataset.
    pub dataset: Dataset,
    /// Its split.
    pub split: Split,
    /// Its place.
    pub place: String,
    /// Number of tracks.
    pub n_agents: usize,
    /// Number of timesteps.
    pub n_timesteps: usize,
}

/// A memory-mapped scene store.
#[derive(Debug)]
pub struct SceneStore {}

impl SceneStore {
    /// Opens and verifies a finished store.
    pub fn open(_dir: &Path) -> Result<Self> {
        later()
    }
    /// Number of scenes.
    pub fn len(&self) -> usize {
        0
    }
    /// Whether there are no scenes.
    pub fn is_empty(&self) -> bool {
        true
    }
    /// The manifest.
    pub fn manifest(&self) -> Result<&SceneManifest> {
        later()
    }
    /// Hash of the manifest, and so of everything in the store.
    pub fn fingerprint(&self) -> &str {
        ""
    }
    /// One entry a scene, in order.
    pub fn index(&self) -> &[SceneIndexEntry] {
        &[]
    }
    /// Loads scene `i` with its lanes.
    pub fn scene(&self, _i: usize) -> Result<Scene> {
        later()
    }
    /// The position of a scene.
    pub fn position(&self, _id: &SceneId) -> Option<usize> {
        None
    }
}

impl MapSource for SceneStore {
    fn map(&self, _id: &MapId) -> Result<LaneGraph> {
        later()
    }
    fn lanes(&self, _id: &MapId, _lane_ids: &[LaneId]) -> Result<LaneGraph> {
        later()
    }
}

/// Writes an event table.
pub fn write_events(_path: &Path, _events: &[BehaviorEvent]) -> Result<FileStamp> {
    later()
}

/// Reads an event table.
pub fn read_events(_path: &Path) -> Result<Vec<BehaviorEvent>> {
    later()
}

/// Writes one shard of generated scenarios.
pub fn write_samples(_path: &Path, _records: &[ScenarioRecord]) -> Result<FileStamp> {
    later()
}

/// Reads one shard of generated scenarios; lanes come from `maps`, such as the scene store they were generated from.
pub fn read_samples(_path: &Path, _maps: &dyn MapSource) -> Result<Vec<ScenarioRecord>> {
    later()
}

/// What a corpus says of itself beyond its tables.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct CorpusNotes {
    /// Dataset → its license and citation.
    pub sources: BTreeMap<String, String>,
    /// Anything else, such as the command or the pipeline's name.
    pub notes: BTreeMap<String, String>,
}

/// The last file written to a corpus.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CorpusManifest {
    /// Number of scenarios.
    pub n_scenarios: u64,
    /// How many of them are verified.
    pub n_verified: u64,
    /// What the writer was told.
    pub notes: CorpusNotes,
}

/// Writes a corpus folder.
#[derive(Debug)]
pub struct CorpusWriter<'a> {
    _maps: std::marker::PhantomData<&'a ()>,
}

impl<'a> CorpusWriter<'a> {
    /// Begins a corpus in `dir`, which is created; files of an earlier one are removed. Maps are copied from `maps` as needed.
    pub fn create(_dir: &Path, _maps: &'a dyn MapSource) -> Result<Self> {
        later()
    }
    /// Adds scenarios.
    pub fn write_scenarios(&mut self, _records: &[ScenarioRecord]) -> Result<()> {
        later()
    }
    /// Adds metric values.
    pub fn write_metrics(&mut self, _rows: &[MetricRow]) -> Result<()> {
        later()
    }
    /// Finishes the tables and writes the manifest.
    pub fn finish(self, _notes: &CorpusNotes) -> Result<CorpusManifest> {
        later()
    }
}

/// Reads a corpus folder.
#[derive(Debug)]
pub struct CorpusReader {}

impl CorpusReader {
    /// Opens and verifies a finished corpus.
    pub fn open(_dir: &Path) -> Result<Self> {
        later()
    }
    /// The manifest.
    pub fn manifest(&self) -> Result<&CorpusManifest> {
        later()
    }
    /// Ids of all scenarios, in order.
    pub fn scenario_ids(&self) -> &[String] {
        &[]
    }
    /// Loads scenario `i` with its lanes.
    pub fn scenario(&self, _i: usize) -> Result<ScenarioRecord> {
        later()
    }
    /// All metric values.
    pub fn metrics(&self) -> Result<Vec<MetricRow>> {
        later()
    }
}

impl MapSource for CorpusReader {
    fn map(&self, _id: &MapId) -> Result<LaneGraph> {
        later()
    }
    fn lanes(&self, _id: &MapId, _lane_ids: &[LaneId]) -> Result<LaneGraph> {
        later()
    }
}
