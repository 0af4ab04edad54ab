//! The layers together: gradients reach every parameter, and padding changes nothing.

use std::collections::BTreeMap;

use candle_core::{DType, Device, Result, Tensor};

use super::testing::values;
use super::*;
use crate::seed::Seed;

/// A network with every layer of this module.
struct Network {
    encode: Mlp,
    lanes: Mlp,
    norms: Vec<LayerNorm>,
    time: SelfAttention,
    agent: SelfAttention,
    map: CrossAttention,
    decode: Linear,
}

impl Network {
    fn new(params: &mut Params) -> Result<Self> {
        let mut scope = Scope::root(params, Seed(5));
        Ok(Self {
            encode: Mlp::new(&mut scope, "encode", &[12, 16, 16])?,
            lanes: Mlp::new(&mut scope, "lanes", &[3, 16, 16])?,
            norms: (0..3).map(|i| LayerNorm::new(&mut scope, &format!("norm.{i}"), 16)).collect::<Result<_>>()?,
            time: SelfAttention::new(&mut scope, "time", 16, 2)?,
            agent: SelfAttention::new(&mut scope, "agent", 16, 2)?,
            map: CrossAttention::new(&mut scope, "map", 16, 2)?,
            decode: Linear::new(&mut scope, "decode", 16, 2)?,
        })
    }

    /// States (B, A, T, 2) and lanes (B, L, 3) to (B, A, T, 2).
    fn forward(&self, x: &Tensor, valid: &Tensor, lanes: &Tensor, lane_valid: &Tensor) -> Result<Tensor> {
        let mut h = self.encode.forward(&sinusoidal(x, 6, 0.5, 50.0)?.flatten_from(3)?)?;
        h = (&h + self.time.forward(&self.norms[0].forward(&h)?, Axis::Time, valid)?)?;
        h = (&h + self.agent.forward(&self.norms[1].forward(&h)?, Axis::Agent, valid)?)?;
        let lanes = self.lanes.forward(lanes)?;
        h = (&h + self.map.forward(&self.norms[2].forward(&h)?, valid, &lanes, lane_valid)?)?;
        self.decode.forward_valid(&h, valid)
    }
}

fn normal(shape: &[usize], seed: u64) -> Tensor {
    let mut rng = Seed(seed).rng();
    let n = shape.iter().product();
    let values: Vec<f32> = (0..n).map(|_| rng.normal() as f32).collect();
    Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
}

/// States (2, 3, 4), with the last agent of the last scene as padding.
fn valid() -> Tensor {
    let values = (0..24).map(|i| if i >= 20 { 0f32 } else { 1.0 }).collect::<Vec<_>>();
    Tensor::from_vec(values, (2, 3, 4), &Device::Cpu).unwrap()
}

#[test]
fn gradients_reach_every_parameter_and_the_input_alike_in_both_implementations() {
    let lane_valid = Tensor::new(&[[1f32, 1.0, 0.0], [1.0, 0.0, 0.0]], &Device::Cpu).unwrap();
    let mut found: Vec<BTreeMap<String, Vec<f64>>> = Vec::new();
    for dtype in [DType::F32, DType::F64] {
        let mut params = Params::with_dtype(&Compute::cpu(), dtype);
        let network = Network::new(&mut params).unwrap();
        let x = candle_core::Var::from_tensor(&normal(&[2, 3, 4, 2], 1).to_dtype(dtype).unwrap()).unwrap();
        let lanes = normal(&[2, 3, 3], 2).to_dtype(dtype).unwrap();
        let y = network.forward(x.as_tensor(), &valid(), &lanes, &lane_valid).unwrap();
        let grads = y.sqr().unwrap().sum_all().unwrap().backward().unwrap();
        let mut all = BTreeMap::from([("y".to_owned(), values(&y))]);
        for (name, var) in params.iter().chain([("x", &x)]) {
            let grad = values(grads.get(var.as_tensor()).unwrap_or_else(|| panic!("{name} has no gradient")));
            assert!(grad.iter().any(|g| *g != 0.0), "{name} has gradient 0");
            all.insert(name.to_owned(), grad);
        }
        found.push(all);
    }
    for (name, plain) in &found[1] {
        let size = plain.iter().fold(1e-3, |max: f64, v| max.max(v.abs()));
        for (fused, plain) in found[0][name].iter().zip(plain) {
            assert!((fused - plain).abs() / size < 2e-5, "{name}: {fused} instead of {plain}");
        }
    }
}

