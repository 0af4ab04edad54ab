//! The table of tags: one row a recorded scene.

use super::columns::{Columns, numbers, texts};
use crate::coverage::{ATTRIBUTES, TaggedScene, Tags};
use crate::scene::Split;
use crate::store::schema::{ColumnExt, TableSchema, column};
use crate::store::{Error, Result};
use arrow::array::RecordBatch;
use arrow::datatypes::{DataType, Float64Type};
use std::path::Path;

/// `tag.v1`.
pub(crate) fn schema() -> TableSchema {
    let attribute = |attribute: &crate::coverage::Attribute| {
        let (openlabel, values) = (attribute.openlabel, attribute.values.join(", "));
        let description = format!("{} One of {values}. In OpenLABEL: {openlabel}.", attribute.definition);
        column(attribute.name, DataType::Utf8, &description)
    };
    let about = [
        column("scene_id", DataType::Utf8, "The scene."),
        column("place", DataType::Utf8, "Its place."),
        column("split", DataType::Utf8, "Its split."),
    ];
    let observed = "Time that it shows and no scene before it does.";
    let observed = column("observed_h", DataType::Float64, observed).unit("h");
    TableSchema {
        name: "tag",
        version: 1,
        description: "One row a recorded scene: what surrounds the center at the present, by attributes of ISO 34503.",
        fields: about.into_iter().chain(ATTRIBUTES.iter().map(attribute)).chain([observed]).collect(),
        open: Vec::new(),
    }
}

pub(crate) fn encode(rows: &[TaggedScene]) -> Result<RecordBatch> {
    let tag = |idx: usize| texts(rows.iter().map(move |row| row.tags.each()[idx].value()));
    let mut arrays = vec![
        texts(rows.iter().map(|row| row.scene_id.0.as_str())),
        texts(rows.iter().map(|row| row.place.as_str())),
        texts(rows.iter().map(|row| row.split.name())),
    ];
    arrays.extend((0..ATTRIBUTES.len()).map(tag));
    arrays.push(numbers::<Float64Type>(rows.iter().map(|row| row.observed_h)));
    RecordBatch::try_new(schema().arrow(), arrays).map_err(|error| Error::invalid("tags", error.to_string()))
}

pub(crate) fn decode(batch: &RecordBatch, path: &Path) -> Result<Vec<TaggedScene>> {
    let columns = Columns::of_batch(batch, path);
    let row = |row: usize| {
        let value = |attribute: usize| columns.text(ATTRIBUTES[attribute].name, row);
        let values = [value(0)?, value(1)?, value(2)?, value(3)?, value(4)?];
        let unknown = || Error::corrupt(path, format!("row {row} has tags {}, which are unknown", values.join(", ")));
        Ok(TaggedScene {
            scene_id: columns.text("scene_id", row)?.into(),
            place: columns.text("place", row)?.to_owned(),
            split: columns.named("split", row, Split::from_name)?,
            tags: Tags::named(values).ok_or_else(unknown)?,
            observed_h: columns.number::<Float64Type>("observed_h", row)?,
        })
    };
    (0..batch.num_rows()).map(row).collect()
}
