//! How much traffic do scenes show, each moment once?

use super::spans::Spans;
use super::{CLASSES, ExposureRow};
use crate::scene::{Scene, SceneId, SceneSource, SituationKind, Track, TrackId, moments};
use std::collections::{BTreeMap, HashMap};

/// One in so many marks of moments is kept, by the mark itself, so that two recordings of a moment keep the same ones.
const KEPT_MARKS: u64 = 4;
/// From so many kept moments in common on, at the same distance in time, two recordings show the same time.
const MOMENTS_IN_COMMON: u32 = 2;

/// What one scene shows, found from the scene alone.
#[derive(Debug, Clone)]
pub struct SceneExposure {
    pub(super) id: SceneId,
    pub(super) dt_s: f64,
    n_timesteps: usize,
    source: SceneSource,
    marks: Vec<(usize, u64)>,
    tracks: Vec<Shown>,
}

/// A track: its name, its class among [`CLASSES`], and its timesteps with the speed at each, m/s.
type Shown = (TrackId, usize, Vec<(usize, f64)>);

impl SceneExposure {
    /// The moments of a scene; per track of a class that counts, its timesteps with the speed at each.
    pub fn of(scene: &Scene) -> Self {
        let track = |track: &Track| {
            let class = CLASSES.iter().position(|class| *class == track.class)?;
            let speeds = track.trajectory.valid().map(|(timestep, state)| (timestep, state.speed_mps()));
            Some((track.id.clone(), class, speeds.collect()))
        };
        let marks = moments(scene).into_iter().filter(|(_, mark)| mark % KEPT_MARKS == 0).collect();
        Self {
            id: scene.id.clone(),
            dt_s: scene.dt_s,
            n_timesteps: scene.n_timesteps,
            source: scene.source.clone(),
            marks,
            tracks: scene.tracks.iter().filter_map(track).collect(),
        }
    }
}

/// A scene as a part of its recording.
#[derive(Debug, Clone, Copy)]
pub struct ShownScene {
    /// The recording's position among the rows of the tally.
    pub recording: usize,
    /// The scene's first frame in the recording.
    pub first_frame: i64,
    /// Time that it shows and no scene before it does, hours.
    pub new_h: f64,
}

/// Adds up what scenes show. The windows of a recording must come by time.
#[derive(Debug, Default)]
pub struct ExposureTally {
    recordings: Vec<Recording>,
    by_name: HashMap<String, usize>,
    /// Where each kept mark was seen first: recording and frame.
    marks: HashMap<u64, (usize, i64)>,
}

#[derive(Debug)]
struct Recording {
    row: ExposureRow,
    frames: Spans,
    /// The frame until which each track was counted, of the tracks of the last window.
    counted_until: HashMap<TrackId, i64>,
    /// How many moments it has in common with another recording, by that recording and the distance of their frames.
    in_common: BTreeMap<(usize, i64), u32>,
}

impl Recording {
    /// The recordings that show the same time, with what leads from its frames to theirs.
    fn same_time(&self) -> impl Iterator<Item = (usize, i64)> {
        self.in_common.iter().filter(|(_, n)| **n >= MOMENTS_IN_COMMON).map(|(other, _)| *other)
    }
}

