//! The measures of each group of samples: the metrics, and how often the miner finds the behaviors.

use crate::behavior::{Behavior, BehaviorEvent, EventLabel};
use crate::metrics::{
    Direction, Likelihoods, Metric, MetricSettings, MetricSpec, ModeFit, Modes, ModesOf, SampleGroup,
};
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

/// All measures, in the order of tables.
pub(super) struct Measures<'a> {
    metrics: Vec<Box<dyn Metric>>,
    modes: Option<usize>,
    behaviors: &'a [Box<dyn Behavior>],
}

/// The requested behavior and its agents.
#[derive(Clone, Copy)]
pub(super) struct Requested<'a> {
    pub(super) behavior: &'a str,
    pub(super) roles: &'a Roles,
}

impl<'a> Measures<'a> {
    /// The measures by these settings, with this number of modes if there are any.
    pub(super) fn new(settings: &MetricSettings, modes: Option<usize>, behaviors: &'a [Box<dyn Behavior>]) -> Self {
        Self { metrics: settings.metrics(), modes, behaviors }
    }

    /// The descriptions of the measures, for reading the tables: those of [`Measures::evaluate`], then those of
    /// [`Measures::likelihoods`].
    pub(super) fn docs(&self) -> Vec<MetricDoc> {
        let metrics = self.metrics.iter().map(|metric| MetricDoc::from(metric.spec()));
        let requested = rate(
            BEHAVIOR_RATE.to_owned(),
            "share of samples in which the miner finds the requested behavior with the requested agents".to_owned(),
        );
        let of_anybody = self.behaviors.iter().map(|behavior| {
            let id = behavior.id();
            let name = format!("{id}_rate");
            let is_taken = self.metrics.iter().any(|metric| metric.spec().id == name);
            let name = if is_taken { format!("mined_{name}") } else { name };
            rate(name, format!("share of samples in which the miner finds {id}, between any agents"))
        });
        let of_samples = metrics.chain([requested]).chain(of_anybody).chain(self.docs_of_modes());
        of_samples.chain(Likelihoods::specs().map(MetricDoc::from)).collect()
    }

    /// The likelihoods of the recorded future under each of `groups`, which are repeated to `n_samples` of them.
    /// Without samples, or for less than two of them, nothing is defined.
    pub(super) fn likelihoods<const N: usize>(
        &self,
        recorded: &Scene,
        has_road: bool,
        groups: [&[Scene]; N],
        n_samples: usize,
    ) -> [Vec<Option<f64>>; N] {
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
        self.metrics.iter().filter_map(|metric| Some((metric.as_ref(), metric.spec().modes?)))
    }

    fn docs_of_modes(&self) -> Vec<MetricDoc> {
        let Some(n_modes) = self.modes else { return Vec::new() };
        let docs = self.of_modes().map(|(metric, of)| {
            let doc = MetricDoc::from(metric.spec());
            let whose = match of {
                ModesOf::Ego => "the ego's futures",
                ModesOf::Scene => "the joint futures of all agents",
            };
            let description = format!("{} over {n_modes} modes of {whose} in place of the samples", doc.metric);
            MetricDoc { metric: format!("modes{n_modes}_{}", doc.metric), description, ..doc }
        });
        docs.collect()
    }

    /// The figures over modes, in the order of their docs.
    fn over_modes(&self, group: &SampleGroup<'_>, seed: Option<Seed>) -> Vec<Option<f64>> {
        let Some(n_modes) = self.modes else { return Vec::new() };
        let seed = seed.filter(|_| group.samples.len() > n_modes);
        let modes =
            |of: ModesOf| Some(ModeFit::new(group.samples, &of.agents(group.recorded), n_modes, seed?)?.modes());
        let [ego, scene] = [ModesOf::Ego, ModesOf::Scene].map(modes);
        let value = |(metric, of): (&dyn Metric, ModesOf)| {
            let Modes { samples, probabilities } = match of {
                ModesOf::Ego => ego.as_ref(),
                ModesOf::Scene => scene.as_ref(),
            }?;
            metric.evaluate(&SampleGroup {
                recorded: group.recorded,
                samples,
                whole: None,
                probabilities: Some(probabilities),
                ..*group
            })
        };
        self.of_modes().map(value).collect()
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
    use crate::behavior::BehaviorConfig;
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
    fn no_two_measures_have_one_name() {
        let behaviors = ["cut_in", "collision"].map(|id| BehaviorConfig::from_id(id).unwrap().build());
        let mut known = std::collections::BTreeSet::new();
        let docs = Measures::new(&MetricSettings::default(), None, &behaviors).docs();
        assert!(docs.iter().all(|doc| known.insert(doc.metric.as_str())));
        assert!(["cut_in_rate", "collision_rate", "mined_collision_rate"].iter().all(|name| known.contains(name)));
    }

    #[test]
    fn the_behavior_counts_with_those_who_were_asked() {
        let behaviors: [Box<dyn Behavior>; 1] = [Box::new(Always)];
        let measures = Measures::new(&MetricSettings::default(), None, &behaviors);
        let (recorded, samples) = (scene(0.0), [scene(1.0)]);
        let roles = |ego: &str, other: &str| Roles::from([("ego", ego), ("other", other)]);
        let rates = |roles: &Roles| {
            let asked = Some(Requested { behavior: "cut_in", roles });
            let values = measures.evaluate(&SampleGroup::equally_likely(&recorded, &samples), asked, None);
            values[values.len() - 2..].to_vec()
        };
        assert_eq!(rates(&roles("1", "2")), [Some(1.0), Some(1.0)]);
        assert_eq!(rates(&roles("2", "1")), [Some(0.0), Some(1.0)]);
        assert_eq!(rates(Roles::none()), [Some(1.0), Some(1.0)]);
    }

    /// Four samples around 3 m and two around -1 m; the recording is at 0.
    #[test]
    fn figures_over_modes_stand_beside_those_over_samples() {
        let samples = [2.9, 3.0, 3.0, 3.1, -0.9, -1.1].map(scene);
        let measures = Measures::new(&MetricSettings::default(), Some(2), &[]);
        let recorded = scene(0.0);
        let group = SampleGroup::equally_likely(&recorded, &samples);
        let of = |seed: Option<Seed>| -> Vec<(String, Option<f64>)> {
            let values = measures.evaluate(&group, None, seed);
            let docs = measures.docs();
            assert_eq!(docs.len(), values.len() + Likelihoods::specs().count());
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
        // The other agent goes as recorded in all samples, so the figure is half of the ego's.
        near("modes2_min_scene_fde_m", 0.5);
        assert!(!found.iter().any(|(metric, _)| metric.ends_with("2_mfd_m")), "variety is not for modes");
        let are_undefined = |values: &[Option<f64>]| {
            let of_modes = measures.docs().into_iter().zip(values).filter(|(doc, _)| doc.metric.starts_with("modes2_"));
            of_modes.map(|(_, value)| value.is_none()).reduce(|a, b| a && b)
        };
        assert_eq!(are_undefined(&measures.evaluate(&group, None, None)), Some(true), "without a seed");
        let few = SampleGroup::equally_likely(&recorded, &samples[..2]);
        let values = measures.evaluate(&few, None, Some(Seed(1)));
        assert_eq!(are_undefined(&values), Some(true), "no more samples than modes: {values:?}");
    }
}
