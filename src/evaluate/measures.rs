//! The measures of each group of samples: the metrics, and how often the miner finds the behaviors.

use super::config::EvaluateConfig;
use crate::behavior::{Behavior, BehaviorEvent, EventLabel};
use crate::metrics::{Direction, Likelihoods, Metric, MetricSpec, ModeFit, Modes, ModesConfig, ModesOf, SampleGroup};
use crate::scene::{Roles, Scene};
use crate::seed::Seed;
use serde::{Deserialize, Serialize};

/// Share of samples that show the requested behavior in the requested roles.
pub(super) const BEHAVIOR_RATE: &str = "behavior_rate";

/// How to read a metric.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct MetricDoc {
    /// Its name in the tables.
    pub metric: String,
    /// Its unit; `1` for shares and counts.
    pub unit: String,
    /// Which way is better.
    pub direction: Direction,
    /// Its definition.
    pub description: String,
}

impl From<MetricSpec> for MetricDoc {
    fn from(spec: MetricSpec) -> Self {
        Self {
            metric: spec.id.to_owned(),
            unit: spec.unit.to_owned(),
            direction: spec.direction,
            description: spec.description.to_owned(),
        }
    }
}

/// Everything that is measured, in the order of tables.
pub(super) struct Measures<'a> {
    metrics: Vec<Box<dyn Metric>>,
    modes: Option<&'a ModesConfig>,
    behaviors: &'a [Box<dyn Behavior>],
    has_likelihoods: bool,
}

/// The requested behavior and its agents.
#[derive(Clone, Copy)]
pub(super) struct Requested<'a> {
    /// Its name.
    pub(super) behavior: &'a str,
    /// Roles and tracks.
    pub(super) roles: &'a Roles,
}

impl<'a> Measures<'a> {
    pub(super) fn new(config: &'a EvaluateConfig, behaviors: &'a [Box<dyn Behavior>]) -> Self {
        let chosen = |id: &str| config.metrics.is_empty() || config.metrics.iter().any(|name| name == id);
        let metrics = config.metric_settings().metrics();
        let metrics = metrics.into_iter().filter(|metric| chosen(metric.spec().id)).collect();
        Self { metrics, modes: config.modes.as_ref(), behaviors, has_likelihoods: chosen(Likelihoods::META_METRIC) }
    }

    /// The descriptions of the measures, for reading the tables: those of [`Measures::evaluate`], then those of
    /// [`Measures::likelihoods`].
    pub(super) fn docs(&self) -> Vec<MetricDoc> {
        let likelihoods = self.has_likelihoods.then(|| Likelihoods::specs().map(MetricDoc::from));
        let metrics = self.metrics.iter().map(|metric| MetricDoc::from(metric.spec()));
        let requested = rate(
            BEHAVIOR_RATE.to_owned(),
            "share of samples in which the miner finds the requested behavior with the requested agents".to_owned(),
        );
        let of_anybody = self.behaviors.iter().map(|behavior| {
            let id = behavior.id();
            rate(format!("{id}_rate"), format!("share of samples in which the miner finds {id}, between any agents"))
        });
        let of_samples = metrics.chain([requested]).chain(of_anybody).chain(self.docs_of_modes());
        of_samples.chain(likelihoods.into_iter().flatten()).collect()
    }

    /// The likelihoods of the recorded future by each of `groups`, which are repeated to `n_samples` of them. Without
    /// samples, or for less than two of them, nothing is defined.
    pub(super) fn likelihoods<const N: usize>(
        &self,
        recorded: &Scene,
        has_road: bool,
        groups: [&[Scene]; N],
        n_samples: usize,
    ) -> [Vec<Option<f64>>; N] {
        if !self.has_likelihoods {
            return std::array::from_fn(|_| Vec::new());
        }
        if n_samples < 2 {
            return std::array::from_fn(|_| Likelihoods::specs().map(|_| None).collect());
        }
        Likelihoods::of_groups(recorded, has_road, groups, n_samples).map(|found| found.values())
    }

