//! Writes a scene store in shards, and continues after an interruption.

use super::atomic::{read_json, write_json_atomically};
use super::ipc_file::{IpcFile, MappedTable};
use super::maps::MapTable;
use super::scene_manifest::{MANIFEST_FILE, MapsEntry, SceneManifest, ShardEntry, ShardSidecar};
use super::tables::columns::Columns;
use super::tables::{lane, scene, scene_header};
use super::{Error, Result};
use crate::files::{FileStamp, remove_if_present};
use crate::scene::{LaneGraph, MapId, Scene};
use fs_err as fs;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// A shard ends with the batch that brings it to this many scenes.
const SCENES_PER_SHARD: u64 = 1024;

/// Writes a scene store, shard by shard.
///
/// A shard is up to three files: `maps-00000.arrow` with the maps that it is the first to need, `scenes-00000.arrow`,
/// and, once both are complete, the sidecar `scenes-00000.json`. The manifest is written last. The same scenes in the
/// same batches give the same bytes, whether or not the writer was interrupted.
pub struct SceneWriter {
    dir: PathBuf,
    scenes_per_shard: u64,
    shards: Vec<ShardEntry>,
    current: OpenShard,
    known_maps: BTreeSet<String>,
    /// The recordings of all scenes so far, by hashes of their ids.
    known_scenes: BTreeMap<u128, String>,
    units_done: u64,
    report: Value,
}

/// The shard that is being written.
#[derive(Default)]
struct OpenShard {
    scenes: Option<IpcFile>,
    n_scenes: u64,
    n_agents: u64,
    maps: Option<IpcFile>,
    n_maps: u64,
    n_lanes: u64,
}

impl SceneWriter {
    /// Continues the store in `dir`, which is created if it is missing, after the last finished shard, and returns its
    /// sidecar with the units done and the report so far; `None` if no shard is finished. Unfinished files are removed.
    ///
    /// # Errors
    /// On I/O errors, or if a map cannot be read.
    pub fn resume(dir: &Path) -> Result<(Self, Option<ShardSidecar>)> {
        fs::create_dir_all(dir)?;
        let mut finished = Vec::new();
        while let Some(sidecar) = finished_shard(dir, finished.len()) {
            finished.push(sidecar);
        }
        let keep = finished.iter().enumerate().flat_map(|(i, sidecar)| {
            let maps = sidecar.shard.maps.as_ref().map(|maps| maps.file.clone());
            [Some(sidecar.shard.file.clone()), Some(sidecar_name(i)), maps].into_iter().flatten()
        });
        remove_store_files(dir, &keep.collect())?;

        let mut known_maps = MapTable::new(dir);
        for maps in finished.iter().filter_map(|sidecar| sidecar.shard.maps.as_ref()) {
            let path = dir.join(&maps.file);
            for batch in MappedTable::open(&path, &lane::schema(), &maps.stamp)?.batches() {
                known_maps.push(&path, batch?)?;
            }
        }
        let mut known_scenes = BTreeMap::new();
        for sidecar in &finished {
            for_each_scene(dir, &sidecar.shard, |scene| {
                known_scenes.insert(hash_of(&scene.id.0), scene.source.file);
            })?;
        }
        let last = finished.last().cloned();
        let writer = Self {
            dir: dir.to_owned(),
            scenes_per_shard: SCENES_PER_SHARD,
            units_done: last.as_ref().map_or(0, |sidecar| sidecar.units_done),
            report: last.as_ref().map_or(Value::Null, |sidecar| sidecar.report.clone()),
            shards: finished.into_iter().map(|sidecar| sidecar.shard).collect(),
            current: OpenShard::default(),
            known_maps: known_maps.ids().map(str::to_owned).collect(),
            known_scenes,
        };
        Ok((writer, last))
    }

    /// [`Scene::identity`] of each scene of the finished shards.
    ///
    /// # Errors
    /// When a shard cannot be read.
    pub fn identities(&self) -> Result<BTreeSet<u128>> {
        let mut found = BTreeSet::new();
        for shard in &self.shards {
            for_each_scene(&self.dir, shard, |scene| _ = found.insert(scene.identity()))?;
        }
        Ok(found)
    }