#[test]
fn padding_changes_nothing() {
    let mut params = Params::new(&Compute::cpu());
    let network = Network::new(&mut params).unwrap();
    let (x, lanes) = (normal(&[1, 2, 4, 2], 1), normal(&[1, 2, 3], 2));
    let ones = |shape: &[usize]| Tensor::ones(shape, DType::F32, &Device::Cpu).unwrap();
    let alone = network.forward(&x, &ones(&[1, 2, 4]), &lanes, &ones(&[1, 2])).unwrap();
    let pad = |x: &Tensor, dim: usize, n: usize| {
        let mut shape = x.dims().to_vec();
        shape[dim] = n;
        Tensor::cat(&[x, &normal(&shape, 9)], dim).unwrap()
    };
    let mask = |shape: &[usize], dim: usize, n: usize| ones(shape).pad_with_zeros(dim, 0, n).unwrap();
    // One more agent and three more lanes that do not exist.
    let padded =
        network.forward(&pad(&x, 1, 1), &mask(&[1, 2, 4], 1, 1), &pad(&lanes, 1, 3), &mask(&[1, 2], 1, 3)).unwrap();
    for (found, expected) in values(&padded.narrow(1, 0, 2).unwrap()).iter().zip(values(&alone)) {
        assert!((found - expected).abs() < 1e-6, "{found} instead of {expected}");
    }
    assert_eq!(values(&padded.narrow(1, 2, 1).unwrap()), [0.0; 8]);
}

#[test]
fn states_without_lanes_read_nothing() {
    let mut params = Params::new(&Compute::cpu());
    let attention = CrossAttention::new(&mut Scope::root(&mut params, Seed(1)), "map", 8, 2).unwrap();
    let (x, valid) = (normal(&[2, 1, 3, 8], 1), Tensor::ones((2, 1, 3), DType::F32, &Device::Cpu).unwrap());
    let lane_valid = Tensor::new(&[[0f32, 0.0], [1.0, 0.0]], &Device::Cpu).unwrap();
    let read = values(&attention.forward(&x, &valid, &normal(&[2, 2, 8], 2), &lane_valid).unwrap());
    assert!(read[..24].iter().all(|v| *v == 0.0) && read[24..].iter().all(|v| *v != 0.0));
    // A map without any lane at all.
    let none = Tensor::zeros((2, 0, 8), DType::F32, &Device::Cpu).unwrap();
    let no_lanes = Tensor::zeros((2, 0), DType::F32, &Device::Cpu).unwrap();
    assert!(values(&attention.forward(&x, &valid, &none, &no_lanes).unwrap()).iter().all(|v| *v == 0.0));
}

#[test]
fn heads_must_divide_the_features() {
    let mut params = Params::new(&Compute::cpu());
    let mut scope = Scope::root(&mut params, Seed(1));
    assert!(SelfAttention::new(&mut scope, "a", 10, 4).is_err());
    assert!(CrossAttention::new(&mut scope, "b", 10, 0).is_err());
}

#[test]
fn names_are_those_of_torch() {
    let mut params = Params::new(&Compute::cpu());
    Mlp::new(&mut Scope::root(&mut params, Seed(1)), "mlp", &[2, 3, 4]).unwrap();
    let names: Vec<(&str, &[usize])> = params.iter().map(|(name, var)| (name, var.dims())).collect();
    let expected: [(&str, &[usize]); 4] =
        [("mlp.0.bias", &[3]), ("mlp.0.weight", &[3, 2]), ("mlp.2.bias", &[4]), ("mlp.2.weight", &[4, 3])];
    assert_eq!(names, expected);
}
