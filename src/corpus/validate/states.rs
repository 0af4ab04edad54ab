//! Checks that states are in order of time, agree in both frames, and are physically possible.

use super::{Known, ValidationReport};
use crate::corpus::Result;
use crate::corpus::rows::texts;
use crate::geometry::{Transform2, Vec2};
use crate::store::{Columns, CorpusChunk, CorpusScan, CorpusTable, FileEntry, fingerprint};
use arrow::array::{Array, BooleanArray, Float32Array, Float64Array, StringArray, UInt32Array};
use arrow::datatypes::{Float64Type, UInt32Type};
use std::collections::BTreeSet;
use std::f64::consts::PI;
use std::ops::Range;

/// The fastest that anything on a road is, m/s.
const MAX_SPEED_MPS: f64 = 100.0;
/// The largest size of a road user, meters.
const MAX_SIZE_M: f32 = 40.0;
/// The farthest that a state can be from its scene's origin, meters.
const MAX_DISTANCE_M: f64 = 5000.0;
/// The required agreement of both frames, meters: single precision within [`MAX_DISTANCE_M`] is good to half a
/// millimeter.
const FRAME_TOLERANCE_M: f64 = 0.01;

struct States<'a> {
    track_id: &'a StringArray,
    is_center: &'a BooleanArray,
    timestep: &'a UInt32Array,
    t_s: &'a Float64Array,
    numbers: [&'a Float32Array; 5],
    world: [&'a Float64Array; 2],
    sizes: [&'a Float32Array; 2],
}

impl<'a> States<'a> {
    fn of(columns: &Columns<'a>) -> Result<Self> {
        Ok(Self {
            track_id: columns.get("track_id")?,
            is_center: columns.get("is_center")?,
            timestep: columns.get("timestep")?,
            t_s: columns.get("t_s")?,
            numbers: [
                columns.get("x_m")?,
                columns.get("y_m")?,
                columns.get("heading_rad")?,
                columns.get("vx_mps")?,
                columns.get("vy_mps")?,
            ],
            world: [columns.get("world_x_m")?, columns.get("world_y_m")?],
            sizes: [columns.get("length_m")?, columns.get("width_m")?],
        })
    }

    fn number(&self, i: usize, row: usize) -> f64 {
        f64::from(self.numbers[i].value(row))
    }
}

/// The place at which findings are reported.
struct Location<'r> {
    file: &'r str,
    /// Position in the file of the first row of the batch.
    first_row: usize,
    report: &'r mut ValidationReport,
}

impl Location<'_> {
    fn damage(&mut self, check: &'static str, row: usize, detail: impl Into<String>) {
        self.report.damage(check, self.file, Some(self.first_row + row), detail);
    }
}

/// Checks the states of scenario `i` of a chunk.
pub(super) fn check_scenario(
    chunk: &CorpusChunk,
    i: usize,
    [file, tracks_file]: [&FileEntry; 2],
    report: &mut ValidationReport,
) -> Result<()> {
    let scenarios = chunk.columns();
    let columns = Columns::of_batch(&chunk.tracks, &chunk.tracks_path);
    let (states, rows) = (States::of(&columns)?, chunk.track_rows[i].clone());
    let id = scenarios.text("scenario_id", i)?;
    let ids: &StringArray = columns.get("scenario_id")?;
    let mut place = Location { file: &tracks_file.path, first_row: chunk.first_track_row, report };
    if let Some(row) = rows.clone().find(|row| ids.value(*row) != id) {
        place.damage("reference", row, format!("it is of scenario {}, expected {id}", ids.value(row)));
        return Ok(());
    }
    let n_timesteps = scenarios.number::<UInt32Type>("n_timesteps", i)?;
    let dt_s = scenarios.number::<Float64Type>("dt_s", i)?;
    let n_tracks = check_tracks(&states, rows.clone(), n_timesteps, dt_s, &mut place);
    let transform = scenarios.of_struct_column("world_from_scene")?;
    let coordinate = |name: &str| transform.number::<Float64Type>(name, i);
    let origin = Vec2::new(coordinate("x_m")?, coordinate("y_m")?);
    let world_from_scene = Transform2::from_pose(origin, coordinate("rotation_rad")?);
    check_frames(&states, rows.clone(), &world_from_scene, &mut place);

    let row = chunk.first_row + i;
    let n_agents = scenarios.number::<UInt32Type>("n_agents", i)?;
    if n_tracks != n_agents as usize {
        report.damage(
            "counts",
            &file.path,
            Some(row),
            format!("n_agents is {n_agents}, but {n_tracks} tracks have states"),
        );
    }
    let center = scenarios.text("center_track_id", i)?;
    let is_wrong = |row: &usize| states.is_center.value(*row) != (states.track_id.value(*row) == center);
    if rows.clone().any(|row| is_wrong(&row)) || !rows.clone().any(|row| states.is_center.value(row)) {
        report.damage(
            "reference",
            &file.path,
            Some(row),
            format!("the center is {center}, but another track is marked as the center"),
        );
    }
    Ok(())
}

/// Checks the tracks in these rows, and gives back how many there are.
fn check_tracks(
    states: &States<'_>,
    rows: Range<usize>,
    n_timesteps: u32,
    dt_s: f64,
    place: &mut Location<'_>,
) -> usize {
    let mut tracks: BTreeSet<&str> = BTreeSet::new();
    let mut last: Option<(&str, u32)> = None;
    for row in rows {
        let (track, timestep) = (states.track_id.value(row), states.timestep.value(row));
        match last {
            Some((of, before)) if of == track => {
                if timestep <= before {
                    place.damage("order", row, format!("track {track}: timestep {timestep} comes after {before}"));
                }
            }
            _ => {
                if !tracks.insert(track) {
                    place.damage("order", row, format!("the rows of track {track} are not together"));
                }
            }
        }
        last = Some((track, timestep));
        if timestep >= n_timesteps {
            place.damage("range", row, format!("timestep {timestep} of {n_timesteps}"));
        }
        if (states.t_s.value(row) - f64::from(timestep) * dt_s).abs() > 1e-6 {
            place.damage(
                "range",
                row,
                format!("t_s is {} at timestep {timestep} of {dt_s} s each", states.t_s.value(row)),
            );
        }
        check_state(states, row, place);
    }
    tracks.len()
}

