//! Which samples become scenarios? Rejection by limits of metrics and objectives, and the best of many.

use crate::metrics::{ALL, Direction, SampleGroup, by_id};
use crate::scene::{Scene, TrackId};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Which samples of a scene at one strength become scenarios.
///
/// Samples are judged by metrics of the evaluation, each sample on its own, or by the sweep's objectives: by one of them,
/// under the name of its kind such as `no_collision` (of several of a kind the sum), or by the sum of all, `objectives`. The
/// value of an objective is its weight times its log potential, so at most 0, and more is better.
///
/// A metric that looks at the recording, such as `min_scene_ade_m`, makes the corpus repeat what was recorded.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SelectConfig {
    /// Limits by metric or objective: samples above them are left out, or below where more is better.
    /// `{ collision_rate = 0.0 }` keeps what has no collision.
    #[serde(default)]
    pub limits: BTreeMap<String, f64>,
    /// How many are kept of those within the limits: the best. Left out: all.
    #[serde(default)]
    pub best: Option<usize>,
    /// The metrics and objectives by which samples are better: the first decides, each further one among equals, and at last
    /// the order of sampling.
    #[serde(default)]
    pub by: Vec<String>,
}

/// The sum of all objectives, as selections name it.
const ALL_OBJECTIVES: &str = "objectives";

/// A sample that may become a scenario.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate<'a> {
    /// The generated scene.
    pub(super) scene: &'a Scene,
    /// The value of each objective of the sweep, with its kind.
    pub(super) objectives: &'a [(&'static str, f64)],
    /// Who was asked to show something, as (role, track).
    pub(super) asked: &'a [(String, TrackId)],
}

impl Candidate<'_> {
    /// The value of what a selection names, of which less is better; `None` where it is not defined for the sample.
    fn cost(&self, id: &str, recorded: &Scene) -> Option<f64> {
        if let Some(metric) = by_id(id) {
            let alone = SampleGroup::equally_likely(recorded, std::slice::from_ref(self.scene));
            let group = SampleGroup { asked: self.asked, ..alone };
            return metric.evaluate(&group).map(|value| as_cost(id, value));
        }
        let named = self.objectives.iter().filter(|(kind, _)| id == ALL_OBJECTIVES || id == *kind);
        Some(as_cost(id, named.map(|(_, value)| value).sum()))
    }
}

impl SelectConfig {
    /// Whether samples are judged by objectives of the sweep.
    pub(super) fn names_objectives(&self) -> bool {
        self.ids().any(|id| by_id(id).is_none())
    }

    fn ids(&self) -> impl Iterator<Item = &String> {
        self.limits.keys().chain(&self.by)
    }

