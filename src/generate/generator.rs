//! Everything that generation needs, checked before it begins.

use super::{Diffusion, Error, ResolvedGeneration, ResolvedSweep};
use crate::behavior::Behavior;
use crate::metrics::MetricSettings;
use crate::model::{DenoiserSpec, TrainedClassifier, TrainedDenoiser, TrainedSceneTransformer};
use crate::nn::keep_freed_memory;
use crate::scene::{Scene, SceneId};
use crate::seed::Seed;
use crate::tensor::{Collator, Normalizer};
use candle_core::Device;
use std::sync::Arc;

/// Loads the scene with this index, for example from a store.
pub type SceneLoader<'a> = dyn Fn(usize) -> Result<Scene, Box<dyn std::error::Error + Send + Sync>> + Sync + 'a;

/// The trained models.
#[derive(Clone, Copy)]
pub struct Models<'a> {
    /// The denoiser.
    pub denoiser: &'a TrainedDenoiser,
    /// Classifiers, at most one for each behavior.
    pub classifiers: &'a [TrainedClassifier],
    /// The distilled denoiser, for the sweeps that use it; of the same shape and scales.
    pub distilled: Option<&'a TrainedDenoiser>,
    /// The baseline, for the sweeps that use it.
    pub baseline: Option<&'a TrainedSceneTransformer>,
}

/// Plans and samples scenarios.
pub struct Generator<'a> {
    pub(super) config: &'a ResolvedGeneration,
    pub(super) models: Models<'a>,
    pub(super) behaviors: &'a [Box<dyn Behavior>],
    pub(super) scenes: &'a SceneLoader<'a>,
    pub(super) metric_settings: MetricSettings,
    pub(super) device: &'a Device,
    /// Turns scenes into batches; it keeps the modes of motion of one batch for the next.
    pub(super) collator: Arc<Collator>,
}

impl<'a> Generator<'a> {
    /// A generator whose `config`, resolved with the mined `behaviors`, fits its `models`. Selections and limits judge
    /// by `metric_settings`.
    pub fn new(
        config: &'a ResolvedGeneration,
        models: Models<'a>,
        behaviors: &'a [Box<dyn Behavior>],
        scenes: &'a SceneLoader<'a>,
        metric_settings: MetricSettings,
        device: &'a Device,
    ) -> Result<Self, Error> {
        keep_freed_memory();
        let collator = Arc::new(models.denoiser.spec.sampling_collator());
        let generator = Self { config, models, behaviors, scenes, metric_settings, device, collator };
        generator.check_all()?;
        Ok(generator)
    }

    /// Refuses sweeps that do not fit the models.
    pub(super) fn check_all(&self) -> Result<(), Error> {
        self.config.sweeps.iter().try_for_each(|sweep| self.check(sweep))
    }

    /// The seed of everything random.
    pub(super) const fn seed(&self) -> Seed {
        Seed(self.config.seed)
    }

