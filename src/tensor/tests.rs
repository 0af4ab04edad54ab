//! Encoding and decoding agree, masks are those of the paper, and nothing leaks.

use super::testing::collator;
use super::*;
use crate::geometry::{Vec2, angle_difference};
use crate::nn::testing::{scalar, values};
use crate::scene::testing::{Drive, scene, without_states};
use crate::scene::{ObservationMask, Scene, State, TrackRole, Trajectory};
use crate::seed::Seed;
use candle_core::{Device, Tensor};

fn three_cars() -> Scene {
    let turning = Drive { x: 30.0, y: 20.0, heading_rad: -1.6, speed_mps: 8.0, curvature_1pm: -0.3 };
    let scene = scene(&[Drive::straight(5.0, 1.0, 0.3, 12.0), turning, Drive::straight(-20.0, 3.5, 3.1, 0.0)]);
    without_states(scene, 2, |t| t > 8)
}

fn collate(collator: &Collator, scene: &Scene, ego_idx: usize, mask: &ObservationMask) -> SceneBatch {
    let view = SceneView { scene, ego_idx, mask };
    collator.collate(&[view], FutureValidity::Recorded, &Device::Cpu).unwrap()
}

#[test]
fn clean_states_decode_to_the_recording_under_every_task_and_parametrization() {
    let scene = three_cars();
    for parametrization in [StateParametrization::Scene, StateParametrization::Motion] {
        for (i, task) in MaskTask::ALL.into_iter().enumerate() {
            let mask = task.sample(&scene, 1, &mut Seed(i as u64).rng());
            let batch = collate(&collator([&scene], parametrization), &scene, 1, &mask);
            let decoded = &batch.decode_scenes(&batch.x0, &[&scene]).unwrap()[0];
            for (agent_idx, track) in scene.tracks.iter().enumerate() {
                for (t, expected) in track.trajectory.valid() {
                    let found = decoded.state(agent_idx, t).unwrap();
                    assert!(found.position.distance(expected.position) < 1e-4, "{parametrization:?} {task:?} {t}");
                    assert!(angle_difference(found.heading_rad, expected.heading_rad).abs() < 1e-4);
                }
                assert_eq!(decoded.tracks[agent_idx].trajectory.n_valid(), track.trajectory.n_valid());
            }
        }
    }
}

#[test]
fn who_creeps_in_the_recording_is_not_held() {
    // Two millimeters a timestep, as trackers move standing vehicles.
    let scene = scene(&[Drive::straight(3.0, 4.0, 0.5, 0.02), Drive::straight(9.0, 4.0, 0.0, 10.0)]);
    let mask = ObservationMask::predictive(2, 12, 4);
    let batch = collate(&collator([&scene], StateParametrization::Motion), &scene, 0, &mask);
    let decoded = &batch.decode_scenes(&batch.x0, &[&scene]).unwrap()[0];
    let missed_m = decoded.state(0, 11).unwrap().position.distance(scene.state(0, 11).unwrap().position);
    assert!(missed_m < 1e-3, "{missed_m}");
}

#[test]
fn no_motion_is_constant_velocity() {
    let scene = three_cars();
    let mask = ObservationMask::predictive(3, 12, 4);
    // Three cars are too few to predict motion from.
    let batch = collate(&collator([&scene], StateParametrization::Motion), &scene, 0, &mask);
    let decoded = &batch.decode_scenes(&batch.x0.zeros_like().unwrap(), &[&scene]).unwrap()[0];
    let (last, found) = (scene.state(1, 3).unwrap(), decoded.state(1, 11).unwrap());
    assert!(found.position.distance(last.position + last.velocity * 0.8) < 1e-4);
    // The car that drives straight on has no residual at all.
    let x0 = values(&batch.x0.get(0).unwrap().get(0).unwrap());
    assert!(x0.iter().all(|x| x.abs() < 1e-5), "{x0:?}");
}

#[test]
fn parked_vehicles_are_left_out_before_others() {
    let drives = [0.0, 5.0, 40.0, 7.0].map(|x| Drive::straight(x, 0.0, 0.0, if x == 40.0 { 9.0 } else { 0.0 }));
    let mut scene = scene(&drives);
    for agent_idx in [0, 1, 3] {
        scene.tracks[agent_idx].role = TrackRole::Parked;
    }
    let mask = ObservationMask::predictive(4, 12, 4);
    for (max_agents, expected) in [(1, vec![0]), (2, vec![0, 2]), (3, vec![0, 1, 2]), (4, vec![0, 1, 2, 3])] {
        let collator = Collator { max_agents, ..collator([&scene], StateParametrization::Motion) };
        assert_eq!(collate(&collator, &scene, 0, &mask).frames[0].agents, expected);
    }
}

