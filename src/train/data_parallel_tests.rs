//! Parts add up to the batch, and as many ranks as divide them take the same steps, whatever becomes of one of them.

use super::exchange::testing::meet;
use super::*;
use crate::nn::{Compute, Init, Params};
use crate::progress::Progress;
use crate::seed::Seed;
use candle_core::Tensor;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;

/// Weighted least squares: rows have targets and weights that depend on the step, and the weights are divided by their sum.
struct Rows {
    x: Tensor,
    unused: Tensor,
}

const BATCH_SIZE: usize = 10;

impl Rows {
    fn weight(step: u64, row: usize) -> f64 {
        1.0 + ((step as usize * 7 + row * 5) % 11) as f64
    }
}

impl TrainTask for Rows {
    fn batch_size(&self) -> usize {
        BATCH_SIZE
    }

    fn divisors(&self, BatchPart { step, rows }: &BatchPart) -> Result<Vec<f64>, Error> {
        Ok(vec![rows.clone().map(|row| Self::weight(*step, row)).sum(), rows.len() as f64])
    }

    fn loss(&self, BatchPart { step, rows }: &BatchPart, divisors: Option<&[f64]>) -> Result<Tensor, Error> {
        let own = self.divisors(&BatchPart { step: *step, rows: rows.clone() })?;
        let divisors = divisors.unwrap_or(&own);
        assert_eq!(divisors[1], BATCH_SIZE as f64);
        let mut loss = (self.unused.sum_all()? * 0.0)?;
        for row in rows.clone() {
            let target = ((step * 3 + row as u64) as f64).sin() / 3.0;
            let squared = (&self.x - target)?.sqr()?.sum_all()?;
            loss = (loss + (squared * (Self::weight(*step, row) / divisors[0]))?)?;
        }
        Ok(loss)
    }

    fn evaluate(&self) -> Result<BTreeMap<String, f64>, Error> {
        Ok(BTreeMap::from([("x".to_owned(), f64::from(self.x.detach().sum_all()?.to_scalar::<f32>()?))]))
    }
}

/// Asks to stop, or is gone, after so many steps.
enum Ends {
    Never,
    Asked(AtomicU64),
    Gone(AtomicU64),
}

impl Progress for Ends {
    fn must_stop(&self) -> bool {
        let is_over = |left: &AtomicU64| {
            left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1)).is_err()
        };
        match self {
            Self::Never => false,
            Self::Asked(left) => is_over(left),
            Self::Gone(left) => {
                assert!(!is_over(left), "killed");
                false
            }
        }
    }
}

/// Trains with four parts by ranks of this number, of which `who` ends as `how` says. What each rank came to; `None` if it died.
fn train(dir: &Path, n_ranks: usize, who: usize, how: &Ends) -> Vec<Option<Result<Option<FitOutcome>, Error>>> {
    let config = FitConfig {
        steps: 23,
        learning_rate: 0.05,
        warmup_steps: 4,
        ema_decay: 0.9,
        evaluate_every: 6,
        save_every: 1_000,
        log_every: 4,
        parts: 4,
        ..FitConfig::default()
    };
    let nowhere = dir.join("nowhere");
    let one = |exchange: Tcp| {
        let compute = Compute::cpu();
        let mut params = Params::new(&compute);
        let init = Init::KaimingUniform { fan_in: 1 };
        let mut get = |name: &str, n: usize| params.get_or_init(name, &[n], init, Seed(1)).unwrap();
        let task = Rows { x: get("x", 5), unused: get("unused", 3) };
        get("without a gradient", 2);
        let progress = if exchange.rank() == who { how } else { &Ends::Never };
        let dir = if exchange.rank() == 0 { dir } else { &nowhere };
        fit(
            &config,
            &mut params,
            &task,
            TrainJob { seed: Seed(1), dir, compute: &compute, progress, exchange: &exchange },
        )
    };
    let outcomes = thread::scope(|scope| {
        let ranks: Vec<_> = meet(n_ranks).into_iter().map(|exchange| scope.spawn(|| one(exchange))).collect();
        ranks.into_iter().map(|rank| rank.join().ok()).collect()
    });
    assert!(!nowhere.exists(), "the first rank alone keeps files");
    outcomes
}

