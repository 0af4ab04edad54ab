//! How likely is a recorded future among the sampled ones? The realism meta-metric of the Waymo Open Sim Agents
//! Challenge (Montali et al. 2023) in its configuration of 2025, on the horizon of the scene.
//!
//! For each agent, the values of a feature in all samples and at all future timesteps fill one histogram, whose bins
//! are smoothed by a pseudocount. The likelihood of a feature is exp(mean of ln p over the recorded values), over
//! agents that are recorded at present and later. Collisions and departures from the road count once for an agent. The
//! meta-metric is the mean of the likelihoods with the weights of `FEATURES`.
//!
//! As in the challenge, differences are central ones; a recorded difference counts only if its timesteps are in the
//! future, a sampled one always, and an undefined one at the end counts in the last bin. On a shorter horizon than the
//! challenge's 8 s this costs every future more of its likelihood, the recorded one, too.
//!
//! A reference such as the recording itself counts as copies of one sample. `scripts/golden_meta_metric.py` writes the
//! results of the challenge's own program.
//!
//! Deviations: maps do not have traffic lights, and some have no boundaries of lanes. The weights of such features are
//! distributed over the others. The road's edge follows from lanes (`road_edge`). All agents are judged. Differences of
//! headings are wrapped where the challenge compares raw ones.

mod estimators;
mod features;
mod road_edge;
#[cfg(test)]
mod tests;

use super::sample_group::{future, present_agents};
use super::{Direction, MetricSpec};
use crate::scene::{AgentClass, Scene};
use estimators::Bins;
use features::FutureFeatures;
use road_edge::RoadEdges;

/// A group of features, which the challenge reports by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FeatureGroup {
    Kinematic,
    Interactive,
    MapBased,
}

/// A feature of an agent whose distribution is compared.
struct Feature {
    id: &'static str,
    group: FeatureGroup,
    /// Its weight in the meta-metric; with the 0.05 of traffic lights the weights sum to 1.
    weight: f64,
    description: &'static str,
    bins: Bins,
    values: Values,
}

/// Which values a feature has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Values {
    /// Values of the series of this index at the timesteps that `Of` allows.
    Series(usize, Of),
    /// Whether the series of this index is ever below 0.
    EverBelow(usize),
    /// Whether it is ever above 0.
    EverAbove(usize),
}

/// The recorded values that count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Of {
    /// At timesteps at which the agent is recorded.
    States,
    /// At timesteps at which the vehicle is recorded.
    VehicleStates,
    /// Timesteps whose neighbors in time are recorded and in the future.
    FirstDifferences,
    /// Timesteps with valid first differences on either side.
    SecondDifferences,
}

