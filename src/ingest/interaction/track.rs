//! The tracks of a table.

use super::CASE_HORIZON;
use super::columns::TrackColumns;
use super::row::{Flaw, TrackRow};
use crate::ingest::csv_rows::lines_of;
use crate::ingest::ids;
use crate::ingest::quotes::printable;
use crate::ingest::recorded_track::{Observation, RecordedTrack};
use crate::ingest::{Finding, Reject};
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

/// The tracks of all tables in order of their first rows, and the rows that are left out. A reject if they are more
/// than this share of all.
///
/// A track has one type. Its size is that of its first row with a size, because sizes are not measured in every frame.
pub(super) fn read_tracks(
    tables: &[TrackTable<'_>],
    max_bad_share: f64,
) -> Result<(Vec<RecordedTrack>, Vec<Finding>), Reject> {
    let mut tracks = Tracks::default();
    let (mut n_rows, mut n_bad, mut first_bad) = (0_u64, 0_u64, None);
    for table in tables {
        tracks.current = None;
        for (line, row_idx) in lines_of(table.rows).zip(0_u64..) {
            if line.is_empty() {
                continue;
            }
            n_rows += 1;
            if let Err(flaw) = tracks.add(line, table, table.first_line + row_idx) {
                n_bad += 1;
                first_bad.get_or_insert_with(|| reject_at(table.file, table.first_line + row_idx, flaw));
            }
        }
    }
    let mut builders = tracks.builders;
    builders.retain(|builder| !builder.observations.is_empty());
    let file = tables.first().map_or("", |table| table.file);
    if let Some(pair) = ids::ambiguous(builders.iter().map(|builder| builder.id)).next() {
        return Err(Reject { reason: ids::AMBIGUOUS, detail: format!("{file}: {}", ids::in_words("track", pair)) });
    }
    let (mut read, mut n_repeated) = (Vec::with_capacity(builders.len()), 0);
    for builder in builders {
        let n_of_track = builder.observations.len() as u64;
        match builder.finish() {
            Ok((track, n_again)) => {
                n_repeated += n_again;
                read.push(track);
            }
            Err(reject) => {
                n_bad += n_of_track;
                first_bad.get_or_insert(reject);
            }
        }
    }
    let mut findings = Vec::new();
    if let Some(Reject { reason, mut detail }) = first_bad {
        if n_bad as f64 > max_bad_share * n_rows as f64 {
            detail += &if n_bad > 1 { format!("; {n_bad} of {n_rows} rows cannot be used") } else { String::new() };
            return Err(Reject { reason, detail });
        }
        findings.push(Finding { what: "rows_left_out", n: n_bad, detail });
    }
    if n_repeated > 0 {
        let detail = format!("{file}: rows that repeat others are left out");
        findings.push(Finding { what: "rows_repeated", n: n_repeated, detail });
    }
    Ok((read, findings))
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

/// The tracks that are being read.
#[derive(Default)]
struct Tracks<'a> {
    builders: Vec<Builder<'a>>,
    by_id: BTreeMap<&'a [u8], usize>,
    /// That of the last row: rows of a track are usually adjacent.
    current: Option<usize>,
    cells: Vec<&'a [u8]>,
}

impl<'a> Tracks<'a> {
    fn add(&mut self, line: &'a [u8], table: &TrackTable<'a>, number: u64) -> Result<(), Flaw> {
        let row = TrackRow::parse(line, &table.columns, &mut self.cells)?;
        let n = self.builders.len();
        let index = match self.current.filter(|index| self.builders[*index].id == row.track_id) {
            Some(index) => index,
            None => self.by_id.get(row.track_id).copied().unwrap_or(n),
        };
        if index == n {
            if n == MAX_TRACKS {
                return Err(("too_many_tracks", format!("more than {MAX_TRACKS} tracks")));
            }
            self.builders.push(Builder::new(&row)?);
            self.by_id.insert(row.track_id, n);
        }
        self.current = Some(index);
        self.builders[index].add(&row, table.file, number)
    }
}

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
            let [id, was, is] = [self.id, self.agent_type, row.agent_type].map(printable);
            return Err(("inconsistent_agent_type", format!("track {id} is \"{was}\" and then \"{is}\"")));
        }
        self.extent = self.extent.or(row.extent);
        self.is_interesting |= row.is_interesting;
        self.is_to_predict |= row.is_to_predict;
        let TrackRow { frame_id: frame, position, velocity, heading_rad, .. } = *row;
        let observation = Observation { frame, position, velocity, heading_rad };
        self.observations.push((observation, Line { file, number: line }));
        Ok(())
    }

    /// The track, and the number of its rows that repeat others.
    fn finish(mut self) -> Result<(RecordedTrack, u64), Reject> {
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
        Ok((RecordedTrack::new(TrackId(id), self.class, role, self.extent, &observations), n_repeated))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vec2;
    use crate::ingest::recorded_track::DT_S;

    const HEADER: &str = "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width";

    /// The tracks, and the number and the first of each kind of rows that are left out.
    fn read_within(rows: &str, max_bad_share: f64) -> Result<(Vec<RecordedTrack>, Vec<Finding>), Reject> {
        let columns = TrackColumns::of(HEADER.as_bytes(), false).unwrap();
        read_tracks(&[TrackTable { file: "t.csv", columns, rows: rows.as_bytes(), first_line: 2 }], max_bad_share)
    }

    fn read(rows: &str) -> Result<Vec<RecordedTrack>, Reject> {
        read_within(rows, 0.0).map(|(tracks, _)| tracks)
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
        let again = "1,1,100,car,0,0,0,0,0,4,2\n1,1,100,car,0,0,0,0,0,4,2\n1,2,200,car,0,0,0,0,0,4,2\n";
        let (again, findings) = read_within(again, 0.0).unwrap();
        assert_eq!((again[0].states.len(), findings[0].what, findings[0].n), (2, "rows_repeated", 1));
        let spelled_twice = read("9,3,300,car,3,0,1,0,0.1,4,2\n9.0,4,400,car,4,0,1,0,0.1,4,2\n").unwrap();
        assert_eq!((spelled_twice.len(), spelled_twice[0].id.0.as_str()), (1, "9"));

        let track = tracks[0].cut(3, 4, 1).unwrap();
        let found = track.trajectory.entries().iter().map(Option::is_some).collect::<Vec<_>>();
        assert_eq!(found, [true, false, true, false]);
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
    fn a_few_bad_rows_are_left_out_and_named() {
        let good = |id: u32| -> String { (1..=20).map(|i| format!("{id},{i},{i}00,car,{i},0,10,0,0,4,2\n")).collect() };
        for (bad, n, why) in [
            ("1,21,2100,car,,0,10,0,0,4,2\n", 1, "t.csv:42: column x is \"\""),
            ("1,21,2100,van,21,0,10,0,0,4,2\n", 1, "t.csv:42: track 1 is \"car\" and then \"van\""),
            ("3,1,100,tank,0,0,0,0,0,4,2\n3,2,200,tank,0,0,0,0,0,4,2\n", 2, "t.csv:42: column agent_type is \"tank\""),
            ("3,1,100,car,0,0,0,0,0,4,2\n3,1,100,car,9,0,0,0,0,4,2\n", 2, "t.csv:43: track 3 is at frame 1 already"),
            ("1,21,2100,car,21,0", 1, "t.csv:42: 6 columns, expected 11"),
        ] {
            let rows = good(1) + &good(2) + bad;
            let (tracks, findings) = read_within(&rows, 0.1).unwrap();
            assert_eq!(tracks.iter().map(|track| track.states.len()).collect::<Vec<_>>(), [20, 20], "{bad}");
            assert_eq!((findings.len(), findings[0].what, findings[0].n), (1, "rows_left_out", n));
            assert!(findings[0].detail.starts_with(why), "{}", findings[0].detail);
            assert!(read_within(&rows, 0.0).unwrap_err().detail.starts_with(why));
        }
        let too_many = good(1) + &good(2) + &"1,21,2100,car,,0,10,0,0,4,2\n".repeat(5);
        let reject = read_within(&too_many, 0.1).unwrap_err();
        assert!(reject.detail.ends_with("; 5 of 45 rows cannot be used"), "{}", reject.detail);
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
            ("1,1,100,tank,0,0,0,0,0,4,2".to_owned(), "unknown_agent_type", "t.csv:2: column agent_type is \"tank"),
        ] {
            let reject = read(&rows).unwrap_err();
            assert_eq!(reject.reason, reason);
            assert!(reject.detail.starts_with(place), "{}", reject.detail);
        }
    }
}
