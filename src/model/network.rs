//! F_θ, the raw network of DJINN: a transformer over the states of all agents at all timesteps (paper, Appendix A).

use crate::nn::{Axis, CrossAttention, LayerNorm, Linear, Mlp, Scope, SelfAttention, sinusoidal};
use crate::tensor::FeatureLayout;
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
    pub width: usize,
    /// Attention heads.
    pub n_heads: usize,
    /// Hidden features of the feed-forward part of each layer (the paper's 1024).
    pub feed_forward: usize,
    /// Features of each sinusoidal encoding (the paper's 256); even.
    pub encoding: usize,
    /// Shortest and longest period of the encodings of diffused states, in units of c_in(σ) x (the paper's 0.01 and 10). Periods
    /// far below 1 carry nothing but noise while σ is large.
    pub latent_periods: [f64; 2],
    /// Whether the network also sees the residuals that diffused motion adds up to (motion parametrization only).
    pub path_input: bool,
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
        }
    }
}

impl NetworkConfig {
    /// The same network with the paper's encodings of diffused states, and without the input of paths.
    #[must_use]
    pub fn without_paths(self) -> Self {
        let Self { latent_periods, path_input, .. } = Self::default();
        Self { latent_periods, path_input, ..self }
    }
}

/// Shortest and longest encoding periods (paper, Appendix A, table "periods").
const STATE_PERIODS: [f64; 2] = [0.01, 10.0];
const TIMESTEP_PERIODS: (f64, f64) = (1.0, 100.0);
const NOISE_PERIODS: (f64, f64) = (0.1, 10_000.0);

/// How one layer of the trunk mixes states.
#[derive(Debug, Clone)]
enum Mixing {
    Own(SelfAttention, Axis),
    Map(CrossAttention),
}

/// A transformer layer in pre-layer-norm form (Xiong et al. 2020): x + Mix(LN x), then x + FFN(LN x).
#[derive(Debug, Clone)]
struct Layer {
    norm_mix: LayerNorm,
    mixing: Mixing,
    norm_feed: LayerNorm,
    feed_forward: Mlp,
}

/// F_θ(c_in x_lat, x_obs, M, c, c_noise).
///
/// The first linear map of the input MLP acts on a concatenation of encodings; it is kept as one map a part (their
/// sum is the same function), so that the parts that do not change between denoiser calls are computed once.
#[derive(Debug, Clone)]
pub struct SceneNetwork {
    encoding: usize,
    latent_periods: [f64; 2],
    input_latent: Linear,
    input_known: Linear,
    input_noise: Linear,
    input_out: Linear,
    lane_encoder: Mlp,
    layers: Vec<Layer>,
    norm_out: LayerNorm,
    output: Mlp,
}

/// Everything that F_θ computes from what does not change between calls: known states, features and the map.
#[derive(Debug, Clone)]
pub struct Known {
    /// The known part of the first input map, (B, A, T, width).
    input: Tensor,
    /// Keys and values of each map layer, (M, L, 2 width).
    lane_keys: Vec<Tensor>,
    lane_valid: Tensor,
    valid: Tensor,
}

