//! The schemas of our tables: columns with unit and frame, and versions.

use super::{Error, Result, tables};
use arrow::array::RecordBatch;
use arrow::compute::cast;
use arrow::datatypes::{DataType, Field, FieldRef, Fields, Schema, SchemaRef};
use arrow::error::ArrowError;
use serde::Serialize;
use std::path::Path;
use std::sync::Arc;

/// The key of the schema's name, such as `scene.v1`, in a file's metadata.
pub const SCHEMA_KEY: &str = "djinn.schema";

/// Frame of coordinates near zero: origin at the ego's position at the present, x axis along its heading there.
pub(crate) const SCENE_FRAME: &str = "scene";
/// Frame of the recording or its map, as the dataset defines it.
pub(crate) const WORLD_FRAME: &str = "world";
/// The unit or frame of a column without one.
const NONE: &str = "none";

/// Columns with names that depend on the data: one for each role or parameter.
#[derive(Debug, Clone)]
pub struct OpenColumns {
    /// The form of the names, such as `<role>_track_id`.
    pub pattern: &'static str,
    /// Their type.
    pub data_type: DataType,
    /// Their content.
    pub description: &'static str,
    /// The columns known beforehand.
    pub known: Vec<Field>,
}

/// The schema of one table.
#[derive(Debug, Clone)]
pub struct TableSchema {
    /// Name of the table, such as `scene`.
    pub name: &'static str,
    /// Version; it changes whenever a column is added, removed or changes its meaning.
    pub version: u32,
    /// The meaning of one row.
    pub description: &'static str,
    /// The columns.
    pub fields: Vec<Field>,
    /// Families of nullable columns after `fields`.
    pub open: Vec<OpenColumns>,
}

impl TableSchema {
    /// Every table of ours, in the order of the pipeline.
    pub fn all() -> Vec<Self> {
        vec![
            tables::scene::schema(),
            tables::lane::schema(),
            tables::event::schema(),
            tables::exposure::schema(),
            tables::rate::schema(),
            tables::tag::schema(),
            tables::coverage::schema(),
            tables::sample::schema(),
            tables::scenario::schema(),
            tables::track::schema(),
            tables::recording::schema(),
            tables::metric::schema(),
            tables::verdict::schema(),
            tables::drive::schema(),
            tables::driven::schema(),
        ]
    }

    /// Name and version, such as `scene.v1`.
    pub fn id(&self) -> String {
        format!("{}.v{}", self.name, self.version)
    }

    /// The Arrow schema without open columns.
    pub fn arrow(&self) -> SchemaRef {
        self.arrow_with(Vec::new())
    }

    /// The Arrow schema with these open columns at its end.
    pub(crate) fn arrow_with(&self, open: Vec<Field>) -> SchemaRef {
        let fields: Fields = self.fields.iter().cloned().chain(open).collect();
        Arc::new(Schema::new_with_metadata(fields, [(SCHEMA_KEY, self.id())]))
    }

