//! Writing a scene store: shards that are whole or absent, and where to go on after an interruption.

use super::atomic::{FileStamp, read_json, remove_if_present, remove_partials, write_json_atomically};
use super::ipc_file::{self, IpcFile};
use super::maps::MapTable;
use super::scene_manifest::{MANIFEST_FILE, MapsEntry, SceneManifest, ShardEntry, ShardSidecar};
use super::tables::columns::Columns;
use super::tables::{lane, scene};
use super::{Error, Result};
use crate::scene::{LaneGraph, MapId, Scene};
use fs_err as fs;
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

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

/// Writes a scene store, shard by shard.
///
/// A shard is up to three files: `maps-00000.arrow` with the maps that it is the first to need, `scenes-00000.arrow`, and,
/// once both are whole, the sidecar `scenes-00000.json`. The manifest is written last. The same scenes in the same batches
/// give the same bytes, whether or not the writer was interrupted.
pub struct SceneWriter {
    dir: PathBuf,
    options: SceneWriterOptions,
    shards: Vec<ShardEntry>,
    current: Shard,
    known_maps: BTreeSet<String>,
    /// Hashes of the ids of all scenes so far.
    known_scenes: BTreeSet<u128>,
    units_done: u64,
    report: Value,
}

/// The shard that is being written.
#[derive(Default)]
struct Shard {
    scenes: Option<IpcFile>,
    n_scenes: u64,
    n_agents: u64,
    maps: Option<IpcFile>,
    n_maps: u64,
    n_lanes: u64,
}

