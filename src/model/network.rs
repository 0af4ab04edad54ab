//! F_θ, the raw network of DJINN: a transformer over the states of all agents at all timesteps (paper, Appendix A).

use super::known_input::{KnownInput, encode_states};
use super::trunk::{LaneKeys, Trunk, TrunkConfig, check_heads, check_layers};
use crate::nn::{LayerNorm, Linear, Mlp, Scope, sinusoidal};
use crate::settings::{self, Issue};
use crate::tensor::RepeatedRows;
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Shape of the network.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct NetworkConfig {
    /// The trunk, one letter a layer: T attends over time, A over agents, M reads the map. Blanks are ignored.
    pub layers: String,
    /// Features per agent state (the paper's 256).
    #[schemars(range(min = 1, max = 16_384))]
    pub width: usize,
    /// Attention heads.
    #[schemars(range(min = 1, max = 1_024))]
    pub n_heads: usize,
    /// Hidden features of the feed-forward part of each layer (the paper's 1024).
    #[schemars(range(min = 1, max = 65_536))]
    pub feed_forward: usize,
    /// Features of each sinusoidal encoding (the paper's 256); even.
    #[schemars(range(min = 2, max = 16_384), extend("multipleOf" = 2))]
    pub encoding: usize,
    /// Shortest and longest period of the encodings of diffused states, in units of c_in(σ) x (the paper's 0.01 and
    /// 10). Periods far below 1 carry nothing but noise while σ is large.
    pub latent_periods: [f64; 2],
    /// Whether the network also sees the residuals that diffused motion adds up to (motion parametrization only).
    pub path_input: bool,
    /// Settings of the geometric network, which sees noisy agents relative to their surroundings (motion
    /// parametrization only); left out, the network is the paper's. The geometric network does not use `encoding`,
    /// `latent_periods` and `path_input`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub geometry: Option<GeometryConfig>,
}

/// The view of the geometric network.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GeometryConfig {
    /// Timesteps of a token.
    #[schemars(range(min = 1, max = 100))]
    pub patch: usize,
    /// Number of lane pieces around its path that an agent sees.
    #[schemars(range(min = 1, max = 200))]
    pub n_lanes: usize,
    /// Number of neighbors that an agent sees at each token, nearest first; 0: none.
    #[schemars(range(max = 200))]
    pub n_neighbors: usize,
    /// Number of lanes that an agent sees at each token, nearest first; 0: none.
    #[schemars(range(max = 200))]
    pub n_nearest_lanes: usize,
    /// Features of a neighbor, and of a lane, at a token.
    #[schemars(range(min = 1, max = 4_096))]
    pub relation_width: usize,
    /// Whether a token contains the pose of its agent's estimate there.
    pub own_pose: bool,
}

impl Default for GeometryConfig {
    fn default() -> Self {
        Self { patch: 3, n_lanes: 24, n_neighbors: 6, n_nearest_lanes: 3, relation_width: 48, own_pose: true }
    }
}

impl NetworkConfig {
    /// Refuses a shape that no network can have.
    pub fn validate(&self) -> settings::Result {
        settings::check_ranges(self)?;
        check_layers("layers", &self.layers)?;
        check_heads(self.width, self.n_heads)?;
        let [shortest, longest] = self.latent_periods;
        match shortest > 0.0 && longest >= shortest && longest.is_finite() {
            true => Ok(()),
            false => Err(Issue::new(
                "latent_periods",
                format_args!("are {shortest} and {longest}, expected 0 < shortest <= longest"),
            )),
        }
    }
}

impl Default for NetworkConfig {
    fn default() -> Self {
        Self {
            layers: "TATM TATM TATM TAT".to_owned(),
            width: 256,
            n_heads: 4,
            feed_forward: 1024,
            encoding: 256,
            latent_periods: [0.01, 10.0],
            path_input: false,
            geometry: None,
        }
    }
}

impl NetworkConfig {
    /// A network of this size for states that are no motion: the paper's, with its encodings of diffused states, no
    /// wider than the network itself.
    #[must_use]
    pub fn without_paths(self) -> Self {
        let Self { latent_periods, path_input, geometry, .. } = Self::default();
        Self { latent_periods, path_input, geometry, encoding: self.encoding.min(self.width), ..self }
    }
}

/// Shortest and longest encoding periods of the noise level (paper, Appendix A, table "periods").
const NOISE_PERIODS: (f64, f64) = (0.1, 10_000.0);

