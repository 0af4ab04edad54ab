//! The manifest of a scene store: its shards with sizes and hashes, and the report of the ingest.

use super::atomic::read_json;
use super::tables::{lane, scene};
use super::{Error, Result};
use crate::files::FileStamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::path::Path;

/// The file that is written last, in every folder of ours.
pub(crate) const MANIFEST_FILE: &str = "manifest.json";

/// One shard of scenes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShardEntry {
    /// Name of the scene file.
    pub file: String,
    /// Number of scenes in it.
    pub n_scenes: u64,
    /// Number of tracks in it.
    pub n_agents: u64,
    /// Its size and hash.
    pub stamp: FileStamp,
    /// The file of maps that this shard is the first to need.
    pub maps: Option<MapsEntry>,
}

/// One file of maps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MapsEntry {
    /// Name of the file.
    pub file: String,
    /// Number of maps in it.
    pub n_maps: u64,
    /// Number of lanes in it.
    pub n_lanes: u64,
    /// Its size and hash.
    pub stamp: FileStamp,
}

/// Facts about a finished shard; written after it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShardSidecar {
    /// Schema of the scenes, such as `scene.v1`.
    pub schema: String,
    /// The shard.
    pub shard: ShardEntry,
    /// Units of input done by the end of this shard, since the start of the job.
    pub units_done: u64,
    /// The caller's report by the end of this shard, since the start of the job.
    pub report: Value,
}

/// The manifest of a scene store.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneManifest {
    /// Schema of the scenes, such as `scene.v1`.
    pub scene_schema: String,
    /// Schema of the maps, such as `lane.v1`.
    pub lane_schema: String,
    /// Number of scenes.
    pub n_scenes: u64,
    /// Number of tracks.
    pub n_agents: u64,
    /// Number of maps.
    pub n_maps: u64,
    /// Size of all shards, bytes.
    pub n_bytes: u64,
    /// The shards, in order.
    pub shards: Vec<ShardEntry>,
    /// The caller's report, such as rejects.
    pub report: Value,
}

impl SceneManifest {
    pub(crate) fn new(shards: Vec<ShardEntry>, report: Value) -> Self {
        let maps = || shards.iter().filter_map(|shard| shard.maps.as_ref());
        Self {
            scene_schema: scene::schema().id(),
            lane_schema: lane::schema().id(),
            n_scenes: shards.iter().map(|shard| shard.n_scenes).sum(),
            n_agents: shards.iter().map(|shard| shard.n_agents).sum(),
            n_maps: maps().map(|maps| maps.n_maps).sum(),
            n_bytes: shards.iter().map(|shard| shard.stamp.n_bytes).sum::<u64>()
                + maps().map(|maps| maps.stamp.n_bytes).sum::<u64>(),
            shards,
            report,
        }
    }

    /// Whether a folder is a finished scene store.
    pub fn is_in(dir: &Path) -> bool {
        dir.join(MANIFEST_FILE).is_file()
    }

    /// Reads the manifest of a scene store, without opening its shards.
    ///
    /// # Errors
    /// [`Error::Unfinished`] when there is none, [`Error::SchemaVersion`] when it has another version.
    pub fn read(dir: &Path) -> Result<Self> {
        let path = dir.join(MANIFEST_FILE);
        if !path.is_file() {
            return Err(Error::Unfinished { dir: dir.to_owned() });
        }
        // The version first: other versions may have other fields.
        let value: Value = read_json(&path)?;
        for (key, schema) in [("scene_schema", scene::schema()), ("lane_schema", lane::schema())] {
            let found = value.get(key).and_then(Value::as_str).unwrap_or_default();
            if found != schema.id() {
                return Err(Error::SchemaVersion { path, expected: schema.id(), found: found.to_owned() });
            }
        }
        serde_json::from_value(value).map_err(Error::json(&path))
    }
}
