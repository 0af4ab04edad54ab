//! The maps of places, which are read before the recordings.

use super::archive::{Entry, visit_entries};
use super::config::IngestConfig;
use super::error::Error;
use super::files::PassedOver;
use super::lane_index::LaneIndex;
use super::source::{MapFile, RecordingSource};
use crate::progress::Progress;
use crate::scene::{Lane, LaneGraph, MapId};
use std::collections::btree_map::Entry as MapEntry;
use std::collections::{BTreeMap, BTreeSet};
use std::io::BufRead;
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex, PoisonError};

/// The maps of places and cities by id. Empty if maps are not read, or scenes bring their own.
#[derive(Debug, Default)]
pub(super) struct MapCatalog {
    maps: BTreeMap<MapId, Listed>,
    /// Maps that cannot be read, which is an error only for recordings that need them.
    broken: BTreeMap<MapId, Broken>,
}

/// The file of a map that cannot be read, the place in it, and the fault.
#[derive(Debug)]
struct Broken(String, String, String);

impl Broken {
    fn error(&self) -> Error {
        let Self(file, place, detail) = self;
        Error::map(file, place, detail.trim_end_matches("; ").to_owned())
    }
}

/// A map and the file it is from.
#[derive(Debug)]
struct Listed {
    lanes: LaneIndex,
    rank: u8,
    path: String,
    warnings: String,
}

impl MapCatalog {
    /// Reads the maps among `map_inputs`, or else among the inputs themselves.
    ///
    /// # Errors
    /// When none is found, or a place named by the recordings' paths lacks one or has one that cannot be read.
    pub(super) fn read(
        config: &IngestConfig,
        source: &dyn RecordingSource,
        passed_over: &PassedOver<'_>,
        progress: &dyn Progress,
    ) -> Result<Self, Error> {
        if !config.wants_maps() || source.has_own_maps() {
            return Ok(Self::default());
        }
        let inputs = if config.map_inputs.is_empty() { &config.inputs } else { &config.map_inputs };
        let needed = Mutex::new(BTreeSet::new());
        let is_wanted = |path: &str| {
            if source.is_recording(path) {
                needed.lock().unwrap_or_else(PoisonError::into_inner).extend(source.map_of(path));
            }
            passed_over.note(path);
            source.map_at(path).is_some()
        };
        let mut catalog = Self::default();
        visit_entries(inputs, &is_wanted, &mut |entry, reader| {
            catalog.add(entry, reader, source, progress)?;
            Ok(ControlFlow::Continue(()))
        })?;
        if catalog.maps.is_empty() && catalog.broken.is_empty() {
            let searched: Vec<String> = inputs.iter().map(|input| input.display().to_string()).collect();
            return Err(Error::NoMaps { dataset: config.dataset.name(), searched: searched.join(", ") });
        }
        let needed = needed.into_inner().unwrap_or_else(PoisonError::into_inner);
        catalog.require(needed.into_iter().filter(|id| !catalog.maps.contains_key(id)))?;
        for broken in catalog.broken.values() {
            progress.warn(&format!("{}; it is passed over, as no recording is known to need it", broken.error()));
        }
        for listed in catalog.maps.values().filter(|listed| !listed.warnings.is_empty()) {
            progress.warn(&format!("{}: {}", listed.path, listed.warnings));
        }
        Ok(catalog)
    }

    fn add(
        &mut self,
        entry: &Entry,
        reader: &mut dyn BufRead,
        source: &dyn RecordingSource,
        progress: &dyn Progress,
    ) -> Result<(), Error> {
        let Some(id) = source.map_at(&entry.path) else { return Ok(()) };
        let MapFile { graph, rank, warnings } = match source.read_map(entry, reader) {
            Err(Error::Map { file, place, detail }) => {
                self.broken.insert(id, Broken(file, place, detail));
                return Ok(());
            }
            map => map?,
        };
        let listed = Listed { lanes: LaneIndex::new(Arc::new(graph)), rank, path: entry.path.clone(), warnings };
        match self.maps.entry(id) {
            MapEntry::Vacant(place) => drop(place.insert(listed)),
            MapEntry::Occupied(mut place) => {
                let is_better = rank < place.get().rank;
                let other = if is_better { place.insert(listed) } else { listed };
                let (id, taken) = (place.key(), place.get());
                match are_alike(taken.lanes.graph(), other.lanes.graph()) {
                    true => progress.note(&format!("skipped {}: map {id} is also in {}", other.path, taken.path)),
                    false => progress.warn(&format!(
                        "{} and {} are different maps of {id}: the first is taken; remove the one that is out of date",
                        taken.path, other.path
                    )),
                }
            }
        }
        Ok(())
    }

    /// The map of this id.
    pub(super) fn get(&self, id: &MapId) -> Option<&LaneIndex> {
        self.maps.get(id).map(|listed| &listed.lanes)
    }

