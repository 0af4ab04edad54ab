//! Ids with types of their own, so that they cannot be mixed up.

use serde::{Deserialize, Serialize};

macro_rules! string_id {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
        pub struct $name(pub String);

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(&self.0)
            }
        }

        impl From<&str> for $name {
            fn from(text: &str) -> Self {
                Self(text.to_owned())
            }
        }
    };
}

string_id! {
    /// A recorded scene, unique over all datasets: `dataset/split/place/case`, for instance `argoverse1/train/PIT/21`.
    SceneId
}
string_id! {
    /// A track as the recording names it; unique within a scene.
    TrackId
}
string_id! {
    /// A map: one for a place (INTERACTION), a city (Argoverse 1) or a scene (Argoverse 2).
    MapId
}

/// A lane as its map names it; unique within a map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct LaneId(pub i64);
