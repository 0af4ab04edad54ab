//! Which agents of a scene can show a behavior, and which are most likely to?

use super::targets::most_difficult;
use super::{Aim, Error, Generator, PairRanking, ResolvedSweep};
use crate::behavior::{Behavior, Outcome};
use crate::diffusion::NoiseSource;
use crate::model::TrainedClassifier;
use crate::scene::{ObservationMask, Roles, Scene, TrackId};
use crate::seed::Seed;
use crate::tensor::{Collator, FutureValidity, SceneBatch, SceneView};
use candle_core::{DType, Tensor};

/// The noise level at which histories are ranked: well above σ_data, so that the future is hidden, but within the
/// training range of classifiers.
const RANKING_SIGMA: f64 = 2.0;
/// A distance that is large compared with that of any pair, meters, so that distances only break ties.
const FAR_M: f64 = 1e4;
/// Noise draws that a rank is averaged over.
const N_RANKING_DRAWS: u64 = 8;

/// A pair that may be requested to show a behavior.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CandidatePair {
    /// The agents with the first two roles; the same one twice for behaviors of a single agent.
    pub(super) agents: (usize, usize),
    /// The roles with their tracks.
    pub(super) roles: Roles,
    /// How suitable it is; higher is better.
    pub(super) score: f64,
    /// The outcomes that it can still reach.
    pub(super) outcomes: Vec<Outcome>,
}

impl Generator<'_> {
    /// The pairs of `scene` that may be requested to show `behavior`, best first.
    pub(super) fn candidates(
        &self,
        sweep: &ResolvedSweep,
        behavior: &dyn Behavior,
        scene: &Scene,
    ) -> Result<Vec<CandidatePair>, Error> {
        let mut candidates = possible_pairs(sweep, behavior, scene);
        // All agents with a role must be among those that the denoiser sees when the first one is at the center.
        let max_agents = self.collator.max_agents;
        let is_seen = |pair: &CandidatePair, track: &TrackId| {
            scene.track_idx(track).is_some_and(|idx| proximity_rank(scene, pair.agents.0, idx) < max_agents)
        };
        candidates.retain(|pair| pair.roles.tracks().all(|track| is_seen(pair, track)));
        // The classifier prefers what is likely, which is seldom hard.
        let by_classifier = sweep.pairs.ranking != Some(PairRanking::Effort) && sweep.aim != Aim::Hard;
        if let Some(classifier) = self.classifier(sweep).filter(|_| by_classifier) {
            self.score(classifier, scene, &mut candidates)?;
        }
        // The sort is stable, and pairs come in the order of their tracks: equal scores keep a fixed order.
        candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
        Ok(candidates)
    }

    /// Scores candidates by the classifier's mean log odds under pure noise, which depend on the history alone.
    fn score(
        &self,
        classifier: &TrainedClassifier,
        scene: &Scene,
        candidates: &mut [CandidatePair],
    ) -> Result<(), Error> {
        if candidates.is_empty() {
            return Ok(());
        }
        let mask = ObservationMask::predictive(scene.tracks.len(), scene.n_timesteps, scene.n_history);
        let view = |pair: &CandidatePair| SceneView { scene, ego_idx: pair.agents.0, mask: &mask };
        let views: Vec<SceneView<'_>> = candidates.iter().map(view).collect();
        // The classifier sees no map.
        let collator = Collator { max_lanes: 0, sight: None, ..Collator::clone(&self.collator) };
        let batch = collator.collate(&views, FutureValidity::Everything, self.device)?;
        let agents: Vec<(usize, usize)> = candidates.iter().map(|pair| pair.agents).collect();
        let features = classifier.spec.features(&batch, &slots(&batch, &agents)?)?;
        let sigma = Tensor::full(RANKING_SIGMA, candidates.len(), self.device)?.to_dtype(batch.x0.dtype())?;
        let mut total = vec![0.0; candidates.len()];
        for draw in 0..N_RANKING_DRAWS {
            // All pairs of a scene get the same noise, so that it does not decide between them.
            let seed = self.seed().derive_named("ranking", &scene.id.0).derive("draw", &[draw]);
            let noise = NoiseSource::new(vec![seed; candidates.len()]).draw_like(&batch.x0)?;
            let logits = classifier.network.logits(&features, &(noise * RANKING_SIGMA)?, &sigma)?;
            for (total, logit) in total.iter_mut().zip(logits.to_dtype(DType::F64)?.to_vec1::<f64>()?) {
                *total += logit;
            }
        }
        for (pair, total) in candidates.iter_mut().zip(total) {
            pair.score = total / N_RANKING_DRAWS as f64;
        }
        Ok(())
    }
}

