//! The tags of a scene: attributes of its operational design domain that follow from its map and its tracks alone.
//!
//! Attributes are those of ISO 34503:2023 (scenery; dynamic elements), in the names of ASAM OpenLABEL 1.0.0, whose
//! definitions refer to BSI PAS 1883:2020. They describe the surroundings of the center at the present, so that a
//! scenario has the tags of the scene that it continues. What maps do not tell as they are read has no tag: surfaces,
//! signs, crossings for pedestrians, weather.

use super::roads;
use crate::scene::{AgentClass, Scene, SceneId, Split, Track};
use crate::settings::Unreadable;
use std::fmt;
use std::str::FromStr;

/// What is within this distance of the center counts, meters: 100 m of road.
pub(super) const REACH_M: f64 = 50.0;

/// An attribute with its values.
#[derive(Debug, PartialEq, Eq)]
pub struct Attribute {
    /// Its name in tables.
    pub name: &'static str,
    /// Its class, or classes, in OpenLABEL's ontology of scenario tags.
    pub openlabel: &'static str,
    /// Its values. Every scene has exactly one.
    pub values: &'static [&'static str],
    /// How the value is found.
    pub definition: &'static str,
}

/// Every attribute.
pub static ATTRIBUTES: [Attribute; 5] = [
    Attribute {
        name: "junction",
        openlabel: "JunctionRoundabout, JunctionIntersection, RoadTypeSlip",
        values: &["roundabout", "intersection", "merge", "none", "unknown"],
        definition: "The first that applies to lanes within 50 m of the center. Roundabout: lanes that follow on from \
                     each other lead around in a circle of at most 350 m. Intersection: the map says so, or the \
                     middles of two lanes cross. Merge: two lanes become one, or a lane ends beside another. Unknown: \
                     there is no map.",
    },
    Attribute {
        name: "lanes",
        openlabel: "LaneSpecificationLaneCount",
        values: &["1", "2", "3_or_more", "unknown"],
        definition: "The most lanes side by side in one direction within 50 m of the center. Unknown: there is no map.",
    },
    Attribute {
        name: "speed",
        openlabel: "none (SubjectVehicleSpeed is that of one vehicle)",
        values: &["below_15_km_h", "15_to_30_km_h", "30_to_60_km_h", "above_60_km_h", "none"],
        definition: "The mean speed of motorized road users within 50 m of the center, itself included and parked ones \
                     left out. None: there are none.",
    },
    Attribute {
        name: "density",
        openlabel: "TrafficAgentDensity",
        values: &["below_50_per_km", "50_to_100_per_km", "above_100_per_km"],
        definition: "Motorized road users within 50 m of the center, itself included and parked ones left out, per \
                     100 m of road: fewer than 5, fewer than 10, or more.",
    },
    Attribute {
        name: "road_users",
        openlabel: "TrafficAgentType",
        values: &["motorized_only", "with_pedestrians", "with_cyclists", "with_both", "with_either"],
        definition: "The classes of road users within 50 m of the center. With either: the recording does not tell \
                     pedestrians from cyclists.",
    },
];

/// A value of an attribute.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Tag {
    attribute: usize,
    value: usize,
}

impl Tag {
    /// Every tag, by attribute.
    pub fn all() -> impl Iterator<Item = Self> {
        let of =
            |(attribute, of): (usize, &Attribute)| (0..of.values.len()).map(move |value| Self { attribute, value });
        ATTRIBUTES.iter().enumerate().flat_map(of)
    }

    /// Its attribute.
    pub fn attribute(self) -> &'static Attribute {
        &ATTRIBUTES[self.attribute]
    }

    /// The value.
    pub fn value(self) -> &'static str {
        self.attribute().values[self.value]
    }
}

impl fmt::Display for Tag {
    /// `junction:merge`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.attribute().name, self.value())
    }
}

impl FromStr for Tag {
    type Err = Unreadable;

    fn from_str(text: &str) -> Result<Self, Unreadable> {
        Self::all().find(|tag| tag.to_string() == text).ok_or_else(|| format!("{text:?} is no tag").into())
    }
}

/// The tags of a scene: the index of the value of each attribute.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Tags([usize; ATTRIBUTES.len()]);

