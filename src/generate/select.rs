//! Which samples become scenarios? The best of those within limits of metrics and objectives.

use super::Limit;
use crate::metrics::{ALL, Direction, MetricSettings, SampleGroup, by_id};
use crate::scene::{Roles, Scene};
use crate::settings::{Issue, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Which samples of a scene at one strength to keep as scenarios.
///
/// Samples are judged by metrics of the evaluation, each sample on its own, or by the sweep's objectives: by one kind
/// under its name, such as `no_collision` (the sum if there are several), or by the sum of all, `objectives`. The value
/// of an objective is its weight times its log potential: at most 0, and higher is better.
///
/// A metric that compares with the recording, such as `min_scene_ade_m`, makes the corpus repeat the recordings.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SelectConfig {
    /// Limits by metric or objective. `{ collision_rate = 0.0 }` keeps samples without a collision,
    /// `{ pair_min_ttc_s = [0.5, 2.0] }` those that come this close to one,
    /// `{ pair_min_distance_m = { at_least = 1.0 } }` those that stay this far apart.
    #[serde(default)]
    pub limits: BTreeMap<String, Limit>,
    /// How many of the samples within the limits to keep, best first. Left out: all.
    #[serde(default)]
    #[schemars(range(min = 1, max = 100_000))]
    pub best: Option<usize>,
    /// The metrics and objectives that rank samples: the first decides, each further one breaks ties, and finally the
    /// order of sampling.
    #[serde(default)]
    pub by: Vec<String>,
}

/// The name of the sum of all objectives in selections.
const ALL_OBJECTIVES: &str = "objectives";
/// The prefix of metrics that look at the requested pair.
const PAIR_PREFIX: &str = "pair_";

/// A sample that may become a scenario.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate<'a> {
    /// The generated scene.
    pub(super) scene: &'a Scene,
    /// The value of each objective of the sweep, with its kind.
    pub(super) objectives: &'a [(&'static str, f64)],
    /// The requested agents.
    pub(super) asked: &'a Roles,
    /// Whether the requested event is a collision.
    pub(super) asked_to_collide: bool,
}

impl Candidate<'_> {
    /// The value of a metric or objective; `None` if it is undefined for the sample.
    fn value(&self, id: &str, recorded: &Scene, settings: &MetricSettings) -> Option<f64> {
        if let Some(metric) = settings.by_id(id) {
            let alone = SampleGroup::equally_likely(recorded, std::slice::from_ref(self.scene));
            let Self { asked, asked_to_collide, .. } = *self;
            return metric.evaluate(&SampleGroup { asked, asked_to_collide, ..alone });
        }
        let named = self.objectives.iter().filter(|(kind, _)| id == ALL_OBJECTIVES || id == *kind);
        Some(named.map(|(_, value)| value).sum())
    }

    /// The value with its sign such that lower is better; undefined values are the worst.
    fn cost(&self, id: &str, recorded: &Scene, settings: &MetricSettings) -> f64 {
        let sign = if direction(id) == Direction::HigherIsBetter { -1.0 } else { 1.0 };
        self.value(id, recorded, settings).map_or(f64::INFINITY, |value| sign * value)
    }
}

impl SelectConfig {
    /// Whether samples are judged by objectives of the sweep.
    pub(super) fn names_objectives(&self) -> bool {
        self.ids().any(|id| by_id(id).is_none())
    }

    /// Whether it judges by metrics for which `is_such` holds.
    pub(super) fn names_metric(&self, is_such: impl Fn(&str) -> bool) -> bool {
        self.ids().any(|id| is_such(id))
    }

    fn ids(&self) -> impl Iterator<Item = &String> {
        self.limits.keys().chain(&self.by)
    }

