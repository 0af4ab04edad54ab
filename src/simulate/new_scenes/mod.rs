//! Situations that nobody recorded: closed loops go on from recorded scenes, and windows of them are scenes.
//!
//! A loop is unguided. It begins with a held-out scene as it is (*continued*), or after road users were put into it
//! (*populated*). Its windows are chosen and framed as those of recordings are, by the same code, for as long as
//! everything in the loop is valid.
//!
//! Windows shall pass for recorded scenes, which `scripts/check_situations.py` judges. So vehicles hold their place in
//! the lane, and a window shows what a recorder of the place would: as far as its recordings see, and as exactly as
//! they hold positions. Still, boosted trees tell nearly all windows, if not each road user: the model brakes less than
//! recorded drivers, moves over more slowly, and comes to other places in the lane than the few of SUMO's drivers.
//! What does not help, or by no more than some .01: to hold the place in bends, too, after which fewer windows are
//! valid; sight that ends a meter earlier; arrivals with smaller gaps, or when they are due rather than at the next
//! replanning; pedals that are not eased; noise that lasts from plan to plan.

mod populate;
mod sight;
mod windows;

pub use populate::AddedConfig;

use super::drivers::named;
use super::maps::{Maps, Places};
use super::rollout::{Others, roll_out};
use super::workers::{in_parallel, pool_of_worker};
use super::{Error, Result, RolloutConfig, Situation};
use crate::generate::{self, Futures, NamedDriver, check_times};
use crate::ingest::IngestConfig;
use crate::metrics::MetricSettings;
use crate::progress::Progress;
use crate::scene::{LaneGraph, MapId, Scene, SceneId, SituationKind};
use crate::seed::Seed;
use crate::settings::{Issue, Result as Checked};
use crate::store::SceneStore;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sight::Sight;
use std::collections::BTreeMap;
use std::sync::Arc;
use windows::windows;

/// The time between the presents of the scenes of a loop, and before the first of them, seconds; the length of their
/// past if that is more, so that all of it is sampled.
const EVERY_S: f64 = 3.0;

/// `[situations]`: how many closed loops go on from held-out scenes, and what becomes of them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SituationsConfig {
    /// Closed loops from held-out scenes as they are, each scene in turn.
    #[schemars(range(max = 1_000_000))]
    pub continued: usize,
    /// Closed loops from held-out scenes into which road users were put.
    #[schemars(range(max = 1_000_000))]
    pub populated: usize,
    /// The road users that are put into each of these, as far as there is room: vehicles and cyclists as they were
    /// seen at the place at other times, pedestrians also beside the road.
    pub added: AddedConfig,
    /// The length of a loop after the present of its scene, seconds, at least 3; every 3 s it gives a scene. It ends
    /// earlier where something in it is not valid.
    #[schemars(range(max = 600.0), extend("exclusiveMinimum" = 0))]
    pub horizon_s: f64,
    /// How long each plan is driven, seconds.
    #[schemars(range(min = 0.01))]
    pub replan_s: f64,
}

impl Default for SituationsConfig {
    fn default() -> Self {
        Self { continued: 40, populated: 40, added: AddedConfig::default(), horizon_s: 9.0, replan_s: 0.5 }
    }
}

impl SituationsConfig {
    /// Rejects settings that bring no scene.
    pub fn validate(&self) -> Checked {
        if self.continued + self.populated == 0 {
            return Err(Issue::new("continued", "is 0, and so is populated: set one of them, or remove the section"));
        }
        match self.horizon_s >= EVERY_S {
            true => Ok(()),
            false => Err(Issue::new("horizon_s", format_args!("is {}, expected at least {EVERY_S}", self.horizon_s))),
        }
    }

    /// Rejects times that do not fit timesteps of `dt_s`, or a model that sees `future_s` ahead.
    pub fn check(&self, dt_s: f64, future_s: f64) -> Checked {
        check_times([self.horizon_s, self.replan_s], [dt_s, future_s])
    }

    fn rollout(&self) -> RolloutConfig {
        RolloutConfig { horizon_s: self.horizon_s, replan_s: self.replan_s }
    }
}

/// The source of new scenes.
pub struct NewScenes<'a> {
    /// The section.
    pub config: &'a SituationsConfig,
    /// Samples the futures.
    pub futures: &'a Futures<'a>,
    /// The recorded scenes.
    pub store: &'a SceneStore,
    /// What is valid in a loop.
    pub judged_by: &'a MetricSettings,
    /// How scenes are chosen and framed.
    pub ingest: &'a IngestConfig,
}

