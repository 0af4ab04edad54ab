//! The scenes of a unit: the one of a case, or the windows of a recording.

use super::cases::plain_case_id;
use super::columns::TrackColumns;
use super::path::TrackFile;
use super::track::{RecordedTrack, TrackTable, read_tracks};
use super::{CASE_HORIZON, DT_S};
use crate::ingest::csv_rows::without_end;
use crate::ingest::{Horizon, IngestConfig, PendingScene, RawScene, RawUnit, Reject, UnitSplit, map_id};
use crate::scene::{Dataset, SceneId, SceneSource, Split};
use std::sync::Arc;

/// Longest recording, 28 hours: frames further apart are a fault.
const MAX_RECORDING_FRAMES: i64 = 1_000_000;

/// The share of a v1.1 recording that is held out as val, its last one: as much as the v1.2 release holds out of its
/// cases.
const HOLDOUT_SHARE: f64 = 0.2;

/// The scene of a v1.2 case.
///
/// The present is the tenth frame of the case, so a shorter history begins later. A case without frames after the
/// present, as in test sets, has only the history.
pub(super) fn case(unit: &RawUnit, horizon: Horizon) -> Result<RawScene, Reject> {
    let columns = TrackColumns::of(&unit.header, false).map_err(|detail| unit.reject("bad_header", detail))?;
    let table =
        TrackTable { file: &unit.file, columns, rows: &unit.bytes, first_line: unit.first_line, lines: &unit.lines };
    let tracks = read_tracks(&[table])?;
    let Some((min_frame, max_frame)) = frames(&tracks) else {
        return Err(unit.reject_at("no_rows", unit.first_line, format!("case {} has no rows", unit.case_id)));
    };
    // Frames are numbered from 1 in each case. Others, of tools that keep the numbers of the recording, begin with the
    // first agent.
    let n_case_frames = CASE_HORIZON.n_timesteps() as i64;
    let is_numbered_from_one = 1 <= min_frame && max_frame <= n_case_frames;
    let first_of_case = if is_numbered_from_one { 1 } else { min_frame };
    if max_frame - first_of_case >= n_case_frames {
        let detail =
            format!("case {} has frames {min_frame} to {max_frame}, expected at most {n_case_frames}", unit.case_id);
        return Err(unit.reject_at("frame_out_of_range", unit.first_line, detail));
    }
    let first_future = first_of_case + CASE_HORIZON.n_history as i64;
    let first_frame = first_future - horizon.n_history as i64;
    let n_timesteps = if max_frame < first_future { horizon.n_history } else { horizon.n_timesteps() };

    let split = match unit.split {
        UnitSplit::All(split) => split,
        UnitSplit::Divided => Split::Unsplit,
    };
    let plain_id = plain_case_id(unit.case_id.as_bytes());
    let case = match TrackFile::of(&unit.container, &unit.file).and_then(|file| file.test_set) {
        Some(test_set) => format!("{test_set}:{plain_id}"),
        None => plain_id,
    };
    let cut = Cut { unit, split, case, first_frame, n_timesteps, n_history: horizon.n_history };
    Ok(cut.scene(&tracks, 0..tracks.len()))
}

/// The windows of a v1.1 recording: `window_stride` apart, whole ones only.
///
/// If no split is named, the last fifth of the recording is val and the rest is train. Windows across the cut
/// are rejects, and so are windows without tracks. The text is dropped before the first window is made.
pub(super) fn windows(mut unit: RawUnit, horizon: Horizon, config: &IngestConfig) -> Vec<PendingScene<'static>> {
    let rejected = |reject: Reject| -> Vec<PendingScene<'static>> { vec![Box::new(|| Err(reject))] };
    let tracks = match recording_tables(&unit).and_then(|tables| read_tracks(&tables)) {
        Ok(tracks) => tracks,
        Err(reject) => return rejected(reject),
    };
    (unit.bytes, unit.companion) = (Vec::new(), None);
    let Some((min_frame, max_frame)) = frames(&tracks) else {
        return rejected(unit.reject("no_rows", "the recording has no rows"));
    };
    let n_frames = max_frame - min_frame + 1;
    let (stride, n_timesteps) = (config.window_stride.max(1) as i64, horizon.n_timesteps());
    if n_frames > MAX_RECORDING_FRAMES {
        let detail = format!("frames {min_frame} to {max_frame}, expected at most {MAX_RECORDING_FRAMES}");
        return rejected(unit.reject("frame_out_of_range", detail));
    }
    let n_windows = (n_frames - n_timesteps as i64).div_euclid(stride) + 1;
    if n_windows <= 0 {
        let detail = format!("{n_frames} frames, a scene has {n_timesteps}");
        return rejected(unit.reject("recording_too_short", detail));
    }

    let n_holdout_frames = (HOLDOUT_SHARE * n_frames as f64).round() as i64;
    let first_holdout_frame = max_frame + 1 - n_holdout_frames;
    let present = tracks_by_window(&tracks, min_frame, n_windows, stride, n_timesteps as i64);
    let recording = Arc::new(Recording { unit, tracks, horizon, first_holdout_frame });
    let window = |(index, present): (usize, Vec<usize>)| -> PendingScene<'static> {
        let recording = Arc::clone(&recording);
        Box::new(move || recording.window(min_frame + index as i64 * stride, present))
    };
    present.into_iter().enumerate().map(window).collect()
}