    /// The open columns of a file of this table.
    pub(crate) fn open_of<'f>(&self, found: &'f Schema) -> impl Iterator<Item = &'f Field> {
        found.fields().iter().map(AsRef::as_ref).filter(|field: &&Field| !self.has(field.name()))
    }

    /// Whether a column with this name is one of the fixed ones.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.fields.iter().any(|field| field.name() == name)
    }

    /// Checks that `found`, read from `path`, is this schema in this version.
    pub(crate) fn check(&self, path: &Path, found: &Schema) -> Result<()> {
        let found_id = found.metadata().get(SCHEMA_KEY).map_or("", |id| id.as_str());
        if found_id != self.id() {
            let (expected, found) = (self.id(), found_id.to_owned());
            return Err(Error::SchemaVersion { path: path.to_owned(), expected, found });
        }
        for field in &self.fields {
            let other = found.fields().iter().find(|other| other.name() == field.name());
            if !other.is_some_and(|other| other.data_type().equals_datatype(field.data_type())) {
                return Err(Error::corrupt(path, format!("column {} is missing or has another type", field.name())));
            }
        }
        Ok(())
    }

    /// The batch with the columns in their order and with their descriptions, then its open columns. Call it on batches
    /// whose schema passed [`check`](Self::check).
    pub(crate) fn conform(&self, path: &Path, batch: &RecordBatch) -> Result<RecordBatch> {
        let schema = self.arrow_with(self.open_of(batch.schema_ref()).cloned().collect());
        let column = |field: &FieldRef| match batch.column_by_name(field.name()) {
            Some(column) if column.data_type() == field.data_type() => Ok(Arc::clone(column)),
            // The type is the same, but the descriptions of its members differ.
            Some(column) => cast(column, field.data_type()),
            None => Err(ArrowError::SchemaError(format!("column {} is missing", field.name()))),
        };
        let columns = schema.fields().iter().map(column).collect::<std::result::Result<Vec<_>, _>>();
        columns
            .and_then(|columns| RecordBatch::try_new(schema, columns))
            .map_err(|error| Error::unreadable(path, error))
    }

    /// The schema as it is published in `schemas/`: indented JSON with a final newline.
    pub fn json(&self) -> serde_json::Result<String> {
        let open = |columns: &OpenColumns| OpenColumnsDoc {
            names: columns.pattern,
            data_type: type_name(&columns.data_type),
            nullable: true,
            description: columns.description,
            known: columns.known.iter().map(ColumnDoc::of).collect(),
        };
        let doc = TableDoc {
            schema: self.id(),
            description: self.description,
            frames: FRAMES,
            columns: self.fields.iter().map(ColumnDoc::of).collect(),
            further_columns: self.open.iter().map(open).collect(),
        };
        Ok(serde_json::to_string_pretty(&doc)? + "\n")
    }
}

/// The definitions of the frames.
const FRAMES: FramesDoc = FramesDoc {
    scene: "Origin at the position of the center (the road user around which the scene was cut out) at timestep \
            n_history - 1, x axis along its heading there.",
    world: "The frame of the recording or its map, as the dataset defines it.",
};

/// A published schema.
#[derive(Serialize)]
struct TableDoc {
    schema: String,
    description: &'static str,
    frames: FramesDoc,
    columns: Vec<ColumnDoc>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    further_columns: Vec<OpenColumnsDoc>,
}

#[derive(Serialize)]
struct FramesDoc {
    scene: &'static str,
    world: &'static str,
}

#[derive(Serialize)]
struct ColumnDoc {
    name: String,
    #[serde(rename = "type")]
    data_type: String,
    nullable: bool,
    unit: String,
    frame: String,
    description: String,
    /// The members of a struct or of a list of structs.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    members: Vec<Self>,
}

#[derive(Serialize)]
struct OpenColumnsDoc {
    names: &'static str,
    #[serde(rename = "type")]
    data_type: String,
    nullable: bool,
    description: &'static str,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    known: Vec<ColumnDoc>,
}

impl ColumnDoc {
    fn of(field: &Field) -> Self {
        let metadata = |key: &str| field.metadata().get(key).cloned().unwrap_or_default();
        let members = match field.data_type() {
            DataType::Struct(members) => Some(members),
            DataType::List(item) => match item.data_type() {
                DataType::Struct(members) => Some(members),
                _ => None,
            },
            _ => None,
        };
        Self {
            name: field.name().clone(),
            data_type: type_name(field.data_type()),
            nullable: field.is_nullable(),
            unit: metadata("unit"),
            frame: metadata("frame"),
            description: metadata("description"),
            members: members.into_iter().flatten().map(|member| Self::of(member)).collect(),
        }
    }
}

