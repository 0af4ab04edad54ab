//! A behavior, models and scenes for the tests of generation.

use super::*;
use crate::behavior::{Behavior, BehaviorEvent, EventLabel, Outcome, Template};
use crate::diffusion::SamplerConfig;
use crate::geometry::Vec2;
use crate::guidance::testing::{denoiser_spec, scene};
use crate::metrics::MetricSettings;
use crate::model::{
    BehaviorClassifierConfig, ClassifierKind, ClassifierSpec, DenoiserSpec, ModelSpec, SceneDenoiser,
    TrainedClassifier, TrainedDenoiser,
};
use crate::nn::{Compute, Params};
use crate::progress::Silent;
use crate::scenario::ScenarioRecord;
use crate::scene::{Dataset, Scene, SituationKind, Split};
use crate::seed::Seed;
use crate::store::{SceneIndex, SceneIndexEntry};
use crate::tensor::StateParametrization;
use candle_core::Device;
use std::collections::BTreeMap;

/// "The second agent ends to the right of where it is now": simple enough to hold in many samples.
pub(super) struct Drift;

impl Behavior for Drift {
    fn id(&self) -> &'static str {
        "drift"
    }

    fn roles(&self) -> &'static [&'static str] {
        &["ego", "other"]
    }

    fn detect(&self, scene: &Scene) -> Vec<BehaviorEvent> {
        let lateral = |agent_idx, timestep| scene.state(agent_idx, timestep).map(|state| state.position.y);
        let mut events = Vec::new();
        for first in 0..scene.tracks.len() {
            for second in (0..scene.tracks.len()).filter(|second| *second != first) {
                let ends = lateral(second, scene.current_timestep()).zip(lateral(second, scene.n_timesteps - 1));
                if let Some((now, then)) = ends.filter(|(now, then)| *then < now - 1.0) {
                    events.push(BehaviorEvent {
                        behavior: self.id().to_owned(),
                        scene_id: scene.id.clone(),
                        label: EventLabel::Positive,
                        roles: [("ego", first), ("other", second)]
                            .map(|(role, agent)| (role.to_owned(), scene.tracks[agent].id.clone()))
                            .into_iter()
                            .collect(),
                        start_timestep: scene.n_history,
                        end_timestep: scene.n_timesteps - 1,
                        parameters: BTreeMap::from([("gap_m".to_owned(), now - then)]),
                    });
                }
            }
        }
        events
    }

    fn feasible(&self, _scene: &Scene, _agents: &[usize]) -> Vec<Outcome> {
        (0..8)
            .map(|i| Outcome::default().with("gap_m", 2.0 + 3.0 * f64::from(i)).at_effort(f64::from(i) / 8.0))
            .collect()
    }

    fn template_parameters(&self) -> &'static [&'static str] {
        &["gap_m"]
    }

    /// The second agent drifts the farther to the right, the larger the target gap is.
    fn templates(
        &self,
        scene: &Scene,
        agents: &[usize],
        wanted: &BTreeMap<String, [f64; 2]>,
        _n: usize,
    ) -> Vec<Template> {
        let [least, most] = wanted.get("gap_m").copied().unwrap_or_default();
        let now = *scene.state(agents[1], scene.current_timestep()).unwrap();
        let duration_s = (scene.n_timesteps - scene.n_history) as f64 * scene.dt_s;
        let drift_m = 3.0 + (least + most) / 4.0;
        let place = |t: f64| Some(now.position + now.velocity * t + Vec2::new(0.0, -drift_m * (t / duration_s)));
        Template::empty().with(scene, agents[1], place).into_iter().collect()
    }
}

pub(super) fn denoiser(n_nan: usize) -> TrainedDenoiser {
    denoiser_of(StateParametrization::Motion, n_nan)
}

fn denoiser_of(parametrization: StateParametrization, n_nan: usize) -> TrainedDenoiser {
    let spec: DenoiserSpec = denoiser_spec(parametrization);
    let mut params = Params::new(&Compute::cpu()).frozen();
    let denoiser = SceneDenoiser::new(&mut params, &spec.network, 3, spec.edm, Seed(1)).unwrap();
    if n_nan > 0 {
        let mut tensors = params.tensors();
        let bias = tensors.get_mut("output.2.bias").unwrap();
        *bias = (bias.zeros_like().unwrap() * f64::NAN).unwrap();
        params.load(&tensors).unwrap();
    }
    TrainedDenoiser { network: denoiser, spec, fingerprint: "denoiser".to_owned() }
}