    /// Rejects metrics and objectives that cannot judge samples of a sweep with objectives of these kinds. `asks_pairs`
    /// is whether the sweep requests a pair, as metrics of pairs need.
    pub(super) fn validate(&self, objectives: &[&str], asks_pairs: bool) -> Result {
        let of_limits = self.limits.keys().map(|id| (format!("limits.{id}"), id));
        for (key, id) in of_limits.chain(self.by.iter().enumerate().map(|(i, id)| (format!("by.{i}"), id))) {
            if !objectives.is_empty() && (id == ALL_OBJECTIVES || objectives.contains(&id.as_str())) {
                continue;
            }
            if by_id(id).is_none() {
                let known: Vec<&str> = ALL.iter().map(|metric| metric.spec().id).collect();
                let own = match objectives.is_empty() {
                    true => "the sweep has no objectives".to_owned(),
                    false => format!("objectives here: {ALL_OBJECTIVES}, {}", objectives.join(", ")),
                };
                return Err(Issue::new(
                    key,
                    format_args!("is not a metric ({id}); known here: {}; {own}", known.join(", ")),
                ));
            }
            if id.starts_with(PAIR_PREFIX) && !asks_pairs {
                return Err(Issue::new(
                    key,
                    format_args!(
                        "({id}) needs a requested pair, which this sweep does not have; request a behavior of two \
                         agents, such as behavior = \"cut_in\", or use a metric of the whole scene"
                    ),
                ));
            }
        }
        if let Some((i, id)) = self.by.iter().enumerate().find(|(_, id)| direction(id) == Direction::Neither) {
            return Err(Issue::new(
                format!("by.{i}"),
                format_args!(
                    "is {id}, which cannot rank, because neither more nor less of it is better; limits can, as in \
                     {{ {id} = {{ at_most = 2.0 }} }}"
                ),
            ));
        }
        for (id, limit) in &self.limits {
            let has_direction = direction(id) != Direction::Neither;
            limit.validate(&format!("limits.{id}"), has_direction)?;
        }
        match (self.best, self.by.is_empty()) {
            (Some(n), true) => Err(Issue::new(
                "best",
                format_args!("is {n}, but needs metrics or objectives to compare by, such as by = [\"offroad_rate\"]"),
            )),
            (None, false) => Err(Issue::new("by", "has no effect without best, the number of samples to keep")),
            (None, true) if self.limits.is_empty() => {
                Err(Issue::new("best", "is missing, and so is limits; set one of them"))
            }
            _ => Ok(()),
        }
    }

