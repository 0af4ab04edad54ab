//! At which places do maps and recordings show enough of the road to judge departures from it?

use super::error::Result;
use crate::ingest::NO_PLACE;
use crate::metrics::{DrivenArea, MapFit, MapGaps, MetricSettings, ValidityConfig};
use crate::scene::SituationKind;
use crate::store::SceneStore;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Number of recorded scenes per place that are examined, and of those that show where vehicles drive, evenly spread.
const SCENES_PER_PLACE: usize = 100;
const SCENES_OF_AREA: usize = 1000;

/// How well maps fit recordings, and where vehicles drive at places whose map does not show the whole road.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MapFits {
    /// A row for each place with lanes.
    pub rows: Vec<MapFitRow>,
    /// The driven areas, by place.
    pub driven: BTreeMap<String, DrivenArea>,
}

/// How well the map of a place fits its recordings.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct MapFitRow {
    /// The place.
    pub place: String,
    /// The fit of the map to its recordings.
    #[serde(flatten)]
    pub fit: MapFit,
    /// Whether departures from the road are judged by it.
    pub allows_offroad: bool,
    /// If not, whether they are judged by it and by where recorded vehicles drive.
    #[serde(default)]
    pub with_driven_area: bool,
}

impl MapFitRow {
    /// A warning about a place where departures are not judged; `None` if they are.
    pub fn caution(&self) -> Option<String> {
        let Self { place, fit, allows_offroad, with_driven_area } = self;
        let of = if place == NO_PLACE { "recordings without a place" } else { place };
        let percent = |n: u64, of: u64| format!("{:.1} %", 100.0 * n as f64 / of.max(1) as f64);
        (!allows_offroad && !with_driven_area).then(|| {
            format!(
                "The map of {of} does not allow to judge who leaves the road: {} of the states of recorded vehicles \
                 lie off its lanes, and in {} of {} recorded scenes vehicles leave them. The check offroad is not made \
                 there.",
                percent(fit.n_states_off, fit.n_states),
                fit.n_scenes_leaving,
                fit.n_scenes
            )
        })
    }
}

impl MapFits {
    /// Of all places with lanes.
    pub fn of(store: &SceneStore, config: &ValidityConfig) -> Result<Self> {
        Self::with_areas(store, config, true)
    }

    /// Of all places with lanes, without the driven areas: for those who do not judge departures.
    pub fn of_maps_alone(store: &SceneStore, config: &ValidityConfig) -> Result<Self> {
        Self::with_areas(store, config, false)
    }

    fn with_areas(store: &SceneStore, config: &ValidityConfig, with_areas: bool) -> Result<Self> {
        let mut by_place: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
        let recorded = store.index().iter().enumerate().filter(|(_, entry)| entry.situation == SituationKind::Recorded);
        for (idx, entry) in recorded {
            by_place.entry(entry.place).or_default().push(idx);
        }
        let mut found = Self::default();
        for (place, scenes) in by_place {
            let scenes_of_fit = spread(&scenes, SCENES_PER_PLACE);
            let Some(fit) = fit(store, &scenes_of_fit, config, MapGaps::none())? else { continue };
            let allows_offroad = fit.allows_offroad(config);
            let is_wanted = with_areas && !allows_offroad;
            let area = if is_wanted { driven_area(store, place, &scenes, config)? } else { None };
            found.rows.push(MapFitRow {
                place: place.to_owned(),
                fit,
                allows_offroad,
                with_driven_area: area.is_some(),
            });
            found.driven.extend(area.map(|area| (place.to_owned(), area)));
        }
        Ok(found)
    }

    /// The settings of metrics with these limits, and with the gaps that maps have.
    pub fn settings(&self, validity: &ValidityConfig) -> MetricSettings {
        let without = self.rows.iter().filter(|row| !row.allows_offroad).map(|row| row.place.clone());
        let map_gaps = MapGaps { places: without.collect(), driven_areas: self.driven.clone() };
        MetricSettings { validity: validity.clone(), map_gaps }
    }
}

/// At most `most` of these, evenly spread.
fn spread(scenes: &[usize], most: usize) -> Vec<usize> {
    let n = scenes.len().min(most);
    (0..n).map(|i| scenes[i * scenes.len() / n]).collect()
}

/// The fit of maps to these scenes; `None` if there are no lanes.
fn fit(store: &SceneStore, scenes: &[usize], config: &ValidityConfig, map_gaps: &MapGaps) -> Result<Option<MapFit>> {
    let fit = |idx: &usize| {
        let scene = store.scene(*idx)?;
        Ok((!scene.lanes.is_empty()).then(|| MapFit::of(&scene, config, map_gaps)))
    };
    let fits: Vec<Option<MapFit>> = scenes.par_iter().map(fit).collect::<Result<_>>()?;
    Ok(fits.into_iter().flatten().reduce(MapFit::with))
}

