//! Data that scenarios of a place share: its map, where traffic enters and leaves it, and the recorded arrivals.
//!
//! Scenarios of a place, and of a recording there, mostly follow each other, so the last of each is kept.

use super::arrivals::{Ends, Recorded, Window};
use super::{Error, Result, Situation};
use crate::scenario::{EgoChoice, ScenarioRecord};
use crate::scene::{LaneGraph, MapId, Scene, SceneId, SituationKind};
use crate::store::{CorpusReader, MapSource, SceneIndexEntry, SceneStore};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Scenes of a place from which its arrivals are estimated.
const MOST_SCENES: usize = 200;

/// Scenes of a place that say how much traffic it has: those of a corpus, or all that were ingested.
pub(crate) trait Places {
    /// Scenes on this map, at most as many as are needed; `scene` is one of them.
    fn scenes_on(&self, map: &MapId, scene: &Scene) -> Result<Vec<Scene>>;

    /// The windows of a recording, each with its first frame and its place for [`Places::window`], in order of time.
    fn windows_of(&self, recording: &str) -> Result<Vec<(i64, usize)>>;

    /// The window at a place.
    fn window(&self, position: usize) -> Result<Scene>;
}

impl Places for CorpusReader {
    fn scenes_on(&self, map: &MapId, _scene: &Scene) -> Result<Vec<Scene>> {
        self.scenes_of(map)?.into_iter().take(MOST_SCENES).map(|position| self.window(position)).collect()
    }

    fn windows_of(&self, recording: &str) -> Result<Vec<(i64, usize)>> {
        Ok(Self::windows_of(self, recording)?)
    }

    fn window(&self, position: usize) -> Result<Scene> {
        Ok(self.scenario(position)?.scenario.scene)
    }
}

impl Places for SceneStore {
    /// They are spread over all of the place.
    fn scenes_on(&self, map: &MapId, scene: &Scene) -> Result<Vec<Scene>> {
        let entries = self.index().iter().enumerate();
        let is_here =
            |at: &SceneIndexEntry<'_>| at.place == scene.source.place && at.situation == SituationKind::Recorded;
        let here: Vec<usize> = entries.filter(|(_, at)| is_here(at)).map(|(i, _)| i).collect();
        let spread = here.iter().step_by(here.len().div_ceil(MOST_SCENES).max(1));
        let mut scenes: Vec<Scene> = spread.map(|i| self.scene(*i)).collect::<Result<_, _>>()?;
        scenes.retain(|scene| scene.map_id.as_ref() == Some(map));
        Ok(scenes)
    }

    fn windows_of(&self, recording: &str) -> Result<Vec<(i64, usize)>> {
        Ok(SceneId::windows_of(recording, self.index().iter().map(|entry| entry.id)))
    }

    fn window(&self, position: usize) -> Result<Scene> {
        Ok(self.scene(position)?)
    }
}

/// The last map, its ends, and the last long recording that were requested.
pub(crate) struct Maps<'a> {
    maps: &'a dyn MapSource,
    places: &'a dyn Places,
    last: Option<(MapId, LaneGraph)>,
    ends: Option<(MapId, Arc<Ends>)>,
    recording: Option<Recording>,
}

/// A long recording.
struct Recording {
    name: String,
    /// Its windows: the first frame, and the position of its scene, or of a scenario that continues it.
    positions: Vec<(i64, usize)>,
    /// The windows that were read.
    windows: BTreeMap<i64, Window>,
}

impl<'a> Maps<'a> {
    /// The maps of scenarios, and the scenes that say how much traffic their places have.
    pub(crate) fn new(maps: &'a dyn MapSource, places: &'a dyn Places) -> Self {
        Self { maps, places, last: None, ends: None, recording: None }
    }

    /// The start of a scenario.
    pub(crate) fn situation(&mut self, record: &ScenarioRecord, ego: &EgoChoice) -> Result<Situation> {
        let unfit = |why: &str| Error::Unfit { scenario_id: record.scenario.id.clone(), why: why.to_owned() };
        let (ego_idx, _) = ego.of(record).ok_or_else(|| unfit("has no such ego"))?;
        Situation::new(record, ego_idx, self.map_of(&record.scenario.scene)?)
    }

    /// The whole map of a scene, in the frame of its recording.
    pub(super) fn map_of(&mut self, scene: &Scene) -> Result<Option<&LaneGraph>> {
        let asked = scene.map_id.as_ref();
        if let Some(id) = asked.filter(|id| self.last.as_ref().is_none_or(|(known, _)| known != *id)) {
            self.last = Some((id.clone(), self.maps.map(id)?));
        }
        Ok(self.last.as_ref().filter(|(id, _)| Some(id) == asked).map(|(_, map)| map))
    }

