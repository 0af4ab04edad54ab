//! The names of the datasets, and the facts about each in one table: its terms, what it records, and the rules of its
//! benchmark.

use crate::settings::named;
use serde::{Deserialize, Serialize};

/// The datasets that can be ingested. Their differences other than formats are in [`Dataset::facts`]: code looks up the
/// fact and never matches the dataset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Dataset {
    /// INTERACTION, v1.1 recordings or v1.2 cases.
    Interaction,
    /// Argoverse 1 motion forecasting.
    Argoverse1,
    /// Argoverse 2 motion forecasting.
    Argoverse2,
    /// Scenarios in CommonRoad's XML, recorded or generated.
    #[serde(rename = "commonroad")]
    CommonRoad,
    /// Waymo Open Motion.
    Womd,
    /// Tables in no format of their own, with a mapping.
    Table,
}

named! { Dataset {
    Interaction = "interaction", Argoverse1 = "argoverse1", Argoverse2 = "argoverse2", CommonRoad = "commonroad",
    Womd = "womd", Table = "table",
} }

/// Time between the timesteps of ingested scenes, seconds: all datasets have 10 Hz, or are resampled to it.
pub const INGESTED_DT_S: f64 = 0.1;

/// The facts about a dataset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DatasetFacts {
    /// The terms under which it is published, which also apply to everything derived from it.
    pub terms: &'static str,
    /// The country of all its places, as a code of three letters; `None` if the names of places give it.
    pub country: Option<&'static str>,
    /// Whether the types of agents are recorded. Otherwise agents of unknown type are vehicles.
    pub has_classes: bool,
    /// Whether headings of vehicles are recorded. Otherwise they follow from positions.
    pub has_headings: bool,
    /// Whether velocities are recorded beside positions. They are filtered by a tracker and not the derivative of the
    /// positions, so trajectories that continue with them jump: ingest derives velocities from positions and keeps the
    /// recorded ones only for states without a neighbor in time.
    pub has_velocities: bool,
    /// Whether positions are good enough to judge motion by: accelerations, jerks, curvature.
    pub has_clean_motion: bool,
    /// Whether positions are at other times than recorded, so that agents seem to jump.
    pub has_uneven_times: bool,
    /// Whether tracks stay as they are where one continues another: its benchmark names them.
    pub has_chosen_tracks: bool,
    /// Whether the focal agent is the dataset's choice of the agent to predict.
    pub has_chosen_focal: bool,
    /// Whether the first frame of a scene is the time at which it begins, in nanoseconds.
    pub begins_at_ns: bool,
    /// When a prediction of the last state is a miss.
    pub miss_rule: MissRule,
    /// The benchmark that its figures are compared with; `None` if it has none.
    pub benchmark: Option<Benchmark>,
}

/// When a sampled last state misses the recorded one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MissRule {
    /// INTERACTION's: by distances along and across the recorded heading, the former growing with the speed.
    AlongHeading,
    /// Argoverse's: by the distance.
    Radial,
}

/// A benchmark, which says whom to predict.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Benchmark {
    /// INTERACTION's multi-agent benchmark: joint futures of the vehicles that are recorded throughout.
    InteractionJoint,
    /// Argoverse 1's: futures of the focal agent.
    ArgoverseFocal,
    /// Argoverse 2's: worlds, which are joint futures of the focal and the scored agents.
    ArgoverseWorlds,
}

impl Dataset {
    /// The facts about it.
    pub const fn facts(self) -> &'static DatasetFacts {
        match self {
            Self::Interaction => &DatasetFacts {
                terms: "INTERACTION dataset (Zhan et al. 2019): non-commercial use under the terms it was obtained \
                        with. Recordings of another origin in its format are under the terms of their maker.",
                country: None,
                has_classes: true,
                has_headings: true,
                has_velocities: true,
                has_clean_motion: true,
                has_uneven_times: false,
                has_chosen_tracks: false,
                has_chosen_focal: false,
                begins_at_ns: false,
                miss_rule: MissRule::AlongHeading,
                benchmark: Some(Benchmark::InteractionJoint),
            },
            Self::Argoverse1 => &DatasetFacts {
                terms: "Argoverse 1 (Chang et al. 2019): CC BY-NC-SA 4.0, non-commercial use only.",
                country: Some("USA"),
                has_classes: false,
                has_headings: false,
                has_velocities: false,
                // Motion of a tracker, unfiltered and at uneven times.
                has_clean_motion: false,
                has_uneven_times: true,
                has_chosen_tracks: true,
                has_chosen_focal: true,
                begins_at_ns: false,
                miss_rule: MissRule::Radial,
                benchmark: Some(Benchmark::ArgoverseFocal),
            },
            Self::Argoverse2 => &DatasetFacts {
                terms: "Argoverse 2 (Wilson et al. 2021): CC BY-NC-SA 4.0, non-commercial use only.",
                country: Some("USA"),
                has_classes: true,
                has_headings: true,
                has_velocities: true,
                has_clean_motion: true,
                has_uneven_times: false,
                has_chosen_tracks: true,
                has_chosen_focal: true,
                begins_at_ns: true,
                miss_rule: MissRule::Radial,
                benchmark: Some(Benchmark::ArgoverseWorlds),
            },
            Self::CommonRoad => &DatasetFacts {
                terms: "CommonRoad scenarios (Althoff et al. 2017): under the terms of whoever made them, which each \
                        file names as its source.",
                country: None,
                has_classes: true,
                has_headings: true,
                has_velocities: true,
                // Of NGSIM's recordings, hardly one is within the limits of accelerations and jerks.
                has_clean_motion: false,
                has_uneven_times: false,
                has_chosen_tracks: false,
                has_chosen_focal: false,
                begins_at_ns: false,
                miss_rule: MissRule::Radial,
                benchmark: None,
            },
            Self::Womd => &DatasetFacts {
                terms: "Waymo Open Motion Dataset (Ettinger et al. 2021): Waymo Dataset License Agreement for \
                        Non-Commercial Use, which also covers what is derived from it, trained models included.",
                country: Some("USA"),
                has_classes: true,
                has_headings: true,
                has_velocities: true,
                // Centimeters of noise: 27 and 5 vehicles of two scenarios are beyond a jerk of 25 m/s³.
                has_clean_motion: false,
                has_uneven_times: false,
                has_chosen_tracks: true,
                has_chosen_focal: false,
                begins_at_ns: false,
                miss_rule: MissRule::Radial,
                benchmark: None,
            },
            Self::Table => &DatasetFacts {
                terms: "recordings read by a mapping: under the terms of their owner, which `evaluate.terms` states.",
                country: None,
                has_classes: true,
                // If no column has them, they are derived, and marked as such.
                has_headings: true,
                has_velocities: false,
                has_clean_motion: false,
                has_uneven_times: false,
                has_chosen_tracks: false,
                has_chosen_focal: false,
                begins_at_ns: false,
                miss_rule: MissRule::Radial,
                benchmark: None,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_configurations() {
        for dataset in Dataset::ALL {
            assert_eq!(serde_json::to_value(dataset).unwrap(), dataset.name());
            assert_eq!(Dataset::from_name(dataset.name()), Some(dataset));
        }
        assert_eq!(Dataset::from_name("argoverse"), None);
    }
}
