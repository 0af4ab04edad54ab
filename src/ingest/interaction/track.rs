//! Which tracks does a table hold, in the frames of the recording?

use super::CASE_HORIZON;
use super::columns::Columns;
use super::row::{Flaw, Row};
use crate::geometry::{Vec2, wrap_angle};
use crate::ingest::Reject;
use crate::ingest::csv_rows::lines_of;
use crate::scene::{AgentClass, Extent, State, Track, TrackId, TrackRole, Trajectory};
use std::collections::BTreeMap;

/// Slower than this, the direction of a velocity is noise: the heading is held.
const MIN_HEADING_SPEED_MPS: f64 = 0.5;

/// Rows of one file.
pub(super) struct Table<'a> {
    /// The file, as rejects name it.
    pub(super) file: &'a str,
    pub(super) columns: Columns,
    pub(super) rows: &'a [u8],
    /// Line of the file at which `rows` begin.
    pub(super) first_line: u64,
}

/// One agent over all frames in which it was tracked.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct RecordedTrack {
    id: TrackId,
    class: AgentClass,
    role: TrackRole,
    extent: Option<Extent>,
    /// By ascending frame.
    states: Vec<(i64, State)>,
    /// First frame whose heading is known, where the recording gives none and the vehicle stands at first.
    heading_from: Option<i64>,
}

/// Reads the tracks of all tables in order of their first rows.
///
/// A track is of one type; its size is that of its first row that has one, as size is not measured anew in every frame.
pub(super) fn read_tracks(tables: &[Table<'_>]) -> Result<Vec<RecordedTrack>, Reject> {
    let mut builders: Vec<Builder<'_>> = Vec::new();
    let mut by_id: BTreeMap<&[u8], usize> = BTreeMap::new();
    let mut cells = Vec::new();
    for table in tables {
        let mut current: Option<usize> = None;
        for (line, number) in lines_of(table.rows).zip(table.first_line..) {
            if line.is_empty() {
                continue;
            }
            let reject = |flaw: Flaw| reject_at(table.file, number, flaw);
            let row = Row::parse(line, &table.columns, &mut cells).map_err(reject)?;
            // Rows of a track usually stand together.
            let index = match current.filter(|index| builders[*index].id == row.track_id) {
                Some(index) => index,
                None => *by_id.entry(row.track_id).or_insert(builders.len()),
            };
            if index == builders.len() {
                if index == MAX_TRACKS {
                    return Err(reject(("too_many_tracks", format!("more than {MAX_TRACKS} tracks"))));
                }
                builders.push(Builder::new(&row).map_err(reject)?);
            }
            builders[index].add(&row, table.file, number).map_err(reject)?;
            current = Some(index);
        }
    }
    builders.into_iter().map(Builder::finish).collect()
}

fn reject_at(file: &str, line: u64, (reason, detail): Flaw) -> Reject {
    Reject { reason, detail: format!("{file}:{line}: {detail}") }
}

/// INTERACTION knows `car` (trucks and buses included) and `pedestrian/bicycle`; tools that write its format know more.
fn class_of(agent_type: &[u8]) -> Option<AgentClass> {
    match agent_type {
        b"car" | b"truck" => Some(AgentClass::Vehicle),
        b"bus" => Some(AgentClass::Bus),
        b"motorcycle" => Some(AgentClass::Motorcyclist),
        b"bicycle" => Some(AgentClass::Cyclist),
        b"pedestrian" => Some(AgentClass::Pedestrian),
        b"pedestrian/bicycle" => Some(AgentClass::PedestrianOrCyclist),
        _ => None,
    }
}

/// Most tracks of a recording; each takes some kilobytes while it is read, and real ones have thousands.
const MAX_TRACKS: usize = 100_000;

/// A track that is being read.
struct Builder<'a> {
    id: &'a [u8],
    agent_type: &'a [u8],
    class: AgentClass,
    extent: Option<Extent>,
    is_interesting: bool,
    is_to_predict: bool,
    observations: Vec<Observation<'a>>,
}

struct Observation<'a> {
    frame_id: i64,
    position: Vec2,
    velocity: Vec2,
    heading_rad: Option<f64>,
    file: &'a str,
    line: u64,
}

impl<'a> Builder<'a> {
    fn new(row: &Row<'a>) -> Result<Self, Flaw> {
        let class = class_of(row.agent_type).ok_or_else(|| {
            let found = String::from_utf8_lossy(row.agent_type).chars().take(40).collect::<String>();
            ("unknown_agent_type", format!("column agent_type is \"{}\"", found.escape_default()))
        })?;
        Ok(Self {
            id: row.track_id,
            agent_type: row.agent_type,
            class,
            extent: None,
            is_interesting: false,
            is_to_predict: false,
            observations: Vec::with_capacity(CASE_HORIZON.n_timesteps()),
        })
    }

