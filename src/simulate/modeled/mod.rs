//! How often does something happen in closed loops of the unguided model? Loops begin with held-out scenes as they are,
//! and are split where road users come close to each other (see [`split`](crate::statistics::split)), so that what is
//! rare is seen often, with small weights.

mod looped;
mod severity;

pub use looped::{FAILURE, TESTED_FAILURE};
pub use severity::Severity;

use super::maps::Maps;
use super::workers::{in_parallel, pool_of_worker};
use super::{Driver, Error, Result, RolloutConfig, Situation, named};
use crate::behavior::Behavior;
use crate::generate::{self, Futures, NamedDriver, check_times};
use crate::progress::Progress;
use crate::rates::ModeledTraffic;
use crate::scene::SceneId;
use crate::settings::{Issue, Result as Checked};
use crate::store::SceneStore;
use looped::{Common, IsTested, Start};
use rayon::ThreadPool;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// More ends of a loop than this are no use.
const MOST_ENDS: usize = 10_000;

/// `[rates]`: how often does what recordings hardly show happen, by the model?
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RatesConfig {
    /// Closed loops from held-out scenes as they are, each scene in turn.
    #[schemars(range(min = 1, max = 10_000_000))]
    pub loops: usize,
    /// The length of a loop after the present of its scene, seconds. Events count that begin before its last 3 s.
    #[schemars(range(max = 600.0), extend("exclusiveMinimum" = 3.0))]
    pub horizon_s: f64,
    /// How long each plan is driven, seconds.
    #[schemars(range(min = 0.01))]
    pub replan_s: f64,
    /// What tells how close road users come to each other.
    pub severity: Severity,
    /// The values of the severity at which loops are split, the least severe first; empty: never. Rates are unbiased
    /// whatever they are; they are surest where some of the loops that reach a level reach the next one.
    pub levels: Vec<f64>,
    /// The loops that go on from a level instead of one.
    #[schemars(range(min = 1, max = 100))]
    pub copies: usize,
}

impl Default for RatesConfig {
    fn default() -> Self {
        Self {
            loops: 400,
            horizon_s: 8.0,
            replan_s: 0.5,
            severity: Severity::default(),
            levels: vec![3.0, 6.0],
            copies: 4,
        }
    }
}

impl RatesConfig {
    /// Rejects levels that are none.
    pub fn validate(&self) -> Checked {
        let severities: Vec<f64> = self.levels.iter().map(|level| self.severity.signed(*level)).collect();
        if !self.levels.iter().all(|level| *level > 0.0 && level.is_finite())
            || !severities.is_sorted_by(|less, more| less < more)
        {
            let why = "expected positive values of the severity, the least severe first";
            return Err(Issue::new("levels", format_args!("is {:?}, {why}", self.levels)));
        }
        match self.copies.checked_pow(self.levels.len() as u32).is_some_and(|n| n <= MOST_ENDS) {
            true => Ok(()),
            false => Err(Issue::new(
                "copies",
                format_args!(
                    "is {}, which at {} levels makes more than {MOST_ENDS} loops of one; take less",
                    self.copies,
                    self.levels.len()
                ),
            )),
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

/// The source of modeled traffic.
pub struct Modeling<'a> {
    /// The section.
    pub config: &'a RatesConfig,
    /// Samples the futures.
    pub futures: &'a Futures<'a>,
    /// The recorded scenes.
    pub store: &'a SceneStore,
    /// The behaviors that are counted.
    pub behaviors: &'a [Box<dyn Behavior>],
}

/// Figures of the loops.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct LoopFigures {
    /// Loops that were driven.
    pub n_loops: u64,
    /// Scenes whose ego has no way, so that no loop begins with them.
    pub n_unfit: u64,
    /// Futures that were sampled for them and their copies.
    pub n_futures: u64,
    /// The share of loops that reach each level.
    pub reached: Vec<f64>,
}

/// Loops that are driven together, whatever the number of threads.
const LOOPS_PER_BATCH: usize = 64;

/// The threads of a worker, and the driver of the ego in its loops.
pub(crate) type LoopWorker<'a> = (&'a ThreadPool, &'a mut Box<dyn Driver>);

impl Modeling<'_> {
    /// Lets the model drive loops from the scenes at `positions` in turn.
    ///
    /// # Errors
    /// When the model does not fit, the device fails or the store is damaged; [`generate::Error::Stopped`] when the
    /// process must stop.
    pub fn run(&self, positions: &[usize], progress: &dyn Progress) -> Result<(ModeledTraffic, LoopFigures)> {
        let worker = |_| Ok((pool_of_worker()?, named(NamedDriver::Model)));
        let mut workers = (0..rayon::current_num_threads()).map(worker).collect::<Result<Vec<_>>>()?;
        let mut workers: Vec<LoopWorker<'_>> = workers.iter_mut().map(|(pool, driver)| (&*pool, driver)).collect();
        self.drive(positions, &mut workers, &|_, _| false, progress)
    }

