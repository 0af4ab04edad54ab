//! The scenes of a unit: the scene of a case, or the windows of a recording.

use super::CASE_HORIZON;
use super::cases::plain_case_id;
use super::columns::TrackColumns;
use super::path::TrackFile;
use super::track::{TrackTable, read_tracks};
use crate::ingest::csv_rows::without_end;
use crate::ingest::raw::MAX_BAD_SHARE;
use crate::ingest::windows::{Cut, Recording, frames};
use crate::ingest::{Horizon, IngestConfig, PendingScene, RawScene, RawUnit, Reject};
use crate::scene::Dataset;

/// The scene of a v1.2 case.
///
/// The present is the tenth frame of the case, so a shorter history begins later. A case without frames after the
/// present, as in test sets, has only the history.
pub(super) fn case(unit: &RawUnit, horizon: Horizon) -> Result<RawScene, Reject> {
    let columns = TrackColumns::of(&unit.header, false).map_err(|detail| unit.reject("bad_header", detail))?;
    let table = TrackTable { file: &unit.file, columns, rows: &unit.bytes, first_line: unit.first_line };
    // A case is 4 s long: whatever is wrong in it costs it.
    let (tracks, findings) = read_tracks(&[table], 0.0)?;
    let Some((min_frame, max_frame)) = frames(&tracks) else {
        return Err(unit.reject_at("no_rows", unit.first_line, format!("case {} has no rows", unit.case_id)));
    };
    // Frames are numbered from 1 in each case. Tables of tools that keep the numbers of the recording begin with the
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

    let plain_id = plain_case_id(unit.case_id.as_bytes());
    let case = match TrackFile::of(&unit.container, &unit.file).and_then(|file| file.test_set) {
        Some(test_set) => format!("{test_set}:{plain_id}"),
        None => plain_id,
    };
    let dataset = Dataset::Interaction;
    let split = unit.split.of_scene();
    let cut = Cut { dataset, unit, split, case, first_frame, n_timesteps, n_history: horizon.n_history };
    Ok(RawScene { findings, ..cut.scene(&tracks, 0..tracks.len()) })
}

/// The windows of a v1.1 recording. The text is dropped before the first window is made.
pub(super) fn windows(mut unit: RawUnit, horizon: Horizon, config: &IngestConfig) -> Vec<PendingScene<'static>> {
    let (tracks, findings) = match recording_tables(&unit).and_then(|tables| read_tracks(&tables, MAX_BAD_SHARE)) {
        Ok(read) => read,
        Err(reject) => return vec![Box::new(|| Err(reject))],
    };
    (unit.bytes, unit.companion) = (Vec::new(), None);
    Recording { dataset: Dataset::Interaction, unit, tracks, findings }.windows(horizon, config)
}

/// The vehicles' and the pedestrians' tables of a recording.
fn recording_tables(unit: &RawUnit) -> Result<Vec<TrackTable<'_>>, Reject> {
    let companion = unit.companion.iter().map(|companion| (companion.file.as_str(), companion.bytes.as_slice()));
    std::iter::once((unit.file.as_str(), unit.bytes.as_slice()))
        .chain(companion)
        .map(|(file, bytes)| {
            let end = bytes.iter().position(|byte| *byte == b'\n').map_or(bytes.len(), |at| at + 1);
            let (header, rows) = bytes.split_at(end);
            // The headers were checked when the files were read, with the names of the files.
            let columns = TrackColumns::of(without_end(header), true)
                .map_err(|detail| Reject { reason: "bad_header", detail: format!("{file}: {detail}") })?;
            Ok(TrackTable { file, columns, rows, first_line: 2 })
        })
        .collect()
}