/// Where the vehicles of these scenes of a place drive; `None` if the lanes and the area of either half of them do not
/// hold the other half well enough to judge departures.
fn driven_area(
    store: &SceneStore,
    place: &str,
    scenes: &[usize],
    config: &ValidityConfig,
) -> Result<Option<DrivenArea>> {
    let scenes = spread(scenes, SCENES_OF_AREA);
    let halves = scenes.split_at(scenes.len() / 2);
    let area = |scenes: &[usize]| -> Result<DrivenArea> {
        let areas = scenes.par_iter().map(|idx| Ok(DrivenArea::default().with_vehicles_of(&store.scene(*idx)?)));
        areas.try_reduce(DrivenArea::default, |all, area| Ok(all.joined(area)))
    };
    let areas = [area(halves.0)?, area(halves.1)?];
    let mut fits = Vec::new();
    for (area, others) in areas.iter().zip([halves.1, halves.0]) {
        let driven_areas = BTreeMap::from([(place.to_owned(), area.clone())]);
        let map_gaps = MapGaps { places: [place.to_owned()].into(), driven_areas };
        fits.extend(fit(store, &spread(others, SCENES_PER_PLACE), config, &map_gaps)?);
    }
    let [first, second] = areas;
    let holds = fits.into_iter().reduce(MapFit::with).is_some_and(|fit| fit.allows_offroad(config));
    Ok(holds.then(|| first.joined(second)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vec2;
    use crate::metrics::{Check, Judged};
    use crate::scene::{LaneGraph, MapId, Roles, Scene, SceneId, SceneSource, State, Trajectory};
    use crate::store::SceneWriter;
    use crate::store::testing::{map, scene};
    use serde_json::json;

    fn fits(scenes: &[Scene], maps: &[(MapId, LaneGraph)], config: &ValidityConfig) -> MapFits {
        let store = stored(scenes, maps);
        let [fits, of_maps] = [MapFits::of, MapFits::of_maps_alone].map(|of| of(&store.1, config).unwrap());
        // Without the areas, the same places lack road.
        let [lacking, with_areas] = [&of_maps, &fits].map(|fits| fits.settings(config).map_gaps.places);
        assert_eq!(lacking, with_areas);
        assert!(of_maps.driven.is_empty());
        fits
    }

    fn stored(scenes: &[Scene], maps: &[(MapId, LaneGraph)]) -> (tempfile::TempDir, SceneStore) {
        let dir = tempfile::tempdir().unwrap();
        let (mut writer, _) = SceneWriter::resume(dir.path()).unwrap();
        writer.write_batch(scenes, maps, Some(0), &json!(0)).unwrap();
        writer.finish(&json!({ "rejects": {} })).unwrap();
        let store = SceneStore::open(dir.path()).unwrap();
        (dir, store)
    }

    #[test]
    fn the_scenes_of_a_place_are_looked_at_once_each_and_places_without_lanes_not() {
        let maps = [(MapId::from("PIT"), map(1, 9))];
        let mut scenes: Vec<Scene> = (0..5).map(|seed| scene(seed, Some((&maps[0].0, &maps[0].1)))).collect();
        let nowhere = scene(5, None);
        scenes.push(Scene { source: SceneSource { place: "MIA".to_owned(), ..nowhere.source.clone() }, ..nowhere });
        let config = ValidityConfig::default();
        let rows = fits(&scenes, &maps, &config).rows;
        let expected =
            scenes[..5].iter().map(|scene| MapFit::of(scene, &config, MapGaps::none())).reduce(MapFit::with).unwrap();
        assert_eq!(rows.iter().map(|row| (row.place.as_str(), row.fit)).collect::<Vec<_>>(), [("PIT", expected)]);
        assert_eq!(expected.n_scenes, 5);
    }

    #[test]
    fn where_the_map_lacks_road_it_is_where_both_halves_of_the_recordings_drive() {
        let maps = [(MapId::from("PIT"), map(1, 9))];
        let seen = |seed: u64, name: &str| Scene {
            id: SceneId(name.to_owned()),
            ..scene(seed, Some((&maps[0].0, &maps[0].1)))
        };
        let config = ValidityConfig::default();
        let is_judged = |scene: &Scene, fits: &MapFits| {
            let MetricSettings { validity, map_gaps } = fits.settings(&config);
            let judged = Judged::future_of(scene, Roles::none());
            !judged.with_gaps(&map_gaps).not_checked(&validity).contains(&Check::Offroad)
        };
        // Nobody drives twice at the same part of a map that is drawn at random.
        let others = fits(&[seen(0, "a"), seen(1, "b")], &maps, &config);
        assert!(!others.rows[0].allows_offroad && !others.rows[0].with_driven_area && others.driven.is_empty());
        assert!(others.rows[0].caution().is_some() && !is_judged(&seen(0, "a"), &others));
        let again = fits(&[seen(0, "a"), seen(0, "b")], &maps, &config);
        assert!(!again.rows[0].allows_offroad && again.rows[0].with_driven_area && again.rows[0].caution().is_none());
        let MetricSettings { validity, map_gaps } = again.settings(&config);
        let mut driven = seen(0, "a");
        let violations = |scene: &Scene| {
            let found = Judged::future_of(scene, Roles::none()).with_gaps(&map_gaps).violations(&validity);
            found.iter().filter(|violation| violation.check == Check::Offroad).count()
        };
        assert!(is_judged(&driven, &again) && violations(&driven) == 0);
        let present = driven.current_timestep();
        for track in driven.tracks.iter_mut() {
            let entries = track.trajectory.entries().iter().enumerate();
            let aside = |t: usize| Vec2::new(if t > present { 3000.0 } else { 0.0 }, 0.0);
            let moved = entries.map(|(t, s)| s.map(|s| State { position: s.position + aside(t), ..s }));
            track.trajectory = Trajectory::new(moved.collect());
        }
        assert_eq!(violations(&driven), 1);
    }
}