impl Known {
    /// The same for each row taken `n` times in a row. Maps are shared, not repeated.
    ///
    /// # Errors
    /// Fails when the device runs out of memory.
    pub fn repeated(&self, n: usize) -> Result<Self> {
        let n_rows = self.valid.dim(0)?;
        let rows: Vec<u32> = (0..n_rows * n).map(|row| (row / n) as u32).collect();
        let rows = Tensor::from_vec(rows, n_rows * n, self.valid.device())?;
        Ok(Self {
            input: self.input.index_select(&rows, 0)?,
            lane_keys: self.lane_keys.clone(),
            lane_valid: self.lane_valid.clone(),
            valid: self.valid.index_select(&rows, 0)?,
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
        let n_known = encoding * (state_dim + 1) + FeatureLayout::AGENT;
        let mut input = scope.enter("input");
        let n_latent = if config.path_input { 2 * state_dim } else { state_dim };
        let input_latent = Linear::new(&mut input, "latent", encoding * n_latent, width)?;
        let input_known = Linear::new(&mut input, "known", n_known, width)?;
        let input_noise = Linear::new(&mut input, "noise", encoding, width)?;
        let input_out = Linear::new(&mut input, "out", width, width)?;
        let lane_encoder = Mlp::new(scope, "lane_encoder", &[FeatureLayout::LANE, width, width, width, width])?;
        let mut layers = Vec::new();
        for (i, letter) in config.layers.chars().filter(|letter| !letter.is_whitespace()).enumerate() {
            let mut trunk = scope.enter("trunk");
            let mut scope = trunk.enter(&i.to_string());
            let mixing = match letter {
                'T' => Mixing::Own(SelfAttention::new(&mut scope, "time", width, n_heads)?, Axis::Time),
                'A' => Mixing::Own(SelfAttention::new(&mut scope, "agent", width, n_heads)?, Axis::Agent),
                'M' => Mixing::Map(CrossAttention::new(&mut scope, "map", width, n_heads)?),
                other => candle_core::bail!("layer string {:?} holds {other:?}; use T, A and M", config.layers),
            };
            layers.push(Layer {
                norm_mix: LayerNorm::new(&mut scope, "norm_mix", width)?,
                mixing,
                norm_feed: LayerNorm::new(&mut scope, "norm_feed", width)?,
                feed_forward: Mlp::new(&mut scope, "feed_forward", &[width, feed_forward, width])?,
            });
        }
        let norm_out = LayerNorm::new(scope, "norm_out", width)?;
        let output = Mlp::new(scope, "output", &[width, width, state_dim])?;
        let latent_periods = config.latent_periods;
        Ok(Self {
            encoding,
            latent_periods,
            input_latent,
            input_known,
            input_noise,
            input_out,
            lane_encoder,
            layers,
            norm_out,
            output,
        })
    }

    /// Encodes what does not change between calls: known states `context` (B, A, T, D), agent features (B, A, T, C),
    /// lane polylines (M, L, F) with `lane_valid` (M, L), and `valid` (B, A, T).
    ///
    /// # Errors
    /// Fails when shapes do not fit the network.
    pub fn encode_known(
        &self,
        context: &Tensor,
        features: &Tensor,
        valid: &Tensor,
        lanes: &Tensor,
        lane_valid: &Tensor,
    ) -> Result<Known> {
        let (n_rows, n_agents, n_timesteps, _) = context.dims4()?;
        let states = self.encode_states(context, STATE_PERIODS)?;
        let timesteps: Vec<f32> = (0..n_timesteps).map(|t| t as f32).collect();
        let timesteps = Tensor::from_vec(timesteps, n_timesteps, context.device())?;
        let timesteps = sinusoidal(&timesteps, self.encoding, TIMESTEP_PERIODS.0, TIMESTEP_PERIODS.1)?
            .reshape((1, 1, n_timesteps, self.encoding))?
            .broadcast_as((n_rows, n_agents, n_timesteps, self.encoding))?;
        let known = Tensor::cat(&[&states, &timesteps, features], 3)?;
        let lanes = self.lane_encoder.forward_valid(lanes, lane_valid)?;
        let map_layers = self.layers.iter().filter_map(|layer| match &layer.mixing {
            Mixing::Map(attention) => Some(attention.project_keys(&lanes)),
            Mixing::Own(..) => None,
        });
        Ok(Known {
            input: self.input_known.forward_valid(&known, valid)?,
            lane_keys: map_layers.collect::<Result<_>>()?,
            lane_valid: lane_valid.clone(),
            valid: valid.clone(),
        })
    }

    /// F_θ for scaled noisy states `x` (B, A, T, D), zero where not latent, at `c_noise` (B): (B, A, T, D).
    ///
    /// # Errors
    /// Fails when shapes do not fit.
    pub fn forward(&self, x: &Tensor, known: &Known, c_noise: &Tensor) -> Result<Tensor> {
        let valid = &known.valid;
        let latent = self.input_latent.forward_valid(&self.encode_states(x, self.latent_periods)?, valid)?;
        let noise = sinusoidal(c_noise, self.encoding, NOISE_PERIODS.0, NOISE_PERIODS.1)?;
        let noise = self.input_noise.forward(&noise)?.unsqueeze(1)?.unsqueeze(1)?;
        let hidden = (latent + &known.input)?.broadcast_add(&noise)?.relu()?;
        let mut h = self.input_out.forward_valid(&hidden, valid)?;
        let mut lane_keys = known.lane_keys.iter();
        for layer in &self.layers {
            let normed = layer.norm_mix.forward(&h)?;
            let mixed = match (&layer.mixing, lane_keys.as_slice().first()) {
                (Mixing::Own(attention, axis), _) => attention.forward(&normed, *axis, valid)?,
                (Mixing::Map(attention), Some(keys)) => {
                    lane_keys.next();
                    attention.forward_with_keys(&normed, valid, keys, &known.lane_valid)?
                }
                (Mixing::Map(_), None) => candle_core::bail!("the known inputs were encoded by another network"),
            };
            h = (h + mixed)?;
            h = (&h + layer.feed_forward.forward_valid(&layer.norm_feed.forward(&h)?, valid)?)?;
        }
        self.output.forward_valid(&self.norm_out.forward(&h)?, valid)
    }

    /// Sinusoidal encodings of every scalar, concatenated: (B, A, T, D) to (B, A, T, D · encoding).
    fn encode_states(&self, states: &Tensor, periods: [f64; 2]) -> Result<Tensor> {
        sinusoidal(states, self.encoding, periods[0], periods[1])?.flatten_from(3)
    }
}
