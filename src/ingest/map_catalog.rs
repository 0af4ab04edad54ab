//! The maps of places, which are read before the recordings.

use super::archive::{Entry, visit_entries};
use super::config::IngestConfig;
use super::error::Error;
use super::files::is_archive;
use super::lane_index::LaneIndex;
use super::map_report::MapReport;
use super::places::Places;
use super::raw::Finding;
use super::source::{MapFile, RecordingSource};
use crate::progress::Progress;
use crate::scene::{Lane, LaneGraph, MapId};
use std::cell::RefCell;
use std::collections::btree_map::Entry as MapEntry;
use std::collections::{BTreeMap, BTreeSet};
use std::io::BufRead;
use std::ops::ControlFlow;
use std::sync::Arc;

/// The maps of places and cities by id. Empty if maps are not read, or scenes bring their own.
#[derive(Debug, Default)]
pub(super) struct MapCatalog {
    maps: BTreeMap<MapId, Listed>,
    /// Maps that cannot be read, which is an error only for recordings that need them.
    broken: BTreeMap<MapId, Broken>,
    /// Archives among the inputs that are not supported.
    passed_over: BTreeSet<String>,
    /// Doubts about the maps and lanes left out of them, for the report; the user has been warned of them.
    pub(super) findings: Vec<Finding>,
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
    report: MapReport,
}

impl MapCatalog {
    /// Reads the maps among `map_inputs`, or otherwise among the inputs themselves.
    pub(super) fn read(
        config: &IngestConfig,
        source: &dyn RecordingSource,
        places: &Places<'_>,
        progress: &dyn Progress,
    ) -> Result<Self, Error> {
        if !config.wants_maps() || source.has_own_maps() {
            return Ok(Self::default());
        }
        let inputs = if config.map_inputs.is_empty() { &config.inputs } else { &config.map_inputs };
        let (needed, passed_over) = (RefCell::new(BTreeMap::new()), RefCell::new(BTreeSet::new()));
        let is_wanted = |path: &str| {
            places.note(source.place_at(path).as_deref());
            if let Some(id) = source.map_of(path).filter(|_| source.is_recording(path)) {
                needed.borrow_mut().entry(id).or_insert_with(|| path.to_owned());
            }
            if is_archive(path) {
                passed_over.borrow_mut().insert(path.to_owned());
            }
            source.map_at(path).is_some()
        };
        let mut catalog = Self::default();
        visit_entries(inputs, &is_wanted, &mut |entry, reader| {
            catalog.add(entry, reader, source, progress)?;
            Ok(ControlFlow::Continue(()))
        })?;
        catalog.passed_over = passed_over.into_inner();
        if catalog.maps.is_empty() && catalog.broken.is_empty() {
            if let Some(error) = places.error() {
                return Err(error);
            }
            let searched: Vec<String> = inputs.iter().map(|input| input.display().to_string()).collect();
            let passed_over = catalog.passed_over.into_iter().collect();
            let (dataset, searched) = (config.dataset.name(), searched.join(", "));
            let needed = needed.into_inner().into_values().next();
            return Err(Error::NoMaps { dataset, searched, needed, passed_over });
        }
        catalog.require(needed.into_inner().into_iter().filter(|(id, _)| !catalog.maps.contains_key(id)))?;
        // Among the recordings, archives that cannot be read are rejects.
        let archives = if config.map_inputs.is_empty() { BTreeSet::new() } else { catalog.passed_over.clone() };
        catalog.warn(archives, progress);
        Ok(catalog)
    }

    /// Warns of maps that are left out or were mended, and of these archives.
    fn warn(&mut self, archives: BTreeSet<String>, progress: &dyn Progress) {
        let broken = self.broken.iter().map(|(id, map)| {
            format!("{}; it is left out, so that recordings of {id}, if there are any, cannot be read", map.error())
        });
        for detail in broken.collect::<Vec<_>>() {
            self.say("maps_passed_over", detail, progress);
        }
        for path in archives {
            self.say("archives_passed_over", format!("{path} is passed over: it cannot be read; unpack it"), progress);
        }
        for Listed { path, report, .. } in self.maps.values() {
            let findings = report.findings(path);
            if !findings.is_empty() {
                progress.warn(&format!("{path}: {}", report.summary()));
            }
            self.findings.extend(findings);
        }
    }