    /// Expects arrivals in a drive of `n_steps`: at least as many as a world with `n_tracks` does, and recorded ones as
    /// far as `n_known` steps.
    pub(crate) fn expect_arrivals(
        &mut self,
        situation: &mut Situation,
        seed: u64,
        [n_steps, n_tracks, n_known]: [usize; 3],
    ) -> Result<()> {
        let ends = self.ends(&situation.scene)?;
        let recorded = self.recorded(&situation.scene, n_known)?;
        situation.expect(&ends, &recorded, seed, [n_steps, n_tracks]);
        Ok(())
    }

    /// The ends of the map of a scene, estimated from scenes on it.
    fn ends(&mut self, scene: &Scene) -> Result<Arc<Ends>> {
        let last = self.last.as_ref().filter(|(id, _)| Some(id) == scene.map_id.as_ref());
        let Some((id, map)) = last else { return Ok(Arc::default()) };
        if let Some((_, ends)) = self.ends.as_ref().filter(|(known, _)| known == id) {
            return Ok(Arc::clone(ends));
        }
        let ends = Arc::new(Ends::of(map, &self.places.scenes_on(id, scene)?));
        self.ends = Some((id.clone(), Arc::clone(&ends)));
        Ok(ends)
    }

    /// The recorded arrivals within `n_steps` after the present of a scene, or a window later.
    fn recorded(&mut self, scene: &Scene, n_steps: usize) -> Result<Recorded> {
        let Some((name, first_frame)) = SceneId::window_of(&scene.id.0) else { return Ok(Recorded::default()) };
        let ends = self.ends(scene)?;
        let known = self.recording.take().filter(|known| known.name == name);
        let known = match known {
            Some(known) => known,
            None => {
                let positions = self.places.windows_of(name)?;
                Recording { name: name.to_owned(), positions, windows: BTreeMap::new() }
            }
        };
        let Recording { positions, windows, .. } = self.recording.insert(known);
        let later = &positions[positions.partition_point(|(frame, _)| *frame <= first_frame)..];
        // The last arrivals are in the first window that begins after the end.
        let n_until = later.partition_point(|(frame, _)| frame - first_frame < n_steps as i64);
        let needed = &later[..later.len().min(n_until + 1)];
        for (frame, position) in needed {
            if !windows.contains_key(frame) {
                windows.insert(*frame, Window::of(&self.places.window(*position)?, *frame));
            }
        }
        let needed = needed.iter().filter_map(|(frame, _)| windows.get(frame));
        Ok(Recorded::of((scene, first_frame), needed, &ends))
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{write_scenes, write_windows};
    use super::*;
    use crate::scene::TrackId;

    #[test]
    fn windows_of_a_recording_say_who_arrives_after_others() {
        let dir = tempfile::tempdir().unwrap();
        let reader = write_windows(dir.path());
        assert_eq!(reader.windows_of("interaction/train/FIX_Merging/000").unwrap(), [(1, 0), (26, 1)]);
        assert!(reader.windows_of("interaction/val/FIX_Merging/000").unwrap().is_empty());
        let mut maps = Maps::new(&reader, &reader);
        let arrive = |maps: &mut Maps<'_>, position: usize, n_steps: usize| -> usize {
            let record = reader.scenario(position).unwrap();
            let mut situation = maps.situation(&record, &EgoChoice::Scene).unwrap();
            let recorded = maps.recorded(&situation.scene, n_steps).unwrap();
            situation.expect(&Arc::default(), &recorded, 0, [100, 0]);
            assert!((0..situation.arrivals.n_expected()).all(|number| situation.arrivals.is_recorded(number)));
            situation.arrivals.n_expected()
        };
        // The window that begins after the end counts, too: the agents that came in between were on their way.
        let n_tracks = reader.scenario(1).unwrap().scenario.scene.tracks.len();
        let found =
            [(0, 80), (0, 20), (1, 80), (0, 80)].map(|(position, n_steps)| arrive(&mut maps, position, n_steps));
        assert_eq!(found, [n_tracks, n_tracks, 0, n_tracks]);
        // Scenes may have one more window.
        let scene = |position: usize| reader.scenario(position).unwrap().scenario.scene;
        let (first, second) = (scene(0), scene(1));
        let mut third = Scene { id: "interaction/train/FIX_Merging/000@51".into(), ..second.clone() };
        third.tracks.iter_mut().for_each(|track| track.id = TrackId(format!("last_{}", track.id)));
        let dir = tempfile::tempdir().unwrap();
        write_scenes(dir.path(), &reader, &[first.clone(), second, third]);
        let store = SceneStore::open(dir.path()).unwrap();
        let mut known = Maps::new(&reader, &store);
        assert_eq!([arrive(&mut known, 0, 80), arrive(&mut known, 1, 80)], [2 * n_tracks, n_tracks]);
        // They tell how much traffic a place has, too.
        let map_id = first.map_id.clone().unwrap();
        let n_scenes = |maps: &Maps<'_>, map: &MapId| maps.places.scenes_on(map, &first).unwrap().len();
        assert_eq!([&known, &maps].map(|maps| n_scenes(maps, &map_id)), [3, 2]);
        assert_eq!(n_scenes(&known, &MapId("another".to_owned())), 0);
    }
}