impl ExposureTally {
    /// Adds a scene. `None` if it was not recorded: what closed loops led to has no rate.
    pub fn add(&mut self, scene: &SceneExposure) -> Option<ShownScene> {
        if scene.source.situation != SituationKind::Recorded {
            return None;
        }
        let (name, first_frame) = SceneId::window_of(&scene.id.0).unwrap_or((&scene.id.0, 0));
        let idx = match self.by_name.get(name) {
            Some(idx) => *idx,
            None => self.begin(name, &scene.source),
        };
        self.compare(idx, first_frame, &scene.marks);
        let frames = first_frame..first_frame + scene.n_timesteps as i64;
        let is_new: Vec<bool> = frames.clone().map(|frame| !self.is_elsewhere(idx, frame)).collect();
        let recording = &mut self.recordings[idx];
        let hours = scene.dt_s / 3600.0;
        let n_shown =
            frames.clone().zip(&is_new).filter(|(frame, is_new)| **is_new && !recording.frames.contains(*frame));
        let new_h = n_shown.count() as f64 * hours;
        recording.row.observed_h += new_h;
        recording.row.n_scenes += 1;
        // Later windows begin later: who ended before this one is not met again.
        recording.counted_until.retain(|_, until| *until > first_frame);
        for (track, class, speeds) in &scene.tracks {
            let until = recording.counted_until.get(track).copied().unwrap_or(i64::MIN);
            for (timestep, speed_mps) in speeds {
                if is_new[*timestep] && first_frame + *timestep as i64 >= until {
                    recording.row.class_h[*class] += hours;
                    recording.row.class_km[*class] += speed_mps * hours * 3.6;
                }
            }
            if let Some((last, _)) = speeds.last().filter(|_| name.len() < scene.id.0.len()) {
                let until = until.max(first_frame + *last as i64 + 1);
                recording.counted_until.insert(track.clone(), until);
            }
        }
        recording.frames.add(frames);
        Some(ShownScene { recording: idx, first_frame, new_h })
    }

    /// Whether an earlier recording shows this frame as well.
    pub fn is_elsewhere(&self, recording: usize, frame: i64) -> bool {
        let shows = |(other, distance): (usize, i64)| self.recordings[other].frames.contains(frame + distance);
        self.recordings[recording].same_time().any(shows)
    }

    /// One row a recording, in the order of their first scenes.
    pub fn rows(&self) -> Vec<ExposureRow> {
        let links = || {
            let of = |(idx, recording): (usize, &Recording)| -> Vec<(usize, usize)> {
                recording.same_time().map(|(other, _)| (idx, other)).collect()
            };
            self.recordings.iter().enumerate().flat_map(of)
        };
        let mut first: Vec<usize> = (0..self.recordings.len()).collect();
        while let Some((idx, other)) = links().find(|(idx, other)| first[*idx] != first[*other]) {
            let (least, most) = (first[idx].min(first[other]), first[idx].max(first[other]));
            first.iter_mut().filter(|first| **first == most).for_each(|first| *first = least);
        }
        let row = |(idx, recording): (usize, &Recording)| {
            let first = Some(first[idx]).filter(|first| *first < idx);
            let shares_with = first.map(|first| self.recordings[first].row.recording.clone());
            ExposureRow { shares_with, ..recording.row.clone() }
        };
        self.recordings.iter().enumerate().map(row).collect()
    }

    fn begin(&mut self, name: &str, source: &SceneSource) -> usize {
        let row = ExposureRow {
            dataset: source.dataset,
            place: source.place.clone(),
            split: source.split,
            recording: name.to_owned(),
            shares_with: None,
            n_scenes: 0,
            observed_h: 0.0,
            class_h: [0.0; CLASSES.len()],
            class_km: [0.0; CLASSES.len()],
        };
        let idx = self.recordings.len();
        self.by_name.insert(name.to_owned(), idx);
        self.recordings.push(Recording {
            row,
            frames: Spans::default(),
            counted_until: HashMap::new(),
            in_common: BTreeMap::new(),
        });
        idx
    }

    /// Compares moments of a scene with those that were seen before.
    fn compare(&mut self, idx: usize, first_frame: i64, marks: &[(usize, u64)]) {
        for (timestep, mark) in marks {
            let frame = first_frame + *timestep as i64;
            let (other, at) = *self.marks.entry(*mark).or_insert((idx, frame));
            if other != idx && !self.recordings[idx].frames.contains(frame) {
                *self.recordings[idx].in_common.entry((other, at - frame)).or_default() += 1;
            }
        }
    }
}

#[cfg(test)]
mod tests;