#[test]
fn no_motion_beyond_what_was_seen_goes_on_along_the_bend() {
    // Traffic that keeps its curvature.
    let bend = |i: i32| Drive { x: 3.0, y: 4.0, heading_rad: 0.5, speed_mps: 8.0, curvature_1pm: 0.005 * f64::from(i) };
    let scene = scene(&(-20..20).map(bend).collect::<Vec<_>>());
    let mask = ObservationMask::predictive(40, 12, 4);
    let collator = Collator { max_agents: 40, ..collator([&scene], StateParametrization::Motion) };
    let batch = collate(&collator, &scene, 0, &mask);
    let decoded = &batch.decode_scenes(&batch.x0.zeros_like().unwrap(), &[&scene]).unwrap()[0];
    for agent_idx in [0, 10, 20, 39] {
        let (found, expected) = (decoded.state(agent_idx, 11).unwrap(), scene.state(agent_idx, 11).unwrap());
        let straight = scene.state(agent_idx, 3).unwrap();
        let straight = straight.position + straight.velocity * 0.8;
        let error_m = found.position.distance(expected.position);
        assert!(error_m < 0.02 + 0.02 * straight.distance(expected.position), "{agent_idx}: {error_m}");
        assert!(angle_difference(found.heading_rad, expected.heading_rad).abs() < 0.02, "{agent_idx}");
    }
    // Whatever is predicted, x0 is the recording.
    let decoded = &batch.decode_scenes(&batch.x0, &[&scene]).unwrap()[0];
    assert!(decoded.state(5, 11).unwrap().position.distance(scene.state(5, 11).unwrap().position) < 1e-4);
}

#[test]
fn diffused_states_have_the_standard_deviation_sigma_data() {
    // Cars that drive alike up to the present and then depart, each in its way.
    let mut scene = scene(&[Drive::straight(5.0, 1.0, 0.3, 12.0); 4]);
    for (track, sign) in scene.tracks.iter_mut().zip([[1.0, 1.0], [-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]]) {
        let depart = |(t, state): (usize, &Option<State>)| {
            let n = t.saturating_sub(3) as f64;
            let by = Vec2::new(0.05 * sign[0], 0.02 * sign[1]) * (n * n);
            state.map(|s| State { position: s.position + by, heading_rad: s.heading_rad + 0.01 * sign[0] * n, ..s })
        };
        track.trajectory = Trajectory::new(track.trajectory.entries().iter().enumerate().map(depart).collect());
    }
    let mask = ObservationMask::predictive(4, 12, 4);
    let batch = collate(&collator([&scene], StateParametrization::Motion), &scene, 0, &mask);
    let x0 = batch.x0.flatten_to(2).unwrap();
    let latent = scalar(&batch.latent.sum_all().unwrap());
    let mean_square = (x0.sqr().unwrap().sum(0).unwrap() / latent).unwrap().to_vec1::<f32>().unwrap();
    assert!(mean_square.iter().all(|m| (m - 0.25).abs() < 1e-3), "{mean_square:?}");
}

#[test]
fn what_is_to_be_generated_never_shows_in_what_the_network_is_given() {
    let scene = three_cars();
    let mut altered = scene.clone();
    for track in &mut altered.tracks {
        let shifted = track.trajectory.entries().iter().enumerate().map(|(t, state)| {
            state.map(|mut s| {
                if t >= 4 {
                    s.position = s.position + Vec2::new(3.0, -2.0);
                    s.heading_rad += 0.5;
                    s.velocity = s.velocity * 2.0;
                }
                s
            })
        });
        track.trajectory = Trajectory::new(shifted.collect());
    }
    let mask = ObservationMask::predictive(3, 12, 4);
    for parametrization in [StateParametrization::Scene, StateParametrization::Motion] {
        let collator = collator([&scene], parametrization);
        let (a, b) = (collate(&collator, &scene, 0, &mask), collate(&collator, &altered, 0, &mask));
        let same = |x: &Tensor, y: &Tensor| values(x) == values(y);
        assert!(same(&a.context, &b.context) && same(&a.features, &b.features) && same(&a.base, &b.base));
        assert!(!same(&a.x0, &b.x0));
        for (x, y) in [(&a.observed_motion, &b.observed_motion), (&a.path, &b.path)] {
            assert_eq!(x.is_some(), parametrization == StateParametrization::Motion);
            assert!(x.as_ref().zip(y.as_ref()).is_none_or(|(x, y)| same(x, y)));
        }
    }
}

#[test]
fn masks_are_those_of_the_papers_table() {
    let scene = three_cars();
    let observed = |mask: &ObservationMask, a: usize| (0..12).filter(|t| mask.is_observed(a, *t)).collect::<Vec<_>>();
    let mut rng = Seed(5).rng();
    let ego = MaskTask::EgoConditioned.sample(&scene, 1, &mut rng);
    assert_eq!((observed(&ego, 0), observed(&ego, 1).len()), (vec![0, 1, 2, 3], 12));
    // Track 2 is not there at the end: it has no goal and no whole trajectory.
    let goals = MaskTask::GoalConditioned.sample(&scene, 0, &mut rng);
    assert_eq!((observed(&goals, 0), observed(&goals, 2)), (vec![0, 1, 2, 3, 11], vec![0, 1, 2, 3]));
    let agents = MaskTask::AgentConditioned.sample(&scene, 0, &mut rng);
    assert_eq!((observed(&agents, 1).len(), observed(&agents, 2).len()), (12, 4));
    for _ in 0..20 {
        let window = MaskTask::Windowed.sample(&scene, 0, &mut rng);
        let hidden: Vec<usize> = (0..12).filter(|t| !window.is_observed(0, *t)).collect();
        assert!(hidden.len() == 4 && hidden[3] - hidden[0] == 3 && hidden[0] <= 4);
        let upsampled = MaskTask::Upsampling.sample(&scene, 0, &mut rng);
        let kept = observed(&upsampled, 0);
        assert!(kept.len() == 4 && kept.windows(2).all(|pair| pair[1] - pair[0] == 3) && kept[0] < 3);
    }
    let imputed: usize = (0..200).map(|_| observed(&MaskTask::Imputation.sample(&scene, 0, &mut rng), 0).len()).sum();
    assert!((imputed as f64 / 2400.0 - 1.0 / 3.0).abs() < 0.04, "{imputed}");
}

