//! INTERACTION v1.2: a scenario as a case of the dataset.

use super::index::Table;
use super::text::number;
use super::{ExportOutcome, Exporter, Item, Result, Written};
use crate::scene::{AgentClass, Scene, State, Track};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

pub(super) const NOTES: &str = "<split>/<place>_<split>.csv: cases as in INTERACTION v1.2 (40 frames at 10 Hz, of \
    which 10 are observed), in the split of the recordings that they continue; the present is frame 10. Maps are not \
    here: use maps/<place>.osm of the recordings themselves, for our lanes are made from it and hold less. Heading, \
    length and width of pedestrians and cyclists are empty, as in the dataset. interesting_agent marks the ego, \
    track_to_predict it and all that take part in the event; the dataset has these two columns in test cases alone.";

/// The dataset's columns, in its order, with the marks of its test cases.
const HEADER: [&str; 14] = [
    "case_id",
    "track_id",
    "frame_id",
    "timestamp_ms",
    "agent_type",
    "x",
    "y",
    "vx",
    "vy",
    "psi_rad",
    "length",
    "width",
    "track_to_predict",
    "interesting_agent",
];

/// Observed frames of a case, which are the first.
const N_OBSERVED_FRAMES: usize = 10;
/// Frames of a case.
const N_FRAMES: usize = 40;
/// INTERACTION is recorded at 10 Hz.
const DT_S: f64 = 0.1;

/// Writes one table per split and place. Scenarios of other datasets use the same frames: the present is frame 10, and
/// timesteps beyond frames 1 to 40 are left out.
pub(super) struct Interaction {
    dir: PathBuf,
    /// The table and the number of its cases, by the table's name.
    tables: BTreeMap<String, (Table, usize)>,
}

impl Interaction {
    pub(super) fn new(dir: &Path) -> Self {
        Self { dir: dir.to_owned(), tables: BTreeMap::new() }
    }

    fn table(&mut self, scene: &Scene) -> Result<(&mut (Table, usize), String)> {
        let (split, place) = (scene.source.split.name(), super::text::plain(&scene.source.place));
        let name = format!("{split}/{place}_{split}.csv");
        if !self.tables.contains_key(&name) {
            fs_err::create_dir_all(self.dir.join(split))?;
            let table = Table::begin(&self.dir.join(&name), b',', &HEADER)?;
            self.tables.insert(name.clone(), (table, 0));
        }
        match self.tables.get_mut(&name) {
            Some(table) => Ok((table, name)),
            None => Err(crate::store::Error::NotFound { path: self.dir.clone(), what: name }.into()),
        }
    }
}

impl Exporter for Interaction {
    fn add(&mut self, item: &Item<'_>) -> Result<ExportOutcome> {
        let scene = item.scene();
        if (scene.dt_s - DT_S).abs() > 1e-6 {
            return Ok(ExportOutcome::LeftOut("not_10_hz"));
        }
        // Timestep 0 is this frame, counted from 1; below 1 if there are more than 10 observed timesteps.
        let first_frame = 1 + N_OBSERVED_FRAMES as i64 - scene.n_history as i64;
        let frames: Vec<Option<usize>> =
            (0..scene.n_timesteps as i64).map(|timestep| frame(first_frame + timestep)).collect();
        let shown = |agent_idx: usize| -> Vec<(usize, State)> {
            let states = item.world_states(agent_idx).into_iter().zip(&frames);
            states.filter_map(|(state, frame)| Some(((*frame)?, state?))).collect()
        };
        let names = names(scene);
        let ((table, n_cases), file) = self.table(scene)?;
        *n_cases += 1;
        let case_id = format!("{n_cases}.0");
        let (mut tracks, mut n_nominal, mut n_renumbered) = (Vec::new(), 0, 0);
        for (agent_idx, (track, name)) in scene.tracks.iter().zip(names).enumerate() {
            let states = shown(agent_idx);
            if track.class == AgentClass::Static || states.is_empty() {
                tracks.push(Err(if states.is_empty() { "no_states" } else { "static_object" }));
                continue;
            }
            let is_ego = agent_idx == item.ego_idx;
            let marks = [is_ego || item.event_role(agent_idx).is_some(), is_ego];
            n_renumbered += u64::from(name != track.id.0);
            n_nominal += u64::from(is_vehicle(track) && track.extent.is_none());
            for (frame, state) in states {
                table.row(&row(&case_id, &name, frame, track, &state, marks).each_ref().map(String::as_str))?;
            }
            tracks.push(Ok(name));
        }
        let n_cut = frames.iter().filter(|frame| frame.is_none()).count() as u64;
        Ok(ExportOutcome::Written(Written {
            file,
            name: case_id,
            first_timestep: frames.iter().position(Option::is_some).unwrap_or_default(),
            tracks,
            assumed: vec![("nominal_size", n_nominal), ("cut_to_window", n_cut), ("renumbered_track", n_renumbered)],
        }))
    }

    fn finish(self: Box<Self>) -> Result<()> {
        self.tables.into_values().try_for_each(|(table, _)| table.finish())
    }
}

/// The frame, if a case has it.
fn frame(frame: i64) -> Option<usize> {
    usize::try_from(frame).ok().filter(|frame| (1..=N_FRAMES).contains(frame))
}

fn is_vehicle(track: &Track) -> bool {
    track.class.is_motorized()
}