pub(super) fn classifier() -> TrainedClassifier {
    let denoiser = denoiser_spec(StateParametrization::Motion);
    let spec = ClassifierSpec {
        kind: ClassifierKind::BehaviorClassifier,
        behavior: "drift".to_owned(),
        roles: vec!["ego".to_owned(), "other".to_owned()],
        network: BehaviorClassifierConfig::default(),
        edm: denoiser.edm,
        normalizer: denoiser.normalizer,
        n_history: denoiser.n_history,
        n_timesteps: denoiser.n_timesteps,
        dt_s: denoiser.dt_s,
        n_positive: 1,
        n_negative: 1,
        pos_weight: 1.0,
        steps: 0,
        seed: 0,
        events: String::new(),
    };
    let classifier = spec.build(&mut Params::new(&Compute::cpu()).frozen(), Seed(2)).unwrap();
    TrainedClassifier { network: classifier, spec, fingerprint: "classifier".to_owned() }
}

pub(super) fn config(toml: &str) -> GenerateConfig {
    let mut config: GenerateConfig = toml::from_str(toml).unwrap();
    config.sampler = SamplerConfig::heun(4);
    config
}

/// The resolved section, with the drift as mined behavior.
pub(super) fn resolve(toml: &str) -> ResolvedGeneration {
    config(toml).resolve(&drift()).unwrap()
}

pub(super) fn drift() -> [Box<dyn Behavior>; 1] {
    [Box::new(Drift)]
}

pub(super) fn load(scene_idx: usize) -> Result<Scene, Box<dyn std::error::Error + Send + Sync>> {
    Ok(scene(scene_idx))
}

/// Calls `use_it` with a generator for `config`, and returns its result.
pub(super) fn with_generator<T>(config: &GenerateConfig, n_nan: usize, use_it: impl FnOnce(&Generator<'_>) -> T) -> T {
    with_denoiser(&denoiser(n_nan), config, use_it)
}

fn with_denoiser<T>(
    denoiser: &TrainedDenoiser,
    config: &GenerateConfig,
    use_it: impl FnOnce(&Generator<'_>) -> T,
) -> T {
    let classifiers = [classifier()];
    let models = Models { denoiser, classifiers: &classifiers, distilled: None, baseline: None };
    let (behaviors, config) = (drift(), config.resolve(&drift()).unwrap());
    use_it(&Generator::new(&config, models, &behaviors, &load, MetricSettings::default(), &Device::Cpu).unwrap())
}

/// [`with_generator`] for a configuration that may be rejected.
pub(super) fn with_generator_result<T>(
    config: &GenerateConfig,
    use_it: impl FnOnce(&Generator<'_>) -> Result<T, Error>,
) -> Result<T, Error> {
    let (denoiser, classifiers) = (denoiser(0), [classifier()]);
    let models = Models { denoiser: &denoiser, classifiers: &classifiers, distilled: None, baseline: None };
    let (behaviors, config) = (drift(), config.resolve(&drift())?);
    use_it(&Generator::new(&config, models, &behaviors, &load, MetricSettings::default(), &Device::Cpu)?)
}

pub(super) fn index(n: usize) -> SceneIndex {
    let scenes: Vec<Scene> = (0..n).map(scene).collect();
    let entries = scenes.iter().map(|scene| SceneIndexEntry {
        id: &scene.id.0,
        dataset: Dataset::Interaction,
        split: Split::Train,
        place: "TEST",
        n_agents: 3,
        situation: SituationKind::Recorded,
        n_timesteps: scene.n_timesteps as u32,
    });
    entries.collect()
}

pub(super) fn generate(config: &GenerateConfig) -> Vec<ScenarioRecord> {
    generate_in(StateParametrization::Motion, config)
}

pub(super) fn generate_in(parametrization: StateParametrization, config: &GenerateConfig) -> Vec<ScenarioRecord> {
    with_denoiser(&denoiser_of(parametrization, 0), config, |generator| {
        let plan = generator.plan(&index(12)).unwrap();
        let shards = plan.shards.iter().map(|shard| generator.generate(shard, &Silent).unwrap());
        shards.flat_map(|output| output.records).collect()
    })
}

/// The largest distance of two generated scenes' states, meters.
pub(super) fn difference_m(a: &Scene, b: &Scene) -> f64 {
    let states = |scene: &Scene| -> Vec<_> {
        scene.tracks.iter().flat_map(|track| track.trajectory.valid().map(|(_, s)| *s).collect::<Vec<_>>()).collect()
    };
    let pairs = states(a).into_iter().zip(states(b));
    pairs.map(|(a, b)| a.position.distance(b.position)).fold(0.0, f64::max)
}

/// Matrix products of few rows round differently from those of many, and the encodings of an untrained network, with
/// their short periods, magnify that; samples of different noise are meters apart.
pub(super) const ROUNDING_M: f64 = 0.1;
