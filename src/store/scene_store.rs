//! Random access to a scene store, from files that are mapped into memory.

use super::ipc_file::MappedTable;
use super::maps::{MapSource, MapTable};
use super::scene_index::{SceneIndex, SceneIndexEntry};
use super::scene_manifest::{MANIFEST_FILE, SceneManifest, ShardEntry};
use super::tables::columns::{Columns, entries};
use super::tables::{lane, scene};
use super::{Error, Result};
use crate::scene::{Dataset, LaneGraph, LaneId, MapId, Scene, SceneId, SituationKind, Split};
use arrow::array::{Array, RecordBatch};
use arrow::datatypes::UInt32Type;
use fs_err as fs;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// Number of batches that stay decoded: more than there are threads, because each mostly reads the scene after its last
/// one.
const N_DECODED: usize = 64;

/// A finished scene store, verified and mapped into memory. Threads can share it. Beside the mapping, a scene takes 28
/// bytes and its id.
pub struct SceneStore {
    fingerprint: String,
    shards: Vec<MappedTable>,
    batches: Vec<BatchPlace>,
    /// The last batches that were read, by position.
    decoded: Mutex<BTreeMap<usize, RecordBatch>>,
    maps: Vec<MapTable>,
    index: SceneIndex,
    /// Positions in `index`, by scene id.
    by_id: Vec<u32>,
}

struct BatchPlace {
    /// Position of its folder, and of its shard.
    folder: usize,
    shard: usize,
    /// Its position there.
    batch: usize,
    /// Position of its first scene in the store.
    first: usize,
}

impl SceneStore {
    /// Opens a finished store and verifies the checksums of all of its files.
    ///
    /// # Errors
    /// [`Error::Unfinished`] without a manifest, [`Error::SchemaVersion`] when another version wrote it,
    /// [`Error::Corrupt`] when a file is not as it was written.
    pub fn open(dir: &Path) -> Result<Self> {
        Self::open_all(&[dir])
    }

    /// Opens several folders as one store, with the scenes of the first one first. Their ids must differ.
    pub fn open_all(dirs: &[&Path]) -> Result<Self> {
        let mut store = Self {
            fingerprint: String::new(),
            shards: Vec::new(),
            batches: Vec::new(),
            decoded: Mutex::default(),
            maps: Vec::new(),
            index: SceneIndex::default(),
            by_id: Vec::new(),
        };
        let fingerprints: Vec<String> = dirs.iter().map(|dir| store.add(dir)).collect::<Result<_>>()?;
        store.fingerprint = match fingerprints.as_slice() {
            [only] => only.clone(),
            several => blake3::hash(several.concat().as_bytes()).to_hex().to_string(),
        };
        store.index.shrink();
        store.by_id = (0..store.index.len() as u32).collect();
        store.by_id.sort_unstable_by_key(|position| store.index.id(*position as usize));
        Ok(store)
    }

    /// Adds the scenes of a folder, and returns the hash of its manifest.
    fn add(&mut self, dir: &Path) -> Result<String> {
        let manifest = SceneManifest::read(dir)?;
        let opened: Vec<(MappedTable, Option<MappedTable>)> =
            manifest.shards.par_iter().map(|shard| open_shard(dir, shard)).collect::<Result<_>>()?;
        let (folder, mut maps) = (self.maps.len(), MapTable::new(dir));
        for (entry, (mut scenes, lanes)) in manifest.shards.iter().zip(opened) {
            for lanes in lanes.iter() {
                lanes.batches().try_for_each(|batch| maps.push(lanes.path(), batch?))?;
            }
            self.shards.first().into_iter().for_each(|first| scenes.share_schema(first));
            let (shard, first_of_shard) = (self.shards.len(), self.index.len());
            for batch in 0..scenes.n_batches() {
                self.batches.push(BatchPlace { folder, shard, batch, first: self.index.len() });
                enter_all(&mut self.index, &Columns::of_batch(&scenes.batch(batch)?, scenes.path()))?;
            }
            if (self.index.len() - first_of_shard) as u64 != entry.n_scenes {
                return Err(Error::corrupt(scenes.path(), "its number of scenes is not the one in the manifest"));
            }
            self.shards.push(scenes);
        }
        self.maps.push(maps);
        Ok(blake3::hash(&fs::read(dir.join(MANIFEST_FILE))?).to_hex().to_string())
    }

    /// Hash of the manifest, and through its checksums of everything in the store; hexadecimal.
    pub fn fingerprint(&self) -> &str {
        &self.fingerprint
    }

