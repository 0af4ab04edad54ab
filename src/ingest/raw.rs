//! The steps between a file and a scene: units of raw bytes, scenes in the recording's frame, and rejects.

use crate::scene::{Dataset, LaneGraph, MapId, SceneId, SceneSource, SituationKind, Split, Track};
use std::collections::BTreeMap;
use std::fmt::Display;
use std::ops::{Range, RangeInclusive};
use std::path::PathBuf;
use std::sync::Arc;

/// The bytes that are parsed independently: one Argoverse file, one INTERACTION case, or one INTERACTION recording.
#[derive(Debug, Clone, Default)]
pub struct RawUnit {
    /// The file within its folder or archive, with `/` between parts.
    pub file: String,
    /// The folder or archive.
    pub container: PathBuf,
    /// The dataset's version or layout, such as `v1.1`; empty if there is only one.
    pub version: &'static str,
    /// The split by the name of the file or folder.
    pub split: UnitSplit,
    /// City or location; empty if it is only in the content.
    pub place: String,
    /// The case, sequence or recording within the dataset, as written.
    pub case_id: String,
    /// The header line of the table that `bytes` were cut from; empty if `bytes` hold the whole file.
    pub header: Arc<[u8]>,
    /// The content.
    pub bytes: Vec<u8>,
    /// Line of the file at which `bytes` begin, counted from 1.
    pub first_line: u64,
    /// The line of each row in `bytes` if the rows are scattered over the file; otherwise empty.
    pub lines: Vec<u64>,
    /// The part of a long table in `bytes`, unless they are all of it.
    pub part: Option<Arc<Part>>,
    /// A second file that belongs to the first: the pedestrians of a recording, the map of a scenario.
    pub companion: Option<Companion>,
}

/// A part of a long table: the rows of some of its scenes. Times are seconds after its frame 0.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// The unit of counting in messages: lines of text, or rows.
    pub counted: &'static str,
    /// The time of frame 0, as in the rows.
    pub start_s: f64,
    /// First and last frame of the whole table.
    pub frames: (i64, i64),
    /// The tracks of the table.
    pub tracks: Arc<BTreeMap<String, SeenTrack>>,
    /// Its windows among those of the table.
    pub windows: Range<i64>,
    /// The times whose rows are counted with this part.
    pub own_s: Range<f64>,
    /// The times of its rows, some of which adjacent parts have, too.
    pub rows_s: Range<f64>,
    /// Doubts about the whole table.
    pub findings: Vec<Finding>,
}

/// Facts about a track from all rows of a table.
#[derive(Debug, Clone, PartialEq)]
pub struct SeenTrack {
    /// Its place in the order of first rows.
    pub number: usize,
    /// When it is parked, seconds after frame 0.
    pub parked_s: Vec<RangeInclusive<f64>>,
    /// From when on its id is that of another agent, and why, by ascending time as in the rows, seconds.
    pub changes: Vec<(f64, Change)>,
    /// The times of rows that are out of place.
    pub jumps_s: Vec<f64>,
    /// The times of rows to which it leaps, and goes on from there.
    pub leaps_s: Vec<f64>,
    /// Where it pointed while it stood for long, each until a time, both as in the rows: seconds, and radians from x
    /// to y.
    pub stood_rad: Vec<(f64, f64)>,
}

/// Why an id is another agent's from some row on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Change {
    Size,
    Class,
    /// No vehicle comes there from where the agent was.
    Place,
    /// Nobody had it for long.
    Time,
}

/// The second file of a [`RawUnit`].
#[derive(Debug, Clone, Default)]
pub struct Companion {
    /// The file within its folder or archive.
    pub file: String,
    /// The content.
    pub bytes: Vec<u8>,
}

/// The split of a unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UnitSplit {
    /// All scenes of the unit are of this split.
    All(Split),
    /// The scenes of the unit are divided among splits when it is parsed.
    Divided,
}