    /// Limits shards to this many scenes.
    #[cfg(test)]
    pub(crate) fn in_shards_of(self, scenes_per_shard: u64) -> Self {
        Self { scenes_per_shard, ..self }
    }

    /// Adds scenes, after the maps that they are the first to need; known maps are skipped. `units_done` and `report`
    /// are cumulative since the start of the job and include this batch. `None`: the last unit continues in the next
    /// batch, so no shard may end here.
    ///
    /// # Errors
    /// [`Error::Invalid`] when a scene cannot be stored, for instance because its map was never added;
    /// [`Error::DuplicateScene`] when its id was added before; errors of the file system. The writer cannot be used
    /// afterwards, but finished shards remain for [`resume`](Self::resume).
    pub fn write_batch(
        &mut self,
        scenes: &[Scene],
        maps: &[(MapId, LaneGraph)],
        units_done: Option<u64>,
        report: &Value,
    ) -> Result<()> {
        self.write_maps(maps)?;
        if let Some(scene) = scenes.iter().find(|scene| !self.has_map_of(scene)) {
            return Err(Error::invalid(&scene.id, "its map was not added before it"));
        }
        for Scene { id, source, .. } in scenes {
            if let Some(earlier) = self.known_scenes.insert(hash_of(&id.0), source.file.clone()) {
                return Err(Error::DuplicateScene { id: id.to_string(), files: [earlier, source.file.clone()] });
            }
        }
        if !scenes.is_empty() {
            let path = self.path_of("scenes", "arrow");
            let batch = scene::encode(scenes)?;
            let shard = &mut self.current;
            open_or_create(&mut shard.scenes, || IpcFile::create(&path, &scene::schema()))?.write(&batch)?;
            shard.n_scenes += scenes.len() as u64;
            shard.n_agents += scenes.iter().map(|scene| scene.tracks.len() as u64).sum::<u64>();
        }
        let Some(units_done) = units_done else { return Ok(()) };
        self.units_done = units_done;
        self.report = report.clone();
        if self.current.n_scenes >= self.scenes_per_shard {
            self.finish_shard()?;
        }
        Ok(())
    }

    /// Finishes the last shard and writes the manifest with the caller's report on the whole job.
    pub fn finish(mut self, report: &Value) -> Result<SceneManifest> {
        self.finish_shard()?;
        let manifest = SceneManifest::new(self.shards, report.clone());
        write_json_atomically(&self.dir.join(MANIFEST_FILE), &manifest)?;
        Ok(manifest)
    }

    fn write_maps(&mut self, maps: &[(MapId, LaneGraph)]) -> Result<()> {
        let mut new = Vec::new();
        for (id, graph) in maps {
            if !graph.is_empty() && self.known_maps.insert(id.0.clone()) {
                new.push((id, graph));
            }
        }
        if new.is_empty() {
            return Ok(());
        }
        let path = self.path_of("maps", "arrow");
        let shard = &mut self.current;
        let batch = lane::encode(&new)?;
        open_or_create(&mut shard.maps, || IpcFile::create(&path, &lane::schema()))?.write(&batch)?;
        shard.n_maps += new.len() as u64;
        shard.n_lanes += batch.num_rows() as u64;
        Ok(())
    }

    fn has_map_of(&self, scene: &Scene) -> bool {
        scene.lanes.is_empty() || scene.map_id.as_ref().is_some_and(|id| self.known_maps.contains(&id.0))
    }

