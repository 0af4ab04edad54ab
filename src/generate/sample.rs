//! How does a shard of the plan become scenarios? Scenes of similar size form batches, and their samples are checked.

use super::batch::{Batch, Draw, Draws};
use super::conditioning::{Conditioned, Templates, Variant};
use super::{Cell, Error, Generator, ResolvedSweep, ShardPlan, requested_events};
use crate::metrics::PairPath;
use crate::nn::side_by_side;
use crate::progress::Progress;
use crate::scenario::ScenarioRecord;
use crate::scene::{GuidanceLevel, Scene, SceneId, UnfitScene};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// The results of a shard.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ShardOutput {
    /// The scenarios: cell by cell, within a cell strength by strength, within a strength by sample.
    pub records: Vec<ScenarioRecord>,
    /// Samples without a scenario.
    pub rejected: Vec<RejectedSample>,
}

/// A sample that is not a scenario.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RejectedSample {
    /// The scene it was to continue.
    pub scene_id: SceneId,
    /// The sweep.
    pub sweep: String,
    /// The level of its guidance.
    #[serde(flatten)]
    pub level: GuidanceLevel,
    /// Its number among the samples of its scene and strength.
    pub sample_idx: usize,
    /// The run's seed.
    pub seed: u64,
    /// Why it is not a scenario.
    pub reason: Rejection,
}

/// Why a sample is not a scenario: a text in files.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Rejection {
    /// It was not drawn: its requested agents would move as in an earlier sample of the shard.
    #[serde(rename = "its template repeats that of an earlier sample")]
    RepeatedTemplate,
    /// What is wrong with it.
    #[serde(untagged)]
    Unfit(String),
}

/// How many more templates are tried for a sample whose template repeats another.
const N_FURTHER: usize = 2;

/// A sample of a cell, or why there is none.
#[derive(Debug, Clone)]
struct Sampled {
    level: GuidanceLevel,
    sample_idx: usize,
    draw: Result<Draw, Rejection>,
}

/// The conditioning of the samples of a shard.
struct Given {
    /// For each cell one conditioning for all samples or, with templates, one for each sample.
    of_cells: Vec<Vec<Conditioned>>,
    first_sample: usize,
}

impl Given {
    fn of(&self, cell: usize, sample_idx: usize) -> &Conditioned {
        let own = &self.of_cells[cell];
        &own[(sample_idx - self.first_sample).min(own.len() - 1)]
    }

    /// Whether a sample with a template repeats another; `None` if the cell has no such sample.
    fn repeats(&self, cell: usize, sample_idx: usize) -> Option<bool> {
        self.of_cells[cell].get(sample_idx - self.first_sample).map(|given| given.repeats)
    }
}

/// The samples of a cell that were conditioned before one of them.
#[derive(Debug, Default)]
struct Before {
    templates: Templates,
    /// How the requested agents move in those of the samples.
    paths: Vec<PairPath>,
}

/// Decides whether to generate a batch, given its level, cells and samples.
type BatchChoice<'a> = dyn Fn(GuidanceLevel, &[usize], &Range<usize>) -> bool + Sync + 'a;

