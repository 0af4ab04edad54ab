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
impl SceneId {
    /// The long recording of which the scene with this id is a window, and its first frame in it: those of
    /// `interaction/train/PLACE/007@41`. `None` for a recording that is one scene. Windows of the other split belong to
    /// another recording.
    pub fn window_of(id: &str) -> Option<(&str, i64)> {
        let (recording, first_frame) = id.rsplit_once('@')?;
        // Frames beyond are no frames, and leave room for sums.
        let first_frame = first_frame.parse::<i64>().ok().filter(|frame| frame.unsigned_abs() < 1 << 53)?;
        Some((recording, first_frame))
    }

    /// The first frames of the windows of a recording among scenes with these ids, with the position of the first scene
    /// of each; by time.
    pub fn windows_of<'i>(recording: &str, ids: impl Iterator<Item = &'i str>) -> Vec<(i64, usize)> {
        let of = |(position, id): (usize, &'i str)| {
            let (name, first_frame) = Self::window_of(id)?;
            (name == recording).then_some((first_frame, position))
        };
        let mut windows: Vec<(i64, usize)> = ids.enumerate().filter_map(of).collect();
        windows.sort_unstable();
        windows.dedup_by_key(|(first_frame, _)| *first_frame);
        windows
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_name_their_recording_and_other_scenes_none() {
        let window = |id: &'static str| SceneId::window_of(id);
        assert_eq!(window("table/train/a@b/007@-41"), Some(("table/train/a@b/007", -41)));
        let others =
            ["argoverse1/train/PIT/21", "table/train/P/007@", "table/train/P/007@4.5", "P@9223372036854775807"];
        assert_eq!(others.map(window), [None; 4]);
    }
}
