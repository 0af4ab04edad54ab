//! Does the geometric denoiser compute what its independent implementation in PyTorch
//! (`scripts/torch_geometric_network.py`) does?

use crate::batch_tensors::tensors;
use crate::support::{djinn, root};
use candle_core::{Device, Tensor, Var};
use djinn::diffusion::{Denoiser, Edm};
use djinn::model::{DenoiserSpec, GeometryConfig, NetworkConfig, SceneDenoiser, TrainedDenoiser};
use djinn::nn::{Compute, Params};
use djinn::scene::{AgentClass, ObservationMask, Scene, Split};
use djinn::seed::Seed;
use djinn::store::SceneStore;
use djinn::tensor::{
    AgentSurroundings, FutureValidity, LanePiece, LanePoint, RowSurroundings, SceneBatch, SceneTensors, SceneView,
    SeenPiece, Surroundings,
};
use std::collections::{BTreeMap, HashMap};
use std::path::PathBuf;
use std::sync::Arc;

/// The largest difference allowed, relative to the largest number: ours are computed in single precision.
const TOLERANCE: f32 = 1e-4;

fn golden_path(name: &str) -> PathBuf {
    root().join("tests/golden").join(name)
}

fn golden(name: &str) -> HashMap<String, Tensor> {
    candle_core::safetensors::load(golden_path(name), &Device::Cpu).unwrap()
}

fn values(tensor: &Tensor) -> Vec<f32> {
    tensor.flatten_all().unwrap().to_vec1().unwrap()
}

/// Fails unless two tensors agree to `TOLERANCE` of the largest entry.
#[track_caller]
fn assert_close(name: &str, found: &Tensor, expected: &Tensor) {
    assert_eq!(found.dims(), expected.dims(), "{name}");
    let scale = values(expected).iter().fold(f32::MIN_POSITIVE, |largest, v| largest.max(v.abs()));
    let pairs = values(found).into_iter().zip(values(expected));
    let error = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max) / scale;
    assert!(error <= TOLERANCE, "{name}: relative difference {error:e}");
}

/// [`assert_close`] for each row, of which each has a noise level of its own.
#[track_caller]
fn assert_rows_close(name: &str, found: &Tensor, expected: &Tensor) {
    for row in 0..expected.dim(0).unwrap() {
        assert_close(&format!("{name} of row {row}"), &found.get(row).unwrap(), &expected.get(row).unwrap());
    }
}

fn carried() -> TrainedDenoiser {
    TrainedDenoiser::read(&root().join("pipelines/models/geometric.safetensors"), &Compute::cpu()).unwrap()
}

/// Two fixture scenes: one to predict, one of which states are missing before, between and after observed ones.
fn collated(spec: &DenoiserSpec) -> SceneBatch {
    let folder = tempfile::tempdir().unwrap();
    let recordings = "tests/fixtures/recordings/interaction/FIX-multi-v1_2.zip";
    let output = folder.path().to_str().unwrap();
    djinn(&["ingest", recordings, "--dataset", "interaction", "--output", output]).expect(0);
    let store = SceneStore::open(&folder.path().join("scenes")).unwrap();
    let scene = |i: usize| {
        let mut scene = store.scene(i).unwrap();
        scene.tracks.truncate(4);
        // One whose heading is not recorded.
        scene.tracks[3].class = AgentClass::PedestrianOrCyclist;
        Scene { ego_idx: 0, ..scene }
    };
    let mut train = (0..store.len()).filter(|i| store.index().get(*i).split == Split::Train).map(scene);
    let scenes = [train.next().unwrap(), train.next().unwrap()];
    let history = ObservationMask::predictive(4, spec.n_timesteps, spec.n_history);
    let gaps = ObservationMask::from_fn(4, spec.n_timesteps, |agent, t| match agent {
        0 => t < spec.n_history || t + 1 == spec.n_timesteps,
        1 => t % 5 == 3,
        2 => false,
        _ => t >= 20,
    });
    let views = [
        SceneView { scene: &scenes[0], ego_idx: 0, mask: &history },
        SceneView { scene: &scenes[1], ego_idx: 0, mask: &gaps },
    ];
    spec.collator().collate(&views, FutureValidity::Continued, &Device::Cpu).unwrap()
}

/// The rows that were written as tensors.
fn rows(named: &HashMap<String, Tensor>, template: &LanePiece) -> Vec<Arc<RowSurroundings>> {
    let at = |name: &str, index: &[usize]| {
        index.iter().fold(named[name].clone(), |tensor, i| tensor.get(*i).unwrap()).to_scalar::<f32>().unwrap()
    };
    let [n_rows, n_agents, n_seen] = *named["seen_piece"].dims() else { panic!("{:?}", named["seen_piece"]) };
    let row = |b: usize| {
        let point = |p: usize, k: usize| LanePoint {
            x: at("piece_points", &[b, p, k, 0]),
            y: at("piece_points", &[b, p, k, 1]),
            heading_rad: at("piece_points", &[b, p, k, 2]),
            edges_m: (at("piece_has_edges", &[b, p, k]) > 0.0)
                .then(|| [0, 1].map(|side| at("piece_edges", &[b, p, k, side]))),
        };
        let piece = |p: usize| {
            let mut piece = template.clone();
            piece.points = std::array::from_fn(|k| point(p, k));
            (piece.lane, piece.length_m) = (at("piece_lane", &[b, p]) as u32, at("piece_length", &[b, p]));
            piece
        };
        let seen = |a: usize, s: usize| SeenPiece {
            piece: at("seen_piece", &[b, a, s]) as u32,
            reach_m: (at("seen_is_reached", &[b, a, s]) > 0.0).then(|| at("seen_reach", &[b, a, s])),
        };
        let agent = |a: usize| AgentSurroundings {
            half_size_m: [0, 1].map(|axis| at("half_size", &[b, a, axis])),
            is_vulnerable: at("is_vulnerable", &[b, a]) > 0.0,
            lanes: (0..n_seen).filter(|s| at("agent_lane_valid", &[b, a, *s]) > 0.0).map(|s| seen(a, s)).collect(),
        };
        Arc::new(RowSurroundings {
            pieces: (0..named["piece_lane"].dim(1).unwrap()).map(piece).collect(),
            agents: (0..n_agents).map(agent).collect(),
            dt_s: at("dt_s", &[b]),
        })
    };
    (0..n_rows).map(row).collect()
}

