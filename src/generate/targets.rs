//! Which event does each sample of a pair aim at? One of the outcomes that the pair can reach.

use super::pairs::CandidatePair;
use super::{Aim, Generator, ResolvedSweep};
use crate::behavior::Outcome;
use crate::guidance::Target;
use crate::scene::SceneId;
use crate::seed::Seed;

/// How far from its target a parameter of the event may be: in seconds for times, otherwise in the parameter's unit.
const HALF_WIDTH_S: f64 = 0.15;
const HALF_WIDTH: f64 = 0.5;
/// The weight of an outcome that takes everything the limits of driving allow; an effortless one has this weight plus
/// 1.
const LEAST_EASE: f64 = 0.1;

impl Generator<'_> {
    /// The targets of the samples of `pair`, in order: as many as the sweep has samples, or as the pair has outcomes.
    /// Empty if the sweep does not aim.
    pub(super) fn targets(&self, sweep: &ResolvedSweep, scene: &SceneId, pair: &CandidatePair) -> Vec<Target> {
        let parameters = match sweep.aim {
            Aim::Anything => return Vec::new(),
            Aim::Feasible => sweep.aims_at(),
        };
        let target = |outcome: &Outcome| -> Target {
            let values = parameters.iter().filter_map(|name| Some((*name, outcome.get(name)?)));
            let interval = |name: &str, value: f64| {
                let half = if name.ends_with("_s") { HALF_WIDTH_S } else { HALF_WIDTH };
                [value - half, value + half]
            };
            values.map(|(name, value)| (name.to_owned(), interval(name, value))).collect()
        };
        let (first, second) = pair.agents;
        let seed = self.seed().derive_named("aim", &scene.0).derive("pair", &[first as u64, second as u64]);
        in_drawn_order(&pair.outcomes, seed).take(sweep.n_samples).map(target).filter(|t| !t.is_empty()).collect()
    }
}

/// The outcomes in an order drawn without replacement, each with a chance in proportion to its ease (Efraimidis and
/// Spirakis 2006).
fn in_drawn_order(outcomes: &[Outcome], seed: Seed) -> impl Iterator<Item = &Outcome> {
    let mut rng = seed.rng();
    let mut keyed: Vec<(f64, &Outcome)> = outcomes
        .iter()
        .map(|outcome| (rng.uniform().powf(1.0 / (LEAST_EASE + 1.0 - outcome.effort().clamp(0.0, 1.0))), outcome))
        .collect();
    keyed.sort_by(|a, b| b.0.total_cmp(&a.0));
    keyed.into_iter().map(|(_, outcome)| outcome)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn easy_outcomes_come_first_in_proportion_and_each_comes_once() {
        let outcomes: Vec<Outcome> =
            [0.0, 0.5, 1.0].iter().map(|effort| Outcome::default().with("gap_m", *effort).at_effort(*effort)).collect();
        let mut n_first = [0; 3];
        for draw in 0..3000 {
            let order: Vec<f64> =
                in_drawn_order(&outcomes, Seed(draw)).filter_map(|outcome| outcome.get("gap_m")).collect();
            let mut sorted = order.clone();
            sorted.sort_by(f64::total_cmp);
            assert_eq!(sorted, [0.0, 0.5, 1.0]);
            n_first[(2.0 * order[0]) as usize] += 1;
        }
        // Chances of 1.1, 0.6 and 0.1 in 1.8, within four standard deviations.
        for (n, ease) in n_first.iter().zip([1.1, 0.6, 0.1]) {
            let share: f64 = ease / 1.8;
            let deviation = (share * (1.0 - share) / 3000.0).sqrt();
            assert!((f64::from(*n) / 3000.0 - share).abs() < 4.0 * deviation, "{n_first:?}");
        }
    }
}
