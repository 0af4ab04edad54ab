//! Drives situations at the same time, each with the driver under test, the careful one, and one that does nothing.

use super::drives::Drives;
use super::external::External;
use super::kept::Kept;
use super::margin::Margin;
use super::{DriveConfig, EgoDriver, FailureRates, Origin, Result, SaveAt, SplitFailures};
use crate::behavior::{Behavior, BehaviorConfig, BehaviorEvent};
use crate::generate::{Futures, NamedDriver};
use crate::progress::Progress;
use crate::rates::ModeledTraffic;
use crate::simulate::{
    CHUNK, Driver, LoopWorker, Modeling, Others, Outcome, RatesConfig, Situation, in_parallel, named, pool_of_worker,
    roll_out,
};
use crate::store::SceneStore;
use rayon::ThreadPool;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// The drivers beside the one under test, unless it is one of them: the careful one says what can be avoided, and one
/// at constant velocity whether a scenario asks for anything.
pub(super) const BESIDE: [NamedDriver; 2] = [NamedDriver::Careful, NamedDriver::ConstantVelocity];

/// Drivers, some for each thread.
pub(super) struct Pool<'a> {
    workers: Vec<Worker>,
    from: &'a Origin<'a>,
    config: &'a DriveConfig,
    futures: &'a Futures<'a>,
}

impl<'a> Pool<'a> {
    /// As many as the settings say; none of them has begun.
    pub(super) fn new(from: &'a Origin<'a>, config: &'a DriveConfig, futures: &'a Futures<'a>) -> Result<Self> {
        let runs = Arc::default();
        let workers = (0..config.n_workers.max(1)).map(|_| Worker::new(config, &runs)).collect::<Result<_>>()?;
        Ok(Self { workers, from, config, futures })
    }

    /// How many situations to drive at a time.
    pub(super) const fn chunk(&self) -> usize {
        CHUNK * self.workers.len()
    }

    /// The drives of some situations in their order, whichever worker drives them.
    pub(super) fn drive(
        &mut self,
        situations: &[Situation],
        kept: &Kept,
        progress: &dyn Progress,
    ) -> Result<Vec<Drives>> {
        let Self { workers, from, config, futures } = self;
        in_parallel(situations, workers, |worker, situation| {
            let driven = match kept.get(&situation.scenario_id)? {
                Some(known) => known,
                None => {
                    let driven = worker.drive(situation, from, config, futures)?;
                    kept.put(&situation.scenario_id, &driven)?;
                    driven
                }
            };
            progress.advance(1);
            Ok(driven)
        })
    }
}

impl Pool<'_> {
    /// Failures of the driver under test, and of the careful one, in loops that begin with the scenes at `positions`:
    /// in events of these buckets, which definitions with default options find, or not.
    pub(super) fn split(
        &mut self,
        config: &RatesConfig,
        (store, positions): (&SceneStore, &[usize]),
        by_buckets: &[FailureRates],
        progress: &dyn Progress,
    ) -> Result<Vec<SplitFailures>> {
        let ids: BTreeSet<&str> = by_buckets.iter().flat_map(FailureRates::behaviors).collect();
        let behaviors = ids.into_iter().filter_map(BehaviorConfig::from_id);
        let behaviors: Vec<Box<dyn Behavior>> = behaviors.map(|config| config.build()).collect();
        let is_tested = |place: &str, event: &BehaviorEvent| by_buckets.iter().any(|at| at.holds(place, event));
        let loops = Modeling { config, futures: self.futures, store, behaviors: &behaviors };
        let mut of = |driver: Option<NamedDriver>| -> Result<ModeledTraffic> {
            let at = |worker: &Worker| {
                let is_asked = |(name, _): &(String, _)| driver.is_some_and(|driver| name == driver.name());
                worker.drivers.iter().position(is_asked).unwrap_or_default()
            };
            let workers = self.workers.iter_mut().map(|worker| (at(worker), worker));
            let mut workers: Vec<LoopWorker<'_>> =
                workers.map(|(at, worker)| (&worker.pool, &mut worker.drivers[at].1)).collect();
            Ok(loops.drive(positions, &mut workers, &is_tested, progress)?.0)
        };
        Ok(SplitFailures::of(&[of(None)?, of(Some(NamedDriver::Careful))?], by_buckets))
    }
}

/// The drivers of one thread, the one under test first.
struct Worker {
    drivers: Vec<(String, Box<dyn Driver>)>,
    pool: ThreadPool,
}

impl Worker {
    /// The drivers of a thread; `runs` is shared by all processes of a planner.
    fn new(config: &DriveConfig, runs: &Arc<AtomicBool>) -> Result<Self> {
        let asked: Box<dyn Driver> = match &config.ego {
            EgoDriver::Named(driver) => named(*driver),
            EgoDriver::External(command) => Box::new(External::new(command, config.rollout, config.time_limit_s, runs)),
        };
        let beside = BESIDE.into_iter().filter(|driver| config.ego != EgoDriver::Named(*driver));
        let beside = beside.map(|driver| (driver.name().to_owned(), named(driver)));
        let drivers = [(config.ego.name_in_tables().to_owned(), asked)].into_iter().chain(beside).collect();
        Ok(Self { drivers, pool: pool_of_worker()? })
    }

    /// The drives from one situation, and its margin.
    fn drive(
        &mut self,
        situation: &Situation,
        from: &Origin<'_>,
        config: &DriveConfig,
        futures: &Futures<'_>,
    ) -> Result<Drives> {
        let others = Others::Sampled(futures);
        let start = || match from {
            Origin::Scenarios(_) => situation.start(futures.seed()),
            Origin::State(world) => world.clone(),
        };
        let save_at = config.save_at.map(|at| match at {
            SaveAt::Event => situation.event[0],
            SaveAt::Timestep(timestep) => timestep,
        });
        let Self { drivers, pool } = self;
        pool.install(|| {
            let mut all = Vec::new();
            for (i, (name, driver)) in drivers.iter_mut().enumerate() {
                let save_at = save_at.filter(|_| i == 0);
                let driven = roll_out(situation, start(), driver.as_mut(), &others, &config.rollout, save_at)?;
                all.push((name.clone(), driven));
            }
            let careful = drivers.iter().position(|(name, _)| name == NamedDriver::Careful.name()).unwrap_or_default();
            let outcomes: [Outcome; 2] = [0, careful].map(|i| all[i].1.outcome);
            let margin = match (config.bisects, from) {
                (true, Origin::Scenarios(_)) => Margin::find(situation, outcomes, |driver, later| {
                    let (_, driver) = &mut drivers[if driver == 0 { 0 } else { careful }];
                    let start = later.start(futures.seed());
                    Ok(roll_out(later, start, driver.as_mut(), &others, &config.rollout, None)?.outcome)
                })?,
                _ => None,
            };
            Ok(Drives { all, margin })
        })
    }
}
