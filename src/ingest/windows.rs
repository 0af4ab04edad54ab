//! The scenes of a long recording: windows of equal length, cut from its tracks.

use super::config::IngestConfig;
use super::raw::{Finding, HeadingGap, RawScene, RawUnit, Reject, UnitSplit, map_id};
use super::recorded_track::{DT_S, RecordedTrack};
use super::source::{Horizon, PendingScene};
use crate::scene::{Dataset, SceneId, Split, Track};
use std::sync::Arc;

/// The longest recording, 28 hours: frames further apart are an error.
pub(super) const MAX_RECORDING_FRAMES: i64 = 1_000_000;

/// The tracks of a whole recording.
pub(super) struct Recording {
    pub(super) dataset: Dataset,
    /// The unit they come from, without the text.
    pub(super) unit: RawUnit,
    pub(super) tracks: Vec<RecordedTrack>,
    /// Doubts about it; reported with its first scene.
    pub(super) findings: Vec<Finding>,
}

impl Recording {
    /// Its windows, [`IngestConfig::window_stride`] apart, whole ones only.
    ///
    /// If no split is named, the last [`IngestConfig::holdout_share`] of the recording is val and the rest is train.
    /// Windows across the cut are rejects, and so are windows without tracks.
    pub(super) fn windows(mut self, horizon: Horizon, config: &IngestConfig) -> Vec<PendingScene<'static>> {
        let of_recording = std::mem::take(&mut self.findings);
        let rejected = |mut reject: Reject| -> Vec<PendingScene<'static>> {
            reject.explain(&of_recording);
            vec![Box::new(|| Err(reject))]
        };
        let part = self.unit.part.clone();
        let of_table = part.as_ref().map(|part| part.frames);
        let Some((min_frame, max_frame)) = of_table.or_else(|| frames(&self.tracks)) else {
            return rejected(self.unit.reject("no_rows", "the recording has no rows"));
        };
        let n_frames = max_frame - min_frame + 1;
        let (stride, n_timesteps) = (config.window_stride.max(1) as i64, horizon.n_timesteps());
        if n_frames > MAX_RECORDING_FRAMES {
            let detail = format!("frames {min_frame} to {max_frame}, expected at most {MAX_RECORDING_FRAMES}");
            return rejected(self.unit.reject("frame_out_of_range", detail));
        }
        let n_windows = (n_frames - n_timesteps as i64).div_euclid(stride) + 1;
        if n_windows <= 0 {
            let in_units = match self.dataset {
                Dataset::Table => "; are ingest.table.time_unit_s and frame_rate_hz right?",
                _ => "",
            };
            let detail = horizon.too_long_for(n_frames, "frames") + in_units;
            return rejected(self.unit.reject("recording_too_short", detail));
        }

        let n_holdout_frames = (config.holdout_share * n_frames as f64).round() as i64;
        let first_holdout_frame = max_frame + 1 - n_holdout_frames;
        let windows = part.map_or(0..n_windows, |part| part.windows.clone());
        let first_frame = min_frame + windows.start * stride;
        let n_windows = windows.end - windows.start;
        let present = tracks_by_window(&self.tracks, first_frame, n_windows, stride, n_timesteps as i64);
        let mut findings = of_recording;
        let is_divided = self.unit.split == UnitSplit::Divided;
        let recording = Arc::new(self);
        let window = |(index, present): (usize, Vec<usize>)| -> PendingScene<'static> {
            let recording = Arc::clone(&recording);
            let first_frame = first_frame + index as i64 * stride;
            let is_across =
                is_divided && (first_frame + 1..first_frame + n_timesteps as i64).contains(&first_holdout_frame);
            let findings = if present.is_empty() || is_across { Vec::new() } else { std::mem::take(&mut findings) };
            Box::new(move || {
                let scene = recording.window(first_frame, horizon, first_holdout_frame, present)?;
                Ok(RawScene { findings, ..scene })
            })
        };
        present.into_iter().enumerate().map(window).collect()
    }

    /// The scene that begins at `first_frame`, with the tracks that are `present`.
    fn window(
        &self,
        first_frame: i64,
        horizon: Horizon,
        first_holdout_frame: i64,
        present: Vec<usize>,
    ) -> Result<RawScene, Reject> {
        let Self { dataset, unit, .. } = self;
        let n_timesteps = horizon.n_timesteps();
        let end_frame = first_frame + n_timesteps as i64;
        let reject = |reason, detail: &str| {
            Err(unit.reject(reason, format!("frames {first_frame} to {}{detail}", end_frame - 1)))
        };
        let split = match unit.split {
            UnitSplit::All(split) => split,
            UnitSplit::Divided if end_frame <= first_holdout_frame => Split::Train,
            UnitSplit::Divided if first_frame >= first_holdout_frame => Split::Val,
            UnitSplit::Divided => {
                return reject("window_across_holdout", &format!(": val begins at {first_holdout_frame}"));
            }
        };
        if present.is_empty() {
            return reject("empty_window", ": nobody is tracked");
        }
        let case = format!("{}@{first_frame}", unit.case_id);
        let cut = Cut { dataset: *dataset, unit, split, case, first_frame, n_timesteps, n_history: horizon.n_history };
        Ok(cut.scene(&self.tracks, present))
    }
}