impl SceneWriter {
    /// Begins a store in `dir`, which is created where it is missing; the files of an earlier store there are removed.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn create(dir: &Path, options: SceneWriterOptions) -> Result<Self> {
        fs::create_dir_all(dir)?;
        remove_store_files(dir, &BTreeSet::new())?;
        Ok(Self {
            dir: dir.to_owned(),
            options,
            shards: Vec::new(),
            current: Shard::default(),
            known_maps: BTreeSet::new(),
            known_scenes: BTreeSet::new(),
            units_done: 0,
            report: Value::Null,
        })
    }

    /// Continues after the last finished shard, whose sidecar says how many units are done and what was reported up to
    /// then. `None`: nothing is finished, begin at the start of the input. Half-written files are removed.
    ///
    /// # Errors
    /// Those of the file system, and of maps that cannot be read.
    pub fn resume(dir: &Path, options: SceneWriterOptions) -> Result<(Self, Option<ShardSidecar>)> {
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
            for batch in ipc_file::map(&path, &lane::schema(), &maps.stamp)? {
                known_maps.push(&path, batch)?;
            }
        }
        let mut known_scenes = BTreeSet::new();
        for sidecar in &finished {
            let path = dir.join(&sidecar.shard.file);
            for batch in ipc_file::map(&path, &scene::schema(), &sidecar.shard.stamp)? {
                let columns = Columns::of_batch(&batch, &path);
                for row in 0..batch.num_rows() {
                    known_scenes.insert(hash_of(columns.text("scene_id", row)?));
                }
            }
        }
        let last = finished.last().cloned();
        let writer = Self {
            dir: dir.to_owned(),
            options,
            units_done: last.as_ref().map_or(0, |sidecar| sidecar.units_done),
            report: last.as_ref().map_or(Value::Null, |sidecar| sidecar.report.clone()),
            shards: finished.into_iter().map(|sidecar| sidecar.shard).collect(),
            current: Shard::default(),
            known_maps: known_maps.ids().map(str::to_owned).collect(),
            known_scenes,
        };
        Ok((writer, last))
    }

    /// Adds scenes, after the maps that they are the first to need; maps that are known already are passed over.
    /// `units_done` and `report` are cumulative since the start of the job, and describe it once this batch is in.
    ///
    /// # Errors
    /// [`Error::Invalid`] when a scene cannot be stored, for instance because its map was never given;
    /// [`Error::DuplicateScene`] when its id was given before; those of the file system. The writer is of no use afterwards, but what it finished remains for [`resume`](Self::resume).
    pub fn write_batch(
        &mut self,
        scenes: &[Scene],
        maps: &[(MapId, LaneGraph)],
        units_done: u64,
        report: &Value,
    ) -> Result<()> {
        self.write_maps(maps)?;
        if let Some(scene) = scenes.iter().find(|scene| !self.has_map_of(scene)) {
            return Err(Error::invalid(&scene.id, "its map was not given before it"));
        }
        if let Some(scene) = scenes.iter().find(|scene| !self.known_scenes.insert(hash_of(&scene.id.0))) {
            return Err(Error::DuplicateScene { id: scene.id.to_string() });
        }
        if !scenes.is_empty() {
            let path = self.path_of("scenes", "arrow");
            let batch = scene::encode(scenes)?;
            let shard = &mut self.current;
            open_or_create(&mut shard.scenes, || IpcFile::create(&path, &scene::schema()))?.write(&batch)?;
            shard.n_scenes += scenes.len() as u64;
            shard.n_agents += scenes.iter().map(|scene| scene.tracks.len() as u64).sum::<u64>();
        }
        self.units_done = units_done;
        self.report = report.clone();
        if self.current.n_scenes >= self.options.scenes_per_shard as u64 {
            self.finish_shard()?;
        }
        Ok(())
    }

    /// Finishes the last shard and writes the manifest with the caller's report on the whole job.
    ///
    /// # Errors
    /// Those of the file system.
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

    /// Gives the shard's files their names, the sidecar last. Maps without scenes are dropped: they can only come after the
    /// last scene.
    fn finish_shard(&mut self) -> Result<()> {
        let Shard { scenes, n_scenes, n_agents, maps, n_maps, n_lanes } = std::mem::take(&mut self.current);
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

fn open_or_create(file: &mut Option<IpcFile>, create: impl FnOnce() -> Result<IpcFile>) -> Result<&mut IpcFile> {
    match file {
        Some(file) => Ok(file),
        None => Ok(file.insert(create()?)),
    }
}

/// Enough of a hash to tell any number of scenes apart.
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

/// The sidecar of a shard all of whose files are there and of the length they were written with. Anything else is simply
/// not finished: it will be written again.
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

/// Removes the manifest, leftovers, and every shard file that is not to be kept. Other files in the folder stay.
fn remove_store_files(dir: &Path, keep: &BTreeSet<String>) -> Result<()> {
    remove_partials(dir)?;
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
mod tests {
    use super::*;
    use crate::store::testing::{folder_bytes, map, scene};
    use serde_json::json;

    /// The batches of a job: (scenes, maps first needed, units done).
    type Batch = (Vec<Scene>, Vec<(MapId, LaneGraph)>, u64);

    fn batches() -> Vec<Batch> {
        let maps: Vec<(MapId, LaneGraph)> = (0..3).map(|i| (MapId(format!("map {i}")), map(i, 8))).collect();
        let scenes = |range: std::ops::Range<u64>, map_idx: usize| -> Vec<Scene> {
            let (id, graph) = &maps[map_idx];
            range.map(|seed| scene(seed, Some((id, graph)))).collect()
        };
        vec![
            (scenes(0..3, 0), vec![maps[0].clone()], 4),
            (Vec::new(), Vec::new(), 6),
            (scenes(3..6, 0), Vec::new(), 9),
            (scenes(6..9, 1), vec![maps[1].clone()], 12),
            (scenes(9..10, 0), Vec::new(), 13),
            (scenes(10..12, 2), vec![maps[2].clone()], 15),
            (Vec::new(), Vec::new(), 16),
        ]
    }

    const OPTIONS: SceneWriterOptions = SceneWriterOptions { scenes_per_shard: 4 };

    /// Writes the batches that are not done yet. As an ingest does after an interruption, all maps that they need are given
    /// again when they come first since then.
    fn write_rest(writer: &mut SceneWriter, done: u64, n_batches: usize) {
        let all = batches();
        let mut given = BTreeSet::new();
        for (scenes, _, units_done) in all.iter().take(n_batches).filter(|(.., units_done)| *units_done > done) {
            let needed: BTreeSet<&MapId> = scenes.iter().filter_map(|scene| scene.map_id.as_ref()).collect();
            let maps = all.iter().flat_map(|(_, maps, _)| maps).filter(|(id, _)| needed.contains(id));
            let maps: Vec<_> = maps.filter(|(id, _)| given.insert(id.clone())).cloned().collect();
            writer.write_batch(scenes, &maps, *units_done, &json!({ "units": units_done })).unwrap();
        }
    }

    fn uninterrupted(dir: &Path) -> SceneManifest {
        let mut writer = SceneWriter::create(dir, OPTIONS).unwrap();
        write_rest(&mut writer, 0, usize::MAX);
        writer.finish(&json!({ "units": 16 })).unwrap()
    }

    #[test]
    fn shards_end_with_the_batch_that_fills_them() {
        let dir = tempfile::tempdir().unwrap();
        let manifest = uninterrupted(dir.path());
        let n_scenes: Vec<u64> = manifest.shards.iter().map(|shard| shard.n_scenes).collect();
        assert_eq!(n_scenes, [6, 4, 2]);
        let n_maps: Vec<u64> =
            manifest.shards.iter().filter_map(|shard| shard.maps.as_ref()).map(|m| m.n_maps).collect();
        assert_eq!(n_maps, [1, 1, 1]);
        assert_eq!((manifest.n_scenes, manifest.n_maps), (12, 3));
        assert_eq!(SceneManifest::read(dir.path()).unwrap(), manifest);
    }

    #[test]
    fn a_resumed_store_has_the_bytes_of_an_uninterrupted_one() {
        let whole = tempfile::tempdir().unwrap();
        uninterrupted(whole.path());
        let expected = folder_bytes(whole.path());
        for n_batches in 0..=batches().len() {
            let dir = tempfile::tempdir().unwrap();
            let mut writer = SceneWriter::create(dir.path(), OPTIONS).unwrap();
            write_rest(&mut writer, 0, n_batches);
            // A killed process does not clean up.
            std::mem::forget(writer);
            let (mut writer, last) = SceneWriter::resume(dir.path(), OPTIONS).unwrap();
            write_rest(&mut writer, last.as_ref().map_or(0, |sidecar| sidecar.units_done), usize::MAX);
            writer.finish(&json!({ "units": 16 })).unwrap();
            assert!(folder_bytes(dir.path()) == expected, "interrupted after {n_batches} batches");
        }
    }

    #[test]
    fn a_kill_between_any_two_renames_is_survived() {
        let whole = tempfile::tempdir().unwrap();
        uninterrupted(whole.path());
        let expected = folder_bytes(whole.path());
        // Files get their names in this order; a kill leaves a prefix of it, and a half-written file after it.
        let mut order: Vec<String> = Vec::new();
        for shard_idx in 0..3 {
            order.push(shard_name("maps", shard_idx, "arrow"));
            order.push(shard_name("scenes", shard_idx, "arrow"));
            order.push(sidecar_name(shard_idx));
        }
        order.push(MANIFEST_FILE.to_owned());
        assert_eq!(order.len(), expected.len());
        for n_named in 0..=order.len() {
            let dir = tempfile::tempdir().unwrap();
            for name in &order[..n_named] {
                fs::write(dir.path().join(name), &expected[name]).unwrap();
            }
            if let Some(name) = order.get(n_named) {
                fs::write(dir.path().join(format!("{name}.partial")), &expected[name][..10]).unwrap();
            }
            let (mut writer, last) = SceneWriter::resume(dir.path(), OPTIONS).unwrap();
            assert_eq!(last.is_some(), n_named >= 3);
            write_rest(&mut writer, last.map_or(0, |sidecar| sidecar.units_done), usize::MAX);
            writer.finish(&json!({ "units": 16 })).unwrap();
            assert!(folder_bytes(dir.path()) == expected, "killed after {n_named} renames");
        }
    }

    #[test]
    fn create_removes_an_earlier_store_and_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        uninterrupted(dir.path());
        fs::write(dir.path().join("scenes-of-mine.txt"), "keep").unwrap();
        let writer = SceneWriter::create(dir.path(), OPTIONS).unwrap();
        drop(writer);
        assert_eq!(folder_bytes(dir.path()).into_keys().collect::<Vec<_>>(), ["scenes-of-mine.txt"]);
    }

    #[test]
    fn a_scene_that_comes_twice_is_refused_even_after_an_interruption() {
        let dir = tempfile::tempdir().unwrap();
        let batches = batches();
        let options = SceneWriterOptions { scenes_per_shard: 3 };
        let mut writer = SceneWriter::create(dir.path(), options).unwrap();
        let (scenes, maps, units) = &batches[0];
        writer.write_batch(scenes, maps, *units, &json!({})).unwrap();
        for mut writer in [writer, SceneWriter::resume(dir.path(), options).unwrap().0] {
            let error = writer.write_batch(&scenes[1..2], &[], units + 1, &json!({})).unwrap_err();
            assert!(matches!(&error, Error::DuplicateScene { id } if *id == scenes[1].id.0), "{error}");
        }
    }

    #[test]
    fn a_scene_whose_map_was_never_given_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = SceneWriter::create(dir.path(), OPTIONS).unwrap();
        let scenes = [scene(1, Some((&MapId::from("PIT"), &map(1, 8))))];
        let error = writer.write_batch(&scenes, &[], 1, &Value::Null).unwrap_err();
        assert_eq!(error.to_string(), "cannot store argoverse1/train/PIT/1: its map was not given before it");
    }

    #[test]
    fn states_that_are_not_finite_are_refused_by_name() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = SceneWriter::create(dir.path(), OPTIONS).unwrap();
        let mut scene = scene(1, None);
        let mut states = scene.tracks[0].trajectory.entries().to_vec();
        states[5].as_mut().unwrap().velocity.x = 1e300;
        scene.tracks[0].trajectory = crate::scene::Trajectory::new(states);
        let error = writer.write_batch(&[scene], &[], 1, &Value::Null).unwrap_err();
        assert!(error.to_string().contains("track track-0 is not finite at timestep 5"), "{error}");
    }
}