/// Agents of the classes that the behavior admits, tracked over the whole history and near each other, that can still
/// show the behavior, given their past, or a hard event where these are aimed at. Scored by how easily they can, or by
/// their distance if that is undefined.
pub(super) fn possible_pairs(sweep: &ResolvedSweep, behavior: &dyn Behavior, scene: &Scene) -> Vec<CandidatePair> {
    let eligible: Vec<usize> = (0..scene.tracks.len())
        .filter(|agent_idx| {
            let track = &scene.tracks[*agent_idx];
            behavior.admits(track.class)
                && !track.is_parked()
                && (0..scene.n_history).all(|timestep| track.trajectory.is_valid(timestep))
        })
        .collect();
    let (is_single, planned) = (behavior.roles().len() == 1, sweep.planned(scene));
    let mut candidates = Vec::new();
    for &first in &eligible {
        for &second in &eligible {
            if (first == second) != is_single || distance_m(scene, first, second) > sweep.pairs.max_distance_m {
                continue;
            }
            let agents = if is_single { Some(vec![first]) } else { behavior.completed(&planned, [first, second]) };
            let Some(agents) = agents.filter(|agents| agents.iter().all(|idx| eligible.contains(idx))) else {
                continue;
            };
            let outcomes = behavior.feasible(&planned, &agents);
            let effort = outcomes.iter().map(Outcome::effort).reduce(f64::min);
            let is_hard = sweep.aim != Aim::Hard || most_difficult(&outcomes) > 0.0;
            if sweep.pairs.only_feasible && (effort.is_none() || !is_hard) {
                continue;
            }
            let roles = behavior.roles().iter().zip(&agents);
            let roles = roles.map(|(role, agent_idx)| ((*role).to_owned(), scene.tracks[*agent_idx].id.clone()));
            let suits = match sweep.aim {
                Aim::Hard => most_difficult(&outcomes),
                Aim::Anything | Aim::Feasible => -effort.unwrap_or(1.0),
            };
            let score = suits - distance_m(scene, first, second) / FAR_M;
            candidates.push(CandidatePair { agents: (first, second), roles: roles.collect(), score, outcomes });
        }
    }
    candidates
}

/// The places on the batch's agent axis of the pair of each row.
pub(super) fn slots(batch: &SceneBatch, agents: &[(usize, usize)]) -> Result<Vec<(usize, usize)>, Error> {
    let slot = |row: usize, agent_idx: usize| {
        let detail =
            || Error::Config(format!("agent {agent_idx} is no longer among those nearest to its partner; plan again"));
        batch.frames[row].slot(agent_idx).ok_or_else(detail)
    };
    agents.iter().enumerate().map(|(row, pair)| Ok((slot(row, pair.0)?, slot(row, pair.1)?))).collect()
}

/// The number of agents nearer to agent `center` at present than `agent_idx`, parked ones aside; ties go to the smaller
/// index.
fn proximity_rank(scene: &Scene, center: usize, agent_idx: usize) -> usize {
    let key = |agent_idx: usize| (distance_m(scene, center, agent_idx), agent_idx);
    let own = key(agent_idx);
    (0..scene.tracks.len()).filter(|other| !scene.tracks[*other].is_parked() && key(*other) < own).count()
}

/// Distance of two agents at present, meters; infinite unless both are tracked then.
fn distance_m(scene: &Scene, a: usize, b: usize) -> f64 {
    let position = |agent_idx| scene.state(agent_idx, scene.current_timestep()).map(|state| state.position);
    position(a).zip(position(b)).map_or(f64::INFINITY, |(a, b)| a.distance(b))
}

/// The seed that orders the scenes of a sweep; it depends only on the run's seed and the scene.
pub(super) fn order_seed(seed: Seed, scene_id: &str) -> u64 {
    seed.derive_named("order", scene_id).0
}
