//! Rare events of a random process: copies of it go on from where it came close.
//!
//! Fixed splitting (Kahn and Harris 1951; L'Ecuyer, Demers and Tuffin 2007): whenever the severity passes the
//! next level for the first time, `n_copies` copies go on instead of one, each with that part of its weight. As copies
//! continue as the process itself would, what ends of paths sum up, times their weights, is expected to be what a path
//! of the process sums up: *whatever* is summed, for any levels and numbers of copies that are fixed beforehand. Levels
//! decide only how much it varies. Sums over different starts are independent.

/// A process that can go on in several ways from where it is.
pub trait Process: Clone {
    /// Why it cannot go on.
    type Error;

    /// Goes on for a step. Returns the largest severity in it; `None` if the process is over.
    fn step(&mut self) -> Result<Option<f64>, Self::Error>;

    /// Makes all that follows independent of what follows for other copies of this state.
    fn draw_anew(&mut self, copy: usize);
}

/// When a process is split.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Levels<'a> {
    /// The severities that copies are made at, in ascending order.
    pub severities: &'a [f64],
    /// How many go on at each.
    pub n_copies: usize,
}

/// Follows a process and its copies to their ends, and takes each end with its weight. Returns the number of steps.
///
/// # Errors
/// The first error of the process.
pub fn split<P: Process>(start: P, levels: Levels<'_>, take: &mut impl FnMut(P, f64)) -> Result<u64, P::Error> {
    let mut n_steps = 0;
    let n_copies = levels.n_copies.max(1);
    // The copies that wait, with the levels that they have passed and their weights.
    let mut waiting = vec![(start, 0, 1.0)];
    while let Some((mut process, mut n_passed, mut weight)) = waiting.pop() {
        loop {
            let Some(severity) = process.step()? else { break };
            n_steps += 1;
            let n_before = n_passed;
            n_passed += levels.severities[n_before..].iter().take_while(|level| severity >= **level).count();
            if n_passed > n_before {
                let n_all = n_copies.pow((n_passed - n_before) as u32);
                weight /= n_all as f64;
                for copy in (1..n_all).rev() {
                    let mut other = process.clone();
                    other.draw_anew(copy);
                    waiting.push((other, n_passed, weight));
                }
                process.draw_anew(0);
            }
        }
        take(process, weight);
    }
    Ok(n_steps)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seed::{Seed, SeededRng};
    use std::convert::Infallible;

    /// A walk from 0 in steps of ±1, up with probability `p`, until it is below 0 or at `top`.
    #[derive(Clone)]
    struct Walk {
        at: i32,
        most: i32,
        n_up: u32,
        top: i32,
        p: f64,
        seed: Seed,
        rng: SeededRng,
    }

    impl Process for Walk {
        type Error = Infallible;

        fn step(&mut self) -> Result<Option<f64>, Infallible> {
            if self.at < 0 || self.at >= self.top {
                return Ok(None);
            }
            let up = self.rng.uniform() < self.p;
            self.at += if up { 1 } else { -1 };
            self.n_up += u32::from(up);
            self.most = self.most.max(self.at);
            Ok(Some(f64::from(self.at)))
        }

        fn draw_anew(&mut self, copy: usize) {
            self.seed = self.seed.derive("copy", &[copy as u64]);
            self.rng = self.seed.rng();
        }
    }

    /// Of `n` walks: the mean of hits of the top and of steps up, the variance of the former, and the steps of all.
    fn estimates(n: u64, levels: Levels<'_>, (top, p): (i32, f64)) -> [f64; 4] {
        let (mut sum, mut sum_of_squares, mut ups, mut n_steps) = (0.0, 0.0, 0.0, 0);
        for i in 0..n {
            let seed = Seed(5).derive("walk", &[i, levels.severities.len() as u64]);
            let start = Walk { at: 0, most: 0, n_up: 0, top, p, seed, rng: seed.rng() };
            let mut hits = 0.0;
            n_steps += split(start, levels, &mut |walk, weight| {
                hits += if walk.at >= top { weight } else { 0.0 };
                ups += weight * f64::from(walk.n_up);
            })
            .unwrap_or_else(|never| match never {});
            (sum, sum_of_squares) = (sum + hits, sum_of_squares + hits * hits);
        }
        let mean = sum / n as f64;
        [mean, ups / n as f64, sum_of_squares / n as f64 - mean * mean, n_steps as f64]
    }

    #[test]
    fn a_walk_hits_as_often_as_a_gambler_whatever_the_levels_and_varies_less() {
        // The gambler's ruin: from 0, `top` comes before -1 with probability (r - 1) / (r^(top + 1) - 1), r = (1 -
        // p)/p; by Wald, steps up are p times all steps, of which there are (1 - hit (top + 1)) / (1 - 2 p).
        let (top, p) = (20, 0.4_f64);
        let r = (1.0 - p) / p;
        let hit = (r - 1.0) / (r.powi(top + 1) - 1.0);
        assert!((1e-4..1.1e-4).contains(&hit));
        let ups = p * (1.0 - hit * f64::from(top + 1)) / (1.0 - 2.0 * p);
        // At equal variance, the first two sets of levels take a sixteenth of the steps, the others 0.09, 0.27 and
        // 0.09, by the variances and steps of the walk from level to level.
        for (severities, n_copies, at_most) in [
            (&[3.0, 6.0, 9.0, 12.0, 15.0, 18.0][..], 3, 0.1),
            (&[4.0, 8.0, 12.0, 16.0], 4, 0.1),
            (&[4.0, 4.5, 9.0, 14.0], 4, 0.15),
            (&[1.0, 16.0], 7, 0.4),
            (&[6.0, 12.0], 10, 0.15),
        ] {
            let n = 20_000;
            let [mean, mean_ups, variance, n_steps] = estimates(n, Levels { severities, n_copies }, (top, p));
            let error = (variance / n as f64).sqrt();
            assert!((mean - hit).abs() < 3.0 * error, "{severities:?}: {mean} ± {error}, expected {hit}");
            assert!((mean_ups / ups - 1.0).abs() < 0.05, "{severities:?}: {mean_ups} steps up, expected {ups}");
            // For the same number of steps as walks that are not split, whose hits vary by hit (1 - hit).
            let per_step = variance * n_steps / n as f64;
            let plain = hit * (1.0 - hit) * (1.0 - hit * f64::from(top + 1)) / (1.0 - 2.0 * p);
            assert!(per_step < at_most * plain, "{severities:?}: {per_step} against {plain}");
        }
    }

    #[test]
    fn without_levels_or_copies_every_start_ends_once() {
        for (severities, n_copies) in [(&[][..], 5), (&[1.0, 2.0], 1)] {
            let (mut n, mut sum) = (0, 0.0);
            let seed = Seed(1);
            let start = Walk { at: 0, most: 0, n_up: 0, top: 4, p: 0.5, seed, rng: seed.rng() };
            split(start, Levels { severities, n_copies }, &mut |_, weight| (n, sum) = (n + 1, sum + weight)).unwrap();
            assert_eq!((n, sum), (1, 1.0));
        }
    }
}
