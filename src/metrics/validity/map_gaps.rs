//! Where do maps lack parts of the road, and what do recordings show there?

use super::DrivenArea;
use crate::scene::Scene;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// The places whose maps lack parts of the road, and where recorded vehicles drive there: found in recordings.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MapGaps {
    /// The places.
    pub places: BTreeSet<String>,
    /// Where vehicles drive, which is road beside the lanes, at those places where this is enough to judge departures.
    pub driven_areas: BTreeMap<String, DrivenArea>,
}

static NONE: MapGaps = MapGaps { places: BTreeSet::new(), driven_areas: BTreeMap::new() };

impl MapGaps {
    /// Maps that show every road.
    pub fn none() -> &'static Self {
        &NONE
    }

    /// Whether every map shows every road.
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// Whether the map and the recorded vehicles of the scene's place show the whole road.
    pub(super) fn show_road_of(&self, scene: &Scene) -> bool {
        !self.places.contains(&scene.source.place) || self.driven_area(scene).is_some()
    }

    /// Where vehicles drive beside the lanes of the scene's place.
    pub(super) fn driven_area(&self, scene: &Scene) -> Option<&DrivenArea> {
        self.driven_areas.get(&scene.source.place)
    }
}