/// A feature with a value at each timestep.
const fn series(
    (id, group, weight): (&'static str, FeatureGroup, f64),
    description: &'static str,
    (min, max, n_bins): (f64, f64, usize),
    values: Values,
) -> Feature {
    Feature { id, group, weight, description, bins: Bins { min, max, n_bins, pseudocount: 0.1 }, values }
}

/// A feature that an agent has or not.
const fn event(
    (id, group, weight): (&'static str, FeatureGroup, f64),
    description: &'static str,
    values: Values,
) -> Feature {
    Feature {
        id,
        group,
        weight,
        description,
        bins: Bins { min: -0.5, max: 1.5, n_bins: 2, pseudocount: 0.001 },
        values,
    }
}

/// Every feature. Meters, seconds and radians.
#[expect(clippy::approx_constant, reason = "a range of the challenge ends at 3.14, not at π")]
static FEATURES: [Feature; 9] = {
    use FeatureGroup::{Interactive, Kinematic, MapBased};
    use Of::{FirstDifferences, SecondDifferences, States, VehicleStates};
    use Values::{EverAbove, EverBelow, Series};
    [
        series(
            ("realism_linear_speed", Kinematic, 0.05),
            "likelihood of recorded speeds among sampled ones",
            (0.0, 25.0, 10),
            Series(0, FirstDifferences),
        ),
        series(
            ("realism_linear_acceleration", Kinematic, 0.05),
            "likelihood of recorded accelerations",
            (-12.0, 12.0, 11),
            Series(1, SecondDifferences),
        ),
        series(
            ("realism_angular_speed", Kinematic, 0.05),
            "likelihood of recorded yaw rates",
            (-0.628, 0.628, 11),
            Series(2, FirstDifferences),
        ),
        series(
            ("realism_angular_acceleration", Kinematic, 0.05),
            "likelihood of recorded yaw accelerations",
            (-3.14, 3.14, 11),
            Series(3, SecondDifferences),
        ),
        series(
            ("realism_distance_to_nearest_object", Interactive, 0.1),
            "likelihood of recorded distances between the rounded boxes of an agent and the nearest other",
            (-5.0, 40.0, 10),
            Series(4, States),
        ),
        event(
            ("realism_collision_indication", Interactive, 0.25),
            "likelihood of whether an agent's box touches another",
            EverBelow(4),
        ),
        series(
            ("realism_time_to_collision", Interactive, 0.1),
            "likelihood of recorded times until a vehicle is at the tail of whom it follows",
            (0.0, features::MAX_TTC_S, 10),
            Series(5, VehicleStates),
        ),
        series(
            ("realism_distance_to_road_edge", MapBased, 0.05),
            "likelihood of recorded distances to the edge of the road",
            (-20.0, 40.0, 10),
            Series(6, States),
        ),
        event(
            ("realism_offroad_indication", MapBased, 0.25),
            "likelihood of whether an agent leaves the road with a corner",
            EverAbove(6),
        ),
    ]
};

/// Weighted means of features, before the features in tables; the first is over all of them.
const MEANS: [(&str, Option<FeatureGroup>, &str); 4] = [
    (
        Likelihoods::META_METRIC,
        None,
        "how likely the recorded future is among the sampled ones: the realism meta-metric of the Waymo sim agents \
         challenge of 2025, without traffic lights",
    ),
    ("realism_kinematic", Some(FeatureGroup::Kinematic), "the part of it about the motion of single agents"),
    ("realism_interactive", Some(FeatureGroup::Interactive), "the part of it about distances and collisions"),
    ("realism_map_based", Some(FeatureGroup::MapBased), "the part of it about the road"),
];

/// The likelihood of the recorded future by each feature; `None` if undefined.
#[derive(Debug, Clone, PartialEq)]
pub struct Likelihoods([Option<f64>; FEATURES.len()]);

impl Likelihoods {
    /// The name of the meta-metric in tables.
    pub const META_METRIC: &str = "realism_meta_metric";

    /// The specifications of [`Likelihoods::values`]: the meta-metric, the means over groups of features, the features.
    pub fn specs() -> impl Iterator<Item = MetricSpec> {
        let means = MEANS.iter().map(|(id, _, description)| (*id, *description));
        let all = means.chain(FEATURES.iter().map(|feature| (feature.id, feature.description)));
        all.map(|(id, description)| MetricSpec::new(id, "1", Direction::HigherIsBetter, description))
    }

    /// The likelihood of the recorded future by the samples of each of `groups`, which are repeated as often as needed
    /// for `n_samples` of them. `has_road` is whether the map shows the whole road.
    pub fn of_groups<const N: usize>(
        recorded: &Scene,
        has_road: bool,
        groups: [&[Scene]; N],
        n_samples: usize,
    ) -> [Self; N] {
        let edges = has_road.then(|| RoadEdges::of(&recorded.lanes)).flatten();
        Self::with_edges(recorded, edges.as_ref(), groups, n_samples)
    }

    fn with_edges<const N: usize>(
        recorded: &Scene,
        edges: Option<&RoadEdges>,
        groups: [&[Scene]; N],
        n_samples: usize,
    ) -> [Self; N] {
        let present: Vec<usize> = present_agents(recorded).collect();
        let is_recorded = |agent_idx: usize, timestep: usize| recorded.state(agent_idx, timestep).is_some();
        let judged: Vec<usize> = present
            .iter()
            .copied()
            .filter(|idx| future(recorded).any(|timestep| is_recorded(*idx, timestep)))
            .collect();
        let of = |scene: &Scene| FutureFeatures::of(scene, &present, &judged, edges);
        let states = |idx: &usize| future(recorded).map(|timestep| is_recorded(*idx, timestep)).collect();
        let reference = Reference {
            features: of(recorded),
            states: judged.iter().map(states).collect(),
            classes: judged.iter().map(|idx| recorded.tracks[*idx].class).collect(),
        };
        groups.map(|scenes| {
            let once: Vec<FutureFeatures> = scenes.iter().map(of).collect();
            let samples: Vec<&FutureFeatures> = once.iter().cycle().take(n_samples).collect();
            Self(std::array::from_fn(|i| reference.likelihood(&FEATURES[i], &samples).filter(|_| !samples.is_empty())))
        })
    }

    /// The values, in the order of the specifications.
    pub fn values(&self) -> Vec<Option<f64>> {
        let means = MEANS.iter().map(|(_, group, _)| self.mean(*group));
        means.chain(self.0).collect()
    }

    /// The weighted mean over the features of a group, or over all.
    fn mean(&self, group: Option<FeatureGroup>) -> Option<f64> {
        let is_meant = |feature: &Feature| group.is_none_or(|group| feature.group == group);
        let meant = FEATURES.iter().zip(self.0).filter(|(feature, _)| is_meant(feature));
        let (sum, weight) = meant.fold((0.0, 0.0), |(sum, weight), (feature, value)| match value {
            Some(value) => (sum + feature.weight * value, weight + feature.weight),
            None => (sum, weight),
        });
        (weight > 0.0).then(|| sum / weight)
    }
}

/// The recorded future.
struct Reference {
    features: FutureFeatures,
    /// At which future timesteps each judged agent is recorded.
    states: Vec<Vec<bool>>,
    classes: Vec<AgentClass>,
}

impl Reference {
    /// The likelihood of the recorded values of a feature.
    fn likelihood(&self, feature: &Feature, samples: &[&FutureFeatures]) -> Option<f64> {
        let mut log_likelihoods: Vec<f64> = Vec::new();
        for (agent, states) in self.states.iter().enumerate() {
            match feature.values {
                Values::Series(series, of) => {
                    let own = self.features.of_agent(series, agent)?;
                    let sampled = samples.iter().filter_map(|sample| sample.of_agent(series, agent)).flatten();
                    let log_p = feature.bins.log_p(sampled.copied());
                    let counts = self.counts(of, agent);
                    log_likelihoods
                        .extend(own.iter().zip(counts).filter(|(_, counts)| *counts).map(|(value, _)| log_p(*value)));
                }
                Values::EverBelow(series) | Values::EverAbove(series) => {
                    let is_it = |value: f64| match feature.values {
                        Values::EverBelow(_) => value < 0.0,
                        _ => value > 0.0,
                    };
                    let ever = |features: &FutureFeatures| {
                        let values = features.of_agent(series, agent)?.iter().zip(states);
                        Some(f64::from(u8::from(values.into_iter().any(|(value, counts)| *counts && is_it(*value)))))
                    };
                    let own = ever(&self.features)?;
                    let log_p = feature.bins.log_p(samples.iter().filter_map(|sample| ever(sample)));
                    log_likelihoods.push(log_p(own));
                }
            }
        }
        let n = log_likelihoods.len() as f64;
        (n > 0.0).then(|| (log_likelihoods.iter().sum::<f64>() / n).exp())
    }

    /// Which recorded values of an agent count.
    fn counts(&self, of: Of, agent: usize) -> Vec<bool> {
        let states = &self.states[agent];
        let between = |of: &[bool]| -> Vec<bool> {
            let at = |i: usize| of.get(i).is_some_and(|counts| *counts);
            (0..of.len()).map(|i| i > 0 && at(i - 1) && at(i + 1)).collect()
        };
        match of {
            Of::States => states.clone(),
            Of::VehicleStates => states.iter().map(|counts| *counts && self.classes[agent].is_motorized()).collect(),
            Of::FirstDifferences => between(states),
            Of::SecondDifferences => between(&between(states)),
        }
    }
}
