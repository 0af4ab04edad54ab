//! Do objectives and networks meet? Contexts of real batches, gradients through a real denoiser.

use super::testing::{N_HISTORY, N_TIMESTEPS, denoiser_spec, scene};
use super::*;
use crate::diffusion::{Denoiser, NoiseSource};
use crate::model::SceneDenoiser;
use crate::nn::{Compute, Params};
use crate::scene::{ObservationMask, Roles, Scene};
use crate::seed::Seed;
use crate::tensor::{FutureValidity, SceneBatch, SceneView, StateParametrization};
use candle_core::{Device, Tensor};

fn batch(scenes: &[Scene], ego_idx: usize) -> SceneBatch {
    let mask = ObservationMask::predictive(3, N_TIMESTEPS, N_HISTORY);
    let views: Vec<SceneView<'_>> = scenes.iter().map(|scene| SceneView { scene, ego_idx, mask: &mask }).collect();
    let spec = denoiser_spec(StateParametrization::Motion);
    spec.collator().collate(&views, FutureValidity::Everything, &Device::Cpu).unwrap()
}

fn roles() -> Roles {
    Roles::from([("ego", "behind"), ("other", "ahead")])
}

#[test]
fn contexts_know_who_is_who() {
    let (mut scenes, roles) = ([scene(0), scene(1)], roles());
    // In the second scene the agent behind comes first.
    scenes[1].tracks.rotate_left(1);
    let egos = [1, 0];
    let mask = ObservationMask::predictive(3, N_TIMESTEPS, N_HISTORY);
    let views: Vec<SceneView<'_>> =
        scenes.iter().zip(egos).map(|(scene, ego_idx)| SceneView { scene, ego_idx, mask: &mask }).collect();
    let collator = denoiser_spec(StateParametrization::Motion).collator();
    let batch = collator.collate(&views, FutureValidity::Everything, &Device::Cpu).unwrap();
    let rows: Vec<ContextRow<'_>> =
        scenes.iter().zip(egos).map(|(scene, ego_idx)| ContextRow { scene, ego_idx, roles: &roles }).collect();
    let context = SceneContext::new(&batch, &rows).unwrap().repeated(2).unwrap();
    let selected = |name: &str| context.selected(&AgentSelector::new(name)).unwrap().to_vec2::<f32>().unwrap();
    let (behind, ahead) = (([0.0, 1.0, 0.0], [1.0, 0.0, 0.0]), ([0.0, 0.0, 1.0], [0.0, 1.0, 0.0]));
    assert_eq!(selected("ego"), [behind.0, behind.0, behind.1, behind.1]);
    assert_eq!(selected("other"), [ahead.0, ahead.0, ahead.1, ahead.1]);
    assert!(selected("all").concat().iter().all(|one| *one == 1.0));
    assert!(
        context.selected(&AgentSelector::new("third")).unwrap_err().to_string().contains("no agent has the role third")
    );
    // Nominal vehicles, and the future to be generated.
    assert_eq!(context.extent_m.get(3).unwrap().to_vec2::<f32>().unwrap()[2], [4.6, 1.9]);
    assert_eq!(context.latent.to_vec3::<f32>().unwrap()[1][2][N_HISTORY - 1..=N_HISTORY], [0.0, 1.0]);
    let stranger = Roles::from([("ego", "nobody")]);
    let row = ContextRow { scene: &scenes[0], ego_idx: 1, roles: &stranger };
    assert!(SceneContext::new(&batch, &[row, row]).unwrap_err().to_string().contains("track nobody"));
}

#[test]
fn objectives_with_nothing_to_say_change_nothing() {
    let spec = denoiser_spec(StateParametrization::Motion);
    let network =
        SceneDenoiser::new(&mut Params::new(&Compute::cpu()).frozen(), &spec.network, 3, spec.edm, Seed(1)).unwrap();
    let (scene, roles) = (scene(3), roles());
    let batch = batch(std::slice::from_ref(&scene), 1);
    let bound = network.bind(&batch, 1).unwrap();
    let context = SceneContext::new(&batch, &[ContextRow { scene: &scene, ego_idx: 1, roles: &roles }]).unwrap();
    // The scene has no lanes to stay on.
    let objectives: Vec<ObjectiveConfig> = serde_json::from_str(r#"[{ "kind": "stay_on_road" }]"#).unwrap();
    let potential = ObjectiveSum { objectives: &objectives, batch: &batch, context: &context };
    let guided = CleanGuidedDenoiser {
        inner: &bound,
        potential: &potential,
        strength: 1.0,
        gate: GuidanceConfig::UNRESTRICTED,
        to_mode: true,
        modes: None,
    };
    let x = NoiseSource::new(vec![Seed(1)]).draw_like(&batch.x0).unwrap();
    let sigma = Tensor::new(&[1.0f32], &Device::Cpu).unwrap();
    let values = |denoiser: &dyn Denoiser| {
        denoiser.denoise(&x, &sigma).unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap()
    };
    assert_eq!(values(&guided), values(&bound));
}
