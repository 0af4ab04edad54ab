//! The table of events: one row an event, with one column for each role and each parameter that it may have.

use super::columns::{Columns, numbers, optional_texts, small, texts};
use super::parameters::{self, Parameters};
use super::roles;
use crate::behavior::{BehaviorEvent, EventLabel};
use crate::scene::{Roles, SceneId};
use crate::store::schema::{ColumnExt, TableSchema, column};
use crate::store::{Error, Result};
use arrow::array::{ArrayRef, RecordBatch};
use arrow::datatypes::{DataType, UInt32Type};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// `event.v1`.
pub(crate) fn schema() -> TableSchema {
    let fields = vec![
        column("event_id", DataType::Utf8, "Unique within the table: scene, behavior and running number."),
        column("behavior", DataType::Utf8, "Name of the behavior."),
        column(
            "label",
            DataType::Utf8,
            "positive: the behavior happens; negative: a hard negative, which only looks like it.",
        ),
        column("scene_id", DataType::Utf8, "The scene it was found in: dataset/split/place/case."),
        column("dataset", DataType::Utf8, "First part of the scene's name.").optional(),
        column("split", DataType::Utf8, "Second part of the scene's name.").optional(),
        column("place", DataType::Utf8, "Third part of the scene's name.").optional(),
        column("start_timestep", DataType::UInt32, "First timestep of the event.").unit("1"),
        column("end_timestep", DataType::UInt32, "Last timestep of the event.").unit("1"),
        roles::field("roles", "Who took part, in the behavior's order of roles."),
    ];
    TableSchema {
        name: "event",
        version: 1,
        description: "One row an event of a behavior in a scene.",
        fields,
        open: vec![roles::open_columns(), parameters::open_columns()],
    }
}

/// The roles and parameters with columns in a table of events.
#[derive(Debug, Clone, Default)]
pub(crate) struct EventNames<'n> {
    pub(crate) roles: BTreeSet<&'n str>,
    pub(crate) parameters: BTreeSet<&'n str>,
}

impl EventNames<'_> {
    /// The error for a role or parameter of an event without a column.
    fn check(&self, event: &BehaviorEvent) -> Result<()> {
        let role = event.roles.names().find(|role| !self.roles.contains(role));
        let mut parameters = event.parameters.keys().map(String::as_str);
        let unknown = role.or_else(|| parameters.find(|name| !self.parameters.contains(name)));
        let refuse = |name: &str| {
            let message = format!("an event of {} cannot have it: its behavior does not declare it", event.behavior);
            Err(Error::invalid(name, message))
        };
        unknown.map_or(Ok(()), refuse)
    }
}

/// The rows of these events, with the number of each among those of its scene and behavior.
///
/// # Errors
/// [`Error::Invalid`] when a parameter has the name of another column, or an event has a role or parameter that is not
/// among `names`.
pub(crate) fn encode(events: &[BehaviorEvent], numbers: &[usize], names: &EventNames<'_>) -> Result<RecordBatch> {
    let schema = schema();
    parameters::check_names(&schema, &names.parameters)?;
    events.iter().try_for_each(|event| names.check(event))?;
    let roles: Vec<&Roles> = events.iter().map(|event| &event.roles).collect();
    let parameters: Vec<Option<&Parameters>> = events.iter().map(|event| Some(&event.parameters)).collect();
    let open = roles::flatten(&names.roles, &roles).into_iter();
    let open = open.chain(parameters::flatten(&names.parameters, &parameters));
    let (open_fields, open_arrays): (Vec<_>, Vec<_>) = open.unzip();
    let id = |(event, number): (&BehaviorEvent, &usize)| format!("{}#{}#{number}", event.scene_id, event.behavior);
    let ids: Vec<String> = events.iter().zip(numbers).map(id).collect();
    let part = |i: usize| optional_texts(events.iter().map(move |event| scene_part(&event.scene_id, i)));
    let mut arrays: Vec<ArrayRef> = vec![
        texts(ids.iter().map(String::as_str)),
        texts(events.iter().map(|event| event.behavior.as_str())),
        texts(events.iter().map(|event| event.label.name())),
        texts(events.iter().map(|event| event.scene_id.0.as_str())),
        part(0),
        part(1),
        part(2),
        timesteps(events, |event| event.start_timestep)?,
        timesteps(events, |event| event.end_timestep)?,
        roles::encode(&roles)?,
    ];
    arrays.extend(open_arrays);
    RecordBatch::try_new(schema.arrow_with(open_fields), arrays).map_err(|e| Error::invalid("events", e.to_string()))
}

pub(crate) fn decode(batch: &RecordBatch, path: &Path) -> Result<Vec<BehaviorEvent>> {
    let columns = Columns::of_batch(batch, path);
    let parameters = parameters::names(&schema(), batch);
    let event = |row: usize| {
        Ok(BehaviorEvent {
            behavior: columns.text("behavior", row)?.to_owned(),
            scene_id: SceneId::from(columns.text("scene_id", row)?),
            label: columns.named("label", row, EventLabel::from_name)?,
            roles: roles::decode(&columns, "roles", row)?,
            start_timestep: columns.number::<UInt32Type>("start_timestep", row)? as usize,
            end_timestep: columns.number::<UInt32Type>("end_timestep", row)? as usize,
            parameters: parameters::decode(&columns, &parameters, row)?,
        })
    };
    (0..batch.num_rows()).map(event).collect()
}

fn timesteps(events: &[BehaviorEvent], of: fn(&BehaviorEvent) -> usize) -> Result<ArrayRef> {
    let values: Result<Vec<u32>> = events.iter().map(|event| small(&event.scene_id.0, "timestep", of(event))).collect();
    Ok(numbers::<UInt32Type>(values?))
}

/// The number of each event among those of its scene and behavior, which must all be among these.
pub(crate) fn numbers_of(events: &[BehaviorEvent]) -> Vec<usize> {
    let mut counts: BTreeMap<(&SceneId, &str), usize> = BTreeMap::new();
    let mut numbers = Vec::with_capacity(events.len());
    for BehaviorEvent { scene_id, behavior, .. } in events {
        let count = counts.entry((scene_id, behavior)).or_default();
        numbers.push(*count);
        *count += 1;
    }
    numbers
}

/// Part `i` of a scene's name, if the name has all four.
pub(crate) fn scene_part(id: &SceneId, i: usize) -> Option<&str> {
    let mut parts = id.0.splitn(4, '/');
    let part = parts.nth(i)?;
    // The last of the four parts exists if as many follow as are missing.
    (i == 3 || parts.nth(2 - i).is_some()).then_some(part)
}
