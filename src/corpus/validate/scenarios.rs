//! Checks that the rows of scenarios are possible and unique, and that their states, lanes and partitions fit.

use super::files::non_finite;
use super::{Known, ValidationReport, states};
use crate::corpus::Result;
use crate::progress::Progress;
use crate::store::{Columns, CorpusScan, CorpusTable, FileEntry, fingerprint};
use arrow::datatypes::{Float64Type, Int64Type, UInt32Type};
use std::collections::BTreeSet;

/// The longest time between timesteps that makes sense, seconds.
const MAX_DT_S: f64 = 10.0;

/// Checks all scenarios with their states.
pub(super) fn check(
    scan: &CorpusScan,
    readable: &BTreeSet<String>,
    known: &mut Known,
    report: &mut ValidationReport,
    progress: &dyn Progress,
) -> Result<()> {
    for part in 0..scan.n_parts() {
        let (file, tracks_file) = match scan.part(part) {
            Ok(files) => files,
            Err(error) => {
                report.damage("manifest", "manifest.json", None, error.to_string());
                continue;
            }
        };
        if !readable.contains(&file.path) {
            continue;
        }
        // First the rows of scenarios alone: they can still be checked if states are damaged.
        let checked = check_rows(scan, part, file, known, report, progress);
        let checked = checked.and_then(|()| match readable.contains(&tracks_file.path) {
            true => check_states(scan, part, [file, tracks_file], report),
            false => Ok(()),
        });
        if let Err(error) = checked {
            report.unreadable("unreadable", &file.path, error)?;
        }
    }
    Ok(())
}

fn check_rows(
    scan: &CorpusScan,
    part: usize,
    file: &FileEntry,
    known: &mut Known,
    report: &mut ValidationReport,
    progress: &dyn Progress,
) -> Result<()> {
    for chunk in scan.chunks(part, false)? {
        let chunk = chunk?;
        report.n_scenarios += chunk.len() as u64;
        non_finite(&chunk.scenarios, &file.path, chunk.first_row, report);
        for i in 0..chunk.len() {
            check_row(&chunk.columns(), i, chunk.first_row + i, file, known, report)?;
        }
        progress.advance(chunk.len() as u64);
    }
    Ok(())
}

fn check_states(
    scan: &CorpusScan,
    part: usize,
    [file, tracks_file]: [&FileEntry; 2],
    report: &mut ValidationReport,
) -> Result<()> {
    for chunk in scan.chunks(part, true)? {
        let chunk = chunk?;
        non_finite(&chunk.tracks, &tracks_file.path, chunk.first_track_row, report);
        report.n_states += chunk.tracks.num_rows() as u64;
        for i in 0..chunk.len() {
            states::check_scenario(&chunk, i, [file, tracks_file], report)?;
        }
    }
    Ok(())
}

fn check_row(
    columns: &Columns<'_>,
    i: usize,
    row: usize,
    file: &FileEntry,
    known: &mut Known,
    report: &mut ValidationReport,
) -> Result<()> {
    let id = columns.text("scenario_id", i)?;
    if !known.scenarios.insert(fingerprint(id.as_bytes())) {
        report.damage("duplicate", &file.path, Some(row), format!("scenario {id} appears twice"));
    }
    let behavior = columns.optional_text("requested_behavior", i)?;
    let expected = CorpusTable::Scenarios.partition(behavior, columns.text("place", i)?);
    if file.partition != Default::default() && file.partition != expected {
        report.damage("partition", &file.path, Some(row), format!("scenario {id} belongs in another partition"));
    }
    let (n_timesteps, n_history) =
        (columns.number::<UInt32Type>("n_timesteps", i)?, columns.number::<UInt32Type>("n_history", i)?);
    let dt_s = columns.number::<Float64Type>("dt_s", i)?;
    if !(dt_s > 0.0 && dt_s <= MAX_DT_S) {
        report.damage(
            "range",
            &file.path,
            Some(row),
            format!("dt_s is {dt_s}, expected more than 0 and at most {MAX_DT_S}"),
        );
    }
    if n_history == 0 || n_history > n_timesteps {
        report.damage("range", &file.path, Some(row), format!("n_history is {n_history} of {n_timesteps} timesteps"));
    }
    let event = |name: &str| columns.optional_number::<UInt32Type>(name, i);
    let (start, end) = (event("event_start_timestep")?, event("event_end_timestep")?);
    if start > end || end.is_some_and(|end| end >= n_timesteps) {
        let shown =
            |timestep: Option<u32>| timestep.map_or_else(|| "missing".to_owned(), |timestep| timestep.to_string());
        let (start, end) = (shown(start), shown(end));
        let detail = format!("the event lasts from timestep {start} to {end} of {n_timesteps}");
        report.damage("range", &file.path, Some(row), detail);
    }
    if let Some(probability) = columns.optional_number::<Float64Type>("probability", i)?
        && !(0.0..=1.0).contains(&probability)
    {
        report.damage("range", &file.path, Some(row), format!("probability is {probability}"));
    }
    let scene = fingerprint(columns.text("scene_id", i)?.as_bytes());
    known.scenes.insert(scene, (n_timesteps, dt_s));
    check_lanes(columns, i, row, file, known, report)
}

fn check_lanes(
    columns: &Columns<'_>,
    i: usize,
    row: usize,
    file: &FileEntry,
    known: &Known,
    report: &mut ValidationReport,
) -> Result<()> {
    let lane_ids = columns.numbers::<Int64Type>("lane_ids", i)?;
    if lane_ids.is_empty() {
        return Ok(());
    }
    let Some(map_id) = columns.optional_text("map_id", i)? else {
        report.damage("reference", &file.path, Some(row), "the scenario has lanes but no map");
        return Ok(());
    };
    match known.lanes.get(map_id) {
        None => report.damage("reference", &file.path, Some(row), format!("there is no map {map_id}")),
        Some(lanes) => {
            if let Some(missing) = lane_ids.iter().find(|id| !lanes.contains(id)) {
                report.damage("reference", &file.path, Some(row), format!("map {map_id} has no lane {missing}"));
            }
        }
    }
    Ok(())
}
