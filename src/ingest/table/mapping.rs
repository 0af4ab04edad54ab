//! The `[ingest.table]` section: what the columns of recordings mean that are in no format of their own.

use crate::geometry::Vec2;
use crate::ingest::Error;
use crate::ingest::ids::whole_number;
use crate::ingest::projection::{GeoPoint, LocalUtm};
use crate::scene::AgentClass;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_2;

/// The meaning of tables that have a row for each agent and time, as CSV (cells separated by commas, semicolons or
/// tabs; also `.gz`) or Parquet.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TableMapping {
    /// The names of the files with recordings; `*` stands for any text.
    #[serde(default = "default_files")]
    pub files: String,
    /// The names of tables with a row for each track, which hold the columns that recordings lack, such as sizes and
    /// classes; `*` stands for the same text as in `files`.
    #[serde(default)]
    pub track_files: Option<String>,
    /// The columns.
    pub columns: TableColumns,
    /// Rows of a track per second, where `columns.frame` counts them.
    #[serde(default)]
    #[schemars(range(min = 0.5, max = 1000.0))]
    pub frame_rate_hz: Option<f64>,
    /// The unit of `columns.time`, seconds: 0.001 where times are in milliseconds. Timestamps and durations in Parquet
    /// are in seconds.
    #[serde(default = "one")]
    #[schemars(range(min = 1e-9, max = 1e3))]
    pub time_unit_s: f64,
    /// The unit of positions and sizes, meters: 0.3048 where they are in feet; of sizes alone where positions are in
    /// degrees. Where sizes are in another unit than positions, convert them first.
    #[serde(default = "one")]
    #[schemars(range(min = 1e-6, max = 1e6))]
    pub length_unit_m: f64,
    /// Where positions are in degrees (x is the longitude, y the latitude, WGS84): the point from which meters east and
    /// north are counted, in its UTM zone. Where a Lanelet2 map's origin is assumed, a warning names it.
    #[serde(default)]
    pub origin: Option<GeoPoint>,
    /// Whether y points down, as in images: positions and headings are mirrored.
    #[serde(default)]
    pub y_points_down: bool,
    /// The point of an agent that its position is.
    #[serde(default)]
    pub position: PositionOf,
    /// How headings are written. Where no column has any, they follow from the motion.
    #[serde(default)]
    pub heading: HeadingUnit,
    /// The class of all agents, where no column names them.
    #[serde(default = "vehicle")]
    #[schemars(schema_with = "class_schema")]
    pub class: AgentClass,
    /// The class for each text of `columns.class`. Agents of others are left out, with a warning, and so are all
    /// of class `unknown`.
    #[serde(default)]
    #[schemars(schema_with = "classes_schema")]
    pub classes: BTreeMap<String, AgentClass>,
    /// The place of all recordings, where no column names it; default: the name of the file. Its map is the
    /// Lanelet2 (`.osm`) or OpenDRIVE (`.xodr`) file of that name.
    #[serde(default)]
    pub place: Option<String>,
    /// Times at which a track is missing are filled in if they last no longer, seconds.
    #[serde(default = "one")]
    #[schemars(range(min = 0.0, max = 10.0))]
    pub max_gap_s: f64,
}

/// The names of columns. `"a|b"` is column b where a is blank or missing, for tables that write kinds of agents into
/// columns of their own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TableColumns {
    /// The id of the agent; blank, `nan` or `-1` is nobody.
    pub track: String,
    /// Position.
    pub x: String,
    /// Position.
    pub y: String,
    /// The time of a row; either this or `frame`.
    #[serde(default)]
    pub time: Option<String>,
    /// The number of its frame.
    #[serde(default)]
    pub frame: Option<String>,
    /// Heading.
    #[serde(default)]
    pub heading: Option<String>,
    /// Size along the heading.
    #[serde(default)]
    pub length: Option<String>,
    /// Size across the heading.
    #[serde(default)]
    pub width: Option<String>,
    /// Class.
    #[serde(default)]
    pub class: Option<String>,
    /// The recording, where a file has several.
    #[serde(default)]
    pub recording: Option<String>,
    /// The place.
    #[serde(default)]
    pub place: Option<String>,
}

/// A point of an agent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PositionOf {
    /// The center of its box.
    #[default]
    Center,
    /// The middle of its front (NGSIM, SUMO).
    Front,
    /// The middle of its rear (I-24 MOTION).
    Rear,
    /// The corner with the least x and y of a box along the axes, as `length` by x and `width` by y (highD).
    Corner,
}

/// How headings are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum HeadingUnit {
    /// Radians, from x toward y.
    #[default]
    Radians,
    /// Degrees, from x toward y.
    Degrees,
    /// Degrees, clockwise from y, as on a compass (SUMO).
    CompassDegrees,
}

