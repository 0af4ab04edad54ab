//! Which samples become scenarios? Rejection by limits of metrics, and the best of many.

use crate::metrics::{ALL, Direction, Metric, SampleGroup, by_id};
use crate::scene::Scene;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Which samples of a scene at one strength become scenarios. Metrics are those of the evaluation, of one sample alone.
///
/// A metric that looks at the recording, such as `min_scene_ade_m`, makes the corpus repeat what was recorded.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SelectConfig {
    /// Limits by metric: samples above them are left out, or below where more is better. `{ collision_rate = 0.0 }` keeps
    /// what has no collision.
    #[serde(default)]
    pub limits: BTreeMap<String, f64>,
    /// How many are kept of those within the limits: the best. Left out: all.
    #[serde(default)]
    pub best: Option<usize>,
    /// The metrics by which samples are better: the first decides, each further one among equals, and at last the order of
    /// sampling.
    #[serde(default)]
    pub by: Vec<String>,
}

impl SelectConfig {
    /// Says what makes no sense.
    ///
    /// # Errors
    /// When something does not.
    pub(super) fn validate(&self) -> Result<(), String> {
        for id in self.limits.keys().chain(&self.by) {
            let Some(metric) = by_id(id) else {
                let known: Vec<&str> = ALL.iter().map(|metric| metric.spec().id).collect();
                return Err(format!("{id:?} is no metric; known here: {}", known.join(", ")));
            };
            if metric.spec().direction == Direction::Neither {
                return Err(format!("{id}: neither more nor less of it is better, so it cannot select"));
            }
        }
        if let Some((id, limit)) = self.limits.iter().find(|(_, limit)| limit.is_nan()) {
            return Err(format!("limits.{id} is {limit}, expected a number"));
        }
        match (self.best, self.by.is_empty()) {
            (Some(0), _) => Err("best is 0, expected at least 1".to_owned()),
            (Some(_), true) => Err("best needs metrics to compare by, such as by = [\"offroad_rate\"]".to_owned()),
            (None, false) => Err("by compares samples for nothing: say how many are kept (best)".to_owned()),
            (None, true) if self.limits.is_empty() => Err("neither limits nor best are given".to_owned()),
            _ => Ok(()),
        }
    }

    /// For each sample of one recorded scene why it is left out; `None` where it is kept. A metric that is not defined for a
    /// sample is no limit to it, and makes it the worst.
    pub(super) fn verdicts(&self, recorded: &Scene, samples: &[Scene]) -> Vec<Option<String>> {
        let cost = |metric: &dyn Metric, sample: &Scene| {
            let group = SampleGroup::equally_likely(recorded, std::slice::from_ref(sample));
            metric.evaluate(&group).map(|value| as_cost(metric, value))
        };
        let mut verdicts: Vec<Option<String>> = samples
            .iter()
            .map(|sample| {
                self.limits.iter().find_map(|(id, limit)| {
                    let metric = by_id(id)?;
                    let is_beyond = cost(metric, sample)? > as_cost(metric, *limit);
                    is_beyond.then(|| format!("{id} beyond {limit}"))
                })
            })
            .collect();
        let Some(best) = self.best else { return verdicts };
        let metrics: Vec<&dyn Metric> = self.by.iter().filter_map(|id| by_id(id)).collect();
        let mut ranked: Vec<(Vec<f64>, usize)> = (0..samples.len())
            .filter(|i| verdicts[*i].is_none())
            .map(|i| (metrics.iter().map(|metric| cost(*metric, &samples[i]).unwrap_or(f64::INFINITY)).collect(), i))
            .collect();
        ranked.sort_by(|(a, i), (b, j)| {
            let first_difference = a.iter().zip(b).map(|(a, b)| a.total_cmp(b)).find(|order| order.is_ne());
            first_difference.unwrap_or_else(|| i.cmp(j))
        });
        for (_, i) in ranked.into_iter().skip(best) {
            verdicts[i] = Some(format!("not among the best {best}"));
        }
        verdicts
    }
}

/// A value of which less is better.
fn as_cost(metric: &dyn Metric, value: f64) -> f64 {
    if metric.spec().direction == Direction::HigherIsBetter { -value } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{Drive, scene};

    /// A car that drives on at 10 m/s, and futures of it at other speeds; ADE and FDE grow with the difference.
    fn samples() -> (Scene, Vec<Scene>) {
        let at = |speed_mps: f64| scene(&[Drive::straight(0.0, 0.0, 0.0, speed_mps)]);
        (at(10.0), [12.0, 10.5, 7.0, 10.5].map(at).to_vec())
    }

    fn select(toml: &str) -> SelectConfig {
        toml::from_str(toml).unwrap()
    }

    #[test]
    fn the_best_are_kept_and_the_first_of_equals() {
        let (recorded, samples) = samples();
        let verdicts = select("best = 1\nby = ['min_fde_m']").verdicts(&recorded, &samples);
        let kept: Vec<usize> = (0..4).filter(|i| verdicts[*i].is_none()).collect();
        assert_eq!(kept, [1]);
        assert_eq!(verdicts[3].as_deref(), Some("not among the best 1"));
        let verdicts = select("best = 3\nby = ['collision_rate', 'min_ade_m']").verdicts(&recorded, &samples);
        assert_eq!(verdicts.iter().map(Option::is_some).collect::<Vec<_>>(), [false, false, true, false]);
    }

    #[test]
    fn limits_come_before_ranks() {
        let (recorded, samples) = samples();
        let fde_m = |i: usize| {
            let group = SampleGroup::equally_likely(&recorded, std::slice::from_ref(&samples[i]));
            by_id("min_fde_m").unwrap().evaluate(&group).unwrap()
        };
        let limit = f64::midpoint(fde_m(0), fde_m(1));
        let verdicts = select(&format!("best = 3\nby = ['min_ade_m']\nlimits = {{ min_fde_m = {limit} }}"))
            .verdicts(&recorded, &samples);
        assert_eq!(verdicts.iter().map(Option::is_some).collect::<Vec<_>>(), [true, false, true, false]);
        assert_eq!(verdicts[0], Some(format!("min_fde_m beyond {limit}")));
    }

    #[test]
    fn nonsense_is_named() {
        for (toml, what) in [
            ("best = 0\nby = ['min_ade_m']", "best is 0"),
            ("best = 2", "needs metrics"),
            ("by = ['min_ade_m']", "how many"),
            ("", "neither limits nor best"),
            ("limits = { min_aed_m = 1.0 }", "no metric"),
            ("limits = { mfd_m = 1.0 }", "cannot select"),
        ] {
            let why = select(toml).validate().unwrap_err();
            assert!(why.contains(what), "{why}");
        }
        select("limits = { collision_rate = 0.0 }").validate().unwrap();
    }
}