#[test]
fn the_papers_weights_are_normalized_from_their_110_percent() {
    let probabilities = TaskWeights::default().probabilities().unwrap();
    assert!((probabilities.iter().map(|(_, p)| p).sum::<f64>() - 1.0).abs() < 1e-12);
    assert!((probabilities[0].1 - 50.0 / 110.0).abs() < 1e-12);
    assert!(TaskWeights { predictive: -1.0, ..TaskWeights::default() }.probabilities().is_none());
}

#[test]
fn sampling_covers_every_future_state_of_agents_seen() {
    let scene = three_cars();
    let mask = ObservationMask::predictive(3, 12, 4);
    let collator = collator([&scene], StateParametrization::Motion);
    let history_only = Scene { n_timesteps: 4, ..scene.clone() };
    for source in [&scene, &history_only] {
        let view = SceneView { scene: source, ego_idx: 0, mask: &mask };
        let batch = collator.collate(&[view], FutureValidity::Everything, &Device::Cpu).unwrap();
        assert_eq!(scalar(&batch.latent.sum_all().unwrap()), 24.0);
        let generated = &batch.decode_scenes(&batch.x0, &[source]).unwrap()[0];
        assert_eq!((generated.n_timesteps, generated.tracks[2].trajectory.n_valid()), (12, 12));
    }
}

#[test]
fn pair_features_do_not_change_when_the_scene_is_seen_from_another_agent() {
    let scene = three_cars();
    let mask = ObservationMask::predictive(3, 12, 4);
    let sigma = Tensor::new(&[0.3f32], &Device::Cpu).unwrap();
    for parametrization in [StateParametrization::Scene, StateParametrization::Motion] {
        let collator = collator([&scene], parametrization);
        let features = |ego_idx: usize| {
            let batch = collate(&collator, &scene, ego_idx, &mask);
            let features = PairFeatures::new(&batch, &[(1, 0)], parametrization).unwrap();
            let all = features.forward(&batch.x0, &sigma).unwrap();
            assert_eq!(all.dims(), &[1, PairFeatures::n_features(12, 3)]);
            values(&all)
        };
        if parametrization != StateParametrization::Scene {
            let worst = features(0).iter().zip(features(2)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(worst < 1e-4, "{worst}");
        }
    }
}

#[test]
fn tensors_that_do_not_belong_together_make_no_batch() {
    let scene = three_cars();
    type Spoil<'a> = &'a dyn Fn(&mut SceneTensors);
    let collator = Collator { sight: Some(Sight::new(4)), ..collator([&scene], StateParametrization::Motion) };
    let batch = collate(&collator, &scene, 0, &ObservationMask::predictive(3, 12, 4));
    let message = |spoil: Spoil<'_>| {
        let mut tensors = SceneTensors::clone(&batch);
        spoil(&mut tensors);
        SceneBatch::new(tensors).unwrap_err().to_string()
    };
    let cut = |tensor: &Tensor| tensor.narrow(1, 0, 2).unwrap();
    let around = |tensors: &mut SceneTensors, spoil: &dyn Fn(&mut Surroundings)| {
        spoil(tensors.surroundings.as_mut().unwrap());
    };
    let cases: [(&str, Spoil<'_>); 7] = [
        ("latent has shape [1, 2, 12], expected [1, 3, 12]", &|t| t.latent = cut(&t.latent)),
        ("path has shape [1, 2, 12, 12], expected [1, 3, 12, 12]", &|t| t.path = t.path.as_ref().map(cut)),
        ("surroundings.modes has shape [1, 2, 3, 12, 12]", &|t| around(t, &|around| around.modes = cut(&around.modes))),
        ("surroundings.rows has 0 items, expected 1", &|t| around(t, &|around| around.rows.clear())),
        ("frames has 0 items, expected 1", &|t| t.frames.clear()),
        ("unit holds f64, expected f32", &|t| t.unit = t.unit.to_dtype(candle_core::DType::F64).unwrap()),
        ("x0 has 1 values", &|t| t.x0 = t.x0.narrow(3, 0, 1).unwrap()),
    ];
    for (expected, spoil) in cases {
        let found = message(spoil);
        assert!(found.starts_with("scene batch: ") && found.contains(expected), "{found}");
    }
}