impl Generator<'_> {
    /// Generates a shard. Progress advances by one for each sample.
    ///
    /// # Errors
    /// When a scene cannot be loaded or is not the planned one, or a tensor operation fails. Samples that are not
    /// finite are not errors: they are rejected. [`Error::Stopped`] when the process must stop between two batches.
    pub fn generate(&self, shard: &ShardPlan, progress: &dyn Progress) -> Result<ShardOutput, Error> {
        self.generate_part(shard, &|_, _, _| true, progress)
    }

    /// Generates the batches of a shard that `is_chosen` picks. Batches do not depend on each other.
    pub(super) fn generate_part(
        &self,
        shard: &ShardPlan,
        is_chosen: &BatchChoice<'_>,
        progress: &dyn Progress,
    ) -> Result<ShardOutput, Error> {
        let sweep = &self.config.sweeps[shard.sweep_idx];
        let scenes: Vec<Scene> =
            shard.cells.iter().map(|cell| self.load(cell.scene_idx, &cell.scene_id)).collect::<Result<_, _>>()?;
        let given = self.given(sweep, shard, &scenes)?;
        let batches = self.batches(sweep, &scenes, &given);
        let draw = |(members, samples): &(Vec<usize>, Range<usize>)| -> Result<Vec<(GuidanceLevel, Draws)>, Error> {
            if progress.must_stop() {
                return Err(Error::Stopped);
            }
            let is_chosen = |level: &GuidanceLevel| is_chosen(*level, members, samples);
            let levels: Vec<GuidanceLevel> = sweep.levels().iter().copied().filter(is_chosen).collect();
            if levels.is_empty() {
                return Ok(Vec::new());
            }
            let cells = members.iter().map(|at| (&shard.cells[*at], given.of(*at, samples.start))).collect();
            let batch = Batch { sweep, cells, samples: samples.clone() };
            let draws = self.sample(&batch, &levels, progress)?;
            Ok(levels.into_iter().zip(draws).collect())
        };
        let mut drawn = side_by_side(self.device, &batches, draw)?;
        let mut sampled: Vec<Vec<Sampled>> = vec![Vec::new(); shard.cells.len()];
        for &level in sweep.levels() {
            for ((members, samples), drawn) in batches.iter().zip(&mut drawn) {
                let at_level = drawn.iter_mut().find(|(of_level, _)| *of_level == level);
                let Some((_, draws)) = at_level else { continue };
                let mut draws = std::mem::take(draws).into_iter();
                for at in members {
                    let own = samples.clone().zip(draws.by_ref().take(samples.len()));
                    sampled[*at].extend(own.map(|(sample_idx, draw)| {
                        let draw = draw.map_err(|UnfitScene(why)| Rejection::Unfit(why));
                        Sampled { level, sample_idx, draw }
                    }));
                }
            }
            for (at, own) in sampled.iter_mut().enumerate() {
                let all = shard.first_sample..shard.first_sample + sweep.n_samples;
                let repeated =
                    all.filter(|sample_idx| given.repeats(at, *sample_idx) == Some(true)).map(|sample_idx| {
                        progress.advance(1);
                        Sampled { level, sample_idx, draw: Err(Rejection::RepeatedTemplate) }
                    });
                own.extend(repeated);
            }
        }
        let of_cell = |(at, (scene, sampled)): (usize, (&Scene, Vec<Sampled>))| -> Result<ShardOutput, Error> {
            let mut output = ShardOutput::default();
            let cell = &shard.cells[at];
            let is_recorded = |behavior| !sampled.is_empty() && requested_events(behavior, &cell.roles, scene).0;
            let recorded_event = self.behavior(sweep).is_some_and(is_recorded);
            for Sampled { level, sample_idx, draw } in sampled {
                match draw {
                    Ok(draw) => {
                        let given = given.of(at, sample_idx);
                        let performed = given.with_maneuver(draw.scene);
                        let scenario = (&performed, given.observed(&performed));
                        let sample = (level, sample_idx, draw.probability);
                        output.records.push(self.record(sweep, cell, recorded_event, scenario, sample)?);
                    }
                    Err(reason) => {
                        let (scene_id, sweep, seed) = (cell.scene_id.clone(), sweep.name.clone(), self.config.seed);
                        output.rejected.push(RejectedSample { scene_id, sweep, level, sample_idx, seed, reason });
                    }
                }
            }
            Ok(output)
        };
        let of_cells = scenes.par_iter().zip(sampled).enumerate().map(of_cell).collect::<Result<Vec<_>, Error>>()?;
        let mut output = ShardOutput::default();
        for ShardOutput { records, rejected } in of_cells {
            output.records.extend(records);
            output.rejected.extend(rejected);
        }
        output.records.iter_mut().for_each(|record| record.shard = shard.idx);
        Ok(output)
    }

    /// The conditioning of the samples of each cell of a shard.
    fn given(&self, sweep: &ResolvedSweep, shard: &ShardPlan, scenes: &[Scene]) -> Result<Given, Error> {
        let n_own = if sweep.uses_template() { sweep.n_samples } else { 1 };
        let of_cells = shard.cells.par_iter().zip(scenes).enumerate().map(|(at, (cell, scene))| {
            let agents = agents(cell, scene)?;
            if let Some(planned) = shard.templates.get(at) {
                let mut templates = Templates::new(planned.iter().max().map_or(0, |last| last + 1));
                let with = |number: &usize| {
                    self.condition(sweep, cell, scene, agents, Variant::Planned(*number), &mut templates)
                };
                return planned.iter().map(with).collect();
            }
            let own = shard.first_sample..shard.first_sample + n_own;
            let mut before = Before { templates: Templates::new(own.end + N_FURTHER), ..Before::default() };
            own.map(|sample_idx| self.condition_anew(sweep, (cell, scene), agents, sample_idx, &mut before)).collect()
        });
        Ok(Given { of_cells: of_cells.collect::<Result<_, Error>>()?, first_sample: shard.first_sample })
    }

    /// The conditioning of a sample with a template in which the requested agents do not move as in a sample `before`,
    /// to which it is added. If there is none, it repeats one of them.
    fn condition_anew(
        &self,
        sweep: &ResolvedSweep,
        (cell, scene): (&Cell, &Scene),
        agents: (usize, usize),
        sample_idx: usize,
        before: &mut Before,
    ) -> Result<Conditioned, Error> {
        let Before { templates, paths } = before;
        let mut further = 0;
        loop {
            let variant = Variant::Usual { sample_idx, further };
            let mut given = self.condition(sweep, cell, scene, agents, variant, templates)?;
            let Some(path) = given.path(&cell.roles) else { return Ok(given) };
            given.repeats = paths.iter().any(|other| other.distance_m(&path) < self.config.duplicate_distance_m);
            if !given.repeats {
                paths.push(path);
            }
            if !given.repeats || further == N_FURTHER {
                return Ok(given);
            }
            further += 1;
        }
    }

    /// Cells (by index) and samples that are denoised together. Scenes of similar size share a batch, so that there is
    /// little padding, and so do all samples of a scene if they fit, so that the scene is encoded once. With templates
    /// the samples of a scene share nothing, and a batch has one sample per scene, without those that repeat another.
    fn batches(&self, sweep: &ResolvedSweep, scenes: &[Scene], given: &Given) -> Vec<(Vec<usize>, Range<usize>)> {
        let mut order: Vec<usize> = (0..scenes.len()).collect();
        order.sort_by_key(|at| scenes[*at].tracks.len());
        let (n_samples, batch_size, start) = (sweep.n_samples, self.config.batch_size, given.first_sample);
        let mut batches = Vec::new();
        if sweep.uses_template() {
            for sample in start..start + n_samples {
                let is_sampled = |at: &usize| given.repeats(*at, sample) == Some(false);
                let order: Vec<usize> = order.iter().copied().filter(is_sampled).collect();
                batches.extend(order.chunks(batch_size).map(|members| (members.to_vec(), sample..sample + 1)));
            }
            return batches;
        }
        for members in order.chunks((batch_size / n_samples).max(1)) {
            for first in (0..n_samples).step_by(batch_size) {
                batches.push((members.to_vec(), start + first..start + n_samples.min(first + batch_size)));
            }
        }
        batches
    }
}

/// The requested agents of a cell, as tracks of its scene; the scene's ego agent twice if there are none. The first is
/// at the center of what the denoiser sees, as in the classifier's training.
fn agents(cell: &Cell, scene: &Scene) -> Result<(usize, usize), Error> {
    let mut indices = cell.roles.iter().map(|(role, track)| {
        scene.track_idx(track).ok_or_else(|| Error::Stale {
            scene_id: cell.scene_id.clone(),
            detail: format!("track {track}, the {role}, is missing"),
        })
    });
    match (indices.next().transpose()?, indices.next().transpose()?) {
        (None, _) => Ok((scene.ego_idx, scene.ego_idx)),
        (Some(only), None) => Ok((only, only)),
        (Some(first), Some(second)) => Ok((first, second)),
    }
}
