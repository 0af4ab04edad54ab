//! Metrics of sampled futures, in plain `f64`: how close to the recording, how diverse, how plausible?
//!
//! One metric a file. A new one needs its file and an entry in [`ALL`].
//!
//! Metrics never share code with guidance: the code that guides a sample must not judge it.
//!
//! Common to all: the future is every timestep from `n_history` on. The agents are those tracked at present, t_obs - 1;
//! nothing is generated for others. Distances to the recording count only timesteps at which the agent is recorded.
//! Observed states of the future (goals, other agents' plans, all but a window) are part of it as recorded: their
//! distances are 0, so distances of sweeps with different masks are not comparable. A group for which a metric is
//! undefined has no value and does not enter the mean.
//!
//! The benchmarks' figures, by their names there. If two benchmarks define the same number, there is one metric:
//!
//! - Argoverse 1: minADE `min_ade_of_min_fde_m`, minFDE `min_fde_m`, MR `miss_rate`, p-minADE `p_min_ade_m`, p-minFDE
//!   `p_min_fde_m`, p-MR `p_miss_rate`, brier-minADE `brier_min_ade_m`, brier-minFDE `brier_min_fde_m`, DAC
//!   `drivable_area_compliance`;
//! - Argoverse 2, one agent: minADE `min_ade_of_min_fde_m`, minFDE `min_fde_m`, MR `miss_rate`, brier-minFDE
//!   `brier_min_fde_m`;
//! - Argoverse 2, worlds: avgMinADE `avg_min_ade_m`, avgMinFDE `avg_min_fde_m`, avgBrierMinFDE `avg_brier_min_fde_m`,
//!   actorMR `actor_miss_rate`, actorCR `actor_collision_rate`;
//! - INTERACTION, one agent: minADE `min_ade_m`, minFDE `min_fde_m`, MR `miss_rate`;
//! - INTERACTION, many agents: minJointADE `min_joint_ade_m`, minJointFDE `min_joint_fde_m`, minJointMR
//!   `min_joint_miss_rate`, Consistent-minJointMR `consistent_min_joint_miss_rate`, CrossCollisionRate
//!   `cross_collision_rate`, EgoCollisionRate `ego_collision_rate`.
//!
//! The likelihood of a recorded future among all samples of a scene, as scored by the Waymo sim agents challenge, is
//! not a [`Metric`]: [`Likelihoods`] finds a dozen values at once, and compares as many copies of a reference as there
//! are samples.
//!
//! The benchmarks take six guesses: with more samples, compare the figures over six [`Modes`].

mod actor_world;
mod aggregate;
mod careful_driver;
mod circles;
mod collision_rate;
mod constant_velocity;
mod criticality;
mod displacement;
pub mod distinguishability;
mod drivable_area;
mod histogram;
mod joint_consistency;
mod kinematics;
mod meta_metric;
mod metric_row;
mod mfd;
mod min_ade;
mod min_fde;
mod min_scene_ade;
mod min_scene_fde;
mod miss_rate;
mod mixture;
mod modes;
mod motion;
mod novelty;
mod offroad_rate;
mod plausibility;
mod probability_penalty;
mod probable_miss_rate;
mod road;
mod sample_group;
mod series;
mod settings;
mod spec;
mod validity;