/// First and last frame of all tracks.
pub(super) fn frames(tracks: &[RecordedTrack]) -> Option<(i64, i64)> {
    tracks.iter().filter_map(RecordedTrack::frames).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}

/// The tracks whose frames reach into each window, in their order.
fn tracks_by_window(
    tracks: &[RecordedTrack],
    min_frame: i64,
    n_windows: i64,
    stride: i64,
    n_timesteps: i64,
) -> Vec<Vec<usize>> {
    let mut present = vec![Vec::new(); usize::try_from(n_windows).unwrap_or(0)];
    for (index, track) in tracks.iter().enumerate() {
        let Some((first, last)) = track.frames() else { continue };
        let first_window = (first - min_frame - n_timesteps).div_euclid(stride) + 1;
        let last_window = (last - min_frame).div_euclid(stride);
        for window in first_window.max(0)..=last_window.min(n_windows - 1) {
            present[window as usize].push(index);
        }
    }
    present
}

/// A stretch of a unit that is a scene.
pub(super) struct Cut<'a> {
    pub(super) dataset: Dataset,
    pub(super) unit: &'a RawUnit,
    pub(super) split: Split,
    /// The last part of the scene's id.
    pub(super) case: String,
    pub(super) first_frame: i64,
    pub(super) n_timesteps: usize,
    pub(super) n_history: usize,
}

impl Cut<'_> {
    /// The scene with the tracks among `present` that are tracked at any time in it.
    pub(super) fn scene(self, tracks: &[RecordedTrack], present: impl IntoIterator<Item = usize>) -> RawScene {
        let Self { dataset, unit, split, case, first_frame, n_timesteps, n_history } = self;
        let cut = |index: usize| {
            let track = tracks[index].cut(first_frame, n_timesteps, n_history)?;
            let trajectory = match dataset.facts().has_velocities {
                true => track.trajectory,
                false => track.trajectory.with_velocities_from_positions(n_history, DT_S),
            };
            Some((Track { trajectory, ..track }, tracks[index].never_moves))
        };
        let (tracks, never_move): (Vec<Track>, Vec<Option<f64>>) = present.into_iter().filter_map(cut).unzip();
        let gap = |(track_idx, never_moves): (usize, Option<f64>)| {
            never_moves.map(|_| HeadingGap { track_idx, until_timestep: n_timesteps, never_moves })
        };
        RawScene {
            id: SceneId(format!("{}/{}/{}/{case}", dataset.name(), split.name(), unit.place)),
            source: unit.source(dataset, split, unit.place.clone(), unit.case_id.clone(), first_frame.to_string()),
            dt_s: DT_S,
            n_timesteps,
            n_history,
            tracks,
            heading_gaps: never_move.into_iter().enumerate().filter_map(gap).collect(),
            map_id: map_id(dataset, &unit.place),
            own_map: None,
            findings: Vec::new(),
        }
    }
}