fn assert_same(a: &Path, b: &Path) {
    for name in ["state.safetensors", "statistics.jsonl"] {
        let read = |dir: &Path| fs_err::read(dir.join(name)).unwrap();
        assert_eq!(read(a), read(b), "{name}");
    }
}

#[test]
fn any_number_of_ranks_takes_the_same_steps() {
    let dirs: Vec<_> = [1, 2, 4].map(|n_ranks| (n_ranks, tempfile::tempdir().unwrap())).into();
    for (n_ranks, dir) in &dirs {
        let outcomes = train(dir.path(), *n_ranks, 0, &Ends::Never);
        let told: Vec<bool> = outcomes.into_iter().map(|outcome| outcome.unwrap().unwrap().is_some()).collect();
        assert_eq!(told, (0..*n_ranks).map(|rank| rank == 0).collect::<Vec<_>>());
        assert_same(dirs[0].1.path(), dir.path());
    }
}

#[test]
fn all_stop_at_one_step_and_go_on_with_another_number_of_ranks() {
    let (whole, stopped) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    train(whole.path(), 1, 0, &Ends::Never);
    let mut reached = 0;
    for (n_ranks, who, n_steps) in [(2, 1, 0), (4, 2, 3), (1, 0, 4), (2, 0, 5), (4, 3, 6)] {
        reached += n_steps;
        for outcome in train(stopped.path(), n_ranks, who, &Ends::Asked(AtomicU64::new(n_steps))) {
            assert!(matches!(outcome, Some(Err(Error::Stopped { step })) if step == reached), "{outcome:?}");
        }
    }
    train(stopped.path(), 2, 0, &Ends::Never);
    assert_same(whole.path(), stopped.path());
}

#[test]
fn a_rank_that_is_gone_ends_the_others_after_the_state_is_saved() {
    let (whole, lost) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    train(whole.path(), 4, 0, &Ends::Never);
    for (n_ranks, who) in [(2, 1), (4, 3), (4, 1)] {
        let outcomes = train(lost.path(), n_ranks, who, &Ends::Gone(AtomicU64::new(5)));
        for (rank, outcome) in outcomes.into_iter().enumerate() {
            match outcome {
                None => assert_eq!(rank, who),
                Some(outcome) => assert!(matches!(outcome, Err(Error::Lost(_))), "rank {rank}: {outcome:?}"),
            }
        }
    }
    // Fifteen steps are saved: the first rank takes the eight others.
    let outcome = train(lost.path(), 1, 0, &Ends::Never).remove(0).unwrap().unwrap().unwrap();
    assert_eq!(outcome.steps_taken, 8);
    assert_same(whole.path(), lost.path());
    // If the first rank is the one that is gone, the others know as well, and what it had saved stays.
    let outcomes = train(tempfile::tempdir().unwrap().path(), 2, 0, &Ends::Gone(AtomicU64::new(2)));
    assert!(outcomes[0].is_none() && matches!(outcomes[1], Some(Err(Error::Lost(_)))), "{outcomes:?}");
}

#[test]
fn ranks_that_do_not_divide_the_parts_are_refused() {
    for (n_parts, n_ranks) in [(1, 2), (4, 8), (4, 3), (3, 3), (8, 0)] {
        let said = check_ranks(n_parts, n_ranks).unwrap_err().to_string();
        assert!(said.contains(&format!("{n_ranks} ranks cannot share {n_parts} parts")), "{said}");
    }
    [(1, 1), (4, 1), (4, 2), (4, 4)].into_iter().for_each(|(n_parts, n_ranks)| check_ranks(n_parts, n_ranks).unwrap());
}
