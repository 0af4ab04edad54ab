//! The groups of traffic that tables compare, each at a guidance strength.

use crate::scene::{GuidanceLevel, Provenance};
use serde::{Deserialize, Serialize};
use std::fmt;

/// A group of traffic in tables, which name it under `group` or `series`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub enum Group {
    /// The recordings that a sweep continues.
    Recorded,
    /// Recorded scenes, with every agent extrapolated at constant velocity.
    ConstantVelocity,
    /// Samples of a sweep that are forecasts: [`Provenance::is_unguided`].
    Unguided,
    /// The other samples of the sweep of this name.
    Sweep(String),
}

impl Group {
    /// Names that sweeps cannot have.
    pub const RESERVED: [&str; 3] = ["recorded", "constant_velocity", "unguided"];

    /// The group of a sample of `sweep`.
    pub fn of(sweep: &str, provenance: &Provenance) -> Self {
        if provenance.is_unguided() { Self::Unguided } else { Self::Sweep(sweep.to_owned()) }
    }

    /// Its name in tables.
    pub fn name(&self) -> &str {
        match self {
            Self::Recorded => Self::RESERVED[0],
            Self::ConstantVelocity => Self::RESERVED[1],
            Self::Unguided => Self::RESERVED[2],
            Self::Sweep(name) => name,
        }
    }

    /// Whether it was generated. Generated traffic is compared with the groups that were not.
    pub const fn is_generated(&self) -> bool {
        matches!(self, Self::Unguided | Self::Sweep(_))
    }
}

impl From<String> for Group {
    fn from(name: String) -> Self {
        let known = [Self::Recorded, Self::ConstantVelocity, Self::Unguided];
        known.into_iter().find(|group| group.name() == name).unwrap_or(Self::Sweep(name))
    }
}

impl From<Group> for String {
    fn from(group: Group) -> Self {
        group.name().to_owned()
    }
}

/// The name in reports.
impl fmt::Display for Group {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name().replace('_', " "))
    }
}

/// The key of a series of figures in a table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SeriesKey {
    /// The group of traffic.
    pub group: Group,
    /// The measured sweep, or the sweep that continues these recordings.
    pub sweep: String,
    /// The level of guidance; unguided for groups that were not generated.
    pub level: GuidanceLevel,
}

impl SeriesKey {
    /// The series of a sample of `sweep`.
    pub fn of(sweep: &str, provenance: &Provenance) -> Self {
        let group = Group::of(sweep, provenance);
        Self { group, sweep: sweep.to_owned(), level: provenance.guidance.level }
    }

    /// The series of `group`, which was not generated, beside the samples of `sweep`.
    pub fn reference(group: Group, sweep: &str) -> Self {
        Self { group, sweep: sweep.to_owned(), level: GuidanceLevel::UNGUIDED }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::provenance;

    #[test]
    fn groups_keep_their_words_in_tables() {
        for name in ["recorded", "constant_velocity", "unguided", "cut_ins"] {
            let group = Group::from(name.to_owned());
            assert_eq!((group.name(), serde_json::to_string(&group).unwrap()), (name, format!("\"{name}\"")));
            assert_eq!(matches!(group, Group::Sweep(_)), !Group::RESERVED.contains(&name));
        }
        assert_eq!(Group::ConstantVelocity.to_string(), "constant velocity");
    }

    #[test]
    fn what_was_edited_or_pushed_is_of_its_sweep() {
        let group = |kind: &str, edit_tau: Option<f64>| {
            let mut provenance = Provenance { edit_tau, ..provenance("a") };
            provenance.guidance.kind = kind.to_owned();
            SeriesKey::of("s", &provenance).group
        };
        assert_eq!(group("none", None), Group::Unguided);
        assert_eq!(group("scene_transformer", None), Group::Unguided);
        let own = Group::Sweep("s".to_owned());
        assert_eq!(group("none", Some(0.4)), own, "it starts from an edited recording");
        assert_eq!(group("classifier:cut_in", None), own);
        assert_eq!(group("classifier_free", None), own);
    }
}