    /// For each sample of one recorded scene, why it is left out; `None` if it is kept. Metrics use `settings`. A
    /// sample for which a metric is undefined ranks last; [`Limit`] defines what that means for limits.
    pub(super) fn verdicts(
        &self,
        recorded: &Scene,
        samples: &[Candidate<'_>],
        settings: &MetricSettings,
    ) -> Vec<Option<String>> {
        let mut verdicts: Vec<Option<String>> = samples
            .iter()
            .map(|sample| {
                self.limits.iter().find_map(|(id, limit)| {
                    let higher_is_better = direction(id) == Direction::HigherIsBetter;
                    limit
                        .broken_by(sample.value(id, recorded, settings), higher_is_better)
                        .map(|why| format!("{id} {why}"))
                })
            })
            .collect();
        let Some(best) = self.best else { return verdicts };
        let mut ranked: Vec<(Vec<f64>, usize)> = (0..samples.len())
            .filter(|i| verdicts[*i].is_none())
            .map(|i| (self.by.iter().map(|id| samples[i].cost(id, recorded, settings)).collect(), i))
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

/// Whether higher values of a metric are better; they are for objectives.
fn direction(id: &str) -> Direction {
    by_id(id).map_or(Direction::HigherIsBetter, |metric| metric.spec().direction)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::{Check, ValidityConfig};
    use crate::scene::testing::{Drive, scene};

    /// A car that drives on at 10 m/s, and futures of it at other speeds; ADE and FDE grow with the difference.
    fn samples() -> (Scene, Vec<Scene>) {
        let at = |speed_mps: f64| scene(&[Drive::straight(0.0, 0.0, 0.0, speed_mps)]);
        (at(10.0), [12.0, 10.5, 7.0, 10.5].map(at).to_vec())
    }

    fn candidates(samples: &[Scene]) -> Vec<Candidate<'_>> {
        samples
            .iter()
            .map(|scene| Candidate { scene, objectives: &[], asked: Roles::none(), asked_to_collide: false })
            .collect()
    }

    fn select(toml: &str) -> SelectConfig {
        toml::from_str(toml).unwrap()
    }

    #[test]
    fn the_best_are_kept_and_the_first_of_equals() {
        let (recorded, samples) = samples();
        let samples = candidates(&samples);
        let verdicts = select("best = 1\nby = ['min_fde_m']").verdicts(&recorded, &samples, &MetricSettings::default());
        let kept: Vec<usize> = (0..4).filter(|i| verdicts[*i].is_none()).collect();
        assert_eq!(kept, [1]);
        assert_eq!(verdicts[3].as_deref(), Some("not among the best 1"));
        let verdicts = select("best = 3\nby = ['collision_rate', 'min_ade_m']").verdicts(
            &recorded,
            &samples,
            &MetricSettings::default(),
        );
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
        let verdicts = select(&format!("best = 3\nby = ['min_ade_m']\nlimits = {{ min_fde_m = {limit} }}")).verdicts(
            &recorded,
            &candidates(&samples),
            &MetricSettings::default(),
        );
        assert_eq!(verdicts.iter().map(Option::is_some).collect::<Vec<_>>(), [true, false, true, false]);
        assert_eq!(verdicts[0], Some(format!("min_fde_m beyond {limit}")));
    }

    #[test]
    fn ranges_choose_how_critical_the_pair_is() {
        // Cars of 4.5 m, ten meters apart from center to center, so 5.5 m from bumper to bumper at present. The one
        // behind drives at 10 m/s, the other at 6, 8 and 10 m/s for the 0.8 s of the future: the gap ends at 5.5 - 0.8
        // Δv, with TTC = gap / Δv of 0.575 s, 1.95 s, and none for the third.
        let at = |speed_mps: f64| {
            scene(&[
                Drive::straight(0.0, 0.0, 0.0, 10.0),
                Drive::straight(10.0 - 0.3 * (speed_mps - 10.0), 0.0, 0.0, speed_mps),
            ])
        };
        let scenes = [6.0, 8.0, 10.0].map(at);
        let asked = Roles::from([("ego", "1"), ("other", "2")]);
        let recorded = at(10.0);
        let samples: Vec<Candidate<'_>> = scenes
            .iter()
            .map(|scene| Candidate { scene, objectives: &[], asked: &asked, asked_to_collide: false })
            .collect();
        let kept = |limits: &str| -> Vec<usize> {
            let verdicts =
                select(&format!("limits = {{ {limits} }}")).verdicts(&recorded, &samples, &MetricSettings::default());
            (0..3).filter(|i| verdicts[*i].is_none()).collect()
        };
        assert_eq!(kept("pair_min_ttc_s = { at_most = 2 }"), [0, 1], "the third never collides");
        assert_eq!(kept("pair_min_ttc_s = { at_least = 1 }"), [1, 2]);
        assert_eq!(kept("pair_min_ttc_s = [1, 2]"), [1]);
        assert_eq!(kept("pair_min_distance_m = [3.5, 5.5001]"), [1, 2]);
        assert_eq!(kept("pair_min_distance_m = { at_most = 4 }, scene_max_drac_mps2 = { at_least = 1 }"), [0]);
    }

    #[test]
    fn validity_is_judged_by_the_limits_that_are_set() {
        // Two cars in a row, the second one stopping at once or in time: the first passes through it.
        let at = |speed_mps: f64| {
            scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(10.0 - 0.3 * speed_mps, 0.0, 0.0, speed_mps)])
        };
        let scenes = [0.0, 10.0].map(at);
        let kept = |skip: &[Check]| -> Vec<usize> {
            let validity = ValidityConfig { skip: skip.to_vec(), ..ValidityConfig::default() };
            let settings = MetricSettings { validity };
            let verdicts =
                select("limits = { validity_rate = 1.0 }").verdicts(&at(10.0), &candidates(&scenes), &settings);
            (0..2).filter(|i| verdicts[*i].is_none()).collect()
        };
        assert_eq!(kept(&[]), [1]);
        assert_eq!(kept(&[Check::Collision]), [0, 1]);
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
        let samples: Vec<Candidate<'_>> = scenes
            .iter()
            .zip(values)
            .map(|(scene, objectives)| Candidate { scene, objectives, asked: Roles::none(), asked_to_collide: false })
            .collect();
        let kept = |toml: &str| -> Vec<usize> {
            let verdicts = select(toml).verdicts(&recorded, &samples, &MetricSettings::default());
            (0..4).filter(|i| verdicts[*i].is_none()).collect()
        };
        assert_eq!(kept("best = 2\nby = ['objectives']"), [1, 3], "sums -4, -1.5, -9, -2.4");
        assert_eq!(kept("best = 1\nby = ['goal']"), [2]);
        assert_eq!(kept("limits = { no_collision = -2.0 }"), [0, 1, 3]);
        assert_eq!(kept("limits = { goal = -1.0 }\nbest = 1\nby = ['no_collision']"), [1]);
    }

    #[test]
    fn objectives_of_the_sweep_may_limit_and_rank() {
        let by_wish = select("best = 1\nby = ['objectives']\nlimits = { goal = -1.0 }");
        by_wish.validate(&["goal"], false).unwrap();
        assert!(by_wish.names_objectives());
        select("limits = { collision_rate = 0.0, mfd_m = [0, 9] }").validate(&[], true).unwrap();
    }
}