    /// Fails if any map is missing.
    ///
    /// # Errors
    /// [`Error::Map`] for one that cannot be read; else [`Error::MissingMaps`] names them, and those that were found.
    pub(super) fn require(&self, missing: impl Iterator<Item = MapId>) -> Result<(), Error> {
        let missing: Vec<MapId> = missing.collect();
        if let Some(broken) = missing.iter().find_map(|id| self.broken.get(id)) {
            return Err(broken.error());
        }
        let missing: Vec<String> = missing.into_iter().map(|id| id.0).collect();
        if missing.is_empty() {
            return Ok(());
        }
        Err(Error::MissingMaps { missing, found: self.maps.keys().map(|id| id.0.clone()).collect() })
    }
}

/// Whether two maps have the same lanes, but for the digits with which they are written.
fn are_alike(one: &LaneGraph, other: &LaneGraph) -> bool {
    const MAX_DISTANCE_M: f64 = 0.1;
    let is_near = |a: &Lane, b: &Lane| {
        let (a, b) = (&a.centerline.0, &b.centerline.0);
        a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.distance(*b) <= MAX_DISTANCE_M)
    };
    let (one, other) = (one.lanes(), other.lanes());
    one.len() == other.len() && one.iter().zip(other).all(|(a, b)| a.id == b.id && is_near(a, b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ingest::interaction::Interaction;
    use crate::progress::Silent;
    use crate::scene::Dataset;

    /// Keeps what the user is told.
    #[derive(Default)]
    struct Told(Mutex<Vec<String>>);

    impl Progress for Told {
        fn warn(&self, message: &str) {
            self.0.lock().unwrap().push(message.to_owned());
        }
    }

    #[test]
    fn different_maps_of_one_place_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let source = "tests/fixtures/recordings/interaction_v1_1/maps/FIX_Intersection.osm";
        let xy = fs_err::read_to_string(format!("{source}_xy")).unwrap();
        let config = IngestConfig::new(Dataset::Interaction, vec![folder.path().to_owned()]);
        let told = || {
            let told = Told::default();
            MapCatalog::read(&config, &Interaction::new(&config), &PassedOver::new(&told), &told).unwrap();
            told.0.into_inner().unwrap()
        };
        for folder in [folder.path().join("maps"), folder.path().join("archive")] {
            fs_err::create_dir_all(folder).unwrap();
        }
        fs_err::copy(source, folder.path().join("maps/FIX_Intersection.osm")).unwrap();
        fs_err::write(folder.path().join("maps/FIX_Intersection.osm_xy"), &xy).unwrap();
        assert_eq!(told(), [""; 0], "one map in both encodings");
        // An old copy, without one of the lanes.
        let old = xy.replacen("\"lanelet\"", "\"multipolygon\"", 1);
        fs_err::write(folder.path().join("archive/FIX_Intersection.osm_xy"), old).unwrap();
        let told = told();
        assert!(
            told[0].starts_with("maps/FIX_Intersection.osm and archive/FIX_Intersection.osm_xy are different maps of"),
            "{told:?}"
        );
    }

    #[test]
    fn maps_that_recordings_need_are_missed_before_any_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let map = "tests/fixtures/recordings/interaction_v1_1/maps/FIX_Intersection.osm";
        fs_err::create_dir_all(folder.path().join("maps")).unwrap();
        fs_err::copy(map, folder.path().join("maps/FIX_Intersection.osm")).unwrap();
        let config = IngestConfig::new(Dataset::Interaction, vec![folder.path().to_owned()]);
        let read = || MapCatalog::read(&config, &Interaction::new(&config), &PassedOver::new(&Silent), &Silent);
        // A map that nobody needs may be broken.
        fs_err::write(folder.path().join("maps/FIX_Nowhere.osm"), "<osm>").unwrap();
        assert_eq!(read().unwrap().maps.len(), 1);
        for place in ["FIX_Intersection", "FIX_Elsewhere"] {
            let tracks = folder.path().join(format!("recorded_trackfiles/{place}/vehicle_tracks_000.csv"));
            fs_err::create_dir_all(tracks.parent().unwrap()).unwrap();
            fs_err::write(tracks, "").unwrap();
        }
        fs_err::write(folder.path().join("maps/FIX_Elsewhere.osm"), "<osm>").unwrap();
        let broken = read().unwrap_err().to_string();
        assert!(broken.starts_with("map maps/FIX_Elsewhere.osm, line 1: "), "{broken}");
        fs_err::remove_file(folder.path().join("maps/FIX_Elsewhere.osm")).unwrap();
        let Err(Error::MissingMaps { missing, found }) = read() else { panic!("a map is missing") };
        assert_eq!((missing.len(), found.len()), (1, 1));
        assert!(missing[0].contains("FIX_Elsewhere") && found[0].contains("FIX_Intersection"), "{missing:?} {found:?}");
    }
}