/// Counts of loops and their scenes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LoopCounts {
    /// Loops that were planned up to here.
    pub n_done: u64,
    /// Loops that were driven.
    pub n_loops: u64,
    /// Scenes into which nobody could be put.
    pub n_full: u64,
    /// Loops that ended before their horizon.
    pub n_ended: u64,
    /// Their scenes.
    pub n_scenes: u64,
    /// Scenes that are missing, because a loop ended or was not valid, or a recording would be rejected for them.
    pub n_left_out: u64,
}

/// Loops that are driven and written together, whatever the number of threads: enough for all of them.
const LOOPS_PER_BATCH: usize = 64;

/// Receives the scenes of a batch of loops, in order, with the maps that they need, and the counts so far.
pub type TakeScenes<'t> = dyn FnMut(&[Scene], &[(MapId, LaneGraph)], &LoopCounts) -> Result<()> + 't;

/// A loop before it is driven.
struct Job {
    situation: Situation,
    kind: SituationKind,
    place: Arc<Place>,
}

/// A place: its map, and what recordings show of it.
#[derive(Default)]
struct Place {
    map: Option<(MapId, Arc<LaneGraph>)>,
    seen: Vec<Scene>,
    sight: Sight,
}

/// The outcome of a loop.
struct Looped {
    scenes: Vec<Scene>,
    n_left_out: u64,
    /// Whether it ended before its horizon.
    has_ended: bool,
}

