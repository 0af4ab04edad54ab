//! Samples of one scene, beside the recording and the baseline: what are their figures?

use super::measures::{Measures, Requested};
use crate::metrics::{SampleGroup, constant_velocity};
use crate::scene::{Scene, Track, Trajectory};
use crate::store::ScenarioRecord;

/// The samples of one scene, asked of the same agents at the same strength.
pub(super) struct Cell<'a> {
    /// The samples, in order.
    pub(super) records: Vec<&'a ScenarioRecord>,
    /// Whether the recording and the baseline are measured too: once for each scene and roles of a sweep.
    pub(super) with_references: bool,
}

/// The figures of a cell, each in the order of the measures.
pub(super) struct CellFigures {
    /// The recording, seen as its own only sample.
    pub(super) recorded: Option<Vec<Option<f64>>>,
    /// The constant-velocity baseline.
    pub(super) constant_velocity: Option<Vec<Option<f64>>>,
    /// All samples together.
    pub(super) together: Vec<Option<f64>>,
    /// Each sample alone.
    pub(super) alone: Vec<Vec<Option<f64>>>,
}

/// Puts the records of a shard into cells, in order of first appearance.
pub(super) fn into_cells(records: &[ScenarioRecord]) -> Vec<Cell<'_>> {
    let mut cells: Vec<Cell<'_>> = Vec::new();
    for record in records {
        let same_roles = |cell: &&mut Cell<'_>| is_same_question(cell.records[0], record);
        let same_cell = |cell: &&mut Cell<'_>| same_roles(cell) && strength(cell.records[0]) == strength(record);
        match cells.iter_mut().find(same_cell) {
            Some(cell) => cell.records.push(record),
            None => {
                let with_references = !cells.iter().any(|cell| is_same_question(cell.records[0], record));
                cells.push(Cell { records: vec![record], with_references });
            }
        }
    }
    cells
}

fn is_same_question(a: &ScenarioRecord, b: &ScenarioRecord) -> bool {
    let (a, b) = (&a.scenario.provenance, &b.scenario.provenance);
    a.scene_id == b.scene_id && a.guidance.roles == b.guidance.roles
}

fn strength(record: &ScenarioRecord) -> u64 {
    record.scenario.provenance.guidance.strength.to_bits()
}

impl Cell<'_> {
    /// Measures the cell against the scene it continues.
    pub(super) fn evaluate(&self, recorded: &Scene, measures: &Measures<'_>) -> CellFigures {
        let samples: Vec<Scene> = self.records.iter().map(|record| record.scenario.scene.clone()).collect();
        let recorded = as_far_as_generated(recorded, &samples[0]);
        let first = self.records[0];
        let requested = first
            .requested_behavior
            .as_deref()
            .map(|behavior| Requested { behavior, roles: &first.scenario.provenance.guidance.roles });
        let figures =
            |samples: &[Scene]| measures.evaluate(&SampleGroup::equally_likely(&recorded, samples), requested);
        let reference = |scene: Scene| self.with_references.then(|| figures(&[scene]));
        CellFigures {
            recorded: reference(recorded.clone()),
            constant_velocity: reference(constant_velocity(&recorded)),
            together: figures(&samples),
            alone: samples.chunks(1).map(figures).collect(),
        }
    }
}

/// The recording without the futures of agents that were not generated (beyond the denoiser's number of agents), so that
/// recording, baseline and samples are measured on the same agents.
fn as_far_as_generated(recorded: &Scene, sample: &Scene) -> Scene {
    let n_history = recorded.n_history;
    let was_generated = |track: &Track| track.trajectory.valid().any(|(timestep, _)| timestep >= n_history);
    let tracks = recorded.tracks.iter().zip(&sample.tracks).map(|(track, generated)| {
        let mut track = track.clone();
        if !was_generated(generated) {
            let observed = |(timestep, state): (usize, &Option<_>)| state.filter(|_| timestep < n_history);
            track.trajectory = Trajectory::new(track.trajectory.entries().iter().enumerate().map(observed).collect());
        }
        track
    });
    Scene { tracks: tracks.collect(), ..recorded.clone() }
}