/// F_θ(c_in x_lat, x_obs, M, c, c_noise).
///
/// The first linear map of the input MLP acts on a concatenation of encodings; it is kept as one map a part (their
/// sum is the same function), so that the parts that do not change between denoiser calls are computed once.
#[derive(Debug, Clone)]
pub struct SceneNetwork {
    encoding: usize,
    latent_periods: [f64; 2],
    input_latent: Linear,
    known: KnownInput,
    input_noise: Linear,
    input_out: Linear,
    trunk: Trunk,
    norm_out: LayerNorm,
    output: Mlp,
}

/// The results of F_θ that do not change between calls: from known states, features and the map.
#[derive(Debug, Clone)]
pub struct Known {
    /// The known part of the first input map, (B, A, T, width).
    input: Tensor,
    lanes: LaneKeys,
    valid: Tensor,
    /// 1 if the result is read: at valid states that are not known, (B, A, T).
    read: Tensor,
}

impl Known {
    /// The known input with each row taken `n` times in a row. Maps are shared, not repeated.
    ///
    /// # Errors
    /// Fails when the device runs out of memory.
    pub fn repeated(&self, n: usize) -> Result<Self> {
        let rows = RepeatedRows::new(self.valid.dim(0)?, n, self.valid.device())?;
        Ok(Self {
            input: rows.tensor(&self.input)?,
            lanes: self.lanes.clone(),
            valid: rows.tensor(&self.valid)?,
            read: rows.tensor(&self.read)?,
        })
    }
}

impl SceneNetwork {
    /// A network for states of `state_dim` dimensions, with parameters below `scope`.
    ///
    /// # Errors
    /// Fails when the layer string holds other letters than T, A and M, or sizes do not fit.
    pub fn new(scope: &mut Scope<'_>, config: &NetworkConfig, state_dim: usize) -> Result<Self> {
        let NetworkConfig { width, n_heads, feed_forward, encoding, .. } = *config;
        let known = KnownInput::new(scope, encoding, width, state_dim)?;
        let mut input = scope.enter("input");
        let n_latent = if config.path_input { 2 * state_dim } else { state_dim };
        let input_latent = Linear::new(&mut input, "latent", encoding * n_latent, width)?;
        let input_noise = Linear::new(&mut input, "noise", encoding, width)?;
        let input_out = Linear::new(&mut input, "out", width, width)?;
        let trunk = Trunk::new(scope, "trunk", TrunkConfig { layers: &config.layers, width, n_heads, feed_forward })?;
        let norm_out = LayerNorm::new(scope, "norm_out", width)?;
        let output = Mlp::new(scope, "output", &[width, width, state_dim])?;
        let latent_periods = config.latent_periods;
        Ok(Self { encoding, latent_periods, input_latent, known, input_noise, input_out, trunk, norm_out, output })
    }

    /// Encodes the inputs that do not change between calls: known states `context` (B, A, T, D), agent features (B, A,
    /// T, C), lane polylines (M, L, F) with `lane_valid` (M, L), `valid` (B, A, T) and `latent` (B, A, T), where
    /// results are read.
    ///
    /// # Errors
    /// Fails when shapes do not fit the network.
    pub fn encode_known(
        &self,
        context: &Tensor,
        features: &Tensor,
        valid: &Tensor,
        latent: &Tensor,
        lanes: (&Tensor, &Tensor),
    ) -> Result<Known> {
        let (lanes, lane_valid) = lanes;
        let encoded = self.known.lanes(lanes, lane_valid)?;
        Ok(Known {
            input: self.known.states(context, features, valid)?,
            lanes: self.trunk.project_keys(&encoded, lane_valid)?,
            valid: valid.clone(),
            read: (valid * latent)?,
        })
    }

    /// F_θ for scaled noisy states `x` (B, A, T, D), zero where not latent, at `c_noise` (B): (B, A, T, D), zero there,
    /// too.
    ///
    /// # Errors
    /// Fails when shapes do not fit.
    pub fn forward(&self, x: &Tensor, known: &Known, c_noise: &Tensor) -> Result<Tensor> {
        let valid = &known.valid;
        let latent = self.input_latent.forward_valid(&encode_states(x, self.encoding, self.latent_periods)?, valid)?;
        let noise = sinusoidal(c_noise, self.encoding, NOISE_PERIODS.0, NOISE_PERIODS.1)?;
        let noise = self.input_noise.forward(&noise)?.unsqueeze(1)?.unsqueeze(1)?;
        let hidden = (latent + &known.input)?.broadcast_add(&noise)?.relu()?;
        let hidden = self.input_out.forward_valid(&hidden, valid)?;
        let h = self.trunk.forward(hidden, valid, &known.read, &known.lanes)?;
        self.output.forward_valid(&self.norm_out.forward(&h)?, &known.read)
    }
}