    /// Gives the shard's files their names, the sidecar last. Maps without scenes are dropped; they can only come after
    /// the last scene.
    fn finish_shard(&mut self) -> Result<()> {
        let OpenShard { scenes, n_scenes, n_agents, maps, n_maps, n_lanes } = std::mem::take(&mut self.current);
        let Some(scenes) = scenes else { return Ok(()) };
        let maps = match maps {
            Some(maps) => {
                Some(MapsEntry { file: self.name_of("maps", "arrow"), n_maps, n_lanes, stamp: maps.finish()? })
            }
            None => None,
        };
        let file = self.name_of("scenes", "arrow");
        let shard = ShardEntry { file, n_scenes, n_agents, stamp: scenes.finish()?, maps };
        let sidecar = ShardSidecar {
            schema: scene::schema().id(),
            shard: shard.clone(),
            units_done: self.units_done,
            report: self.report.clone(),
        };
        write_json_atomically(&self.dir.join(sidecar_name(self.shards.len())), &sidecar)?;
        self.shards.push(shard);
        Ok(())
    }

    fn name_of(&self, kind: &str, extension: &str) -> String {
        shard_name(kind, self.shards.len(), extension)
    }

    fn path_of(&self, kind: &str, extension: &str) -> PathBuf {
        self.dir.join(self.name_of(kind, extension))
    }
}

/// Calls `visit` with every scene of a shard, without its tracks and lanes.
fn for_each_scene(dir: &Path, shard: &ShardEntry, mut visit: impl FnMut(Scene)) -> Result<()> {
    let path = dir.join(&shard.file);
    for batch in MappedTable::open(&path, &scene::schema(), &shard.stamp)?.batches() {
        let batch = batch?;
        let columns = Columns::of_batch(&batch, &path);
        for row in 0..batch.num_rows() {
            visit(scene_header::decode(&columns, row)?.scene);
        }
    }
    Ok(())
}

fn open_or_create(file: &mut Option<IpcFile>, create: impl FnOnce() -> Result<IpcFile>) -> Result<&mut IpcFile> {
    match file {
        Some(file) => Ok(file),
        None => Ok(file.insert(create()?)),
    }
}

/// A hash long enough to distinguish any number of scenes.
fn hash_of(scene_id: &str) -> u128 {
    let mut start = [0; 16];
    start.copy_from_slice(&blake3::hash(scene_id.as_bytes()).as_bytes()[..16]);
    u128::from_le_bytes(start)
}

fn shard_name(kind: &str, shard_idx: usize, extension: &str) -> String {
    format!("{kind}-{shard_idx:05}.{extension}")
}

fn sidecar_name(shard_idx: usize) -> String {
    shard_name("scenes", shard_idx, "json")
}

/// The sidecar of a shard whose files all exist with the length that was written. Any other shard is unfinished and
/// will be written again.
fn finished_shard(dir: &Path, shard_idx: usize) -> Option<ShardSidecar> {
    let sidecar: ShardSidecar = read_json(&dir.join(sidecar_name(shard_idx))).ok()?;
    let has = |file: &str, stamp: &FileStamp| {
        let path = dir.join(file);
        fs::metadata(&path).is_ok_and(|found| stamp.verify_length(&path, found.len()).is_ok())
    };
    let ShardEntry { file, stamp, maps, .. } = &sidecar.shard;
    let is_whole = sidecar.schema == scene::schema().id()
        && *file == shard_name("scenes", shard_idx, "arrow")
        && has(file, stamp)
        && maps.as_ref().is_none_or(|maps| has(&maps.file, &maps.stamp));
    is_whole.then_some(sidecar)
}

/// Removes the manifest and every shard file except those to keep. Other files in the folder stay.
fn remove_store_files(dir: &Path, keep: &BTreeSet<String>) -> Result<()> {
    remove_if_present(&dir.join(MANIFEST_FILE))?;
    for entry in fs::read_dir(dir)? {
        let entry = entry?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if is_shard_file(&name) && !keep.contains(&name) {
            fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

fn is_shard_file(name: &str) -> bool {
    let number = |kind: &str, extension: &str| name.strip_prefix(kind)?.strip_suffix(extension);
    [("scenes-", ".arrow"), ("scenes-", ".json"), ("maps-", ".arrow")]
        .into_iter()
        .filter_map(|(kind, extension)| number(kind, extension))
        .any(|number| !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit()))
}

#[cfg(test)]
mod tests;
