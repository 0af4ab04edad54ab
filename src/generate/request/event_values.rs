//! By what are events of one situation told apart?

use crate::behavior::BehaviorEvent;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The parameters of an event that a request names or a template solves for, in hundredths of their units.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct EventValues(BTreeMap<String, i64>);

impl EventValues {
    /// How far apart events of one situation are at least in one parameter: in hundredths of a second for times,
    /// otherwise of the parameter's unit.
    const APART: [i64; 2] = [15, 50];

    pub(super) fn of<'n>(event: &BehaviorEvent, names: impl Iterator<Item = &'n str>) -> Self {
        let value = |name: &str| Some((name.to_owned(), (event.parameters.get(name)? * 100.0).round() as i64));
        Self(names.filter_map(value).collect())
    }

    /// Whether two events of one situation differ too little to be two.
    pub(super) fn is_like(&self, other: &Self) -> bool {
        self.0.iter().all(|(name, value)| {
            let [apart_s, apart] = Self::APART;
            let least = if name.ends_with("_s") { apart_s } else { apart };
            other.0.get(name).is_some_and(|other| (value - other).abs() < least)
        })
    }
}
