//! The place, split and recording in the names of INTERACTION's files and folders.

use crate::ingest::UnitSplit;
use crate::scene::Split;
use std::path::Path;

/// The information in the name of a table of tracks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct TrackFile {
    /// The location, such as `DR_CHN_Merging_ZS0`; empty if neither file nor folder names it.
    pub(super) place: String,
    /// The split, if file or folder name it.
    pub(super) split: Option<Split>,
    /// The kind of test set after `test_`, such as `single-agent`, if it is not the usual `multi-agent`. Their cases
    /// have the same numbers.
    pub(super) test_set: Option<String>,
    /// The part of a v1.1 recording that the file is.
    pub(super) recording: Option<RecordingPart>,
}

/// One of the two files of a v1.1 recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct RecordingPart {
    /// `NNN` of `vehicle_tracks_NNN.csv`.
    pub(super) number: String,
    /// Whether it is the file of the pedestrians and cyclists.
    pub(super) is_pedestrians: bool,
}

const SPLIT_SUFFIXES: [(&str, Split); 4] =
    [("_train", Split::Train), ("_val", Split::Val), ("_obs", Split::Test), ("_test", Split::Test)];

impl TrackFile {
    /// The information in the path of a table within its container; `None` if it is not a table.
    pub(super) fn of_path(path: &str) -> Option<Self> {
        let (folders, name) = path.rsplit_once('/').unwrap_or(("", path));
        let stem = strip_suffix_ignoring_case(name, ".csv")?;
        let recording =
            [("vehicle_tracks_", false), ("pedestrian_tracks_", true)].iter().find_map(|(prefix, is_pedestrians)| {
                let number = stem.strip_prefix(prefix)?.to_owned();
                Some(RecordingPart { number, is_pedestrians: *is_pedestrians })
            });
        let by_suffix = SPLIT_SUFFIXES.iter().find_map(|(suffix, split)| Some((stem.strip_suffix(suffix)?, *split)));
        let by_folder = folders.rsplit('/').find_map(split_of_folder);
        let place = match (&recording, by_suffix) {
            (Some(_), _) => folders.rsplit('/').next().unwrap_or_default(),
            (None, Some((place, _))) => place,
            (None, None) => stem,
        };
        Some(Self {
            place: place.to_owned(),
            split: by_suffix.map(|(_, split)| split).or(by_folder.as_ref().map(|(split, _)| *split)),
            test_set: by_folder.and_then(|(_, test_set)| test_set),
            recording,
        })
    }

    /// The information in the path of a table, or otherwise in its folder or archive.
    pub(super) fn of(container: &Path, path: &str) -> Option<Self> {
        let mut file = Self::of_path(path)?;
        let container = std::path::absolute(container).unwrap_or_else(|_| container.to_owned());
        let name = container.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let name = [".zip", ".tar", ".tar.gz", ".tgz"]
            .iter()
            .find_map(|suffix| strip_suffix_ignoring_case(&name, suffix))
            .unwrap_or(&name);
        if file.place.is_empty() {
            file.place = name.to_owned();
        }
        if file.split.is_none()
            && let Some((split, test_set)) = split_of_folder(name)
        {
            (file.split, file.test_set) = (Some(split), test_set);
        }
        Some(file)
    }

    /// The split of a unit of this file: recordings without a named split are divided by time.
    pub(super) fn unit_split(&self, is_recording: bool) -> UnitSplit {
        match self.split {
            Some(split) => UnitSplit::All(split),
            None if is_recording => UnitSplit::Divided,
            None => UnitSplit::All(Split::Unsplit),
        }
    }
}

/// The name of a file without folders and last extension.
pub(super) fn stem(path: &str) -> &str {
    let name = path.rsplit_once('/').map_or(path, |(_, name)| name);
    name.rsplit_once('.').map_or(name, |(stem, _)| stem)
}

