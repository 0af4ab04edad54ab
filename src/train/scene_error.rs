//! The error of sampled futures of held-out scenes, which may rise while the loss still falls.

use super::{Error, SceneDraws};
use crate::diffusion::{Denoiser, Edm, NoiseSource, SamplerConfig};
use crate::guidance::ForwardDenoiser;
use crate::metrics::{Metric, MinSceneAde, SampleGroup, ScoredAgents};
use crate::model::SceneDenoiser;
use crate::scene::{ObservationMask, Scene};
use crate::tensor::{Collator, FutureValidity, LeastProgress, SceneView};

/// Samples of each scene, and the evaluations of the network for each: few, since trainings are compared.
const N_SAMPLES: usize = 3;
const SAMPLER: SamplerConfig = SamplerConfig::dpmpp_2m(5);
/// The noise levels that they begin with and end at.
const SIGMA_MAX: f64 = 30.0;
const SIGMA_MIN: f64 = 0.05;
/// Scenes that are sampled together.
const TOGETHER: usize = 8;

/// The mean of minSceneADE over the held-out scenes as recorded, meters, by unguided samples from the observed past;
/// `None` if it is not defined for any. `collator` is that of sampling. The noise of a scene is the same at every call.
pub(super) fn scene_error_m(
    network: &SceneDenoiser,
    collator: &Collator,
    draws: &SceneDraws<'_>,
) -> Result<Option<f64>, Error> {
    let metric = MinSceneAde(ScoredAgents::All);
    let edm = Edm { sigma_max: SIGMA_MAX, sigma_min: SIGMA_MIN, ..*network.edm() };
    let mut errors_m: Vec<f64> = Vec::new();
    for indices in draws.held_out.chunks(TOGETHER) {
        let scenes = indices.iter().map(|idx| draws.dataset.scene(*idx).map_err(Error::Scene));
        let scenes: Vec<Scene> = scenes.collect::<Result<_, _>>()?;
        let observed =
            |scene: &Scene| ObservationMask::predictive(scene.tracks.len(), scene.n_timesteps, scene.n_history);
        let masks: Vec<ObservationMask> = scenes.iter().map(observed).collect();
        let both = scenes.iter().zip(&masks);
        let views: Vec<SceneView<'_>> =
            both.map(|(scene, mask)| SceneView { scene, ego_idx: scene.ego_idx, mask }).collect();
        let batch = collator.collate(&views, FutureValidity::Everything, draws.device)?;
        let bound = network.bind(&batch, N_SAMPLES)?;
        let repeated = batch.repeated(N_SAMPLES)?;
        let least = LeastProgress::new(&batch, &scenes.iter().collect::<Vec<_>>(), N_SAMPLES)?;
        let seed = |idx: &usize, sample: usize| draws.seed.derive("scene error", &[*idx as u64, sample as u64]);
        let seeds = indices.iter().flat_map(|idx| (0..N_SAMPLES).map(move |sample| seed(idx, sample)));
        let mut noise = NoiseSource::new(seeds.collect());
        let mut sample = |denoiser: &dyn Denoiser| {
            SAMPLER.sample(&edm, denoiser, &repeated.x0.dims()[1..], &repeated.x0, &mut noise, &mut |_| {})
        };
        let x = match &least {
            Some(least) => sample(&ForwardDenoiser { inner: &bound, batch: &repeated, least })?,
            None => sample(&bound)?,
        };
        let sources: Vec<&Scene> = scenes.iter().flat_map(|scene| std::iter::repeat_n(scene, N_SAMPLES)).collect();
        let sampled = repeated.decode_scenes(&x, &sources)?;
        let both = scenes.iter().zip(sampled.chunks(N_SAMPLES));
        errors_m
            .extend(both.filter_map(|(scene, samples)| metric.evaluate(&SampleGroup::equally_likely(scene, samples))));
    }
    let mean_m = errors_m.iter().sum::<f64>() / errors_m.len() as f64;
    Ok(Some(mean_m).filter(|mean_m| mean_m.is_finite()))
}