    /// The values of a group, in the order of [`Measures::docs`]; `None` for undefined ones. Figures over modes need
    /// `mode_seed`, the seed of the reduction, and more samples than modes.
    pub(super) fn evaluate(
        &self,
        group: &SampleGroup<'_>,
        requested: Option<Requested<'_>>,
        mode_seed: Option<Seed>,
    ) -> Vec<Option<f64>> {
        let metrics = self.metrics.iter().map(|metric| metric.evaluate(group));
        let events: Vec<Vec<BehaviorEvent>> = group.samples.iter().map(|sample| self.positive_events(sample)).collect();
        let share = |holds: &dyn Fn(&[BehaviorEvent]) -> bool| {
            let n_holding = events.iter().filter(|events| holds(events)).count();
            let is_defined = !events.is_empty() && group.samples.iter().all(Scene::has_future);
            is_defined.then(|| n_holding as f64 / events.len() as f64)
        };
        let requested = requested.and_then(|Requested { behavior, roles }| {
            let is_asked = |event: &BehaviorEvent| roles.is_empty() || event.roles == *roles;
            share(&|events| events.iter().any(|event| event.behavior == behavior && is_asked(event)))
        });
        let of_anybody = self
            .behaviors
            .iter()
            .map(|behavior| share(&|events| events.iter().any(|event| event.behavior == behavior.id())));
        metrics.chain([requested]).chain(of_anybody).chain(self.over_modes(group, mode_seed)).collect()
    }

    /// The metrics that are also taken over modes.
    fn of_modes(&self) -> impl Iterator<Item = (&dyn Metric, ModesOf)> + '_ {
        self.metrics.iter().filter_map(|metric| Some((metric.as_ref(), metric.modes()?)))
    }

    fn docs_of_modes(&self) -> Vec<MetricDoc> {
        let Some(ModesConfig { n_modes, by, .. }) = self.modes else { return Vec::new() };
        let docs = by.iter().flat_map(|by| {
            self.of_modes().map(|(metric, of)| {
                let doc = MetricDoc::from(metric.spec());
                let whose = match of {
                    ModesOf::Ego => "the ego's futures",
                    ModesOf::Scene => "the joint futures of all agents",
                };
                let description = format!("{} over {n_modes} modes of {whose} in place of the samples", doc.metric);
                MetricDoc { metric: format!("{}{}", by.prefix(*n_modes), doc.metric), description, ..doc }
            })
        });
        docs.collect()
    }

    /// The figures over modes, in the order of their docs.
    fn over_modes(&self, group: &SampleGroup<'_>, seed: Option<Seed>) -> Vec<Option<f64>> {
        let Some(config) = self.modes else { return Vec::new() };
        let seed = seed.filter(|_| group.samples.len() > config.n_modes);
        let fit = |of: ModesOf| {
            let is_wanted = self.of_modes().any(|(_, wanted)| wanted == of);
            ModeFit::new(group.samples, &of.agents(group.recorded), config, seed.filter(|_| is_wanted)?)
        };
        let fits = [(ModesOf::Ego, fit(ModesOf::Ego)), (ModesOf::Scene, fit(ModesOf::Scene))];
        let mut values = Vec::new();
        for by in &config.by {
            let modes: Vec<(ModesOf, Option<Modes>)> =
                fits.iter().map(|(of, fit)| (*of, fit.as_ref().map(|fit| fit.modes(*by)))).collect();
            for (metric, of) in self.of_modes() {
                let modes = modes.iter().find(|(found, _)| *found == of).and_then(|(_, modes)| modes.as_ref());
                values.push(modes.and_then(|Modes { samples, probabilities }| {
                    metric.evaluate(&SampleGroup {
                        recorded: group.recorded,
                        samples,
                        probabilities: Some(probabilities),
                        ..*group
                    })
                }));
            }
        }
        values
    }

    fn positive_events(&self, scene: &Scene) -> Vec<BehaviorEvent> {
        let found = self.behaviors.iter().flat_map(|behavior| behavior.detect(scene));
        found.filter(|event| event.label == EventLabel::Positive).collect()
    }
}