    /// Number of scenes.
    pub const fn len(&self) -> usize {
        self.index.len()
    }

    /// Whether there are no scenes.
    pub const fn is_empty(&self) -> bool {
        self.index.is_empty()
    }

    /// One entry a scene, in the order of ingest.
    pub const fn index(&self) -> &SceneIndex {
        &self.index
    }

    /// The position of a scene.
    pub fn position(&self, id: &SceneId) -> Option<usize> {
        let found = self.by_id.binary_search_by_key(&id.0.as_str(), |position| self.index.id(*position as usize));
        found.ok().map(|at| self.by_id[at] as usize)
    }

    /// Loads scene `i` with its lanes.
    ///
    /// # Errors
    /// [`Error::NotFound`] when there are fewer; errors of its map.
    pub fn scene(&self, i: usize) -> Result<Scene> {
        let after = self.batches.partition_point(|batch| batch.first <= i);
        let Some(at) = after.checked_sub(1).filter(|_| i < self.len()) else {
            let path = self.dir().join(MANIFEST_FILE);
            return Err(Error::NotFound { path, what: format!("scene {i}: there are {}", self.len()) });
        };
        let BatchPlace { folder, shard, first, .. } = self.batches[at];
        let batch = self.batch(at)?;
        scene::decode(&Columns::of_batch(&batch, self.shards[shard].path()), i - first, &self.maps[folder])
    }

    /// The first folder.
    fn dir(&self) -> &Path {
        self.maps.first().map_or(Path::new(""), MapTable::dir)
    }

    /// The answer of the first folder that has the map.
    fn of_maps<T>(&self, ask: impl Fn(&MapTable) -> Result<T>) -> Result<T> {
        let mut answers = self.maps.iter().map(ask);
        let first = answers
            .next()
            .unwrap_or_else(|| Err(Error::NotFound { path: self.dir().to_owned(), what: "maps".to_owned() }));
        first.or_else(|error| answers.find_map(Result::ok).ok_or(error))
    }

    /// The batch at this position among all.
    fn batch(&self, at: usize) -> Result<RecordBatch> {
        let lock = || self.decoded.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(batch) = lock().get(&at) {
            return Ok(batch.clone());
        }
        let BatchPlace { shard, batch, .. } = self.batches[at];
        let batch = self.shards[shard].batch(batch)?;
        let mut decoded = lock();
        if decoded.len() >= N_DECODED {
            decoded.clear();
        }
        decoded.insert(at, batch.clone());
        Ok(batch)
    }
}

impl MapSource for SceneStore {
    fn map(&self, id: &MapId) -> Result<LaneGraph> {
        self.of_maps(|maps| maps.map(id))
    }

    fn lanes(&self, id: &MapId, lane_ids: &[LaneId]) -> Result<LaneGraph> {
        self.of_maps(|maps| maps.lanes(id, lane_ids))
    }
}

/// The scenes of a shard, and the maps that come with it.
fn open_shard(dir: &Path, shard: &ShardEntry) -> Result<(MappedTable, Option<MappedTable>)> {
    let lanes = shard.maps.as_ref();
    let lanes = lanes.map(|maps| MappedTable::open(&dir.join(&maps.file), &lane::schema(), &maps.stamp)).transpose()?;
    Ok((MappedTable::open(&dir.join(&shard.file), &scene::schema(), &shard.stamp)?, lanes))
}

/// Adds the scenes of a batch to the index.
fn enter_all(index: &mut SceneIndex, columns: &Columns<'_>) -> Result<()> {
    let (tracks, _) = columns.of_list("tracks")?;
    for row in 0..tracks.len() {
        index.push(SceneIndexEntry {
            id: columns.text("scene_id", row)?,
            dataset: columns.named("dataset", row, Dataset::from_name)?,
            split: columns.named("split", row, Split::from_name)?,
            situation: columns.named("situation", row, SituationKind::from_name)?,
            place: columns.text("place", row)?,
            n_agents: entries(tracks, row).len() as u32,
            n_timesteps: columns.number::<UInt32Type>("n_timesteps", row)?,
        });
    }
    Ok(())
}

impl std::fmt::Debug for SceneStore {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SceneStore").field("dir", &self.dir()).field("n_scenes", &self.len()).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::testing::{folder_bytes, map, scene};
    use crate::store::{SceneWriter, as_stored};
    use proptest::prelude::*;
    use serde_json::json;