    pub(super) const fn spec(&self) -> &'a DenoiserSpec {
        &self.models.denoiser.spec
    }

    pub(super) fn denoiser(&self, sweep: &ResolvedSweep) -> Result<&'a TrainedDenoiser, Error> {
        match (sweep.uses_distilled(), self.models.distilled) {
            (false, _) => Ok(self.models.denoiser),
            (true, Some(distilled)) => Ok(distilled),
            (true, None) => Err(Error::Config(format!(
                "sweep {}: model = \"distilled\" needs a distilled denoiser; add a section [train.distill]",
                sweep.name
            ))),
        }
    }

    /// The behavior that a sweep requests.
    pub fn behavior(&self, sweep: &ResolvedSweep) -> Option<&'a dyn Behavior> {
        let id = sweep.behavior.as_deref()?;
        self.behaviors.iter().find(|behavior| behavior.id() == id).map(AsRef::as_ref)
    }

    /// The classifier of the behavior that a sweep requests.
    pub(super) fn classifier(&self, sweep: &ResolvedSweep) -> Option<&'a TrainedClassifier> {
        let id = sweep.behavior.as_deref()?;
        self.models.classifiers.iter().find(|classifier| classifier.spec.behavior == id)
    }

    /// Loads a scene and checks that the denoiser can continue it.
    pub(super) fn load(&self, scene_idx: usize, scene_id: &SceneId) -> Result<Scene, Error> {
        let scene = (self.scenes)(scene_idx).map_err(|source| Error::Scene { scene_id: scene_id.clone(), source })?;
        if scene.id != *scene_id {
            let detail = format!("found {} at its place", scene.id);
            return Err(Error::Stale { scene_id: scene_id.clone(), detail });
        }
        let spec = self.spec();
        let has_shape = scene.n_history == spec.n_history
            && (scene.n_timesteps == spec.n_timesteps || !scene.has_future())
            && (scene.dt_s - spec.dt_s).abs() < 1e-6;
        if !has_shape {
            let shape = |n_history: usize, n_timesteps: usize, dt_s: f64| {
                format!("{n_history} + {} (of {dt_s} s)", n_timesteps.saturating_sub(n_history))
            };
            return Err(Error::Config(format!(
                "scene {scene_id} has {} timesteps, but the denoiser was trained on {}; ingest scenes of that length",
                shape(scene.n_history, scene.n_timesteps, scene.dt_s),
                shape(spec.n_history, spec.n_timesteps, spec.dt_s)
            )));
        }
        Ok(scene)
    }

    /// Rejects a distilled denoiser with other scales or timesteps than the denoiser, and either of the two in place of
    /// the other.
    fn check_distilled(&self, sweep: &ResolvedSweep) -> Result<(), Error> {
        let (own, spec) = (&self.denoiser(sweep)?.spec, self.spec());
        let is_alike = own.edm == spec.edm
            && (own.n_history, own.n_timesteps) == (spec.n_history, spec.n_timesteps)
            && same_scales(&own.normalizer, &spec.normalizer);
        if !is_alike {
            return Err(Error::Config(format!(
                "sweep {}: the distilled denoiser has different scales or timesteps than the denoiser; distill this \
                 denoiser again",
                sweep.name
            )));
        }
        match (sweep.uses_distilled(), &own.distillation) {
            (true, Some(distillation)) => sweep.check_distillation(distillation, &own.edm),
            (true, None) => Err(Error::Config(format!(
                "sweep {}: train.distill.checkpoint is an ordinary denoiser; pass a distilled one, or set the sweep's \
                 model = \"denoiser\"",
                sweep.name
            ))),
            (false, None) => Ok(()),
            (false, Some(_)) => Err(Error::Config(format!(
                "sweep {}: the denoiser is distilled; pass it as train.distill.checkpoint, and set the sweep's \
                 model = \"distilled\"",
                sweep.name
            ))),
        }
    }

    /// Refuses noise levels above the denoiser's largest.
    fn check_noise_levels(&self, name: &str, Diffusion { sampler, edit, .. }: &Diffusion) -> Result<(), Error> {
        let refuse = |why: String| Err(Error::Config(format!("sweep {name}: {why}")));
        let edm = &self.spec().edm;
        let sigma_max = edm.sigma_max;
        if let Some(edit) = edit.as_ref().filter(|edit| edit.tau > sigma_max) {
            let tau = edit.tau;
            return refuse(format!(
                "edit.tau is {tau}, expected at most the denoiser's largest noise level {sigma_max}"
            ));
        }
        let levels = sampler.schedule(edm, sampler.sigma_start(edm));
        match levels.len() == sampler.n_steps() + 1 && levels[0] <= sigma_max {
            true => Ok(()),
            false => refuse(format!("the sampler uses noise levels above the denoiser's largest, {sigma_max}")),
        }
    }

    fn check(&self, sweep: &ResolvedSweep) -> Result<(), Error> {
        self.check_baseline(sweep)?;
        self.check_distilled(sweep)?;
        if let Some(rollout) = &sweep.rollout {
            let spec = self.spec();
            let future_s = (spec.n_timesteps - spec.n_history) as f64 * spec.dt_s;
            let checked = rollout.check(spec.dt_s, future_s);
            checked.map_err(|issue| Error::Config(format!("sweep {}: {}", sweep.name, issue.within("rollout"))))?;
        }
        if let Some(diffusion) = sweep.diffusion() {
            self.check_noise_levels(&sweep.name, diffusion)?;
        }
        let Some(behavior) = &sweep.behavior else { return Ok(()) };
        let Some(classifier) = self.classifier(sweep) else {
            return match sweep.needs_classifier() {
                false => Ok(()),
                true => Err(Error::NoClassifier { sweep: sweep.name.clone(), behavior: behavior.clone() }),
            };
        };
        let (own, denoiser) = (&classifier.spec, self.spec());
        let differs = |what: &str| {
            let trained = format!("the classifier for {behavior} was trained with a different {what}");
            Err(Error::Config(format!("{trained} than the denoiser; retrain it")))
        };
        if own.edm != denoiser.edm {
            return differs("diffusion");
        }
        if (own.n_history, own.n_timesteps) != (denoiser.n_history, denoiser.n_timesteps) {
            return differs("number of timesteps");
        }
        if !same_scales(&own.normalizer, &denoiser.normalizer) {
            return differs("normalization");
        }
        Ok(())
    }
}

/// Whether two normalizers are the same up to the last digits, which may differ after a round trip through JSON.
fn same_scales(a: &Normalizer, b: &Normalizer) -> bool {
    let units = |n: &Normalizer| [n.scene_units(), n.motion_units()].concat();
    a.parametrization == b.parametrization
        && a.state_dim == b.state_dim
        && units(a).iter().zip(units(b)).all(|(a, b)| (a / b - 1.0).abs() < 1e-9)
}
