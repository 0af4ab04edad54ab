//! Drives situations at the same time, each with the driver under test and with the careful one.

use super::external::External;
use super::kept::Kept;
use super::margin::Margin;
use super::{DriveConfig, EgoDriver, Origin, Result, SaveAt};
use crate::generate::{Futures, NamedDriver};
use crate::progress::Progress;
use crate::simulate::{
    CHUNK, Careful, Driven, Driver, Others, Situation, in_parallel, named, pool_of_worker, roll_out,
};
use rayon::ThreadPool;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// The drives from a situation, by driver, and its margin.
pub(super) type Drives = (Vec<Driven>, Option<Margin>);

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

/// The drivers of one thread: the one under test, and the careful one if it is another.
struct Worker {
    asked: Box<dyn Driver>,
    careful: Option<Careful>,
    pool: ThreadPool,
}

impl Worker {
    /// The drivers of a thread; `runs` is shared by all processes of a planner.
    fn new(config: &DriveConfig, runs: &Arc<AtomicBool>) -> Result<Self> {
        let asked: Box<dyn Driver> = match &config.ego {
            EgoDriver::Named(driver) => named(*driver),
            EgoDriver::External(command) => Box::new(External::new(command, config.rollout, config.time_limit_s, runs)),
        };
        let careful = (config.ego != EgoDriver::Named(NamedDriver::Careful)).then(Careful::default);
        Ok(Self { asked, careful, pool: pool_of_worker()? })
    }

    /// The drives from one situation, of the driver under test and of the careful one, and their margin.
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
        let Self { asked, careful, pool } = self;
        pool.install(|| {
            let driven = roll_out(situation, start(), asked.as_mut(), &others, &config.rollout, save_at)?;
            let beside = match careful {
                Some(careful) => Some(roll_out(situation, start(), careful, &others, &config.rollout, None)?),
                None => None,
            };
            let outcomes = [driven.outcome, beside.as_ref().map_or(driven.outcome, |beside| beside.outcome)];
            let margin = match (config.bisects, from) {
                (true, Origin::Scenarios(_)) => Margin::find(situation, outcomes, |driver, later| {
                    let driver: &mut dyn Driver = match careful {
                        Some(careful) if driver == 1 => careful,
                        _ => asked.as_mut(),
                    };
                    let start = later.start(futures.seed());
                    Ok(roll_out(later, start, driver, &others, &config.rollout, None)?.outcome)
                })?,
                _ => None,
            };
            Ok(([driven].into_iter().chain(beside).collect(), margin))
        })
    }
}
