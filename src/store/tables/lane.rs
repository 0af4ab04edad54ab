//! The table of lanes: one row a lane of a whole map, in the recording's frame, once a map.

use super::columns::{Columns, entries, flags, lists, number_lists, numbers, optional_numbers, structs, texts};
use crate::geometry::{Polyline, Vec2};
use crate::scene::{Lane, LaneAttributes, LaneGraph, LaneId, MapId, TurnDirection};
use crate::store::schema::{ColumnExt, TableSchema, WORLD_FRAME, column, list_of, list_of_structs};
use crate::store::{Error, Result};
use arrow::array::RecordBatch;
use arrow::datatypes::{DataType, Field, Float64Type, Int64Type};
use std::collections::BTreeMap;
use std::sync::Arc;

/// `lane.v1`.
pub(crate) fn schema() -> TableSchema {
    let line = |name: &str, description: &str| {
        column(name, list_of(DataType::Float64), description).unit("m").frame(WORLD_FRAME)
    };
    let fields = vec![
        column("map_id", DataType::Utf8, "The map."),
        column("lane_id", DataType::Int64, "The map's name for the lane; ascending within a map."),
        line("centerline_x_m", "Center line in driving direction."),
        line("centerline_y_m", "Center line in driving direction."),
        line("left_x_m", "Left boundary in driving direction; empty if the map has none."),
        line("left_y_m", "Left boundary in driving direction; empty if the map has none."),
        line("right_x_m", "Right boundary in driving direction; empty if the map has none."),
        line("right_y_m", "Right boundary in driving direction; empty if the map has none."),
        column("successors", list_of(DataType::Int64), "Lanes that follow on from its end."),
        column("predecessors", list_of(DataType::Int64), "Lanes that end where it begins."),
        column("left_neighbor", DataType::Int64, "Lane beside it on the left, in the same direction.").optional(),
        column("right_neighbor", DataType::Int64, "Lane beside it on the right, in the same direction.").optional(),
        column("kind", DataType::Utf8, "The map's own word for its kind; empty if it has none."),
        column("turn", DataType::Utf8, "Turn at an intersection: none, left or right."),
        column("is_intersection", DataType::Boolean, "Whether it lies in an intersection."),
        column("has_traffic_control", DataType::Boolean, "Whether lights or signs control it."),
        column("one_way", DataType::Boolean, "Whether traffic runs one way only."),
        column("tags", list_of_structs(tag_fields()), "Further tags of the map, such as regulatory elements."),
    ];
    TableSchema {
        name: "lane",
        version: 1,
        description: "One row a lane of a map, each map once; sorted by map as first used, then by lane.",
        fields,
        open: Vec::new(),
    }
}

fn tag_fields() -> Vec<Field> {
    vec![column("key", DataType::Utf8, "Name of the tag."), column("value", DataType::Utf8, "Its value.")]
}

/// The rows of these maps.
pub(crate) fn encode(maps: &[(&MapId, &LaneGraph)]) -> Result<RecordBatch> {
    let lanes: Vec<&Lane> = maps.iter().flat_map(|(_, graph)| graph.lanes()).collect();
    let map_ids = maps.iter().flat_map(|(id, graph)| graph.lanes().iter().map(|_| id.0.as_str()));
    let line = |of: fn(&Lane) -> &Polyline, coordinate: fn(&Vec2) -> f64| {
        number_lists::<Float64Type, _>(lanes.iter().map(|lane| of(lane).0.iter().map(coordinate)))
    };
    let ids = |of: fn(&Lane) -> &Vec<LaneId>| {
        number_lists::<Int64Type, _>(lanes.iter().map(|lane| of(lane).iter().map(|id| id.0)))
    };
    let neighbor = |of: fn(&Lane) -> Option<LaneId>| {
        optional_numbers::<Int64Type>(lanes.iter().map(|lane| of(lane).map(|id| id.0)))
    };
    let flag = |of: fn(&LaneAttributes) -> bool| flags(lanes.iter().map(|lane| of(&lane.attributes)));
    let tags = || lanes.iter().flat_map(|lane| &lane.attributes.tags);
    let tag_structs = structs(
        "lane",
        &DataType::Struct(tag_fields().into()),
        vec![texts(tags().map(|(key, _)| key.as_str())), texts(tags().map(|(_, value)| value.as_str()))],
    )?;
    let arrays = vec![
        texts(map_ids),
        numbers::<Int64Type>(lanes.iter().map(|lane| lane.id.0)),
        line(|lane| &lane.centerline, |p| p.x),
        line(|lane| &lane.centerline, |p| p.y),
        line(|lane| &lane.left, |p| p.x),
        line(|lane| &lane.left, |p| p.y),
        line(|lane| &lane.right, |p| p.x),
        line(|lane| &lane.right, |p| p.y),
        ids(|lane| &lane.successors),
        ids(|lane| &lane.predecessors),
        neighbor(|lane| lane.left_neighbor),
        neighbor(|lane| lane.right_neighbor),
        texts(lanes.iter().map(|lane| lane.attributes.kind.as_str())),
        texts(lanes.iter().map(|lane| lane.attributes.turn.name())),
        flag(|attributes| attributes.is_intersection),
        flag(|attributes| attributes.has_traffic_control),
        flag(|attributes| attributes.one_way),
        lists(lanes.iter().map(|lane| lane.attributes.tags.len()), tag_structs),
    ];
    RecordBatch::try_new(schema().arrow(), arrays).map_err(|error| Error::invalid("lanes", error.to_string()))
}

pub(crate) fn decode(columns: &Columns<'_>, row: usize) -> Result<Lane> {
    let line = |x: &str, y: &str| -> Result<Polyline> {
        let (x, y) = (columns.numbers::<Float64Type>(x, row)?, columns.numbers::<Float64Type>(y, row)?);
        if x.len() != y.len() {
            return Err(Error::corrupt(columns.path, "a lane has more x than y coordinates"));
        }
        Ok(Polyline(x.iter().zip(y).map(|(x, y)| Vec2::new(*x, *y)).collect()))
    };
    let ids = |name: &str| -> Result<Vec<LaneId>> {
        Ok(columns.numbers::<Int64Type>(name, row)?.iter().copied().map(LaneId).collect())
    };
    let neighbor = |name: &str| Ok::<_, Error>(columns.optional_number::<Int64Type>(name, row)?.map(LaneId));
    Ok(Lane {
        id: LaneId(columns.number::<Int64Type>("lane_id", row)?),
        centerline: line("centerline_x_m", "centerline_y_m")?,
        left: line("left_x_m", "left_y_m")?,
        right: line("right_x_m", "right_y_m")?,
        successors: ids("successors")?,
        predecessors: ids("predecessors")?,
        left_neighbor: neighbor("left_neighbor")?,
        right_neighbor: neighbor("right_neighbor")?,
        attributes: Arc::new(LaneAttributes {
            kind: columns.text("kind", row)?.to_owned(),
            turn: columns.named("turn", row, TurnDirection::from_name)?,
            is_intersection: columns.flag("is_intersection", row)?,
            has_traffic_control: columns.flag("has_traffic_control", row)?,
            one_way: columns.flag("one_way", row)?,
            tags: decode_tags(columns, row)?,
        }),
    })
}

fn decode_tags(columns: &Columns<'_>, row: usize) -> Result<BTreeMap<String, String>> {
    let (list, tags) = columns.of_list("tags")?;
    entries(list, row).map(|i| Ok((tags.text("key", i)?.to_owned(), tags.text("value", i)?.to_owned()))).collect()
}