/// The name of a type, such as `list<float64>`.
pub(crate) fn type_name(data_type: &DataType) -> String {
    match data_type {
        DataType::List(item) => format!("list<{}>", type_name(item.data_type())),
        DataType::Struct(_) => "struct".to_owned(),
        other => other.to_string().to_lowercase(),
    }
}

/// A required column without unit or frame.
pub(crate) fn column(name: &str, data_type: DataType, description: &str) -> Field {
    let metadata = [("unit", NONE), ("frame", NONE), ("description", description)];
    Field::new(name, data_type, false).with_metadata(metadata)
}

/// The type of a list without missing entries.
pub(crate) fn list_of(data_type: DataType) -> DataType {
    DataType::List(Arc::new(Field::new_list_field(data_type, false)))
}

pub(crate) fn list_of_structs(fields: Vec<Field>) -> DataType {
    list_of(DataType::Struct(fields.into()))
}

/// Properties of a column beyond its type.
pub(crate) trait ColumnExt {
    /// Sets its unit.
    fn unit(self, unit: &str) -> Self;
    /// Sets its frame.
    fn frame(self, frame: &str) -> Self;
    /// Makes it nullable.
    fn optional(self) -> Self;
}

impl ColumnExt for Field {
    fn unit(self, unit: &str) -> Self {
        with_entry(self, "unit", unit)
    }

    fn frame(self, frame: &str) -> Self {
        with_entry(self, "frame", frame)
    }

    fn optional(self) -> Self {
        self.with_nullable(true)
    }
}

fn with_entry(field: Field, key: &str, value: &str) -> Field {
    let metadata = field.metadata().clone();
    let entries = metadata.iter().map(|(k, v)| (k.to_string(), v.to_string())).filter(|(k, _)| k != key);
    let entries: Vec<_> = entries.chain([(key.to_owned(), value.to_owned())]).collect();
    field.with_metadata(entries.into_iter().collect::<arrow::datatypes::Metadata>())
}

/// The unit at the end of a parameter's name.
pub(crate) fn unit_of_name(name: &str) -> &'static str {
    const SUFFIXES: [(&str, &str); 12] = [
        ("_mps3", "m/s^3"),
        ("_mps2", "m/s^2"),
        ("_mps", "m/s"),
        ("_radps", "rad/s"),
        ("_rad", "rad"),
        ("_deg", "deg"),
        ("_per_m", "1/m"),
        ("_per_hour", "1/h"),
        ("_per_1000_km", "1/(1000 km)"),
        ("_km", "km"),
        ("_m", "m"),
        ("_s", "s"),
    ];
    SUFFIXES.iter().find(|(suffix, _)| name.ends_with(suffix)).map_or("1", |(_, unit)| unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_field_of_every_table_says_what_it_is() {
        fn check(table: &str, field: &Field) {
            for key in ["unit", "frame", "description"] {
                let value = field.metadata().get(key).map_or("", |value| value.as_str());
                assert!(!value.is_empty(), "{table}.{} has no {key}", field.name());
            }
            let unit = field.metadata().get("unit").unwrap().to_string();
            let by_name = unit_of_name(field.name());
            assert!(by_name == "1" || by_name == unit, "{table}.{} is in {unit}", field.name());
            match field.data_type() {
                DataType::Struct(members) => members.iter().for_each(|member| check(table, member)),
                DataType::List(item) => {
                    if let DataType::Struct(members) = item.data_type() {
                        members.iter().for_each(|member| check(table, member));
                    }
                }
                _ => {}
            }
        }
        for table in TableSchema::all() {
            let known = table.open.iter().flat_map(|open| &open.known);
            table.fields.iter().chain(known).for_each(|field| check(table.name, field));
        }
    }

    #[test]
    fn units_follow_from_names() {
        let cases = [("gap_m", "m"), ("speed_mps", "m/s"), ("decel_mps2", "m/s^2"), ("ttc_s", "s"), ("count", "1")];
        for (name, unit) in cases {
            assert_eq!(unit_of_name(name), unit);
        }
    }
}