fn check_state(states: &States<'_>, row: usize, place: &mut Location<'_>) {
    let heading_rad = states.number(2, row);
    if heading_rad.abs() > PI {
        place.damage("range", row, format!("heading_rad is {heading_rad}, expected within half a turn"));
    }
    for (name, size) in ["length_m", "width_m"].iter().zip(states.sizes) {
        let is_possible = |size: f32| size > 0.0 && size <= MAX_SIZE_M;
        if !size.is_null(row) && !is_possible(size.value(row)) {
            place.damage(
                "range",
                row,
                format!("{name} is {}, expected more than 0 and at most {MAX_SIZE_M}", size.value(row)),
            );
        }
    }
    let position = Vec2::new(states.number(0, row), states.number(1, row));
    if position.norm() > MAX_DISTANCE_M {
        let detail =
            format!("it is {:.0} m from the origin of its scene, expected at most {MAX_DISTANCE_M}", position.norm());
        place.damage("range", row, detail);
    }
    // Recorded tracks jump, and tracks generated from them may do so, too: worth a look, no damage.
    let speed_mps = Vec2::new(states.number(3, row), states.number(4, row)).norm();
    if speed_mps > MAX_SPEED_MPS {
        let detail = format!("the speed is {speed_mps:.1} m/s, more than {MAX_SPEED_MPS}");
        place.report.remark("speed", place.file, Some(place.first_row + row), detail);
    }
}

/// Checks that positions in both frames are the same places.
fn check_frames(states: &States<'_>, rows: Range<usize>, world_from_scene: &Transform2, place: &mut Location<'_>) {
    for row in rows {
        let position = world_from_scene.point(Vec2::new(states.number(0, row), states.number(1, row)));
        let world = Vec2::new(states.world[0].value(row), states.world[1].value(row));
        let distance_m = position.distance(world);
        if distance_m > FRAME_TOLERANCE_M {
            place.damage(
                "frames",
                row,
                format!("the scene frame and the recording's frame differ by {distance_m:.3} m"),
            );
        }
    }
}

/// Checks the recorded scenes: each once, together, and one for each scene that scenarios continue.
pub(super) fn check_recordings(
    scan: &CorpusScan,
    readable: &BTreeSet<String>,
    known: &Known,
    report: &mut ValidationReport,
) -> Result<()> {
    let files = scan.manifest().files(CorpusTable::Recordings);
    let mut found = BTreeSet::new();
    for file in files.iter().filter(|file| readable.contains(&file.path)) {
        if let Err(error) = check_recording_file(scan, file, known, &mut found, report) {
            report.unreadable("unreadable", &file.path, error)?;
        }
    }
    let n_missing = known.scenes.keys().filter(|scene| !found.contains(*scene)).count();
    if n_missing > 0 && !files.is_empty() {
        let detail = format!("the recordings of {n_missing} scenes that scenarios continue are missing");
        report.remark("recordings", "recordings", None, detail);
    }
    if scan.manifest().n_recordings != found.len() as u64 && !files.is_empty() {
        let detail = format!("n_recordings is {}, but there are {}", scan.manifest().n_recordings, found.len());
        report.damage("counts", "manifest.json", None, detail);
    }
    Ok(())
}

fn check_recording_file(
    scan: &CorpusScan,
    file: &FileEntry,
    known: &Known,
    found: &mut BTreeSet<[u8; 16]>,
    report: &mut ValidationReport,
) -> Result<()> {
    let path = scan.path(file);
    let mut first_row = 0;
    // Batches break anywhere: the scene, track and timestep that the last one ended with.
    let mut last: Option<(String, String, u32)> = None;
    for batch in scan.batches(CorpusTable::Recordings, file, None)? {
        let batch = batch?;
        super::files::non_finite(&batch, &file.path, first_row, report);
        report.n_states += batch.num_rows() as u64;
        let states = States::of(&Columns::of_batch(&batch, &path))?;
        let scenes = texts(&batch, "scene_id", &path)?;
        let mut place = Location { file: &file.path, first_row, report };
        for row in 0..batch.num_rows() {
            let (scene, track, timestep) = (scenes.value(row), states.track_id.value(row), states.timestep.value(row));
            let hash = fingerprint(scene.as_bytes());
            let is_same_scene = last.as_ref().is_some_and(|(of, ..)| of == scene);
            if !is_same_scene && !found.insert(hash) {
                place.damage("duplicate", row, format!("scene {scene} appears twice"));
            }
            match known.scenes.get(&hash) {
                None if !is_same_scene => {
                    place.damage("reference", row, format!("no scenario continues scene {scene}"));
                }
                Some((n_timesteps, _)) if timestep >= *n_timesteps => {
                    place.damage("range", row, format!("timestep {timestep} of {n_timesteps}"));
                }
                _ => {}
            }
            if let Some((_, of, before)) = &last
                && is_same_scene
                && of == track
                && timestep <= *before
            {
                place.damage("order", row, format!("track {track}: timestep {timestep} comes after {before}"));
            }
            check_state(&states, row, &mut place);
            last = Some((scene.to_owned(), track.to_owned(), timestep));
        }
        first_row += batch.num_rows();
    }
    Ok(())
}
