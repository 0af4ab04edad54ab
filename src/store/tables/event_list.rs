//! Events as a nested column, so that a scenario's row holds all of its events.

use super::columns::{Columns, entries, lists, numbers, small, structs, texts};
use super::parameters::Parameters;
use super::roles;
use crate::behavior::{BehaviorEvent, EventLabel};
use crate::scene::SceneId;
use crate::store::Result;
use crate::store::schema::{ColumnExt, column, list_of_structs};
use arrow::array::ArrayRef;
use arrow::datatypes::{DataType, Field, Float64Type, UInt32Type};

/// The column.
pub(crate) fn field() -> Field {
    let members = vec![
        column("behavior", DataType::Utf8, "Name of the behavior."),
        column("label", DataType::Utf8, "positive or negative."),
        column("start_timestep", DataType::UInt32, "First timestep of the event.").unit("1"),
        column("end_timestep", DataType::UInt32, "Last timestep of the event.").unit("1"),
        roles::field("roles", "Who took part, in the behavior's order of roles."),
        parameters_field("parameters"),
    ];
    column("events", list_of_structs(members), "Events of the requested behavior that the miner found in the scenario.")
}

/// A column of parameters.
pub(crate) fn parameters_field(name: &str) -> Field {
    let members = vec![
        column("name", DataType::Utf8, "Name of the parameter, which ends in its unit."),
        column("value", DataType::Float64, "Its value, in the unit that its name ends in."),
    ];
    column(name, list_of_structs(members), "Parameters, sorted by name.")
}

/// The array of each row's parameters.
pub(crate) fn encode_parameters(rows: &[&Parameters]) -> Result<ArrayRef> {
    let all = || rows.iter().copied().flatten();
    let arrays = vec![texts(all().map(|(name, _)| name.as_str())), numbers::<Float64Type>(all().map(|(_, v)| *v))];
    let values = structs("events", parameters_field("").data_type(), arrays)?;
    Ok(lists(rows.iter().map(|row| row.len()), values))
}

pub(crate) fn decode_parameters(columns: &Columns<'_>, name: &str, row: usize) -> Result<Parameters> {
    let (list, parameters) = columns.of_list(name)?;
    let parameter =
        |i: usize| Ok((parameters.text("name", i)?.to_owned(), parameters.number::<Float64Type>("value", i)?));
    entries(list, row).map(parameter).collect()
}

/// The array of each row's events.
pub(crate) fn encode(rows: &[&[BehaviorEvent]]) -> Result<ArrayRef> {
    let events: Vec<&BehaviorEvent> = rows.iter().copied().flatten().collect();
    let timesteps = |of: fn(&BehaviorEvent) -> usize| -> Result<ArrayRef> {
        let values: Result<Vec<u32>> = events.iter().map(|e| small(&e.scene_id.0, "timestep", of(e))).collect();
        Ok(numbers::<UInt32Type>(values?))
    };
    let arrays = vec![
        texts(events.iter().map(|event| event.behavior.as_str())),
        texts(events.iter().map(|event| event.label.name())),
        timesteps(|event| event.start_timestep)?,
        timesteps(|event| event.end_timestep)?,
        roles::encode(&events.iter().map(|event| &event.roles).collect::<Vec<_>>())?,
        encode_parameters(&events.iter().map(|event| &event.parameters).collect::<Vec<_>>())?,
    ];
    Ok(lists(rows.iter().map(|row| row.len()), structs("events", field().data_type(), arrays)?))
}

/// The events in a row, which belong to `scene_id`.
pub(crate) fn decode(columns: &Columns<'_>, row: usize, scene_id: &SceneId) -> Result<Vec<BehaviorEvent>> {
    let (list, events) = columns.of_list("events")?;
    let decode_event = |i: usize| {
        Ok(BehaviorEvent {
            behavior: events.text("behavior", i)?.to_owned(),
            scene_id: scene_id.clone(),
            label: events.named("label", i, EventLabel::from_name)?,
            roles: roles::decode(&events, "roles", i)?,
            start_timestep: events.number::<UInt32Type>("start_timestep", i)? as usize,
            end_timestep: events.number::<UInt32Type>("end_timestep", i)? as usize,
            parameters: decode_parameters(&events, "parameters", i)?,
        })
    };
    entries(list, row).map(decode_event).collect()
}
