//! Scenes for tests of guidance, training and generation: some hold a cut-in, others could.

use crate::diffusion::Edm;
use crate::geometry::Vec2;
use crate::model::{DenoiserKind, DenoiserSpec, NetworkConfig};
use crate::scene::{Scene, SceneSource, State, Track, testing};
use crate::seed::Seed;
use crate::tensor::{NormalizerFit, StateParametrization};

pub(crate) const N_TIMESTEPS: usize = 12;
pub(crate) const N_HISTORY: usize = 4;
const DT_S: f64 = 0.25;

/// Two cars side by side; if `is_positive`, the second moves over in front of the first. The history gives no hint.
pub(crate) fn scene(idx: usize) -> Scene {
    let mut rng = Seed(17).derive("scene", &[idx as u64]).rng();
    let is_positive = is_positive(idx);
    let track = |id: &str, start: Vec2, speed_mps: f64, shift_m: f64, wobble_m: f64| {
        let state = |timestep: usize| {
            let future = (timestep as f64 - (N_HISTORY - 1) as f64).max(0.0) / (N_TIMESTEPS - N_HISTORY) as f64;
            State {
                position: start + Vec2::new(speed_mps * DT_S * timestep as f64 + wobble_m * future, shift_m * future),
                heading_rad: if future > 0.0 { shift_m.atan2(speed_mps * 2.0) } else { 0.0 },
                velocity: Vec2::new(speed_mps, 0.0),
            }
        };
        Track { extent: None, ..testing::vehicle(id, (0..N_TIMESTEPS).map(|timestep| Some(state(timestep)))) }
    };
    let mut draw = |low: f64, high: f64| low + (high - low) * rng.uniform();
    let shift_m = if is_positive { draw(-4.0, -3.0) } else { draw(-0.5, 0.5) };
    let tracks = vec![
        track("bystander", Vec2::new(-20.0, -8.0), draw(4.0, 12.0), 0.0, draw(-3.0, 3.0)),
        track("behind", Vec2::ZERO, draw(6.0, 10.0), draw(-0.3, 0.3), draw(-3.0, 3.0)),
        track("ahead", Vec2::new(draw(3.0, 8.0), 3.5), draw(6.0, 10.0), shift_m, draw(-3.0, 3.0)),
    ];
    let base = testing::scene(&[]);
    Scene {
        id: format!("interaction/train/TEST/{idx}").as_str().into(),
        source: SceneSource { place: "TEST".to_owned(), case_id: idx.to_string(), ..base.source },
        dt_s: DT_S,
        n_timesteps: N_TIMESTEPS,
        n_history: N_HISTORY,
        tracks,
        map_id: None,
        lanes: std::sync::Arc::default(),
        ..base
    }
}

/// One scene in four is positive.
pub(crate) const fn is_positive(idx: usize) -> bool {
    idx.is_multiple_of(4)
}

/// The specification of a small denoiser of these scenes.
pub(crate) fn denoiser_spec(parametrization: StateParametrization) -> DenoiserSpec {
    let mut normalizer = NormalizerFit::default();
    (0..100).for_each(|idx| normalizer.add(&scene(idx)));
    DenoiserSpec {
        kind: DenoiserKind::SceneDenoiser,
        network: NetworkConfig {
            layers: "TAM".to_owned(),
            width: 16,
            n_heads: 2,
            feed_forward: 32,
            encoding: 8,
            ..NetworkConfig::default()
        },
        edm: Edm::default(),
        normalizer: normalizer.finish(parametrization, 3),
        n_history: N_HISTORY,
        n_timesteps: N_TIMESTEPS,
        dt_s: DT_S,
        max_agents: 8,
        max_lanes: 8,
        steps: 0,
        seed: 0,
        scenes: String::new(),
        objectives: Vec::new(),
        changed_losses: Vec::new(),
        losses_by_place: Vec::new(),
        distillation: None,
    }
}