/// The plane in which positions are.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plane {
    unit_m: f64,
    projection: Option<LocalUtm>,
    /// The direction of north, radians from x.
    pub(super) north_rad: f64,
}

impl Plane {
    /// The position that two numbers of a table are, meters.
    pub(super) fn at(&self, [x, y]: [f64; 2]) -> Vec2 {
        match self.projection {
            Some(projection) => projection.project(GeoPoint { latitude_deg: y, longitude_deg: x }),
            None => Vec2::new(x, y) * self.unit_m,
        }
    }
}

impl TableColumns {
    /// Whether a column must be in the table itself; others may be in the table of tracks.
    pub(super) fn is_of_rows(&self, name: &str) -> bool {
        let Self { track, x, y, time, frame, heading, recording, place, .. } = self;
        let optional = [time, frame, heading, recording, place].into_iter().flatten();
        [track, x, y].into_iter().chain(optional).any(|of_rows| of_rows == name)
    }
}

impl TableMapping {
    pub(super) fn plane(&self) -> Plane {
        let projection = self.origin.map(LocalUtm::around);
        let north_rad = projection.zip(self.origin).map_or(FRAC_PI_2, |(projection, at)| projection.north_rad(at));
        Plane { unit_m: self.length_unit_m, projection, north_rad }
    }

    /// The seconds that a number in the column of the time, or of the frame, stands for.
    pub(super) fn seconds_of(&self, value: f64) -> f64 {
        match self.frame_rate_hz {
            Some(rate_hz) if self.columns.time.is_none() => value / rate_hz,
            _ => value * self.time_unit_s,
        }
    }

    /// The class for a text of `columns.class`.
    pub(super) fn class_of(&self, text: &str) -> Option<AgentClass> {
        let other = || self.classes.iter().find(|(name, _)| whole_number(name) == text).map(|(_, class)| class);
        self.classes.get(text).or_else(other).copied()
    }

    /// Refuses mappings that cannot work.
    pub(in crate::ingest) fn validate(&self) -> Result<(), Error> {
        let refuse =
            |key: &str, detail: &str| Err(Error::Config { key: format!("table.{key}"), detail: detail.to_owned() });
        let TableColumns { time, frame, length, width, class, .. } = &self.columns;
        match (time, frame, self.frame_rate_hz) {
            (None, None, _) => return refuse("columns", "has neither time nor frame: name the column of the time"),
            (Some(_), Some(_), _) => return refuse("columns", "has both time and frame: name one of them"),
            (None, Some(_), None) => return refuse("frame_rate_hz", "is missing: how many frames are a second?"),
            (Some(_), None, Some(_)) => return refuse("frame_rate_hz", "is of columns.frame, which is not named"),
            _ => {}
        }
        let TableColumns { track, x, y, heading, .. } = &self.columns;
        let once = [Some(track), Some(x), Some(y), time.as_ref(), frame.as_ref(), heading.as_ref()];
        let once: Vec<&String> = once.into_iter().flatten().collect();
        if let Some((_, twice)) = once.iter().enumerate().find(|(idx, name)| once[..*idx].contains(name)) {
            return refuse("columns", &format!("has \"{twice}\" for two of track, x, y, time, frame and heading"));
        }
        if length.is_some() != width.is_some() {
            return refuse("columns", "has only one of length and width: name both or neither");
        }
        if self.origin.is_some() && (self.y_points_down || self.position == PositionOf::Corner) {
            return refuse("origin", "is of positions in degrees, which neither point down nor are corners");
        }
        if self.position == PositionOf::Corner && length.is_none() {
            return refuse("position", "is corner, which needs columns.length and columns.width");
        }
        if class.is_some() == self.classes.is_empty() {
            return refuse("classes", "and columns.class belong together: name both or neither");
        }
        for (key, pattern) in [("files", Some(&self.files)), ("track_files", self.track_files.as_ref())] {
            let Some(pattern) = pattern else { continue };
            if pattern.matches('*').count() > 1 || pattern.contains('/') || pattern.is_empty() {
                return refuse(key, "is the name of a file without its folders, with at most one *");
            }
        }
        if self.track_files.as_ref() == Some(&self.files) {
            return refuse("track_files", "is the same as files");
        }
        Ok(())
    }
}

fn default_files() -> String {
    "*.csv".to_owned()
}

const fn one() -> f64 {
    1.0
}

const fn vehicle() -> AgentClass {
    AgentClass::Vehicle
}

fn class_schema(_: &mut SchemaGenerator) -> Schema {
    json_schema!({ "type": "string", "enum": AgentClass::ALL.map(AgentClass::name) })
}

fn classes_schema(_: &mut SchemaGenerator) -> Schema {
    let class = json_schema!({ "type": "string", "enum": AgentClass::ALL.map(AgentClass::name) });
    json_schema!({ "type": "object", "additionalProperties": class })
}