/// The batch that these tensors are; the rows' frames, lanes and flags of pieces, which the geometric network does not
/// read, are those of `other`.
fn batch_of(named: &HashMap<String, Tensor>, other: &SceneBatch) -> SceneBatch {
    let get = |name: &str| named[name].clone();
    let template = &other.surroundings.as_ref().unwrap().rows[0].pieces[0];
    let n_rows = get("latent").dim(0).unwrap();
    let other = other.repeated(n_rows / other.n_rows()).unwrap();
    SceneBatch::new(SceneTensors {
        x0: get("observed_motion").zeros_like().unwrap(),
        context: get("observed_motion").zeros_like().unwrap(),
        scored: get("latent").zeros_like().unwrap(),
        lanes: other.lanes.clone(),
        lane_valid: other.lane_valid.clone(),
        frames: other.frames.clone(),
        observed: get("observed"),
        latent: get("latent"),
        valid: get("valid"),
        observed_motion: Some(get("observed_motion")),
        features: get("features"),
        base: get("base"),
        rotation: get("rotation"),
        unit: get("unit"),
        path: Some(get("path")),
        surroundings: Some(Surroundings {
            origin: get("origin"),
            attributes: get("attributes"),
            lanes: get("agent_lanes"),
            lane_valid: get("agent_lane_valid"),
            modes: get("modes"),
            variances: get("variances"),
            rows: rows(named, template),
        }),
    })
    .unwrap()
}

/// The tensors whose names begin so, by the rest of their names.
fn below(golden: &HashMap<String, Tensor>, prefix: &str) -> BTreeMap<String, Tensor> {
    let named = golden.iter().filter_map(|(name, t)| Some((name.strip_prefix(prefix)?.to_owned(), t.clone())));
    named.collect()
}

#[test]
fn outputs_and_gradients_of_random_weights_are_those_of_pytorch() {
    let golden = golden("geometric_network.safetensors");
    let config = NetworkConfig {
        layers: "TMAT".to_owned(),
        width: 8,
        n_heads: 2,
        feed_forward: 12,
        geometry: Some(GeometryConfig {
            n_lanes: 4,
            n_neighbors: 2,
            n_nearest_lanes: 2,
            relation_width: 4,
            ..GeometryConfig::default()
        }),
        ..NetworkConfig::default()
    };
    let mut params = Params::new(&Compute::cpu());
    let denoiser = SceneDenoiser::new(&mut params, &config, 3, Edm::default(), Seed(1)).unwrap();
    params.load(&below(&golden, "weight.")).unwrap();
    let batch = batch_of(&below(&golden, "input.").into_iter().collect(), &collated(&carried().spec));
    let x = Var::from_tensor(&golden["x"]).unwrap();
    let output = denoiser.bind(&batch, 1).unwrap().denoise(x.as_tensor(), &golden["sigma"]).unwrap();
    assert_rows_close("x0_hat", &output, &golden["output"]);
    let gradients = (output * &golden["probe"]).unwrap().sum_all().unwrap().backward().unwrap();
    assert_rows_close("gradient by x", gradients.get(x.as_tensor()).unwrap(), &golden["gradient_x"]);
    for (name, var) in params.iter() {
        assert_close(name, gradients.get(var.as_tensor()).unwrap(), &golden[&format!("gradient.{name}")]);
    }
}

/// `DJINN_UPDATE_GOLDEN=1 cargo test --test it pytorch` writes the batch that PyTorch is given;
/// `scripts/golden_geometric.py` follows. How motion changes along time, and its modes, are no part of it: PyTorch
/// works them out by itself.
#[test]
fn the_carried_checkpoint_gives_what_it_gives_in_pytorch() {
    let trained = carried();
    let batch = collated(&trained.spec);
    let mut named = tensors(&batch).unwrap();
    for unread in ["x0", "context", "lanes", "lane_valid", "path", "modes", "variances"] {
        named.remove(unread).unwrap();
    }
    if std::env::var_os("DJINN_UPDATE_GOLDEN").is_some() {
        candle_core::safetensors::save(&named, golden_path("geometric_scene.safetensors")).unwrap();
    }
    let told: BTreeMap<String, Tensor> = golden("geometric_scene.safetensors").into_iter().collect();
    assert_eq!(told.len(), named.len());
    for (name, tensor) in &told {
        assert_close(name, &named[name], tensor);
    }

    let golden = golden("carried_geometric.safetensors");
    let x = Var::from_tensor(&golden["x"]).unwrap();
    let n_samples = x.dim(0).unwrap() / batch.n_rows();
    let x0_hat = trained.network.bind(&batch, n_samples).unwrap().denoise(x.as_tensor(), &golden["sigma"]).unwrap();
    assert_rows_close("x0_hat", &x0_hat, &golden["output"]);
    let gradients = (x0_hat * &golden["probe"]).unwrap().sum_all().unwrap().backward().unwrap();
    assert_rows_close("gradient by x", gradients.get(x.as_tensor()).unwrap(), &golden["gradient_x"]);
}