fn rate(metric: String, description: String) -> MetricDoc {
    MetricDoc { metric, unit: "1".to_owned(), direction: Direction::Neither, description }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{self, Drive};

    fn scene(offset_m: f64) -> Scene {
        let mut scene = testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(0.0, 9.0, 0.0, 10.0)]);
        let history = scene.tracks[0].trajectory.entries()[..scene.n_history].to_vec();
        let moved = testing::scene(&[Drive::straight(0.0, offset_m, 0.0, 10.0)]).tracks.remove(0).trajectory;
        let states = history.into_iter().chain(moved.entries()[scene.n_history..].iter().copied());
        scene.tracks[0].trajectory = crate::scene::Trajectory::new(states.collect());
        scene
    }

    /// Finds a cut-in of track 2 ahead of track 1 in every scene.
    struct Always;

    impl Behavior for Always {
        fn id(&self) -> &'static str {
            "cut_in"
        }

        fn roles(&self) -> &'static [&'static str] {
            &["ego", "other"]
        }

        fn detect(&self, scene: &Scene) -> Vec<BehaviorEvent> {
            vec![BehaviorEvent::new(("cut_in", self.roles()), scene, EventLabel::Positive, &[0, 1], 5..=6)]
        }
    }

    #[test]
    fn the_behavior_counts_with_those_who_were_asked() {
        let config: EvaluateConfig = toml::from_str("metrics = ['min_fde_m']").expect("readable");
        let behaviors: [Box<dyn Behavior>; 1] = [Box::new(Always)];
        let measures = Measures::new(&config, &behaviors);
        let (recorded, samples) = (scene(0.0), [scene(1.0)]);
        let roles = |ego: &str, other: &str| Roles::from([("ego", ego), ("other", other)]);
        let rates = |roles: &Roles| {
            let asked = Some(Requested { behavior: "cut_in", roles });
            measures.evaluate(&SampleGroup::equally_likely(&recorded, &samples), asked, None)[1..3].to_vec()
        };
        assert_eq!(rates(&roles("1", "2")), [Some(1.0), Some(1.0)]);
        assert_eq!(rates(&roles("2", "1")), [Some(0.0), Some(1.0)]);
        assert_eq!(rates(Roles::none()), [Some(1.0), Some(1.0)]);
    }

    /// Four samples around 3 m and two around -1 m; the recording is at 0.
    #[test]
    fn figures_over_modes_stand_beside_those_over_samples() {
        let samples = [2.9, 3.0, 3.0, 3.1, -0.9, -1.1].map(scene);
        let config: EvaluateConfig = toml::from_str(
            r#"metrics = ["min_fde_m", "brier_min_fde_m", "min_scene_fde_m", "mfd_m"]
            modes = { n_modes = 2, by = ["mean", "medoid"] }"#,
        )
        .expect("readable");
        let measures = Measures::new(&config, &[]);
        let recorded = scene(0.0);
        let group = SampleGroup::equally_likely(&recorded, &samples);
        let of = |seed: Option<Seed>| -> Vec<(String, Option<f64>)> {
            let values = measures.evaluate(&group, None, seed);
            let docs = measures.docs();
            assert_eq!(docs.len(), values.len());
            docs.into_iter().map(|doc| doc.metric).zip(values).collect()
        };
        let found = of(Some(Seed(1)));
        let near = |id: &str, expected: f64| {
            let value = found.iter().find(|(metric, _)| metric == id).and_then(|(_, value)| *value);
            assert!(value.is_some_and(|value| (value - expected).abs() < 1e-6), "{id}: {value:?}");
        };
        near("min_fde_m", 0.9);
        near("modes2_min_fde_m", 1.0);
        // A third of the samples is in that mode: 1 + (2/3)².
        near("modes2_brier_min_fde_m", 1.0 + 4.0 / 9.0);
        near("brier_min_fde_m", 0.9 + 25.0 / 36.0);
        // The other agent goes as recorded in all samples, so half of the ego's.
        near("modes2_min_scene_fde_m", 0.5);
        near("medoids2_min_fde_m", 0.9);
        assert!(!found.iter().any(|(metric, _)| metric.ends_with("2_mfd_m")), "variety is not for modes");
        assert!(
            of(None).iter().all(|(metric, value)| value.is_none() == metric.contains("s2_") || metric == BEHAVIOR_RATE)
        );
        let few = SampleGroup::equally_likely(&recorded, &samples[..2]);
        let values = measures.evaluate(&few, None, Some(Seed(1)));
        assert!(values[5..].iter().all(Option::is_none), "no more samples than modes: {values:?}");
    }
}