pub use actor_world::ActorWorld;
pub use aggregate::{Aggregate, AggregateTally};
pub use careful_driver::{CarefulDriver, CarefulJudgment, CarefulReplay, Ending, PreventableRate, Seen, Way};
pub(crate) use careful_driver::{DELAY_S, WANDERING_M, acceleration_mps2, body, eased_mps2, half_width_m, least_ttc_s};
pub(crate) use collision_rate::collisions;
pub use collision_rate::{AgentCollisionRate, CollisionRate};
pub use constant_velocity::constant_velocity;
pub use criticality::{PairCriticality, PairMetric, SceneCriticality, SceneMetric, closeness_over_time};
pub use displacement::ScoredAgents;
pub use drivable_area::DrivableAreaCompliance;
pub use histogram::Histogram;
pub use joint_consistency::JointConsistency;
pub use kinematics::{AccelerationViolationRate, JerkViolationRate};
pub use meta_metric::Likelihoods;
pub use metric_row::MetricRow;
pub use mfd::Mfd;
pub use min_ade::{MinAde, MinAdeOfMinFde};
pub use min_fde::MinFde;
pub use min_scene_ade::MinSceneAde;
pub use min_scene_fde::MinSceneFde;
pub use miss_rate::MissRate;
pub use mixture::{Component, Mixture};
pub use modes::{ModeFit, Modes, ModesOf};
pub use motion::{MOTION, MotionHistograms, MotionQuantity};
pub use novelty::{DUPLICATE_DISTANCE_M, EventSpace, PairPath, PathIndex};
pub use offroad_rate::OffroadRate;
pub use plausibility::RecordedRanges;
pub use probability_penalty::{Displacement, PenalizedMinimum, Penalty};
pub use probable_miss_rate::ProbableMissRate;
pub(crate) use road::Road;
pub use sample_group::SampleGroup;
pub use series::{Group, SeriesKey};
pub use settings::MetricSettings;
pub use spec::{Direction, MetricSpec};
pub use validity::{Check, DrivenArea, Judged, LocalFit, MapFit, MapGaps, ValidityConfig, ValidityRate, Violation};

use std::collections::BTreeSet;

/// A metric of the samples of one scene.
pub trait Metric: Send + Sync {
    /// Its specification.
    fn spec(&self) -> MetricSpec;
    /// Its value; `None` if undefined, such as a distance to a recording without a future.
    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64>;
}

impl<M: Metric + ?Sized> Metric for &M {
    fn spec(&self) -> MetricSpec {
        (**self).spec()
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        (**self).evaluate(group)
    }
}

/// Every metric, in the order of tables.
pub static ALL: &[&dyn Metric] = &[
    &MinAde,
    &MinFde,
    &MinAdeOfMinFde,
    &MissRate,
    &ProbableMissRate,
    &MinSceneAde(ScoredAgents::All),
    &MinSceneFde(ScoredAgents::All),
    &MinSceneAde(ScoredAgents::Others),
    &MinSceneFde(ScoredAgents::Others),
    &PenalizedMinimum(Displacement::Ade, Penalty::Logarithm),
    &PenalizedMinimum(Displacement::Fde, Penalty::Logarithm),
    &PenalizedMinimum(Displacement::Ade, Penalty::Brier),
    &PenalizedMinimum(Displacement::Fde, Penalty::Brier),
    &DrivableAreaCompliance { places_without_road: BTreeSet::new() },
    &MinSceneAde(ScoredAgents::Targets),
    &MinSceneFde(ScoredAgents::Targets),
    &JointConsistency::MinMissRate,
    &JointConsistency::ConsistentMinMissRate,
    &JointConsistency::CrossCollisionRate,
    &JointConsistency::EgoCollisionRate,
    &ActorWorld::AvgMinAde,
    &ActorWorld::AvgMinFde,
    &ActorWorld::AvgBrierMinFde,
    &ActorWorld::MissRate,
    &ActorWorld::CollisionRate,
    &Mfd,
    &CollisionRate,
    &AgentCollisionRate,
    &OffroadRate { places_without_road: BTreeSet::new() },
    &AccelerationViolationRate,
    &JerkViolationRate,
    &ValidityRate { settings: None },
    &PairMetric::MinTtc,
    &PairMetric::MaxDrac,
    &PairMetric::MinHeadway,
    &PairMetric::Pet,
    &PairMetric::MinDistance,
    &PreventableRate,
    &SceneMetric::MinTtc,
    &SceneMetric::MaxDrac,
];

/// The metric with this name. `None` if there is no such metric.
pub fn by_id(id: &str) -> Option<&'static dyn Metric> {
    ALL.iter().copied().find(|metric| metric.spec().id == id)
}

#[cfg(test)]
mod tests;