    /// Writes scenes two by two, every third without a map.
    fn write(dir: &Path, scenes: &[Scene], maps: &[(MapId, LaneGraph)]) {
        let mut writer = SceneWriter::resume(dir).unwrap().0.in_shards_of(3);
        for (i, batch) in scenes.chunks(2).enumerate() {
            writer.write_batch(batch, maps, Some(i as u64), &json!(i)).unwrap();
        }
        writer.finish(&json!({ "rejects": {} })).unwrap();
    }

    fn scenes(seeds: std::ops::Range<u64>) -> (Vec<Scene>, Vec<(MapId, LaneGraph)>) {
        let maps = vec![(MapId::from("PIT"), map(1, 9)), (MapId::from("MIA"), map(2, 7))];
        let choose = |seed: u64| maps.get(seed as usize % 3).map(|(id, graph)| (id, graph));
        (seeds.map(|seed| scene(seed, choose(seed))).collect(), maps)
    }

    #[test]
    fn any_scene_can_be_read_at_once() {
        let dir = tempfile::tempdir().unwrap();
        let (scenes, maps) = scenes(0..11);
        write(dir.path(), &scenes, &maps);
        let store = SceneStore::open(dir.path()).unwrap();
        assert_eq!(store.len(), 11);
        assert_eq!(store.shards.len(), 3);
        for i in [10, 0, 5, 3, 4, 9] {
            assert_eq!(store.scene(i).unwrap(), as_stored(&scenes[i]), "scene {i}");
            let entry = store.index().get(i);
            assert_eq!((entry.id, entry.n_agents as usize), (scenes[i].id.0.as_str(), scenes[i].tracks.len()));
            assert_eq!(store.position(&scenes[i].id), Some(i));
        }
        assert_eq!(store.position(&SceneId::from("nowhere")), None);
        let error = store.scene(11).unwrap_err().to_string();
        assert!(error.contains("scene 11: there are 11"), "{error}");
    }

    #[test]
    fn of_many_batches_few_are_kept_decoded() {
        let dir = tempfile::tempdir().unwrap();
        let (scenes, maps) = scenes(0..2 * N_DECODED as u64 + 6);
        write(dir.path(), &scenes, &maps);
        let store = SceneStore::open(dir.path()).unwrap();
        let n_decoded = || store.decoded.lock().unwrap().len();
        assert_eq!((store.batches.len(), n_decoded()), (N_DECODED + 3, 0));
        let schemas = store.shards.iter().map(|shard| shard.batch(0).unwrap().schema());
        assert!(schemas.clone().all(|schema| std::sync::Arc::ptr_eq(&schema, &schemas.clone().next().unwrap())));
        for (i, scene) in scenes.iter().enumerate().chain([(0, &scenes[0])]) {
            assert_eq!(store.scene(i).unwrap(), as_stored(scene), "scene {i}");
            assert!((1..=N_DECODED).contains(&n_decoded()), "scene {i}");
        }
    }