    fn add(&mut self, row: &Row<'a>, file: &'a str, line: u64) -> Result<(), Flaw> {
        if row.agent_type != self.agent_type {
            let [was, is] = [self.agent_type, row.agent_type].map(String::from_utf8_lossy);
            let detail = format!("track {} is \"{was}\" and then \"{is}\"", String::from_utf8_lossy(self.id));
            return Err(("inconsistent_agent_type", detail.escape_debug().to_string()));
        }
        self.extent = self.extent.or(row.extent);
        self.is_interesting |= row.is_interesting;
        self.is_to_predict |= row.is_to_predict;
        let Row { frame_id, position, velocity, heading_rad, .. } = *row;
        self.observations.push(Observation { frame_id, position, velocity, heading_rad, file, line });
        Ok(())
    }

    fn finish(mut self) -> Result<RecordedTrack, Reject> {
        let id = String::from_utf8_lossy(self.id).into_owned();
        if !self.observations.is_sorted_by_key(|observation| observation.frame_id) {
            self.observations.sort_by_key(|observation| observation.frame_id);
        }
        let repeated = self.observations.windows(2).find(|pair| pair[0].frame_id == pair[1].frame_id);
        if let Some([_, again]) = repeated {
            let detail = format!("track {id} is at frame {} already", again.frame_id);
            return Err(reject_at(again.file, again.line, ("duplicate_frame", detail)));
        }
        let (states, heading_from) = states(&self.observations);
        Ok(RecordedTrack {
            id: TrackId(id),
            class: self.class,
            role: match (self.is_interesting, self.is_to_predict) {
                (true, _) => TrackRole::Focal,
                (false, true) => TrackRole::Scored,
                (false, false) => TrackRole::Context,
            },
            extent: self.extent,
            states,
            heading_from: heading_from.filter(|_| self.class.is_motorized()),
        })
    }
}

