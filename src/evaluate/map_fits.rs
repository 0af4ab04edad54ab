//! At which places is the map good enough to judge departures from the road?

use super::error::Result;
use crate::metrics::{MapFit, ValidityConfig};
use crate::scene::SituationKind;
use crate::store::SceneStore;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Number of recorded scenes per place that are examined, evenly spread.
const SCENES_PER_PLACE: usize = 100;

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
}

impl MapFitRow {
    /// A warning about a map that does not allow the check; `None` if it does.
    pub fn caution(&self) -> Option<String> {
        let Self { place, fit, allows_offroad } = self;
        let percent = |n: u64, of: u64| format!("{:.1} %", 100.0 * n as f64 / of.max(1) as f64);
        (!allows_offroad).then(|| {
            format!(
                "The map of {place} does not allow to judge who leaves the road: {} of the states of recorded vehicles \
                 lie off its lanes, and in {} of {} recorded scenes vehicles leave them. The check offroad is not made \
                 there.",
                percent(fit.n_states_off, fit.n_states),
                fit.n_scenes_leaving,
                fit.n_scenes
            )
        })
    }
}

/// The maps of all places with lanes, by place.
pub fn map_fits(store: &SceneStore, config: &ValidityConfig) -> Result<Vec<MapFitRow>> {
    let mut by_place: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    let recorded = store.index().iter().enumerate().filter(|(_, entry)| entry.situation == SituationKind::Recorded);
    for (idx, entry) in recorded {
        by_place.entry(entry.place).or_default().push(idx);
    }
    let mut rows = Vec::new();
    for (place, scenes) in by_place {
        let n = scenes.len().min(SCENES_PER_PLACE);
        let fits = (0..n).into_par_iter().map(|i| {
            let scene = store.scene(scenes[i * scenes.len() / n])?;
            Ok((!scene.lanes.is_empty()).then(|| MapFit::of(&scene, config)))
        });
        let fits: Vec<Option<MapFit>> = fits.collect::<Result<_>>()?;
        if let Some(fit) = fits.into_iter().flatten().reduce(MapFit::with) {
            rows.push(MapFitRow { place: place.to_owned(), fit, allows_offroad: fit.allows_offroad(config) });
        }
    }
    Ok(rows)
}

/// The limits, with the places whose maps do not allow the check of departures.
pub fn for_maps(config: &ValidityConfig, maps: &[MapFitRow]) -> ValidityConfig {
    let without = maps.iter().filter(|map| !map.allows_offroad).map(|map| map.place.clone());
    let places_without_road = config.places_without_road.iter().cloned().chain(without).collect();
    ValidityConfig { places_without_road, ..config.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{MapId, Scene, SceneSource};
    use crate::store::SceneWriter;
    use crate::store::testing::{map, scene};
    use serde_json::json;

    #[test]
    fn the_scenes_of_a_place_are_looked_at_once_each_and_places_without_lanes_not() {
        let maps = [(MapId::from("PIT"), map(1, 9))];
        let mut scenes: Vec<Scene> = (0..5).map(|seed| scene(seed, Some((&maps[0].0, &maps[0].1)))).collect();
        let nowhere = scene(5, None);
        scenes.push(Scene { source: SceneSource { place: "MIA".to_owned(), ..nowhere.source.clone() }, ..nowhere });
        let dir = tempfile::tempdir().unwrap();
        let (mut writer, _) = SceneWriter::resume(dir.path()).unwrap();
        writer.write_batch(&scenes, &maps, Some(0), &json!(0)).unwrap();
        writer.finish(&json!({ "rejects": {} })).unwrap();

        let config = ValidityConfig::default();
        let rows = map_fits(&SceneStore::open(dir.path()).unwrap(), &config).unwrap();
        let expected = scenes[..5].iter().map(|scene| MapFit::of(scene, &config)).reduce(MapFit::with).unwrap();
        assert_eq!(rows.iter().map(|row| (row.place.as_str(), row.fit)).collect::<Vec<_>>(), [("PIT", expected)]);
        assert_eq!(expected.n_scenes, 5);
    }
}