    #[test]
    fn maps_are_read_whole_or_in_part() {
        let dir = tempfile::tempdir().unwrap();
        let (scenes, maps) = scenes(0..4);
        write(dir.path(), &scenes, &maps);
        let store = SceneStore::open(dir.path()).unwrap();
        for (id, graph) in &maps {
            assert_eq!(store.map(id).unwrap(), *graph);
            let some: Vec<LaneId> = graph.lanes().iter().step_by(2).map(|lane| lane.id).collect();
            assert_eq!(store.lanes(id, &some).unwrap(), graph.subset(&some));
        }
        let error = store.map(&MapId::from("WDC")).unwrap_err().to_string();
        assert!(error.starts_with("map WDC is not among the maps of"), "{error}");
        let error = store.lanes(&maps[0].0, &[LaneId(7)]).unwrap_err().to_string();
        assert!(error.ends_with("holds no lane 7 of map PIT"), "{error}");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20))]
        #[test]
        fn what_is_read_is_what_was_written(first in 0..1_000_000u64) {
            let (first_dir, second_dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
            let (scenes, maps) = scenes(first..first + 4);
            write(first_dir.path(), &scenes, &maps);
            let store = SceneStore::open(first_dir.path()).unwrap();
            let read: Vec<Scene> = (0..store.len()).map(|i| store.scene(i).unwrap()).collect();
            for (read, scene) in read.iter().zip(&scenes) {
                prop_assert_eq!(&read.lanes, &scene.lanes);
                prop_assert_eq!(read.world_from_scene, scene.world_from_scene);
                for (track, original) in read.tracks.iter().zip(&scene.tracks) {
                    prop_assert_eq!(
                        (&track.id, track.class, track.role),
                        (&original.id, original.class, original.role)
                    );
                    for (state, original) in track.trajectory.entries().iter().zip(original.trajectory.entries()) {
                        prop_assert_eq!(state.is_some(), original.is_some());
                        let (Some(state), Some(original)) = (state, original) else { continue };
                        // In the recording's frame, for which single precision would give only decimeters.
                        let world = |s: &crate::scene::State| scene.world_from_scene.point(s.position);
                        prop_assert!(world(state).distance(world(original)) < 1e-4);
                    }
                }
            }
            write(second_dir.path(), &read, &maps);
            prop_assert_eq!(folder_bytes(first_dir.path()), folder_bytes(second_dir.path()));
        }
    }

    #[test]
    fn several_folders_are_one_store() {
        let dirs = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
        let (scenes, maps) = scenes(0..9);
        write(dirs[0].path(), &scenes[..4], &maps);
        write(dirs[1].path(), &scenes[4..], &maps);
        let store = SceneStore::open_all(&dirs.each_ref().map(|dir| dir.path())).unwrap();
        for (i, scene) in scenes.iter().enumerate() {
            assert_eq!((store.scene(i).unwrap(), store.position(&scene.id)), (as_stored(scene), Some(i)), "scene {i}");
        }
        assert!(maps.iter().all(|(id, graph)| store.map(id).unwrap() == *graph));
        let alone = SceneStore::open(dirs[0].path()).unwrap();
        assert_ne!(alone.fingerprint(), store.fingerprint());
    }

    #[test]
    fn an_empty_store_is_a_store() {
        let dir = tempfile::tempdir().unwrap();
        write(dir.path(), &[], &[]);
        assert!(SceneStore::open(dir.path()).unwrap().is_empty());
    }

    #[test]
    fn an_unfinished_store_says_what_to_do() {
        let dir = tempfile::tempdir().unwrap();
        let error = SceneStore::open(dir.path()).unwrap_err().to_string();
        assert!(error.contains("has no manifest.json") && error.contains("run that command again"), "{error}");
    }

    #[test]
    fn another_version_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let (scenes, maps) = scenes(0..2);
        write(dir.path(), &scenes, &maps);
        let path = dir.path().join(MANIFEST_FILE);
        let text = fs::read_to_string(&path).unwrap().replace("scene.v1", "scene.v0");
        fs::write(&path, text).unwrap();
        let error = SceneStore::open(dir.path()).unwrap_err().to_string();
        assert!(error.contains("has schema `scene.v0`, expected `scene.v1`"), "{error}");
    }

    #[test]
    fn damage_anywhere_is_an_error_that_names_the_file() {
        let dir = tempfile::tempdir().unwrap();
        let (scenes, maps) = scenes(0..4);
        write(dir.path(), &scenes, &maps);
        for file in ["scenes-00000.arrow", "maps-00000.arrow"] {
            let path = dir.path().join(file);
            let whole = fs::read(&path).unwrap();
            for at in (0..whole.len()).step_by(97) {
                let mut damaged = whole.clone();
                damaged[at] ^= 0x10;
                for content in [&damaged[..], &whole[..at]] {
                    fs::write(&path, content).unwrap();
                    let error = SceneStore::open(dir.path()).unwrap_err();
                    assert!(matches!(&error, Error::Corrupt { path, .. } if path.ends_with(file)), "{error}");
                }
            }
            fs::write(&path, &whole).unwrap();
        }
        SceneStore::open(dir.path()).unwrap();
        fs::remove_file(dir.path().join("scenes-00000.arrow")).unwrap();
        assert!(SceneStore::open(dir.path()).unwrap_err().to_string().contains("scenes-00000.arrow"));
    }

    #[test]
    fn equal_stores_have_equal_fingerprints() {
        let dirs = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
        for (dir, seeds) in dirs.iter().zip([0..3, 0..3, 1..4]) {
            let (scenes, maps) = scenes(seeds);
            write(dir.path(), &scenes, &maps);
        }
        let fingerprints = dirs.map(|dir| SceneStore::open(dir.path()).unwrap().fingerprint().to_owned());
        assert_eq!(fingerprints[0], fingerprints[1]);
        assert_ne!(fingerprints[0], fingerprints[2]);
    }
}