/// The states by frame, and the first frame with a known heading if that is not the first of all.
///
/// Where no heading is recorded it is the direction of the velocity, held while the agent is slow. An agent that is slow
/// from the start has the direction of its small velocity until then; looking ahead would tell the past of a scene in
/// which direction the agent is going to leave.
fn states(observations: &[Observation<'_>]) -> (Vec<(i64, State)>, Option<i64>) {
    let mut known_rad: Option<f64> = None;
    let mut n_unknown = 0;
    let mut states = Vec::with_capacity(observations.len());
    for Observation { frame_id, position, velocity, heading_rad, .. } in observations {
        let moving_rad = || (velocity.norm() >= MIN_HEADING_SPEED_MPS).then(|| velocity.angle());
        known_rad = heading_rad.map(wrap_angle).or_else(moving_rad).or(known_rad);
        n_unknown += usize::from(known_rad.is_none());
        let heading_rad = known_rad.unwrap_or_else(|| velocity.angle());
        states.push((*frame_id, State { position: *position, heading_rad, velocity: *velocity }));
    }
    let heading_from =
        (n_unknown > 0).then(|| observations.get(n_unknown).map_or(i64::MAX, |observation| observation.frame_id));
    (states, heading_from)
}

impl RecordedTrack {
    /// First and last frame.
    pub(super) fn frames(&self) -> Option<(i64, i64)> {
        Some((self.states.first()?.0, self.states.last()?.0))
    }

    /// The track in the `n_timesteps` frames from `first_frame` on; `None` where it was not tracked in any of them. Beside
    /// it, the first timestep with a known heading where that is not the first of all.
    pub(super) fn cut(&self, first_frame: i64, n_timesteps: usize) -> Option<(Track, Option<usize>)> {
        let timestep = |frame: i64| usize::try_from(frame - first_frame).ok();
        let begin = self.states.partition_point(|(frame, _)| *frame < first_frame);
        let mut entries = vec![None; n_timesteps];
        for (frame, state) in &self.states[begin..] {
            let Some(entry) = timestep(*frame).and_then(|timestep| entries.get_mut(timestep)) else { break };
            *entry = Some(*state);
        }
        if entries.iter().all(Option::is_none) {
            return None;
        }
        let track = Track {
            id: self.id.clone(),
            class: self.class,
            role: self.role,
            extent: self.extent,
            trajectory: Trajectory::new(entries),
        };
        let heading_from = self.heading_from.filter(|from| *from > first_frame);
        Some((track, heading_from.map(|from| timestep(from).map_or(n_timesteps, |from| from.min(n_timesteps)))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width";

    fn read(rows: &str) -> Result<Vec<RecordedTrack>, Reject> {
        let columns = Columns::of(HEADER.as_bytes(), false).unwrap();
        read_tracks(&[Table { file: "t.csv", columns, rows: rows.as_bytes(), first_line: 2 }])
    }

    /// In degrees.
    fn headings(track: &RecordedTrack) -> Vec<f64> {
        track.states.iter().map(|(_, state)| (state.heading_rad.to_degrees() * 1e3).round() / 1e3).collect()
    }

    #[test]
    fn tracks_are_in_order_of_appearance_and_their_states_in_order_of_time() {
        let rows = "9,3,300,car,3,0,1,0,0.1,4,2\r\n9,2,200,car,2,0,1,0,7.0,5,3\r\n\r\n1,2,200,car,0,0,0,0,0,4,2\r\n9,5,500,car,5,0,1,0,0.3,4,2";
        let tracks = read(rows).unwrap();
        assert_eq!(tracks.iter().map(|track| track.id.0.as_str()).collect::<Vec<_>>(), ["9", "1"]);
        assert_eq!(tracks[0].states.iter().map(|(frame, _)| *frame).collect::<Vec<_>>(), [2, 3, 5]);
        assert_eq!(headings(&tracks[0]), [41.07, 5.73, 17.189]);
        assert_eq!(tracks[0].extent, Some(Extent { length_m: 4.0, width_m: 2.0 }));

        let (track, gap) = tracks[0].cut(3, 4).unwrap();
        assert_eq!(
            track.trajectory.entries().iter().map(Option::is_some).collect::<Vec<_>>(),
            [true, false, true, false]
        );
        assert_eq!(gap, None);
        assert!(tracks[0].cut(6, 4).is_none() && tracks[1].cut(3, 4).is_none());
    }

    #[test]
    fn headings_follow_the_velocity_and_are_held_when_slow() {
        let row =
            |frame: i64, vx: f64, vy: f64| format!("P1,{frame},{}00,pedestrian/bicycle,0,0,{vx},{vy},,,\n", frame);
        let rows = [row(1, 0.0, 0.0), row(2, -0.1, 0.0), row(3, 0.0, 1.0), row(4, 0.3, 0.0), row(5, 2.0, 0.0)].concat();
        let tracks = read(&rows).unwrap();
        assert_eq!(headings(&tracks[0]), [0.0, 180.0, 90.0, 90.0, 0.0]);
        assert_eq!((tracks[0].extent, tracks[0].class), (None, AgentClass::PedestrianOrCyclist));
        // Pedestrians do not stand along lanes.
        assert_eq!(tracks[0].cut(1, 5).unwrap().1, None);
        // Vehicles do.
        let tracks = read(&rows.replace("pedestrian/bicycle", "car")).unwrap();
        assert_eq!(tracks[0].cut(1, 5).unwrap().1, Some(2));
        assert_eq!(tracks[0].cut(2, 3).unwrap().1, Some(1));
        assert_eq!(tracks[0].cut(3, 3).unwrap().1, None);
        assert_eq!(tracks[0].cut(1, 1).unwrap().1, Some(1));
    }

    #[test]
    fn flaws_are_rejects_with_file_and_line() {
        let good = "1,1,100,car,0,0,0,0,0,4,2\n";
        for (rows, reason, place) in [
            (format!("{good}1,2,200,car,0,0,0"), "malformed_row", "t.csv:3: 7 columns"),
            (format!("{good}1,2,200,car,nan,0,0,0,0,4,2"), "non_finite", "t.csv:3: column x"),
            (format!("{good}2,1,100,car,0,0,0,0,0,4,2\n{good}"), "duplicate_frame", "t.csv:4: track 1 is at frame 1"),
            (format!("{good}1,2,200,pedestrian,0,0,0,0,0,4,2"), "inconsistent_agent_type", "t.csv:3:"),
            ("1,1,100,tank,0,0,0,0,0,4,2".to_owned(), "unknown_agent_type", "t.csv:2: column agent_type is \\\"tank"),
        ] {
            let reject = read(&rows).unwrap_err();
            assert_eq!(reject.reason, reason);
            assert!(reject.detail.replace('"', "\\\"").starts_with(place), "{}", reject.detail);
        }
    }
}
