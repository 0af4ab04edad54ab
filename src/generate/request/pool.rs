//! Which scenes and pairs may a request use?

use super::config::Requirement;
use super::resolve::ResolvedRequest;
use crate::behavior::Outcome;
use crate::generate::plan::AbleCell;
use crate::generate::{Cell, Error, Generator, ResolvedSweep};
use crate::scene::{Scene, SceneId, TrackId};
use crate::store::{SceneIndex, SceneIndexEntry};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Windows of a recording are situations of their own if their presents are this many timesteps apart: three seconds.
const APART: i64 = 30;

/// The moment of a cell.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Moment {
    recording: String,
    agents: Vec<TrackId>,
    frame: i64,
    idx: usize,
}

impl Moment {
    fn is_of_situation_of(&self, first: &Self) -> bool {
        self.recording == first.recording && self.agents == first.agents && self.frame < first.frame + APART
    }
}

/// The cells that a request may use, in random order; written before anything is sampled.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Pool {
    /// Name of the request.
    pub request: String,
    /// Its cells: pairs of scenes.
    pub cells: Vec<Cell>,
    /// The number of their scenes.
    pub n_scenes: usize,
    /// The buckets that each cell can still reach given its past, at least one, and the effort of each, from 0 to 1.
    pub feasible: Vec<BTreeMap<usize, f64>>,
    /// Pairs that were examined and can reach no bucket.
    pub n_infeasible: usize,
    /// Why no situation can fulfill the request; `None` if there are cells.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unmet: Option<String>,
}

impl Pool {
    /// The situation of each cell: pairs are in one if they are the same agents, at moments of one recording or closed
    /// loop less than [`APART`] timesteps apart.
    pub(super) fn situations(&self) -> Vec<usize> {
        let moment = |(idx, cell): (usize, &Cell)| {
            let (recording, frame) = SceneId::window_of(&cell.scene_id.0).unwrap_or((&cell.scene_id.0, 0));
            let agents = cell.roles.tracks().cloned().collect();
            Moment { recording: recording.to_owned(), agents, frame, idx }
        };
        let mut in_order: Vec<Moment> = self.cells.iter().enumerate().map(moment).collect();
        in_order.sort();
        let (mut situations, mut n, mut first) = (vec![0; self.cells.len()], 0, None);
        for moment in in_order {
            let idx = moment.idx;
            if !first.as_ref().is_some_and(|first: &Moment| moment.is_of_situation_of(first)) {
                (n, first) = (n + 1, Some(moment));
            }
            situations[idx] = n - 1;
        }
        situations
    }

    /// The number of cells that can reach a bucket.
    pub fn n_feasible(&self, bucket: usize) -> usize {
        self.feasible.iter().filter(|buckets| buckets.contains_key(&bucket)).count()
    }
}

impl Generator<'_> {
    /// The cells of a request, from scenes in random order that have a suitable pair, or from the scenes with the best
    /// pairs, depending on its `pairs`. Places and classes that `where` rules out are excluded. Where there are none,
    /// or none can reach a bucket, the pool says why: other requests can still be fulfilled.
    ///
    /// # Errors
    /// When a scene cannot be loaded.
    pub fn pool(&self, request: &ResolvedRequest, index: &SceneIndex) -> Result<Pool, Error> {
        self.filled_pool(request, index).or_else(|error| {
            let n_infeasible = match &error {
                Error::Infeasible { n_pairs, .. } => *n_pairs,
                Error::NoScenes { .. } => 0,
                _ => return Err(error),
            };
            let (request, unmet) = (request.config.name.clone(), Some(error.to_string()));
            Ok(Pool { request, cells: Vec::new(), n_scenes: 0, feasible: Vec::new(), n_infeasible, unmet })
        })
    }

    fn filled_pool(&self, request: &ResolvedRequest, index: &SceneIndex) -> Result<Pool, Error> {
        let conditions = &request.config.conditions;
        let is_possible = |entry: &SceneIndexEntry<'_>| match conditions.get("place") {
            Some(Requirement::Texts(places)) => places.iter().any(|place| place == entry.place),
            _ => true,
        };
        let sweep = self.most_patient(request);
        let scenes = self.cells_by_scene((&request.config.name, sweep), index, &is_possible)?;
        let n_scenes = scenes.len();
        let (mut cells, mut feasible, mut n_infeasible) = (Vec::new(), Vec::new(), 0);
        for AbleCell { cell, outcomes } in scenes.into_iter().flatten() {
            let scene = self.load(cell.scene_idx, &cell.scene_id)?;
            if !has_classes(request, &cell, &scene) {
                continue;
            }
            let buckets = feasible_buckets(request, &scene, outcomes);
            if buckets.is_empty() {
                n_infeasible += 1;
                continue;
            }
            cells.push(cell);
            feasible.push(buckets);
        }
        if cells.is_empty() && n_infeasible > 0 {
            return Err(Error::Infeasible { request: request.config.name.clone(), n_scenes, n_pairs: n_infeasible });
        }
        if cells.is_empty() {
            return Err(Error::NoScenes {
                of: format!("request {}", request.config.name),
                n_considered: n_scenes,
                hint: ", but none has a pair that meets the request; widen where, or raise pairs.max_distance_m",
            });
        }
        Ok(Pool { request: request.config.name.clone(), cells, n_scenes, feasible, n_infeasible, unmet: None })
    }

    /// The arm of a request whose maneuvers may take longest.
    fn most_patient(&self, request: &ResolvedRequest) -> &ResolvedSweep {
        let arms = request.arms.iter().map(|arm| &self.config.sweeps[arm.sweep_idx]);
        let plans_s =
            |sweep: &&ResolvedSweep| sweep.rollout.filter(|_| sweep.uses_template()).map_or(0.0, |own| own.horizon_s);
        // The last of equal ones is that of the first arm.
        arms.rev().max_by(|a, b| plans_s(a).total_cmp(&plans_s(b))).unwrap_or(&self.config.sweeps[0])
    }
}

