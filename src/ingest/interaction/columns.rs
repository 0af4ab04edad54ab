//! The columns of a table of tracks, by which INTERACTION's versions are distinguished.

use crate::ingest::error::Malformed;

/// The columns of every table.
const REQUIRED: [&str; 8] = ["track_id", "frame_id", "timestamp_ms", "agent_type", "x", "y", "vx", "vy"];
/// Further columns of all tables except v1.1's tables of pedestrians.
const SHAPE: [&str; 3] = ["psi_rad", "length", "width"];

/// Maximum number of columns of a table; real ones have at most 14.
const MAX_COLUMNS: usize = 256;

/// The position of each quantity, by the names in the header. Other columns are ignored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct TrackColumns {
    pub(super) n_columns: usize,
    /// v1.2 cuts recordings into cases.
    pub(super) case_id: Option<usize>,
    pub(super) track_id: usize,
    pub(super) frame_id: usize,
    pub(super) timestamp_ms: usize,
    pub(super) agent_type: usize,
    pub(super) x: usize,
    pub(super) y: usize,
    pub(super) vx: usize,
    pub(super) vy: usize,
    /// Heading, length and width; not in v1.1's tables of pedestrians.
    pub(super) shape: Option<[usize; 3]>,
    /// Only in test sets.
    pub(super) track_to_predict: Option<usize>,
    /// Only in test sets.
    pub(super) interesting_agent: Option<usize>,
}

impl TrackColumns {
    /// The columns in `header`.
    ///
    /// A table without `case_id` belongs to v1.1, which has separate tables of pedestrians without `psi_rad`, `length`
    /// and `width`; all other tables must have these.
    pub(super) fn of(header: &[u8], is_pedestrians: bool) -> Result<Self, Malformed> {
        let names: Vec<&[u8]> = header.split(|byte| *byte == b',').map(<[u8]>::trim_ascii).collect();
        if names.len() > MAX_COLUMNS {
            return Err(format!("line 1: the header has more than {MAX_COLUMNS} columns").into());
        }
        let find = |name: &str| names.iter().position(|found| *found == name.as_bytes());
        let needs_shape = !is_pedestrians || find("case_id").is_some() || SHAPE.iter().any(|name| find(name).is_some());
        let expected: Vec<&str> = REQUIRED.into_iter().chain(SHAPE.into_iter().filter(|_| needs_shape)).collect();
        let missing: Vec<&str> = expected.iter().copied().filter(|name| find(name).is_none()).collect();
        if !missing.is_empty() {
            return Err(missing_columns(&missing, &expected, header).into());
        }
        let known = ["case_id", "track_to_predict", "interesting_agent"].into_iter().chain(expected);
        for name in known {
            if names.iter().filter(|found| **found == name.as_bytes()).count() > 1 {
                return Err(format!("line 1: the column `{name}` appears twice").into());
            }
        }
        let index = |name: &str| find(name).unwrap_or_default();
        Ok(Self {
            n_columns: names.len(),
            case_id: find("case_id"),
            track_id: index("track_id"),
            frame_id: index("frame_id"),
            timestamp_ms: index("timestamp_ms"),
            agent_type: index("agent_type"),
            x: index("x"),
            y: index("y"),
            vx: index("vx"),
            vy: index("vy"),
            shape: needs_shape.then(|| SHAPE.map(index)),
            track_to_predict: find("track_to_predict"),
            interesting_agent: find("interesting_agent"),
        })
    }
}

fn missing_columns(missing: &[&str], expected: &[&str], header: &[u8]) -> String {
    let found = String::from_utf8_lossy(&header[..header.len().min(200)]);
    let found: String = found.chars().map(|c| if c.is_control() && c != '\t' { '\u{fffd}' } else { c }).collect();
    let hint = match header.iter().find(|byte| matches!(byte, b';' | b'\t' | b'|')) {
        Some(delimiter) if !header.contains(&b',') => {
            format!("; columns must be separated by `,`, not `{}`", char::from(*delimiter).escape_default())
        }
        _ => String::new(),
    };
    format!("line 1: no column {}; expected `{}`, found `{found}`{hint}", missing.join(", "), expected.join(","))
}

#[cfg(test)]
mod tests {
    use super::*;

    const V1_1: &str = "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width";

    #[test]
    fn columns_are_found_by_name_in_any_order() {
        let columns = TrackColumns::of(V1_1.as_bytes(), false).unwrap();
        assert_eq!((columns.case_id, columns.x, columns.shape), (None, 4, Some([8, 9, 10])));
        let reordered = b"width,length,psi_rad,extra,vy,vx,y,x,agent_type,timestamp_ms,frame_id, track_id ,case_id";
        let columns = TrackColumns::of(reordered, false).unwrap();
        assert_eq!((columns.case_id, columns.x, columns.track_id), (Some(12), 7, 11));
        assert_eq!((columns.shape, columns.n_columns), (Some([2, 1, 0]), 13));
    }

    #[test]
    fn only_tables_of_pedestrians_may_lack_heading_and_size() {
        let short = "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy";
        assert_eq!(TrackColumns::of(short.as_bytes(), true).unwrap().shape, None);
        assert!(TrackColumns::of(short.as_bytes(), false).unwrap_err().to_string().contains("psi_rad, length, width"));
        assert!(TrackColumns::of(format!("case_id,{short}").as_bytes(), true).is_err());
        assert!(
            TrackColumns::of(format!("{short},psi_rad").as_bytes(), true)
                .unwrap_err()
                .to_string()
                .contains("length, width")
        );
    }

    #[test]
    fn wrong_headers_are_explained() {
        let error = TrackColumns::of(V1_1.replace(",vx", "").as_bytes(), false).unwrap_err().to_string();
        assert!(error.starts_with("line 1: no column vx; expected `track_id,") && error.contains("found `track_id,"));
        let error = TrackColumns::of(V1_1.replace(',', "\t").as_bytes(), false).unwrap_err().to_string();
        assert!(error.contains("not `\\t`"), "{error}");
        assert!(
            TrackColumns::of(format!("{V1_1},x").as_bytes(), false)
                .unwrap_err()
                .to_string()
                .contains("`x` appears twice")
        );
        assert!(TrackColumns::of(b"\x00\xff", false).is_err());
    }
}
