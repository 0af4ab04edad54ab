//! The tracks of a table.

use super::CASE_HORIZON;
use super::columns::TrackColumns;
use super::row::{Flaw, TrackRow};
use crate::ingest::Reject;
use crate::ingest::csv_rows::lines_of;
use crate::ingest::ids;
use crate::ingest::quotes::printable;
use crate::ingest::recorded_track::{Observation, RecordedTrack};
use crate::scene::{AgentClass, Extent, TrackId, TrackRole};
use std::collections::BTreeMap;

/// Rows of one file.
pub(super) struct TrackTable<'a> {
    /// The file, as rejects name it.
    pub(super) file: &'a str,
    pub(super) columns: TrackColumns,
    pub(super) rows: &'a [u8],
    /// Line of the file at which `rows` begin.
    pub(super) first_line: u64,
}

/// Reads the tracks of all tables in order of their first rows.
///
/// A track has one type. Its size is that of its first row with a size, because sizes are not measured in every frame.
pub(super) fn read_tracks(tables: &[TrackTable<'_>]) -> Result<Vec<RecordedTrack>, Reject> {
    let mut builders: Vec<Builder<'_>> = Vec::new();
    let mut by_id: BTreeMap<&[u8], usize> = BTreeMap::new();
    let mut cells = Vec::new();
    for table in tables {
        let mut current: Option<usize> = None;
        for (line, row_idx) in lines_of(table.rows).zip(0_u64..) {
            let number = table.first_line + row_idx;
            if line.is_empty() {
                continue;
            }
            let reject = |flaw: Flaw| reject_at(table.file, number, flaw);
            let row = TrackRow::parse(line, &table.columns, &mut cells).map_err(reject)?;
            // Rows of a track are usually adjacent.
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
    if let Some(pair) = ids::ambiguous(builders.iter().map(|builder| builder.id)).next() {
        let file = tables.first().map_or("", |table| table.file);
        return Err(Reject { reason: ids::AMBIGUOUS, detail: format!("{file}: {}", ids::in_words("track", pair)) });
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

/// Maximum number of tracks of a recording; each takes some kilobytes while it is read, and real recordings have
/// thousands.
const MAX_TRACKS: usize = 100_000;

/// A track that is being read.
struct Builder<'a> {
    id: &'a [u8],
    agent_type: &'a [u8],
    class: AgentClass,
    extent: Option<Extent>,
    is_interesting: bool,
    is_to_predict: bool,
    observations: Vec<(Observation, Line<'a>)>,
}

/// The line of a state.
struct Line<'a> {
    file: &'a str,
    number: u64,
}

impl<'a> Builder<'a> {
    fn new(row: &TrackRow<'a>) -> Result<Self, Flaw> {
        let class = class_of(row.agent_type)
            .ok_or_else(|| ("unknown_agent_type", format!("column agent_type is \"{}\"", printable(row.agent_type))))?;
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

    fn add(&mut self, row: &TrackRow<'a>, file: &'a str, line: u64) -> Result<(), Flaw> {
        if row.heading_rad.is_none() && self.class.is_motorized() {
            let detail = format!(
                "column psi_rad is blank or missing, expected the heading of a {} in radians",
                printable(row.agent_type)
            );
            return Err(("malformed_row", detail));
        }
        if row.agent_type != self.agent_type {
            let [was, is] = [self.agent_type, row.agent_type].map(String::from_utf8_lossy);
            let detail = format!("track {} is \"{was}\" and then \"{is}\"", String::from_utf8_lossy(self.id));
            return Err(("inconsistent_agent_type", detail.escape_debug().to_string()));
        }
        self.extent = self.extent.or(row.extent);
        self.is_interesting |= row.is_interesting;
        self.is_to_predict |= row.is_to_predict;
        let TrackRow { frame_id: frame, position, velocity, heading_rad, .. } = *row;
        let observation = Observation { frame, position, velocity, heading_rad };
        self.observations.push((observation, Line { file, number: line }));
        Ok(())
    }

    fn finish(mut self) -> Result<RecordedTrack, Reject> {
        let id = String::from_utf8_lossy(self.id).into_owned();
        if !self.observations.is_sorted_by_key(|(observation, _)| observation.frame) {
            self.observations.sort_by_key(|(observation, _)| observation.frame);
        }
        let n_rows = self.observations.len();
        self.observations.dedup_by(|(again, _), (first, _)| again == first);
        let n_repeated = (n_rows - self.observations.len()) as u64;
        let repeated = self.observations.windows(2).find(|pair| pair[0].0.frame == pair[1].0.frame);
        if let Some([_, (again, line)]) = repeated {
            let detail = format!("track {id} is at frame {} already", again.frame);
            return Err(reject_at(line.file, line.number, ("duplicate_frame", detail)));
        }
        let role = match (self.is_interesting, self.is_to_predict) {
            (true, _) => TrackRole::Focal,
            (false, true) => TrackRole::Scored,
            (false, false) => TrackRole::Context,
        };
        let observations: Vec<Observation> =
            self.observations.into_iter().map(|(observation, _)| observation).collect();
        let mut track = RecordedTrack::new(TrackId(id), self.class, role, self.extent, &observations);
        track.n_repeated = n_repeated;
        Ok(track)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vec2;
    use crate::ingest::recorded_track::DT_S;

    const HEADER: &str = "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width";

    fn read(rows: &str) -> Result<Vec<RecordedTrack>, Reject> {
        let columns = TrackColumns::of(HEADER.as_bytes(), false).unwrap();
        read_tracks(&[TrackTable { file: "t.csv", columns, rows: rows.as_bytes(), first_line: 2 }])
    }

    /// The headings of a track in degrees.
    fn headings(track: &RecordedTrack) -> Vec<f64> {
        track.states.iter().map(|(_, state, _)| (state.heading_rad.to_degrees() * 1e3).round() / 1e3).collect()
    }

    #[test]
    fn tracks_are_in_order_of_appearance_and_their_states_in_order_of_time() {
        let rows = "9,3,300,car,3,0,1,0,0.1,4,2\r\n9,2,200,car,2,0,1,0,7.0,5,3\r\n\r\n1,2,200,car,0,0,0,0,0,4,2\r\n\
                    9,5,500,car,5,0,1,0,0.3,4,2";
        let tracks = read(rows).unwrap();
        assert_eq!(tracks.iter().map(|track| track.id.0.as_str()).collect::<Vec<_>>(), ["9", "1"]);
        assert_eq!(tracks[0].states.iter().map(|(frame, ..)| *frame).collect::<Vec<_>>(), [2, 3, 5]);
        assert_eq!(headings(&tracks[0]), [401.07, 5.73, 17.189]);
        assert_eq!(tracks[0].extent, Some(Extent { length_m: 4.0, width_m: 2.0 }));

        let nan = read("P1,1,100,pedestrian/bicycle,0,0,0,0,nan,nan,NaN\n1,1,100,car,0,0,0,0,0,nan,nan\n").unwrap();
        assert_eq!(nan.iter().map(|track| track.extent).collect::<Vec<_>>(), [None, None]);
        let again = read("1,1,100,car,0,0,0,0,0,4,2\n1,1,100,car,0,0,0,0,0,4,2\n1,2,200,car,0,0,0,0,0,4,2\n").unwrap();
        assert_eq!((again[0].states.len(), again[0].n_repeated), (2, 1));
        let spelled_twice = read("9,3,300,car,3,0,1,0,0.1,4,2\n9.0,4,400,car,4,0,1,0,0.1,4,2\n").unwrap();
        assert_eq!((spelled_twice.len(), spelled_twice[0].id.0.as_str()), (1, "9"));

        let track = tracks[0].cut(3, 4, 1).unwrap();
        assert_eq!(
            track.trajectory.entries().iter().map(Option::is_some).collect::<Vec<_>>(),
            [true, false, true, false]
        );
        assert_eq!(track.trajectory.derivation(), None);
        assert!(tracks[0].cut(6, 4, 1).is_none() && tracks[1].cut(3, 4, 1).is_none());
    }

    /// Headings in degrees and whether they are held, for an agent with these velocities, in the frames from
    /// `first_frame` on; the first `n_history` are observed.
    fn cut(rows: &[(f64, f64)], first_frame: i64, n_history: usize) -> (Vec<f64>, Vec<bool>) {
        // Positions whose backward differences are these velocities.
        let (mut at, mut step) = (Vec2::ZERO, Vec2::new(rows[0].0, rows[0].1) * DT_S);
        let row = |(frame, (vx, vy)): (usize, &(f64, f64))| {
            if frame > 0 {
                let moved = Vec2::new(*vx, *vy) * DT_S;
                step = if frame == 1 { moved } else { (moved * 2.0 + step) * (1.0 / 3.0) };
                at = at + step;
            }
            let (frame, Vec2 { x, y }) = (frame + 1, at);
            format!("P1,{frame},{frame}00,pedestrian/bicycle,{x:.9},{y:.9},{vx},{vy},,,\n")
        };
        let tracks = read(&rows.iter().enumerate().map(row).collect::<String>()).unwrap();
        assert_eq!((tracks[0].extent, tracks[0].class), (None, AgentClass::PedestrianOrCyclist));
        let track = tracks[0].cut(first_frame, rows.len() + 1 - first_frame as usize, n_history).unwrap();
        let headings = track.trajectory.valid().map(|(_, state)| (state.heading_rad.to_degrees() * 1e3).round() / 1e3);
        (headings.collect(), track.trajectory.derivation().unwrap().held_headings.clone())
    }

    #[test]
    fn headings_follow_the_velocity_and_are_held_when_slow() {
        let rows = [(0.0, 0.0), (-0.1, 0.0), (0.0, 1.0), (0.3, 0.0), (2.0, 0.0)];
        // The first motion is observed.
        assert_eq!(cut(&rows, 1, 3), (vec![90.0, 90.0, 90.0, 90.0, 0.0], vec![true, true, false, true, false]));
        // It is not: the direction is that of any velocity there is.
        assert_eq!(cut(&rows, 1, 2), (vec![180.0, 180.0, 90.0, 90.0, 0.0], vec![true, true, false, true, false]));
        // The past before a window is known within it.
        assert_eq!(cut(&rows, 4, 1), (vec![90.0, 0.0], vec![true, false]));
    }

    #[test]
    fn the_heading_of_who_stands_does_not_turn() {
        let rows = [(0.1, 0.0), (-0.1, 0.01), (0.0, 0.0), (-0.2, -0.1), (0.0, -0.4)];
        let (headings, held) = cut(&rows, 1, 2);
        assert_eq!((headings, held), (vec![0.0; 5], vec![true; 5]));
        assert_eq!(cut(&[(0.0, 0.0); 3], 1, 2).0, vec![0.0; 3]);
    }

    #[test]
    fn flaws_are_rejects_with_file_and_line() {
        let good = "1,1,100,car,0,0,0,0,0,4,2\n";
        for (rows, reason, place) in [
            (format!("{good}1,2,200,car,0,0,0"), "malformed_row", "t.csv:3: 7 columns"),
            (format!("{good}1,2,200,car,nan,0,0,0,0,4,2"), "non_finite", "t.csv:3: column x"),
            (format!("{good}1,1,100,car,0.5,0,0,0,0,4,2"), "duplicate_frame", "t.csv:3: track 1 is at frame 1"),
            (format!("{good}1,2,200,car,0,0,0,0,,4,2"), "malformed_row", "t.csv:3: column psi_rad is blank"),
            (format!("{good}1,2,200,pedestrian,0,0,0,0,0,4,2"), "inconsistent_agent_type", "t.csv:3:"),
            (format!("{good}1,2,200,car,0,0,0,0,NaN,4,2"), "malformed_row", "t.csv:3: column psi_rad is blank"),
            (format!("{good}01,2,200,car,0,0,0,0,0,4,2"), "ambiguous_id", "t.csv: track 1 is also written 01; write"),
            ("1,1,100,tank,0,0,0,0,0,4,2".to_owned(), "unknown_agent_type", "t.csv:2: column agent_type is \\\"tank"),
        ] {
            let reject = read(&rows).unwrap_err();
            assert_eq!(reject.reason, reason);
            assert!(reject.detail.replace('"', "\\\"").starts_with(place), "{}", reject.detail);
        }
    }
}