impl Tags {
    /// The tags of a scene; see [`ATTRIBUTES`].
    pub fn of(scene: &Scene) -> Self {
        let present = scene.current_timestep();
        let Some(center) = scene.ego().trajectory.get(present) else {
            let last = |attribute: &Attribute| attribute.values.len() - 1;
            return Self([last(&ATTRIBUTES[0]), last(&ATTRIBUTES[1]), last(&ATTRIBUTES[2]), 0, 0]);
        };
        let is_near = |track: &&Track| {
            let state = track.trajectory.get(present);
            !track.is_parked() && state.is_some_and(|state| state.position.distance(center.position) <= REACH_M)
        };
        let near: Vec<&Track> = scene.tracks.iter().filter(is_near).collect();
        let motorized = near.iter().filter(|track| track.class.is_motorized());
        let speeds_mps: Vec<f64> =
            motorized.filter_map(|track| Some(track.trajectory.get(present)?.speed_mps())).collect();
        let mean_km_h = 3.6 * speeds_mps.iter().sum::<f64>() / speeds_mps.len() as f64;
        let at_least = |value: f64, limits: &[f64]| limits.iter().filter(|limit| value >= **limit).count();
        let [pedestrian, cyclist, either] =
            [AgentClass::Pedestrian, AgentClass::Cyclist, AgentClass::PedestrianOrCyclist]
                .map(|class| near.iter().any(|track| track.class == class));
        let roads = roads::of(&scene.lanes, center.position);
        let [junction, lanes] = [0, 1].map(|i| ATTRIBUTES[i].values.iter().position(|value| *value == roads[i]));
        Self([
            junction.unwrap_or_default(),
            lanes.unwrap_or_default(),
            if speeds_mps.is_empty() { 4 } else { at_least(mean_km_h, &[15.0, 30.0, 60.0]) },
            at_least(speeds_mps.len() as f64, &[5.0, 10.0]),
            if either { 4 } else { usize::from(pedestrian) + 2 * usize::from(cyclist) },
        ])
    }

    /// Those of a row: the names of the values, in the order of the attributes.
    pub fn named(values: [&str; ATTRIBUTES.len()]) -> Option<Self> {
        let mut tags = [0; ATTRIBUTES.len()];
        for ((tag, attribute), name) in tags.iter_mut().zip(&ATTRIBUTES).zip(values) {
            *tag = attribute.values.iter().position(|value| *value == name)?;
        }
        Some(Self(tags))
    }

    /// Each tag.
    pub fn each(self) -> [Tag; ATTRIBUTES.len()] {
        std::array::from_fn(|attribute| Tag { attribute, value: self.0[attribute] })
    }

    /// Whether this tag is among them.
    pub fn has(self, tag: Tag) -> bool {
        self.0[tag.attribute] == tag.value
    }
}

/// A recorded scene with its tags.
#[derive(Debug, Clone, PartialEq)]
pub struct TaggedScene {
    /// Its name.
    pub scene_id: SceneId,
    /// Its place.
    pub place: String,
    /// Its split.
    pub split: Split,
    /// Its tags.
    pub tags: Tags,
    /// Time that it shows and no scene before it does, hours.
    pub observed_h: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{Drive, scene};
    use crate::scene::{LaneGraph, TrackRole};
    use std::sync::Arc;

    fn named(scene: &Scene) -> String {
        Tags::of(scene).each().map(Tag::value).join(" ")
    }

    #[test]
    fn the_present_around_the_center_is_tagged() {
        // At 5 and 15 m/s; the third one is more than 50 m away.
        let drives = [
            Drive::straight(0.0, 0.0, 0.0, 5.0),
            Drive::straight(20.0, 0.0, 0.0, 15.0),
            Drive::straight(60.0, 0.0, 0.0, 30.0),
        ];
        let mut found = scene(&drives);
        assert_eq!(named(&found), "none 1 30_to_60_km_h below_50_per_km motorized_only");
        found.tracks[1].class = AgentClass::Pedestrian;
        assert_eq!(named(&found), "none 1 15_to_30_km_h below_50_per_km with_pedestrians");
        found.tracks[0].class = AgentClass::Cyclist;
        found.lanes = Arc::new(LaneGraph::default());
        assert_eq!(named(&found), "unknown unknown none below_50_per_km with_both");
        found.tracks[1].class = AgentClass::PedestrianOrCyclist;
        assert!(named(&found).ends_with("with_either"));

        let queue: Vec<Drive> = (0..11).map(|i| Drive::straight(4.0 * f64::from(i), 0.0, 0.0, 0.0)).collect();
        let mut found = scene(&queue);
        assert_eq!(named(&found), "none 1 below_15_km_h above_100_per_km motorized_only");
        found.tracks[1..6].iter_mut().for_each(|track| track.role = TrackRole::Parked);
        assert_eq!(named(&found), "none 1 below_15_km_h 50_to_100_per_km motorized_only");
    }

    #[test]
    fn tags_are_known_by_their_names() {
        for tag in Tag::all() {
            assert_eq!(tag.to_string().parse::<Tag>().unwrap(), tag);
        }
        assert!("junction:cloverleaf".parse::<Tag>().is_err());
        let tags = Tags::of(&scene(&[Drive::straight(0.0, 0.0, 0.0, 5.0)]));
        assert_eq!(Tags::named(tags.each().map(Tag::value)), Some(tags));
        assert!(tags.each().iter().all(|tag| tags.has(*tag)));
    }
}