impl NewScenes<'_> {
    /// Drives loops from the scenes at `positions` in turn, first continued and then populated ones, after those that
    /// `counts` has already.
    ///
    /// # Errors
    /// When the model does not fit, the device fails or the store is damaged; [`generate::Error::Stopped`] when the
    /// process must stop; errors of `take`.
    pub fn make(
        &self,
        positions: &[usize],
        mut counts: LoopCounts,
        progress: &dyn Progress,
        take: &mut TakeScenes<'_>,
    ) -> Result<LoopCounts> {
        let Self { config, futures, .. } = self;
        let future_s = (futures.n_timesteps() - futures.n_history()) as f64 * futures.dt_s();
        let checked = config.check(futures.dt_s(), future_s);
        checked.map_err(|issue| Error::Config(issue.within("situations").to_string()))?;
        let mut workers = (0..rayon::current_num_threads()).map(|_| pool_of_worker()).collect::<Result<Vec<_>>>()?;
        let mut maps = Maps::new(self.store, self.store);
        let mut place = Arc::default();
        let of_kind = |n: usize, kind| {
            let scenes = positions.iter().copied().cycle().take(if positions.is_empty() { 0 } else { n });
            scenes.enumerate().map(move |(i, position)| (position, i / positions.len().max(1), kind))
        };
        let continued = of_kind(self.config.continued, SituationKind::Continued);
        let all: Vec<_> = continued.chain(of_kind(self.config.populated, SituationKind::Populated)).collect();
        progress.start("situations", all.len() as u64, "loops");
        progress.advance(counts.n_done);
        for chunk in all.chunks(LOOPS_PER_BATCH).skip(counts.n_done as usize / LOOPS_PER_BATCH) {
            if progress.must_stop() {
                return Err(generate::Error::Stopped.into());
            }
            let mut jobs: Vec<Job> = Vec::new();
            for loop_of in chunk {
                jobs.extend(self.job(*loop_of, (&mut maps, &mut place), &mut counts)?);
            }
            let found = in_parallel(&jobs, &mut workers, |pool, job| pool.install(|| self.drive(job)))?;
            let needed: BTreeMap<&MapId, &Arc<LaneGraph>> =
                jobs.iter().filter_map(|job| job.place.map.as_ref().map(|(id, map)| (id, map))).collect();
            let needed: Vec<(MapId, LaneGraph)> =
                needed.into_iter().map(|(id, map)| (id.clone(), map.as_ref().clone())).collect();
            counts.n_loops += jobs.len() as u64;
            for looped in &found {
                counts.n_ended += u64::from(looped.has_ended);
                counts.n_left_out += looped.n_left_out;
            }
            let scenes: Vec<Scene> = found.into_iter().flat_map(|looped| looped.scenes).collect();
            counts.n_scenes += scenes.len() as u64;
            counts.n_done += chunk.len() as u64;
            take(&scenes, &needed, &counts)?;
            progress.advance(chunk.len() as u64);
            progress.note(&format!("{} scenes", counts.n_scenes));
        }
        progress.finish();
        Ok(counts)
    }

    /// A loop of the scene at a position; `None` if nobody can be put into it, or its ego has no way.
    fn job(
        &self,
        (position, variant, kind): (usize, usize, SituationKind),
        (maps, place): (&mut Maps<'_>, &mut Arc<Place>),
        counts: &mut LoopCounts,
    ) -> Result<Option<Job>> {
        let mut scene = self.store.scene(position)?;
        let name = format!("{}+{}{variant}", scene.id.0.replace('@', "_"), kind.name());
        let map = maps.map_of(&scene)?;
        let is_known = |id: &MapId| place.map.as_ref().is_some_and(|(known, _)| known == id);
        if let Some((id, map)) = scene.map_id.as_ref().zip(map).filter(|(id, _)| !is_known(id)) {
            let seen = self.store.scenes_on(id, &scene)?;
            let map = Some((id.clone(), Arc::new(map.clone())));
            *place = Arc::new(Place { map, sight: Sight::of(&seen), seen });
        }
        // Without a map, nothing is known of the place.
        let place = if scene.map_id.is_some() { Arc::clone(place) } else { Arc::default() };
        if kind == SituationKind::Populated {
            let mut rng = Seed(self.futures.seed()).derive_named("populate", &name).rng();
            if populate::populate(&mut scene, &place.seen, &self.config.added, &mut rng) == 0 {
                counts.n_full += 1;
                return Ok(None);
            }
        }
        let ego_idx = scene.ego_idx;
        let map = place.map.as_ref().map(|(_, map)| map.as_ref());
        let mut situation = match Situation::without_event(&name, scene, ego_idx, map) {
            Ok(situation) => situation,
            Err(Error::Unfit { .. }) => return Ok(None),
            Err(error) => return Err(error),
        };
        situation.holds_places = true;
        let [n_steps, _] = self.config.rollout().n_steps(situation.scene.dt_s);
        maps.expect_arrivals(&mut situation, self.futures.seed(), [n_steps, 0, n_steps])?;
        Ok(Some(Job { situation, kind, place }))
    }

    /// The scenes of a loop.
    fn drive(&self, Job { situation, kind, place }: &Job) -> Result<Looped> {
        let (config, seed) = (self.config.rollout(), self.futures.seed());
        let mut driver = named(NamedDriver::Model);
        let others = Others::Sampled(self.futures);
        let driven = roll_out(situation, situation.start(seed), driver.as_mut(), &others, &config, None)?;
        let [n_steps, n_every] = RolloutConfig { replan_s: EVERY_S, ..config }.n_steps(situation.scene.dt_s);
        let n_every = n_every.max(situation.scene.n_history);
        let has_ended = driven.world.now() < situation.scene.current_timestep() + n_steps;
        let n_future = situation.scene.n_timesteps - situation.scene.n_history;
        let n_possible = n_steps.saturating_sub(n_future) / n_every;
        let from = SceneId(situation.scenario_id.clone());
        let found = windows(situation, &driven.world, n_every, (self.judged_by, &place.sight));
        let map = place.map.as_ref().map(|(_, map)| map);
        let scenes = found.into_iter().filter_map(|mut raw| {
            (raw.source.situation, raw.source.continues) = (*kind, Some(situation.scene.id.clone()));
            raw.id = SceneId(format!("{from}@{}", raw.source.first_frame));
            // What recordings would be rejected for is left out here, too.
            let scene = crate::ingest::assemble_window(raw, map.cloned(), self.ingest).ok()?;
            let is_valid = windows::is_valid(&scene, self.judged_by);
            is_valid.then_some(scene)
        });
        let scenes: Vec<Scene> = scenes.collect();
        Ok(Looped { n_left_out: n_possible.saturating_sub(scenes.len()) as u64, scenes, has_ended })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;
    use crate::scene::{AgentClass, Dataset, TrackId};
    use crate::simulate::testing::{corpus, model, record, write_scenes};
    use crate::store::CorpusReader;
    use candle_core::Device;

    const CONFIG: SituationsConfig = SituationsConfig {
        continued: 1,
        populated: 1,
        added: AddedConfig { vehicles: 1, pedestrians: 1, cyclists: 0 },
        horizon_s: 6.0,
        replan_s: 0.5,
    };

    fn made(config: &SituationsConfig, n_threads: usize) -> (Scene, Vec<Scene>, LoopCounts) {
        let dir = tempfile::tempdir().unwrap();
        let recorded = record().scenario.scene;
        write_scenes(dir.path(), &CorpusReader::open(&corpus()).unwrap(), std::slice::from_ref(&recorded));
        let store = SceneStore::open(dir.path()).unwrap();
        let model = model();
        let futures = Futures::new(&model, 3, &Device::Cpu).unwrap();
        let (judged_by, ingest) = (MetricSettings::default(), IngestConfig::new(Dataset::Interaction, Vec::new()));
        let new = NewScenes { config, futures: &futures, store: &store, judged_by: &judged_by, ingest: &ingest };
        let mut scenes = Vec::new();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
        let counts = pool.install(|| {
            new.make(&[0], LoopCounts::default(), &Silent, &mut |found, maps, _| {
                assert_eq!(maps.first().map(|(id, _)| id), recorded.map_id.as_ref());
                scenes.extend_from_slice(found);
                Ok(())
            })
        });
        (recorded.clone(), scenes, counts.unwrap())
    }

    #[test]
    fn windows_of_loops_are_scenes_whose_past_was_sampled() {
        let (recorded, scenes, counts) = made(&CONFIG, 1);
        assert_eq!((counts.n_done, counts.n_loops, counts.n_scenes), (2, 2, scenes.len() as u64));
        assert_eq!(counts.n_left_out, 0, "of one scene each");
        let kinds: Vec<SituationKind> = scenes.iter().map(|scene| scene.source.situation).collect();
        assert_eq!(kinds, [SituationKind::Continued, SituationKind::Populated]);
        for (scene, name) in scenes.iter().zip(["continued0", "populated0"]) {
            assert_eq!(scene.id.0, format!("{}+{name}@30", recorded.id.0.replace('@', "_")));
            assert_eq!(scene.source.continues.as_ref(), Some(&recorded.id));
            assert_eq!((scene.n_history, scene.n_timesteps), (recorded.n_history, recorded.n_timesteps));
            // Framed as recorded scenes are: by the present state of its own ego.
            let ego = scene.state(scene.ego_idx, scene.current_timestep()).unwrap();
            assert!(ego.position.norm() < 1e-6 && ego.heading_rad.abs() < 1e-6);
            // Whoever was there before has come from where the recording saw it, at a speed that traffic has.
            for track in scene.tracks.iter().filter(|track| recorded.track_idx(&track.id).is_some()) {
                let before = recorded.track_idx(&track.id).and_then(|idx| recorded.state(idx, recorded.n_history - 1));
                let before = recorded.world_from_scene.point(before.unwrap().position);
                let now = track.trajectory.get(scene.current_timestep()).unwrap().position;
                assert!(scene.world_from_scene.point(now).distance(before) < 3.0 * 30.0);
            }
        }
        assert_eq!(made(&CONFIG, 2), (recorded, scenes, counts), "whatever the number of threads");
    }

    #[test]
    fn those_who_are_put_into_a_scene_have_room_and_a_past() {
        let recorded = record().scenario.scene;
        let added = AddedConfig { vehicles: 2, pedestrians: 2, cyclists: 1 };
        let populated = |seed: u64| {
            let mut scene = recorded.clone();
            let seen = [recorded.clone()];
            let n = populate::populate(&mut scene, &seen, &added, &mut Seed(seed).rng());
            (scene, n)
        };
        let (scene, n) = populated(1);
        assert_eq!((scene.clone(), n), populated(1));
        assert_eq!(scene.tracks.len(), recorded.tracks.len() + n);
        let road = crate::metrics::Road::new(&scene.lanes);
        let walkers: Vec<usize> =
            (0..scene.tracks.len()).filter(|idx| scene.tracks[*idx].class == AgentClass::Pedestrian).collect();
        assert!(walkers.len() == 2 && scene.track_idx(&TrackId("added_cyclist_1".to_owned())).is_none());
        for idx in recorded.tracks.len()..scene.tracks.len() {
            let states: Vec<_> = (0..scene.n_history).map(|timestep| *scene.state(idx, timestep).unwrap()).collect();
            assert!(scene.state(idx, scene.n_history).is_none(), "its future is not known");
            let steps = states.windows(2).map(|pair| pair[0].position.distance(pair[1].position) / scene.dt_s);
            let (least, most) = steps.fold((f64::INFINITY, 0.0_f64), |(a, b), step| (a.min(step), b.max(step)));
            let now = states.last().unwrap();
            if walkers.contains(&idx) {
                assert!(least > 0.8 && most < 1.9 && road.distance_m(now.position) >= 0.5, "{least} {most}");
            }
            let body = |idx: usize, timestep: usize| {
                scene.state(idx, timestep).map(|state| scene.tracks[idx].footprint(state))
            };
            for other in (0..scene.tracks.len()).filter(|other| *other != idx) {
                let meets = |timestep: usize| {
                    let both = body(idx, timestep).zip(body(other, timestep));
                    both.is_some_and(|(own, theirs)| own.overlaps(&theirs))
                };
                assert!(!(0..scene.n_history).any(meets), "{idx} and {other}");
            }
        }
    }

    #[test]
    fn sections_without_loops_are_refused() {
        let none = SituationsConfig { continued: 0, populated: 0, ..CONFIG };
        assert!(none.validate().unwrap_err().to_string().contains("continued is 0, and so is populated"));
        let short = SituationsConfig { horizon_s: 1.0, ..CONFIG };
        assert!(short.validate().unwrap_err().to_string().contains("horizon_s is 1, expected at least 3"));
        assert!(CONFIG.check(0.1, 3.0).is_ok() && CONFIG.check(0.1, 0.3).is_err());
    }
}
