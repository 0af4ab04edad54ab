//! Attention between the states of a scene and from states to lanes: which other features does a state read?

use candle_core::{Result, Tensor, bail};

use super::linear::Linear;
use super::ops;
use super::params::Scope;

/// The axis along which self-attention mixes the states of a scene (B, A, T, D).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    /// Each agent's states over time.
    Time,
    /// All agents' states at one timestep.
    Agent,
}

/// Multi-head self-attention along one axis of the states, with the output projection.
#[derive(Debug, Clone)]
pub struct SelfAttention {
    qkv: Linear,
    out: Linear,
    n_heads: usize,
}

impl SelfAttention {
    /// Attention over `dim` features in `n_heads` heads, with parameters `qkv` (queries, keys and values in one map)
    /// and `out`.
    ///
    /// # Errors
    /// When `dim` is not a multiple of `n_heads`, or the parameters exist with other shapes.
    pub fn new(scope: &mut Scope<'_>, name: &str, dim: usize, n_heads: usize) -> Result<Self> {
        check_heads(name, dim, n_heads)?;
        let mut scope = scope.enter(name);
        let qkv = Linear::new(&mut scope, "qkv", dim, 3 * dim)?;
        let out = Linear::new(&mut scope, "out", dim, dim)?;
        Ok(Self { qkv, out, n_heads })
    }

    /// Mixes `x` (B, A, T, D) along `axis`. States where `valid` (B, A, T) is 0 are not attended to and get exactly 0.
    pub fn forward(&self, x: &Tensor, axis: Axis, valid: &Tensor) -> Result<Tensor> {
        let qkv = self.qkv.forward_valid(x, valid)?;
        let mixed = ops::self_attention(&qkv, valid, self.n_heads, axis)?;
        self.out.forward_valid(&mixed, valid)
    }
}

/// Multi-head attention from states to the lanes of their scene, with the output projection.
#[derive(Debug, Clone)]
pub struct CrossAttention {
    query: Linear,
    key_value: Linear,
    out: Linear,
    n_heads: usize,
}

impl CrossAttention {
    /// Attention over `dim` features in `n_heads` heads, with parameters `query`, `key_value` (keys and values in one
    /// map) and `out`.
    ///
    /// # Errors
    /// When `dim` is not a multiple of `n_heads`, or the parameters exist with other shapes.
    pub fn new(scope: &mut Scope<'_>, name: &str, dim: usize, n_heads: usize) -> Result<Self> {
        check_heads(name, dim, n_heads)?;
        let mut scope = scope.enter(name);
        let query = Linear::new(&mut scope, "query", dim, dim)?;
        let key_value = Linear::new(&mut scope, "key_value", dim, 2 * dim)?;
        let out = Linear::new(&mut scope, "out", dim, dim)?;
        Ok(Self { query, key_value, out, n_heads })
    }

    /// Reads from `lanes` (M, L, D) into `x` (B, A, T, D): see [`forward_with_keys`](Self::forward_with_keys).
    pub fn forward(&self, x: &Tensor, valid: &Tensor, lanes: &Tensor, lane_valid: &Tensor) -> Result<Tensor> {
        self.forward_with_keys(x, valid, &self.project_keys(lanes)?, lane_valid)
    }

    /// The keys and values (M, L, 2 D) of `lanes` (M, L, D): they do not change between calls of a denoiser.
    pub fn project_keys(&self, lanes: &Tensor) -> Result<Tensor> {
        self.key_value.forward(lanes)
    }

    /// Reads from the lanes of `keys` (M, L, 2 D) into `x` (B, A, T, D). M divides B: each map serves B / M consecutive
    /// rows of the batch, such as the samples of one scene. Lanes where `lane_valid` (M, L) is 0 are not attended to;
    /// states where `valid` (B, A, T) is 0 and states without any lane get exactly 0.
    pub fn forward_with_keys(&self, x: &Tensor, valid: &Tensor, keys: &Tensor, lane_valid: &Tensor) -> Result<Tensor> {
        let reads = ops::rows_with_keys(valid, lane_valid)?;
        let query = self.query.forward_valid(x, &reads)?;
        let mixed = ops::cross_attention(&query, &reads, keys, lane_valid, self.n_heads)?;
        self.out.forward_valid(&mixed, &reads)
    }
}

fn check_heads(name: &str, dim: usize, n_heads: usize) -> Result<()> {
    if n_heads == 0 || !dim.is_multiple_of(n_heads) {
        bail!("{name}: {dim} features cannot be split into {n_heads} heads");
    }
    Ok(())
}