    /// Lets these drivers, which are alike, drive the ego of loops, and the model everybody else. Of drivers other than
    /// the model, their own ways and time are counted, and each failure as an event [`FAILURE`] and as one more: is it
    /// in an event of `behaviors` that `is_tested`, which happens to the ego?
    pub(crate) fn drive(
        &self,
        positions: &[usize],
        workers: &mut [LoopWorker<'_>],
        is_tested: &IsTested<'_>,
        progress: &dyn Progress,
    ) -> Result<(ModeledTraffic, LoopFigures)> {
        let Self { config, futures, behaviors, .. } = *self;
        let future_s = (futures.n_timesteps() - futures.n_history()) as f64 * futures.dt_s();
        let checked = config.validate().and_then(|()| config.check(futures.dt_s(), future_s));
        checked.map_err(|issue| Error::Config(issue.within("rates").to_string()))?;
        let severities = config.levels.iter().map(|level| config.severity.signed(*level)).collect();
        let common = Common { config, futures, behaviors, severities, is_tested };
        let mut maps = Maps::new(self.store, self.store);
        let n_positions = positions.len().max(1);
        let of_loop = |i: usize| positions.get(i % n_positions).map(|position| (*position, i / n_positions));
        let mut all: Vec<(usize, usize)> = (0..config.loops).filter_map(of_loop).collect();
        // Neighbors share a map.
        all.sort_unstable();
        let (mut traffic, mut figures) = (ModeledTraffic::default(), LoopFigures::default());
        let mut passed = vec![0.0; config.levels.len()];
        progress.start("rates", all.len() as u64, "loops");
        for chunk in all.chunks(LOOPS_PER_BATCH) {
            if progress.must_stop() {
                return Err(generate::Error::Stopped.into());
            }
            let mut starts = Vec::new();
            for loop_of in chunk {
                starts.extend(self.start(*loop_of, &mut maps)?);
            }
            let found =
                in_parallel(&starts, workers, |(pool, driver), start| pool.install(|| common.follow(start, driver)))?;
            figures.n_loops += starts.len() as u64;
            figures.n_unfit += (chunk.len() - starts.len()) as u64;
            for looped in found {
                figures.n_futures += looped.n_futures;
                passed.iter_mut().zip(looped.passed).for_each(|(sum, weight)| *sum += weight);
                traffic.loops.push(looped.counted);
            }
            progress.advance(chunk.len() as u64);
            progress.note(&format!("{} futures sampled", figures.n_futures));
        }
        progress.finish();
        figures.reached = passed.into_iter().map(|weight| weight / figures.n_loops.max(1) as f64).collect();
        Ok((traffic, figures))
    }

    /// The start of a loop from the scene at a position; `None` if its ego has no way.
    fn start(&self, (position, variant): (usize, usize), maps: &mut Maps<'_>) -> Result<Option<Start>> {
        let scene = self.store.scene(position)?;
        let id = scene.id.0.clone();
        let name = format!("{}+rates{variant}", id.replace('@', "_"));
        let ego_idx = scene.ego_idx;
        let map = maps.map_of(&scene)?.cloned();
        let mut situation = match Situation::without_event(&name, scene, ego_idx, map.as_ref()) {
            Ok(situation) => situation,
            Err(Error::Unfit { .. }) => return Ok(None),
            Err(error) => return Err(error),
        };
        let [n_steps, _] = self.config.rollout().n_steps(situation.scene.dt_s);
        maps.expect_arrivals(&mut situation, self.futures.seed(), [n_steps, 0, n_steps])?;
        let recording = SceneId::window_of(&id).map_or(id.as_str(), |(recording, _)| recording).to_owned();
        let n_every = self.n_every(&recording)?.unwrap_or(situation.scene.n_timesteps);
        Ok(Some(Start { situation, recording, n_every }))
    }

    /// The least distance of two windows of a recording.
    fn n_every(&self, recording: &str) -> Result<Option<usize>> {
        let mut firsts: Vec<i64> =
            super::Places::windows_of(self.store, recording)?.into_iter().map(|(first, _)| first).collect();
        firsts.sort_unstable();
        let steps = firsts.windows(2).map(|pair| (pair[1] - pair[0]) as usize);
        Ok(steps.filter(|n_every| *n_every > 0).min())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::{self, BehaviorConfig};
    use crate::geometry::Vec2;
    use crate::progress::Silent;
    use crate::scene::State;
    use crate::simulate::testing::{corpus, model, record, write_scenes};
    use crate::simulate::{Failed, Peeker, World};
    use crate::store::CorpusReader;
    use candle_core::Device;
    use std::sync::{Arc, Mutex};

    const LEVELS: [f64; 2] = [0.5, 2.0];

    fn run(config: &RatesConfig, n_threads: usize) -> (ModeledTraffic, LoopFigures) {
        run_with(config, n_threads, |modeling| modeling.run(&[0], &Silent).unwrap())
    }

    fn run_with<R: Send>(config: &RatesConfig, n_threads: usize, run: impl Fn(&Modeling<'_>) -> R + Sync + Send) -> R {
        let dir = tempfile::tempdir().unwrap();
        write_scenes(dir.path(), &CorpusReader::open(&corpus()).unwrap(), &[record().scenario.scene]);
        let store = SceneStore::open(dir.path()).unwrap();
        let model = model();
        let futures = Futures::new(&model, 3, &Device::Cpu).unwrap();
        let behaviors: Vec<_> = behavior::ALL.iter().map(|entry| (entry.default_config)()).collect();
        let behaviors: Vec<Box<dyn Behavior>> = behaviors.iter().map(BehaviorConfig::build).collect();
        let modeling = Modeling { config, futures: &futures, store: &store, behaviors: &behaviors };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
        pool.install(|| run(&modeling))
    }

    #[test]
    fn loops_that_are_split_show_as_much_traffic_and_the_same_for_any_threads() {
        let config =
            RatesConfig { loops: 3, horizon_s: 4.0, levels: LEVELS.to_vec(), copies: 3, ..RatesConfig::default() };
        let (plain, [of_plain, of_split]) = {
            let (plain, figures) = run(&RatesConfig { levels: Vec::new(), ..config.clone() }, 1);
            let (split, of_split) = run(&config, 1);
            let again = run(&config, 2);
            assert!((&split, &of_split) == (&again.0, &again.1));
            let all = [&plain, &split].map(|traffic| {
                let sum = |of: fn(&crate::rates::ModeledLoop) -> f64| traffic.loops.iter().map(of).sum::<f64>();
                [sum(|one| one.observed_h), sum(|one| one.motorized_km)]
            });
            // Three loops of a second that counts.
            assert!((all[0][0] * 3600.0 - 3.0).abs() < 1e-9 && (all[1][0] * 3600.0 - 3.0).abs() < 1e-9);
            assert!((all[0][1] / all[1][1] - 1.0).abs() < 0.05, "{all:?}");
            (plain, [figures, of_split])
        };
        assert_eq!((of_plain.n_loops, of_plain.n_futures, plain.loops.len()), (3, 24, 3));
        assert!(of_split.n_futures > of_plain.n_futures && of_split.reached.len() == 2, "{of_split:?}");
        // The three loops differ.
        assert!(plain.loops[0].motorized_km != plain.loops[1].motorized_km);
    }

    /// An ego that stands, so that others come close, and that notes where it does not remember how often it planned.
    #[derive(Clone, Default)]
    struct Remembers {
        n_planned: usize,
        /// Times that it began, and plans that it does not remember.
        noted: Arc<Mutex<[usize; 2]>>,
    }

    impl Driver for Remembers {
        fn begin(&mut self, _: &Situation, _: &World) -> Result<(), Failed> {
            self.n_planned = 0;
            self.noted.lock().unwrap()[0] += 1;
            Ok(())
        }

        fn plan(&mut self, of: &Situation, world: &World, n_steps: usize, _: &Peeker<'_>) -> Result<(), Failed> {
            let n_before = (world.now() - of.scene.current_timestep()) / n_steps;
            self.noted.lock().unwrap()[1] += usize::from(n_before != self.n_planned);
            self.n_planned = n_before + 1;
            Ok(())
        }

        fn next(&mut self, of: &Situation, world: &World, _: Option<State>) -> Result<State, Failed> {
            let present = world.present(of.ego_idx).ok_or_else(|| Failed::because("it is gone"))?;
            Ok(State { velocity: Vec2::default(), ..present })
        }
    }

    #[test]
    fn copies_of_a_driver_remember_their_own_past_and_split_loops_are_as_long() {
        let levels = vec![0.01, 0.5];
        let config = RatesConfig { loops: 2, horizon_s: 4.0, levels, copies: 3, ..RatesConfig::default() };
        let driven = |config: &RatesConfig| {
            let driver = Remembers::default();
            let (traffic, figures) = run_with(config, 1, |modeling| {
                let (pool, mut own): (_, Box<dyn Driver>) = (pool_of_worker().unwrap(), Box::new(driver.clone()));
                modeling.drive(&[0], &mut [(&pool, &mut own)], &|_, _| false, &Silent).unwrap()
            });
            let noted = *driver.noted.lock().unwrap();
            (traffic, figures, noted)
        };
        let (plain, of_plain, noted) = driven(&RatesConfig { levels: Vec::new(), ..config.clone() });
        assert_eq!((noted, plain.loops.len()), ([2, 0], 2));
        let (split, of_split, [n_begun, n_forgotten]) = driven(&config);
        assert!(n_begun > 2 && n_forgotten == 0 && of_split.n_futures > of_plain.n_futures, "{n_begun} {n_forgotten}");
        // A loop lasts 4 s, with all of its copies, unless the ego fails.
        for one in plain.loops.iter().chain(&split.loops) {
            let has_failed = one.events.iter().any(|event| event.behavior == FAILURE);
            assert!(has_failed || (one.observed_h * 3600.0 - 4.0).abs() < 1e-9, "{one:?}");
        }
    }

    #[test]
    fn levels_become_more_severe() {
        let with = |severity: Severity, levels: &[f64], copies: usize| {
            RatesConfig { severity, levels: levels.to_vec(), copies, ..RatesConfig::default() }.validate()
        };
        let (decelerates, ttc) = (Severity::RequiredDecelerationMps2, Severity::TimeToCollisionS);
        assert!(with(decelerates, &[2.0, 4.0], 4).is_ok() && with(ttc, &[2.0, 1.0], 4).is_ok());
        assert!(with(decelerates, &[], 1).is_ok() && RatesConfig::default().validate().is_ok());
        for (severity, levels, copies) in
            [(decelerates, &[4.0, 2.0][..], 4), (ttc, &[1.0, 2.0], 4), (ttc, &[2.0, 2.0], 4), (ttc, &[2.0, -1.0], 4)]
        {
            assert!(with(severity, levels, copies).unwrap_err().to_string().contains("levels"));
        }
        assert!(with(ttc, &[4.0, 3.0, 2.0], 22).unwrap_err().to_string().contains("copies"));
    }
}