/// The place of the map in the file at `path`, by its exact name: `<place>.osm` or `<place>.osm_xy`.
pub(super) fn place_of_map(path: &str) -> Option<&str> {
    let name = path.rsplit_once('/').map_or(path, |(_, name)| name);
    strip_suffix_ignoring_case(name, ".osm").or_else(|| strip_suffix_ignoring_case(name, ".osm_xy"))
}

fn split_of_folder(name: &str) -> Option<(Split, Option<String>)> {
    let name = name.to_ascii_lowercase();
    match name.as_str() {
        "train" | "training" => Some((Split::Train, None)),
        "val" | "validation" => Some((Split::Val, None)),
        "test" | "testing" | "test_multi-agent" => Some((Split::Test, None)),
        _ => name.strip_prefix("test_").map(|test_set| (Split::Test, Some(test_set.to_owned()))),
    }
}

fn strip_suffix_ignoring_case<'a>(name: &'a str, suffix: &str) -> Option<&'a str> {
    let at = name.len().checked_sub(suffix.len())?;
    (name.is_char_boundary(at) && name[at..].eq_ignore_ascii_case(suffix)).then(|| &name[..at])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(place: &str, split: Option<Split>) -> TrackFile {
        TrackFile { place: place.to_owned(), split, test_set: None, recording: None }
    }

    fn recording(place: &str, number: &str, is_pedestrians: bool) -> TrackFile {
        TrackFile { recording: Some(RecordingPart { number: number.to_owned(), is_pedestrians }), ..file(place, None) }
    }

    #[test]
    fn published_names_are_understood() {
        let of = |path: &str| TrackFile::of_path(path).unwrap();
        let root = "INTERACTION-Dataset-DR-multi-v1_2";
        assert_eq!(of("x/train/DR_CHN_Merging_ZS0_train.csv"), file("DR_CHN_Merging_ZS0", Some(Split::Train)));
        assert_eq!(of(&format!("{root}/val/SIM_A_val.csv")), file("SIM_A", Some(Split::Val)));
        assert_eq!(of(&format!("{root}/test_multi-agent/SIM_A_obs.csv")), file("SIM_A", Some(Split::Test)));
        assert_eq!(of("SIM_A_val.csv"), file("SIM_A", Some(Split::Val)));
        for (folder, split) in [("Val", Split::Val), ("validation", Split::Val), ("TRAINING", Split::Train)] {
            assert_eq!(of(&format!("{folder}/SIM_A.csv")), file("SIM_A", Some(split)));
        }
        assert_eq!(of("SIM_A.csv"), file("SIM_A", None));
        assert_eq!(of("recorded_trackfiles/SIM_A/vehicle_tracks_007.csv"), recording("SIM_A", "007", false));
        assert_eq!(of("SIM_A/pedestrian_tracks_007.CSV"), recording("SIM_A", "007", true));
        let single = TrackFile { test_set: Some("single-agent".into()), ..file("SIM_A", Some(Split::Test)) };
        assert_eq!(of("test_single-agent/SIM_A_obs.csv"), single);
        assert_eq!(TrackFile::of_path("maps/SIM_A.osm"), None);
    }

    #[test]
    fn the_container_tells_what_the_path_does_not() {
        let of = |container: &str, path: &str| TrackFile::of(Path::new(container), path).unwrap();
        assert_eq!(of("data/SIM_A", "vehicle_tracks_000.csv"), recording("SIM_A", "000", false));
        assert_eq!(of("data/SIM_A.tar.gz", "vehicle_tracks_000.csv").place, "SIM_A");
        assert_eq!(of("data/val", "SIM_A.csv"), file("SIM_A", Some(Split::Val)));
    }

    #[test]
    fn maps_match_by_exact_name() {
        assert_eq!(place_of_map("maps/DR_CHN_Merging_ZS.osm"), Some("DR_CHN_Merging_ZS"));
        assert_eq!(place_of_map("DR_CHN_Merging_ZS0.osm_xy"), Some("DR_CHN_Merging_ZS0"));
        assert_eq!(place_of_map("notes.txt"), None);
    }
}