/// The tracks of a whole recording.
struct Recording {
    /// Where they come from, without the text.
    unit: RawUnit,
    tracks: Vec<RecordedTrack>,
    horizon: Horizon,
    first_holdout_frame: i64,
}

impl Recording {
    /// The scene that begins at `first_frame`, of the tracks that are `present`.
    fn window(&self, first_frame: i64, present: Vec<usize>) -> Result<RawScene, Reject> {
        let Self { unit, first_holdout_frame, .. } = self;
        let n_timesteps = self.horizon.n_timesteps();
        let end_frame = first_frame + n_timesteps as i64;
        let reject = |reason, detail: &str| {
            Err(unit.reject(reason, format!("frames {first_frame} to {}{detail}", end_frame - 1)))
        };
        let split = match unit.split {
            UnitSplit::All(split) => split,
            UnitSplit::Divided if end_frame <= *first_holdout_frame => Split::Train,
            UnitSplit::Divided if first_frame >= *first_holdout_frame => Split::Val,
            UnitSplit::Divided => {
                return reject("window_across_holdout", &format!(": val begins at {first_holdout_frame}"));
            }
        };
        if present.is_empty() {
            return reject("empty_window", ": nobody is tracked");
        }
        let case = format!("{}@{first_frame}", unit.case_id);
        let cut = Cut { unit, split, case, first_frame, n_timesteps, n_history: self.horizon.n_history };
        Ok(cut.scene(&self.tracks, present))
    }
}

/// The vehicles' and the pedestrians' tables of a recording.
fn recording_tables(unit: &RawUnit) -> Result<Vec<TrackTable<'_>>, Reject> {
    let companion = unit.companion.iter().map(|companion| (companion.file.as_str(), companion.bytes.as_slice()));
    std::iter::once((unit.file.as_str(), unit.bytes.as_slice()))
        .chain(companion)
        .map(|(file, bytes)| {
            let end = bytes.iter().position(|byte| *byte == b'\n').map_or(bytes.len(), |at| at + 1);
            let (header, rows) = bytes.split_at(end);
            // The headers were checked when the files were read, with the name of the file in mind.
            let columns = TrackColumns::of(without_end(header), true)
                .map_err(|detail| Reject { reason: "bad_header", detail: format!("{file}: {detail}") })?;
            Ok(TrackTable { file, columns, rows, first_line: 2, lines: &[] })
        })
        .collect()
}

/// First and last frame of all tracks.
fn frames(tracks: &[RecordedTrack]) -> Option<(i64, i64)> {
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
struct Cut<'a> {
    unit: &'a RawUnit,
    split: Split,
    /// The last part of the scene's id.
    case: String,
    first_frame: i64,
    n_timesteps: usize,
    n_history: usize,
}

impl Cut<'_> {
    /// The scene with those of `tracks` at `present` that are tracked at any time in it.
    fn scene(self, tracks: &[RecordedTrack], present: impl IntoIterator<Item = usize>) -> RawScene {
        let Self { unit, split, case, first_frame, n_timesteps, n_history } = self;
        let cut = |index: usize| tracks[index].cut(first_frame, n_timesteps, n_history);
        let dataset = Dataset::Interaction;
        RawScene {
            id: SceneId(format!("{}/{}/{}/{case}", dataset.name(), split.name(), unit.place)),
            source: SceneSource {
                dataset,
                version: unit.version.to_owned(),
                split,
                place: unit.place.clone(),
                file: unit.file.clone(),
                case_id: unit.case_id.clone(),
                first_frame: first_frame.to_string(),
            },
            dt_s: DT_S,
            n_timesteps,
            n_history,
            tracks: present.into_iter().filter_map(cut).collect(),
            heading_gaps: Vec::new(),
            map_id: map_id(dataset, &unit.place),
            own_map: None,
            findings: Vec::new(),
        }
    }
}