/// The buckets that a pair with these outcomes can reach, with the least effort for each.
fn feasible_buckets(request: &ResolvedRequest, scene: &Scene, mut outcomes: Vec<Outcome>) -> BTreeMap<usize, f64> {
    let all = request.buckets.of_scene(scene).into_iter();
    if !request.config.pairs.only_feasible {
        return all.map(|bucket| (bucket, 0.0)).collect();
    }
    outcomes.retain(|outcome| {
        request.config.conditions.iter().all(|(name, condition)| match (outcome.get(name), condition) {
            (Some(value), Requirement::Range([least, most])) => (*least..=*most).contains(&value),
            _ => true,
        })
    });
    let least_effort = |bucket: usize| {
        let own = outcomes.iter().filter(|outcome| request.buckets.allows(bucket, outcome));
        own.map(Outcome::effort).reduce(f64::min).map(|effort| (bucket, effort))
    };
    all.filter_map(least_effort).collect()
}

/// Whether the agents of a cell are of the classes that the request allows.
fn has_classes(request: &ResolvedRequest, cell: &Cell, scene: &Scene) -> bool {
    cell.roles.iter().all(|(role, track)| match request.config.conditions.get(&format!("{role}_class")) {
        Some(Requirement::Texts(classes)) => scene.track_idx(track).is_some_and(|agent_idx| {
            let class = scene.tracks[agent_idx].class.name();
            classes.iter().any(|allowed| allowed == class)
        }),
        _ => true,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::{Behavior, BehaviorEvent};
    use crate::generate::request::tests::pool;
    use crate::generate::testing::{denoiser, index, load};
    use crate::generate::{GenerateConfig, Models};
    use crate::metrics::MetricSettings;
    use candle_core::Device;

    /// Cut-ins with a gap of 3 m, which any two agents can show.
    struct Easy;

    impl Behavior for Easy {
        fn id(&self) -> &'static str {
            "cut_in"
        }

        fn roles(&self) -> &'static [&'static str] {
            &["ego", "other"]
        }

        fn detect(&self, _: &Scene) -> Vec<BehaviorEvent> {
            Vec::new()
        }

        fn feasible(&self, _: &Scene, _: &[usize]) -> Vec<Outcome> {
            vec![Outcome::default().with("gap_m", 3.0)]
        }
    }

    #[test]
    fn a_pool_holds_pairs_that_can_reach_a_bucket_at_the_places_or_says_why_it_is_empty() {
        let pool = |more: &str| {
            let config: GenerateConfig = toml::from_str(&format!(
                "splits = ['train']\n[[arms]]\nname = 'plain'\n[[requests]]\nname = 'r'\nbehavior = 'cut_in'\n\
                 arms = ['plain']\nper_bucket = 1\nn_scenes = 2\nbudget = {{ n_samples = 9 }}\n{more}"
            ))
            .unwrap();
            let (behaviors, denoiser): ([Box<dyn Behavior>; 1], _) = ([Box::new(Easy)], denoiser(0));
            let config = config.resolve(&behaviors).unwrap();
            let models = Models { denoiser: &denoiser, classifiers: &[], distilled: None, baseline: None };
            let settings = MetricSettings::default();
            let generator = Generator::new(&config, models, &behaviors, &load, settings, &Device::Cpu).unwrap();
            let pool = generator.pool(&config.requests[0], &index(4)).unwrap();
            (pool.cells.len(), pool.n_infeasible, pool.unmet.unwrap_or_default())
        };
        assert_eq!(pool("buckets = { gap_m = [0, 5] }\nwhere = { place = ['TEST'] }"), (2, 0, String::new()));
        let (n_cells, n_infeasible, unmet) = pool("buckets = { gap_m = [5, 9] }");
        assert!((n_cells, n_infeasible) == (0, 2) && unmet.contains("request r"), "{n_infeasible}: {unmet}");
        let (n_cells, n_infeasible, unmet) = pool("buckets = { gap_m = [0, 5] }\nwhere = { place = ['X'] }");
        assert!((n_cells, n_infeasible) == (0, 0) && unmet.contains("request r"), "{n_infeasible}: {unmet}");
    }

    #[test]
    fn windows_of_a_recording_within_three_seconds_are_one_situation() {
        let ids = ["a@60", "b@0", "a@0", "a@29", "a@30", "a@59"].map(SceneId::from);
        let mut pool = pool(ids.len());
        pool.cells.iter_mut().zip(ids).for_each(|(cell, id)| cell.scene_id = id);
        assert_eq!(pool.situations(), [2, 3, 0, 0, 1, 1]);
    }
}
