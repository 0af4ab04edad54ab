//! Parses one row of a table of tracks.

use super::cases::without_point;
use super::columns::TrackColumns;
use crate::geometry::Vec2;
use crate::ingest::assemble::MAX_COORDINATE_M;
use crate::ingest::csv_rows::split_cells;
use crate::ingest::decimal;
use crate::ingest::quotes::printable;
use crate::scene::Extent;

/// INTERACTION is recorded at 10 Hz, and `timestamp_ms` counts from the start of the recording.
const MS_PER_FRAME: i64 = 100;

/// Values beyond these limits are errors of the recording.
const MAX_SPEED_MPS: f64 = 1e3;
const MAX_FRAME: i64 = 100_000_000;
const MAX_SIZE_M: f64 = 1e3;
/// The smallest size.
const MIN_SIZE_M: f64 = 1e-3;

/// One agent at one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TrackRow<'a> {
    /// The id as written, but `1` for `1.0`.
    pub(super) track_id: &'a [u8],
    pub(super) frame_id: i64,
    /// The type as written.
    pub(super) agent_type: &'a [u8],
    pub(super) position: Vec2,
    pub(super) velocity: Vec2,
    /// Absent for pedestrians and cyclists.
    pub(super) heading_rad: Option<f64>,
    /// Absent for pedestrians and cyclists, and where length or width is blank.
    pub(super) extent: Option<Extent>,
    pub(super) is_interesting: bool,
    pub(super) is_to_predict: bool,
}