    fn say(&mut self, what: &'static str, detail: String, progress: &dyn Progress) {
        progress.warn(&detail);
        self.findings.push(Finding { what, n: 1, detail });
    }

    fn add(
        &mut self,
        entry: &Entry,
        reader: &mut dyn BufRead,
        source: &dyn RecordingSource,
        progress: &dyn Progress,
    ) -> Result<(), Error> {
        let Some(id) = source.map_at(&entry.path) else { return Ok(()) };
        let MapFile { graph, rank, report } = match source.read_map(entry, reader) {
            Err(Error::Map { file, place, detail }) => {
                self.broken.insert(id, Broken(file, place, detail));
                return Ok(());
            }
            map => map?,
        };
        let listed = Listed { lanes: LaneIndex::new(Arc::new(graph)), rank, path: entry.path.clone(), report };
        match self.maps.entry(id) {
            MapEntry::Vacant(place) => drop(place.insert(listed)),
            MapEntry::Occupied(mut place) => {
                let is_better = rank < place.get().rank;
                let other = if is_better { place.insert(listed) } else { listed };
                let (id, taken) = (place.key(), place.get());
                if are_alike(taken.lanes.graph(), other.lanes.graph()) {
                    progress.note(&format!("skipped {}: map {id} is also in {}", other.path, taken.path));
                    return Ok(());
                }
                let detail = format!(
                    "{} and {} are different maps of {id}: the first is taken; remove the one that is out of date",
                    taken.path, other.path
                );
                self.say("maps_that_differ", detail, progress);
            }
        }
        Ok(())
    }

    pub(super) fn get(&self, id: &MapId) -> Option<&LaneIndex> {
        self.maps.get(id).map(|listed| &listed.lanes)
    }

    /// Fails if any map is missing, each with a recording that needs it.
    pub(super) fn require(&self, missing: impl Iterator<Item = (MapId, String)>) -> Result<(), Error> {
        let missing: Vec<(MapId, String)> = missing.collect();
        if let Some(broken) = missing.iter().find_map(|(id, _)| self.broken.get(id)) {
            return Err(broken.error());
        }
        let missing: Vec<String> = missing.into_iter().map(|(id, file)| format!("{id} (of {file})")).collect();
        if missing.is_empty() {
            return Ok(());
        }
        let found = self.maps.keys().map(|id| id.0.clone()).collect();
        Err(Error::MissingMaps { missing, found, passed_over: self.passed_over.iter().cloned().collect() })
    }
}

/// Whether two maps have the same lanes, apart from the digits with which they are written.
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
    use crate::progress::{Heard, Silent};
    use crate::scene::Dataset;

    #[test]
    fn different_maps_of_one_place_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let source = "tests/fixtures/recordings/interaction_v1_1/maps/FIX_Intersection.osm";
        let xy = fs_err::read_to_string(format!("{source}_xy")).unwrap();
        let config = IngestConfig::new(Dataset::Interaction, vec![folder.path().to_owned()]);
        let told = || {
            let told = Heard::default();
            MapCatalog::read(&config, &Interaction::new(&config), &Places::of(&config), &told).unwrap();
            told.take()
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
        let read = || MapCatalog::read(&config, &Interaction::new(&config), &Places::of(&config), &Silent);
        // A map that is not needed may be broken.
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
        let Err(Error::MissingMaps { missing, found, .. }) = read() else { panic!("a map is missing") };
        assert_eq!((missing.len(), found.len()), (1, 1));
        let seen = &missing[0];
        assert_eq!(seen, "interaction/FIX_Elsewhere (of recorded_trackfiles/FIX_Elsewhere/vehicle_tracks_000.csv)");
        assert!(found[0].contains("FIX_Intersection"), "{found:?}");
        fs_err::remove_dir_all(folder.path().join("maps")).unwrap();
        let none = read().unwrap_err().to_string();
        assert!(none.contains("as recorded_trackfiles/FIX_Elsewhere/vehicle_tracks_000.csv needs"), "{none}");
    }
}
