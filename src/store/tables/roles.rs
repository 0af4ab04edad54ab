//! Lists of roles and tracks, and extra columns for queries.

use super::columns::{Columns, entries, lists, optional_texts, structs, texts};
use crate::scene::{Roles, TrackId};
use crate::store::Result;
use crate::store::schema::{ColumnExt, OpenColumns, column, list_of_structs};
use arrow::array::ArrayRef;
use arrow::datatypes::{DataType, Field};
use std::collections::BTreeSet;

/// A column with the track of each role.
pub(crate) fn field(name: &str, description: &str) -> Field {
    let members = vec![
        column("role", DataType::Utf8, "Name of the role."),
        column("track_id", DataType::Utf8, "The track in it."),
    ];
    column(name, list_of_structs(members), description)
}

pub(crate) fn encode(rows: &[&Roles]) -> Result<ArrayRef> {
    let all = || rows.iter().flat_map(|roles| roles.iter());
    let arrays = vec![texts(all().map(|(role, _)| role.as_str())), texts(all().map(|(_, track)| track.0.as_str()))];
    let values = structs("roles", field("roles", "").data_type(), arrays)?;
    Ok(lists(rows.iter().map(|roles| roles.len()), values))
}

pub(crate) fn decode(columns: &Columns<'_>, name: &str, row: usize) -> Result<Roles> {
    let (list, roles) = columns.of_list(name)?;
    entries(list, row)
        .map(|i| Ok((roles.text("role", i)?.to_owned(), TrackId::from(roles.text("track_id", i)?))))
        .collect()
}

/// The open columns of [`flatten`].
pub(crate) fn open_columns() -> OpenColumns {
    OpenColumns {
        pattern: "<role>_track_id",
        data_type: DataType::Utf8,
        description: "The track in this role, such as ego_track_id; missing if the row has no such role.",
        known: Vec::new(),
    }
}

/// One column for each of these roles, sorted by name.
pub(crate) fn flatten(names: &BTreeSet<&str>, rows: &[&Roles]) -> Vec<(Field, ArrayRef)> {
    names
        .iter()
        .map(|name| {
            let field = column(&format!("{name}_track_id"), DataType::Utf8, "The track in this role.").optional();
            let tracks = rows.iter().map(|roles| roles.track(name).map(|track| track.0.as_str()));
            (field, optional_texts(tracks))
        })
        .collect()
}