impl UnitSplit {
    /// The split of a unit that is one scene.
    pub fn of_scene(self) -> Split {
        if let Self::All(split) = self { split } else { Split::Unsplit }
    }
}

impl Default for UnitSplit {
    fn default() -> Self {
        Self::All(Split::Unsplit)
    }
}

impl RawUnit {
    /// Bytes held in memory.
    pub fn n_bytes(&self) -> u64 {
        (self.bytes.len() + self.companion.as_ref().map_or(0, |companion| companion.bytes.len())) as u64
    }

    /// The source of a scene that is recorded in it.
    pub fn source(
        &self,
        dataset: Dataset,
        split: Split,
        place: String,
        case_id: String,
        first_frame: String,
    ) -> SceneSource {
        let (version, file) = (self.version.to_owned(), self.file.clone());
        let situation = SituationKind::Recorded;
        SceneSource { dataset, version, split, place, file, case_id, first_frame, situation, continues: None }
    }

    /// A reject of something in this unit at `line` of its file.
    pub fn reject_at(&self, reason: &'static str, line: u64, detail: impl Display) -> Reject {
        Reject { reason, detail: format!("{}:{line}: {detail}", self.file) }
    }

    /// A reject of the whole unit.
    pub fn reject(&self, reason: &'static str, detail: impl Display) -> Reject {
        Reject { reason, detail: format!("{}: {detail}", self.file) }
    }
}

/// A scene as recorded: tracks in the recording's frame, no ego, nothing left out.
#[derive(Debug, Clone)]
pub struct RawScene {
    /// Unique name.
    pub id: SceneId,
    /// Where it came from.
    pub source: SceneSource,
    /// Time between timesteps, seconds.
    pub dt_s: f64,
    /// Number of timesteps, history and future.
    pub n_timesteps: usize,
    /// Number of observed timesteps.
    pub n_history: usize,
    /// The tracks in the recording's frame, each with `n_timesteps` entries.
    pub tracks: Vec<Track>,
    /// Unknown headings, which are replaced by the direction of the lane.
    pub heading_gaps: Vec<HeadingGap>,
    /// The map of the scene.
    pub map_id: MapId,
    /// The map, if the scene brings its own; otherwise it is among those read beforehand.
    pub own_map: Option<Arc<LaneGraph>>,
    /// Doubts about it and its own map.
    pub findings: Vec<Finding>,
}

/// Something doubtful that is kept.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// A stable code that names the things, such as `lanes_turned_around`.
    pub what: &'static str,
    /// How many there are.
    pub n: u64,
    /// File and figures.
    pub detail: String,
}

/// A track that stands before it moves, in a recording without headings: headings before `until_timestep` are
/// placeholders.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeadingGap {
    /// Index of the track.
    pub track_idx: usize,
    /// First timestep with a known heading; the number of timesteps if there is none.
    pub until_timestep: usize,
    /// If the recording is long and the track never moves in it: how far the center is ahead of the positions, meters.
    /// Only a lane that it stands on tells its heading then.
    pub never_moves: Option<f64>,
}

/// The map of `dataset` for a place, city or scenario.
pub fn map_id(dataset: Dataset, key: &str) -> MapId {
    MapId(format!("{}/{key}", dataset.name()))
}

/// A recording is rejected if a larger share of its rows cannot be used; the rows of others are left out and named.
pub(super) const MAX_BAD_SHARE: f64 = 0.1;

/// A recording, or a scene of one, that was left out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reject {
    /// A stable code, such as `wrong_timestamp_count`.
    pub reason: &'static str,
    /// File, line and what is wrong there.
    pub detail: String,
}

impl Reject {
    /// Adds what was found before, and may explain it.
    pub(super) fn explain(&mut self, findings: &[Finding]) {
        for Finding { what, n, detail } in findings {
            self.detail.push_str(&format!("; {n} {}, the first: {detail}", what.replace('_', " ")));
        }
    }
}
