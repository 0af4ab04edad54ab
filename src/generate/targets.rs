//! Which event does each sample of a pair aim at? One of the outcomes that the pair can reach.

use super::pairs::CandidatePair;
use super::{Aim, Generator, ResolvedSweep};
use crate::behavior::Outcome;
use crate::guidance::Target;
use crate::metrics::least_ttc_s;
use crate::scene::SceneId;
use crate::seed::Seed;

/// How far from its target a parameter of the event may be: in seconds for times, otherwise in the parameter's unit.
const HALF_WIDTH_S: f64 = 0.15;
const HALF_WIDTH: f64 = 0.5;
/// The weight of an outcome that takes everything the limits of driving allow; an effortless one has this weight plus
/// 1.
const LEAST_EASE: f64 = 0.1;
/// The least hardness of an outcome that is aimed at as a hard one: 2.5 s to spare.
const LEAST_HARDNESS: f64 = 0.03125;

impl Generator<'_> {
    /// The targets of the samples of `pair`, in order: as many as the sweep has samples, or as the pair has outcomes.
    /// Empty if the sweep does not aim.
    pub(super) fn targets(&self, sweep: &ResolvedSweep, scene: &SceneId, pair: &CandidatePair) -> Vec<Target> {
        let parameters = match sweep.aim {
            Aim::Anything => return Vec::new(),
            Aim::Feasible | Aim::Hard => sweep.aims_at(),
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
        let weight = if sweep.aim == Aim::Hard { difficulty } else { ease };
        in_drawn_order(pair.outcomes.iter().filter(|outcome| weight(outcome) > 0.0), weight, seed)
            .take(sweep.n_samples)
            .map(target)
            .filter(|t| !t.is_empty())
            .collect()
    }
}

/// The weight of an outcome: easy ones come more often.
fn ease(outcome: &Outcome) -> f64 {
    LEAST_EASE + 1.0 - outcome.effort().clamp(0.0, 1.0)
}

/// The weight of an outcome where hard ones are aimed at: 0 unless it is one. Those that close no gap by their kind
/// come alike.
fn difficulty(outcome: &Outcome) -> f64 {
    match hardness(outcome) {
        None => 1.0,
        Some(hardness) if hardness < LEAST_HARDNESS => 0.0,
        Some(hardness) => hardness,
    }
}

/// The largest weight of these outcomes where hard ones are aimed at; 0 if none is hard.
pub(super) fn most_difficult(outcomes: &[Outcome]) -> f64 {
    outcomes.iter().map(difficulty).fold(0.0, f64::max)
}

/// How near an outcome is to what cannot be avoided, from 0 to 1: a quarter with each second to spare. 0 if it cannot
/// be avoided, or no gap closes; `None` for events without gaps.
fn hardness(outcome: &Outcome) -> Option<f64> {
    let (gap_m, closing_mps) = (outcome.get("gap_m")?, outcome.get("relative_speed_mps")?);
    let spare_s = gap_m / closing_mps - least_ttc_s(closing_mps);
    Some(if closing_mps > 0.0 && spare_s >= 0.0 { (-2.0 * spare_s).exp2() } else { 0.0 })
}

/// All outcomes in an order drawn without replacement, each with a chance in proportion to its weight (Efraimidis and
/// Spirakis 2006).
fn in_drawn_order<'a>(
    outcomes: impl Iterator<Item = &'a Outcome>,
    weight: fn(&Outcome) -> f64,
    seed: Seed,
) -> impl Iterator<Item = &'a Outcome> {
    let mut rng = seed.rng();
    let key = |outcome| (rng.uniform().powf(1.0 / weight(outcome)), outcome);
    let mut keyed: Vec<(f64, &Outcome)> = outcomes.map(key).collect();
    keyed.sort_by(|a, b| b.0.total_cmp(&a.0));
    keyed.into_iter().map(|(_, outcome)| outcome)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hard_outcomes_close_in_little_more_time_than_a_careful_driver_needs() {
        let at =
            |gap_m: f64, mps: f64| difficulty(&Outcome::default().with("gap_m", gap_m).with("relative_speed_mps", mps));
        // 6 m/s need 6 / 12 + 0.35 s: 5.1 m.
        assert!((at(5.1, 6.0) - 1.0).abs() < 1e-9 && (at(11.1, 6.0) - 0.25).abs() < 1e-9);
        // It cannot be avoided, is easy, or closes no gap; a turn has none.
        assert_eq!([at(5.0, 6.0), at(20.2, 6.0), at(5.0, -1.0)], [0.0; 3]);
        assert_eq!(difficulty(&Outcome::default()), 1.0);
        assert_eq!(most_difficult(&[]), 0.0);
    }

    #[test]
    fn easy_outcomes_come_first_in_proportion_and_each_comes_once() {
        let outcomes: Vec<Outcome> =
            [0.0, 0.5, 1.0].iter().map(|effort| Outcome::default().with("gap_m", *effort).at_effort(*effort)).collect();
        let mut n_first = [0; 3];
        for draw in 0..3000 {
            let order: Vec<f64> =
                in_drawn_order(outcomes.iter(), ease, Seed(draw)).filter_map(|outcome| outcome.get("gap_m")).collect();
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