/// Why a row cannot be read: reason and detail.
pub(super) type Flaw = (&'static str, String);

impl<'a> TrackRow<'a> {
    /// Reads `line`; `cells` is a buffer.
    pub(super) fn parse(line: &'a [u8], columns: &TrackColumns, cells: &mut Vec<&'a [u8]>) -> Result<Self, Flaw> {
        split_cells(line, cells);
        if cells.len() != columns.n_columns {
            let n = cells.len();
            return Err(("malformed_row", format!("{n} columns, expected {}", columns.n_columns)));
        }
        let cells = cells.as_slice();
        let track_id = without_point(cells[columns.track_id].trim_ascii());
        if track_id.is_empty() || !track_id.iter().all(u8::is_ascii_graphic) {
            return Err(malformed("track_id", track_id, "an id"));
        }
        let frame_id = frame_id(cells, columns)?;
        let (position, velocity) = motion(cells, columns)?;
        let (heading_rad, extent) = shape(cells, columns)?;
        let mark = |index: Option<usize>, name| match index {
            Some(index) => optional(cells[index], name).map(|mark| mark.is_some_and(|mark| mark != 0.0)),
            None => Ok(false),
        };
        Ok(Self {
            track_id,
            frame_id,
            agent_type: cells[columns.agent_type].trim_ascii(),
            position,
            velocity,
            heading_rad,
            extent,
            is_interesting: mark(columns.interesting_agent, "interesting_agent")?,
            is_to_predict: mark(columns.track_to_predict, "track_to_predict")?,
        })
    }
}

/// The number of the frame, whose timestamp must agree with it.
fn frame_id(cells: &[&[u8]], columns: &TrackColumns) -> Result<i64, Flaw> {
    let frame_id = integer(cells[columns.frame_id], "frame_id")?;
    if !(0..=MAX_FRAME).contains(&frame_id) {
        return Err(("out_of_range", format!("frame_id is {frame_id}")));
    }
    let timestamp_ms = integer(cells[columns.timestamp_ms], "timestamp_ms")?;
    if timestamp_ms != MS_PER_FRAME * frame_id {
        let expected = MS_PER_FRAME * frame_id;
        let detail = format!("timestamp_ms is {timestamp_ms} at frame_id {frame_id}, expected {expected}");
        return Err(("bad_timestamp", detail));
    }
    Ok(frame_id)
}

/// Position and velocity, meters and m/s.
fn motion(cells: &[&[u8]], columns: &TrackColumns) -> Result<(Vec2, Vec2), Flaw> {
    let number = |index: usize, name| number(cells[index], name);
    let position = Vec2::new(number(columns.x, "x")?, number(columns.y, "y")?);
    let velocity = Vec2::new(number(columns.vx, "vx")?, number(columns.vy, "vy")?);
    if position.x.abs().max(position.y.abs()) > MAX_COORDINATE_M
        || velocity.dot(velocity) > MAX_SPEED_MPS * MAX_SPEED_MPS
    {
        let detail = format!("position ({}, {}) m, speed {} m/s", position.x, position.y, velocity.norm());
        return Err(("out_of_range", detail));
    }
    Ok((position, velocity))
}

/// Heading and size, if the table has them.
fn shape(cells: &[&[u8]], columns: &TrackColumns) -> Result<(Option<f64>, Option<Extent>), Flaw> {
    let Some([psi, length, width]) = columns.shape else { return Ok((None, None)) };
    let heading_rad = optional(cells[psi], "psi_rad")?;
    let (length_m, width_m) = (optional(cells[length], "length")?, optional(cells[width], "width")?);
    for (column, size_m) in [("length", length_m), ("width", width_m)] {
        if let Some(size_m) = size_m.filter(|size_m| !(MIN_SIZE_M..=MAX_SIZE_M).contains(size_m)) {
            let range = format!("{MIN_SIZE_M} to {MAX_SIZE_M} m, or a blank cell where the size is unknown");
            return Err(("out_of_range", format!("column {column} is {size_m}, expected {range}")));
        }
    }
    Ok((heading_rad, length_m.zip(width_m).map(|(length_m, width_m)| Extent { length_m, width_m })))
}

/// The number in a cell; `None` if the cell is blank, or `nan`, as Python writes a blank one. Marks may be `True` and
/// `False`.
fn optional(cell: &[u8], column: &str) -> Result<Option<f64>, Flaw> {
    match cell.trim_ascii() {
        [] => Ok(None),
        // Nearly all cells are numbers.
        [b'n' | b'N', rest @ ..] if rest.eq_ignore_ascii_case(b"an") => Ok(None),
        b"True" => Ok(Some(1.0)),
        b"False" => Ok(Some(0.0)),
        _ => number(cell, column).map(Some),
    }
}

/// The number in a cell, with or without blanks around it.
fn number(cell: &[u8], column: &str) -> Result<f64, Flaw> {
    let number = decimal::number(cell).or_else(|| decimal::number(cell.trim_ascii()));
    let number = number.ok_or_else(|| malformed(column, cell, "a number"))?;
    if number.is_finite() {
        Ok(number)
    } else {
        Err(("non_finite", format!("column {column} is \"{}\"", printable(cell))))
    }
}

/// A whole number, which may be printed as a float.
fn integer(cell: &[u8], column: &str) -> Result<i64, Flaw> {
    let whole = decimal::whole_number(cell).or_else(|| decimal::whole_number(cell.trim_ascii()));
    whole.map_or_else(|| number(cell, column).and_then(|_| Err(malformed(column, cell, "a whole number"))), Ok)
}

fn malformed(column: &str, cell: &[u8], expected: &str) -> Flaw {
    ("malformed_row", format!("column {column} is \"{}\", expected {expected}", printable(cell)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(line: &str) -> Result<TrackRow<'_>, Flaw> {
        let header = b"track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width,\
            track_to_predict,interesting_agent";
        TrackRow::parse(line.as_bytes(), &TrackColumns::of(header, false).unwrap(), &mut Vec::new())
    }

    #[test]
    fn rows_are_read() {
        let row = parse("7,3,300,car,1.5,-2,3e0,0,0.25,4.5,1.8,1.0,0.0").unwrap();
        assert_eq!((row.track_id, row.frame_id, row.agent_type), (&b"7"[..], 3, &b"car"[..]));
        assert_eq!((row.position, row.velocity), (Vec2::new(1.5, -2.0), Vec2::new(3.0, 0.0)));
        assert_eq!((row.heading_rad, row.extent), (Some(0.25), Some(Extent { length_m: 4.5, width_m: 1.8 })));
        assert_eq!((row.is_to_predict, row.is_interesting), (true, false));
        let row = parse("P7,3.0,300.0,pedestrian/bicycle,1,2,3,4,,,,0,1").unwrap();
        assert_eq!((row.frame_id, row.heading_rad, row.extent, row.is_interesting), (3, None, None, true));
        assert_eq!(parse("7,3,300,car,1,2,3,0,0,,1.8,,").unwrap().extent, None);
        let row = parse("P7,3,300,pedestrian/bicycle,1,2,3,4,nan,NaN,2,True,False").unwrap();
        assert_eq!((row.heading_rad, row.extent, row.is_to_predict, row.is_interesting), (None, None, true, false));
    }

    #[test]
    fn flaws_name_the_column_and_what_was_found() {
        for (line, reason, detail) in [
            ("7,3,300,car,1.5", "malformed_row", "5 columns, expected 13"),
            ("7,3,300,car,1,2,3,4,0,4,2,1,0,9", "malformed_row", "14 columns"),
            ("7,3,300,car,one,2,3,4,0,4,2,1,0", "malformed_row", "column x is \"one\", expected a number"),
            ("7,3,300,car,,2,3,4,0,4,2,1,0", "malformed_row", "column x is \"\""),
            ("7,3,300,car,1,2,3,4,0,1e39,2,1,0", "out_of_range", "column length is 1"),
            ("7,3,300,car,1,2,3,4,0,0.0,2,1,0", "out_of_range", "column length is 0, expected 0.001 to 1000 m"),
            ("7,3,300,car,1,2,3,4,0,4,-2,1,0", "out_of_range", "column width is -2"),
            ("7,3,300,car,1,2,3,4,0,4,1e-60,1,0", "out_of_range", "column width is 0.000"),
            ("7,3.5,300,car,1,2,3,4,0,4,2,1,0", "malformed_row", "column frame_id is \"3.5\", expected a whole number"),
            (",3,300,car,1,2,3,4,0,4,2,1,0", "malformed_row", "column track_id"),
            ("7,3,300,car,1,NaN,3,4,0,4,2,1,0", "non_finite", "column y is \"NaN\""),
            ("7,3,300,car,1,2,inf,4,0,4,2,1,0", "non_finite", "column vx"),
            ("7,3,300,car,1,2,3,4,inf,4,2,1,0", "non_finite", "column psi_rad"),
            ("7,3,310,car,1,2,3,4,0,4,2,1,0", "bad_timestamp", "timestamp_ms is 310 at frame_id 3, expected 300"),
            ("7,-3,-300,car,1,2,3,4,0,4,2,1,0", "out_of_range", "frame_id is -3"),
            ("7,3,300,car,1e9,2,3,4,0,4,2,1,0", "out_of_range", "position"),
            ("7,9223372036854775807,300,car,1,2,3,4,0,4,2,1,0", "out_of_range", "frame_id"),
        ] {
            let flaw = parse(line).unwrap_err();
            assert!(flaw.0 == reason && flaw.1.contains(detail), "{line}: {flaw:?}");
        }
    }
}
