//! How many steps fit into the time that is left, while other processes come and go?

/// Steps over which their duration is averaged.
const MEMORY: u64 = 40;
/// Steps that are timed before a plan is changed.
const LEAST: u64 = 5;
/// A plan is changed by at least this part of the steps to come, and of all steps.
const CHANGES: [f64; 2] = [0.1, 0.02];

/// The durations of steps and evaluations, seconds.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pace {
    pub(super) step_s: f64,
    pub(super) evaluation_s: f64,
    n_timed: u64,
}

impl Pace {
    /// The pace of steps and evaluations that were timed before.
    pub(super) const fn new(step_s: f64, evaluation_s: f64) -> Self {
        Self { step_s, evaluation_s, n_timed: 0 }
    }

    /// Hears that a step took so long. The first one, in which memory is allocated, counts until there is another.
    pub(super) fn took(&mut self, step_s: f64) {
        self.step_s += (step_s - self.step_s) / self.n_timed.clamp(1, MEMORY) as f64;
        self.n_timed += 1;
    }

    /// The number of steps, after `step` of them, that end within `left_s`: with an evaluation after every `every`
    /// steps and after the last, and the time of one more for losses on changed scenes. At least one more step.
    pub(super) fn steps(&self, step: u64, left_s: f64, every: u64) -> u64 {
        let needed_s = |steps: u64| {
            let n_evaluations = steps.div_ceil(every) - step / every;
            (steps - step) as f64 * self.step_s + (n_evaluations + 1) as f64 * self.evaluation_s
        };
        let (mut fits, mut too_many) = (step + 1, (step + 2).saturating_add((left_s / self.step_s).max(0.0) as u64));
        while fits + 1 < too_many {
            let middle = u64::midpoint(fits, too_many);
            *(if needed_s(middle) <= left_s { &mut fits } else { &mut too_many }) = middle;
        }
        fits
    }

    /// Another number of steps in place of `planned`, if steps have become faster or slower than it was planned for.
    pub(super) fn replanned(&self, planned: u64, step: u64, left_s: f64, every: u64) -> Option<u64> {
        let steps = self.steps(step, left_s, every);
        let change = steps.abs_diff(planned) as f64;
        let [of_rest, of_all] = CHANGES;
        let is_due = change > of_rest * (planned - step) as f64 && change > of_all * planned as f64;
        Some(steps).filter(|_| is_due && self.n_timed >= LEAST)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_and_evaluations_fill_the_time() {
        let pace = Pace::new(1.0, 10.0);
        // 80 steps, evaluations after 50 and 80, and 10 s for the rest.
        assert_eq!(pace.steps(0, 110.0, 50), 80);
        // Another evaluation would not fit before the 100th step, the last.
        assert_eq!([129.0, 130.0].map(|left_s| pace.steps(0, left_s, 50)), [99, 100]);
        assert_eq!([131.0, 141.0].map(|left_s| pace.steps(0, left_s, 50)), [100, 101]);
        // At the 50th step, after its evaluation, one is left.
        assert_eq!(pace.steps(50, 50.0, 50), 80);
        assert_eq!([pace.steps(7, -3.0, 50), pace.steps(7, 0.0, 1)], [8, 8]);
    }

    #[test]
    fn a_plan_is_changed_when_steps_become_slower_or_faster() {
        let mut pace = Pace::new(1.0, 10.0);
        pace.took(9.0);
        (1..LEAST).for_each(|_| pace.took(1.05));
        assert_eq!(pace.replanned(80, 5, 105.0, 50), None);
        (0..400).for_each(|_| pace.took(2.0));
        assert!((pace.step_s - 2.0).abs() < 1e-3);
        assert_eq!(pace.replanned(80, 10, 100.0, 50), Some(50));
        (0..400).for_each(|_| pace.took(0.5));
        assert_eq!(pace.replanned(80, 20, 90.1, 50), Some(120));
    }
}