/// The names of the tracks: their own ids if all have the dataset's form (numbers, and `P` with a number for
/// pedestrians and cyclists), else consecutive numbers.
fn names(scene: &Scene) -> Vec<String> {
    let is_as_in_dataset = |track: &Track| {
        let digits = if is_vehicle(track) { Some(track.id.0.as_str()) } else { track.id.0.strip_prefix('P') };
        digits.is_some_and(|digits| !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit()))
    };
    if scene.tracks.iter().all(is_as_in_dataset) {
        return scene.tracks.iter().map(|track| track.id.0.clone()).collect();
    }
    let name = |(i, track): (usize, &Track)| format!("{}{}", if is_vehicle(track) { "" } else { "P" }, i + 1);
    scene.tracks.iter().enumerate().map(name).collect()
}

/// `marks` tells whether the track is to be predicted, and whether it is the interesting one.
fn row(case_id: &str, name: &str, frame: usize, track: &Track, state: &State, marks: [bool; 2]) -> [String; 14] {
    let [to_predict, interesting] = marks.map(|is_marked| u8::from(is_marked).to_string());
    let [heading, length, width] = if is_vehicle(track) {
        let extent = track.extent_or_nominal();
        [number(state.heading_rad), number(extent.length_m), number(extent.width_m)]
    } else {
        Default::default()
    };
    [
        case_id.to_owned(),
        name.to_owned(),
        frame.to_string(),
        (100 * frame).to_string(),
        if is_vehicle(track) { "car" } else { "pedestrian/bicycle" }.to_owned(),
        number(state.position.x),
        number(state.position.y),
        number(state.velocity.x),
        number(state.velocity.y),
        heading,
        length,
        width,
        to_predict,
        interesting,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::{self, add_all, assert_same_states, read};
    use crate::ingest::{IngestConfig, MapsConfig, scenes_of};
    use crate::scene::{Dataset, TrackId};

    fn written(scenes: &[Scene]) -> (tempfile::TempDir, Vec<std::result::Result<Written, &'static str>>) {
        let dir = tempfile::tempdir().unwrap();
        let outcomes = add_all(Box::new(Interaction::new(dir.path())), scenes);
        (dir, outcomes)
    }

    #[test]
    fn rows_are_those_of_the_dataset() {
        let (dir, outcomes) = written(&[testing::scene(), testing::scene()]);
        let text = read(dir.path(), "train/Test_train.csv");
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], HEADER.join(","));
        // 12 + 11 + 11 states a case; four observed timesteps end at frame 10.
        assert_eq!(lines.len(), 1 + 2 * (12 + 11 + 11));
        assert_eq!(lines[1], "1.0,1,7,700,car,1000,2000,0,10,1.570796327,4.5,1.8,1,1");
        assert_eq!(lines[12], "1.0,1,18,1800,car,1000,2011,0,10,1.570796327,4.5,1.8,1,1");
        assert_eq!(lines[13], "1.0,2,8,800,car,997,2001,0,10,1.570796327,4.5,1.8,1,0");
        // Left of north is west.
        assert_eq!(lines[24], "1.0,P3,7,700,pedestrian/bicycle,1000,2005,-1,0,,,,0,0");
        assert_eq!(lines[26], "1.0,P3,10,1000,pedestrian/bicycle,999.7,2005,-1,0,,,,0,0");
        assert!(lines[35].starts_with("2.0,1,7,700,"));
        let second = outcomes[1].as_ref().unwrap();
        assert_eq!((second.file.as_str(), second.name.as_str()), ("train/Test_train.csv", "2.0"));
        assert!(second.assumed.iter().all(|(_, n)| *n == 0), "{:?}", second.assumed);
    }

    #[test]
    fn what_the_format_does_not_know_is_counted() {
        let mut scene = testing::scene();
        scene.source.dataset = Dataset::Argoverse1;
        scene.tracks[0].id = TrackId::from("a-b");
        scene.tracks[0].extent = None;
        scene.tracks[1].class = AgentClass::Static;
        let mut slow = testing::scene();
        slow.dt_s = 0.2;
        // Twelve observed timesteps, ten of which fit into a case.
        let mut late = testing::scene();
        late.n_history = 12;
        let (dir, outcomes) = written(&[scene, slow, late]);
        let first = outcomes[0].as_ref().unwrap();
        assert_eq!(first.tracks, [Ok("1".to_owned()), Err("static_object"), Ok("P3".to_owned())]);
        assert_eq!(first.assumed, [("nominal_size", 1), ("cut_to_window", 0), ("renumbered_track", 1)]);
        assert!(
            read(dir.path(), "train/Test_train.csv")
                .contains("\n1.0,1,7,700,car,1000,2000,0,10,1.570796327,4.6,1.9,1,1\n")
        );
        assert_eq!(outcomes[1].as_ref().err(), Some(&"not_10_hz"));
        let third = outcomes[2].as_ref().unwrap();
        assert_eq!((third.first_timestep, third.assumed[1]), (2, ("cut_to_window", 2)));
    }

    #[test]
    fn our_own_reader_finds_the_same_states() {
        let scene = testing::scene();
        let (dir, _) = written(std::slice::from_ref(&scene));
        let config = IngestConfig {
            maps: MapsConfig::None,
            ..IngestConfig::new(Dataset::Interaction, vec![dir.path().to_owned()])
        };
        let (found, _) = scenes_of(&config).unwrap();
        assert_eq!(found.len(), 1);
        let read = &found[0];
        assert_eq!((read.source.place.as_str(), read.source.split), ("Test", scene.source.split));
        assert_eq!((read.n_timesteps, read.n_history, read.tracks.len()), (40, 10, 3));
        for (agent_idx, track) in scene.tracks.iter().enumerate() {
            let same = read.track_idx(&track.id).unwrap();
            assert_eq!(read.tracks[same].extent, track.extent);
            assert_same_states((&scene, agent_idx), (read, same), 6, [2e-6; 2]);
        }
    }
}