    /// Says what makes no sense for a sweep with objectives of these kinds.
    ///
    /// # Errors
    /// When something does not.
    pub(super) fn validate(&self, objectives: &[&str]) -> Result<(), String> {
        for id in self.ids() {
            if !objectives.is_empty() && (id == ALL_OBJECTIVES || objectives.contains(&id.as_str())) {
                continue;
            }
            let Some(metric) = by_id(id) else {
                let known: Vec<&str> = ALL.iter().map(|metric| metric.spec().id).collect();
                let own = match objectives.is_empty() {
                    true => "the sweep has no objectives".to_owned(),
                    false => format!("objectives here: {ALL_OBJECTIVES}, {}", objectives.join(", ")),
                };
                return Err(format!("{id:?} is no metric; known here: {}; {own}", known.join(", ")));
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
            (Some(_), true) => {
                Err("best needs metrics or objectives to compare by, such as by = [\"offroad_rate\"]".to_owned())
            }
            (None, false) => Err("by compares samples for nothing: say how many are kept (best)".to_owned()),
            (None, true) if self.limits.is_empty() => Err("neither limits nor best are given".to_owned()),
            _ => Ok(()),
        }
    }

    /// For each sample of one recorded scene why it is left out; `None` where it is kept. A metric that is not defined for a
    /// sample is no limit to it, and makes it the worst.
    pub(super) fn verdicts(&self, recorded: &Scene, samples: &[Candidate<'_>]) -> Vec<Option<String>> {
        let mut verdicts: Vec<Option<String>> = samples
            .iter()
            .map(|sample| {
                self.limits.iter().find_map(|(id, limit)| {
                    let is_beyond = sample.cost(id, recorded)? > as_cost(id, *limit);
                    is_beyond.then(|| format!("{id} beyond {limit}"))
                })
            })
            .collect();
        let Some(best) = self.best else { return verdicts };
        let mut ranked: Vec<(Vec<f64>, usize)> = (0..samples.len())
            .filter(|i| verdicts[*i].is_none())
            .map(|i| (self.by.iter().map(|id| samples[i].cost(id, recorded).unwrap_or(f64::INFINITY)).collect(), i))
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

/// A value of which less is better, of a metric or else of an objective.
fn as_cost(id: &str, value: f64) -> f64 {
    match by_id(id).map(|metric| metric.spec().direction) {
        None | Some(Direction::HigherIsBetter) => -value,
        Some(Direction::LowerIsBetter | Direction::Neither) => value,
    }
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

    fn candidates(samples: &[Scene]) -> Vec<Candidate<'_>> {
        samples.iter().map(|scene| Candidate { scene, objectives: &[], asked: &[] }).collect()
    }

    fn select(toml: &str) -> SelectConfig {
        toml::from_str(toml).unwrap()
    }

    #[test]
    fn the_best_are_kept_and_the_first_of_equals() {
        let (recorded, samples) = samples();
        let samples = candidates(&samples);
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
            .verdicts(&recorded, &candidates(&samples));
        assert_eq!(verdicts.iter().map(Option::is_some).collect::<Vec<_>>(), [true, false, true, false]);
        assert_eq!(verdicts[0], Some(format!("min_fde_m beyond {limit}")));
    }

    #[test]
    fn objectives_select_by_their_sum_or_one_kind() {
        let (recorded, scenes) = samples();
        let values: [&[(&str, f64)]; 4] = [
            &[("goal", -3.0), ("no_collision", 0.0), ("goal", -1.0)],
            &[("goal", -1.0), ("no_collision", -0.5), ("goal", 0.0)],
            &[("goal", 0.0), ("no_collision", -9.0), ("goal", 0.0)],
            &[("goal", -0.2), ("no_collision", -2.0), ("goal", -0.2)],
        ];
        let samples: Vec<Candidate<'_>> =
            scenes.iter().zip(values).map(|(scene, objectives)| Candidate { scene, objectives, asked: &[] }).collect();
        let kept = |toml: &str| -> Vec<usize> {
            let verdicts = select(toml).verdicts(&recorded, &samples);
            (0..4).filter(|i| verdicts[*i].is_none()).collect()
        };
        assert_eq!(kept("best = 2\nby = ['objectives']"), [1, 3], "sums -4, -1.5, -9, -2.4");
        assert_eq!(kept("best = 1\nby = ['goal']"), [2]);
        assert_eq!(kept("limits = { no_collision = -2.0 }"), [0, 1, 3]);
        assert_eq!(kept("limits = { goal = -1.0 }\nbest = 1\nby = ['no_collision']"), [1]);
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
            let why = select(toml).validate(&[]).unwrap_err();
            assert!(why.contains(what), "{why}");
        }
        select("limits = { collision_rate = 0.0 }").validate(&[]).unwrap();
        let by_wish = select("best = 1\nby = ['objectives']\nlimits = { goal = -1.0 }");
        by_wish.validate(&["goal"]).unwrap();
        assert!(by_wish.names_objectives());
        assert!(by_wish.validate(&["stay_on_road"]).unwrap_err().contains("objectives here: objectives, stay_on_road"));
        assert!(by_wish.validate(&[]).unwrap_err().contains("no objectives"));
    }
}
