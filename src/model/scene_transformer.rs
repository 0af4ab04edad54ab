//! Scene Transformer, the joint variant (Ngiam et al. 2021): from the known inputs of a scene, a few futures of all its
//! agents at once, with their probabilities.

use super::known_input::KnownInput;
use super::trunk::{Trunk, TrunkConfig, check_heads, check_layers};
use crate::nn::{Init, LayerNorm, Linear, Mlp, Params, Scope};
use crate::seed::Seed;
use crate::settings;
use crate::tensor::{SceneBatch, StateParametrization};
use candle_core::{Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Shape of the network.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SceneTransformerConfig {
    /// Layers before the futures part, one letter a layer: T attends over time, A over agents, M reads the map. Blanks
    /// are ignored.
    pub encoder: String,
    /// Layers after the futures have parted, in the same letters. Each future sees itself alone.
    pub decoder: String,
    /// Features per agent state.
    #[schemars(range(min = 1, max = 16_384))]
    pub width: usize,
    /// Attention heads.
    #[schemars(range(min = 1, max = 1_024))]
    pub n_heads: usize,
    /// Hidden features of the feed-forward part of each layer.
    #[schemars(range(min = 1, max = 65_536))]
    pub feed_forward: usize,
    /// Features of each sinusoidal encoding; even.
    #[schemars(range(min = 2, max = 16_384), extend("multipleOf" = 2))]
    pub encoding: usize,
    /// Number F of joint futures.
    #[schemars(range(min = 1, max = 1_000))]
    pub n_modes: usize,
}

impl SceneTransformerConfig {
    /// Refuses a shape that no network can have.
    pub fn validate(&self) -> settings::Result {
        settings::check_ranges(self)?;
        check_layers("encoder", &self.encoder)?;
        check_layers("decoder", &self.decoder)?;
        check_heads(self.width, self.n_heads)
    }
}

impl Default for SceneTransformerConfig {
    /// The published layers, except for those that read traffic signals, which our recordings do not have.
    fn default() -> Self {
        Self {
            encoder: "TATATA M TA M TA".to_owned(),
            decoder: "TATA".to_owned(),
            width: 256,
            n_heads: 4,
            feed_forward: 1024,
            encoding: 256,
            n_modes: 6,
        }
    }
}

/// The output of a forward pass for B scenes.
#[derive(Debug, Clone)]
pub struct JointFutures {
    /// The states of every future in diffused units, as `SceneBatch::x0` has them: (B · F, A, T, D), all futures of a
    /// row after each other; zero except on latent entries.
    pub x0: Tensor,
    /// Unnormalized log probabilities of the futures, (B, F).
    pub logits: Tensor,
}

impl JointFutures {
    /// The futures of each row, the likeliest first, each with its probability; of equal ones in their order.
    pub fn ranked(&self) -> Result<Vec<Vec<(usize, f64)>>> {
        let rank = |logits: Vec<f32>| {
            let largest = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            let weights: Vec<f64> = logits.iter().map(|logit| f64::from(logit - largest).exp()).collect();
            let sum: f64 = weights.iter().sum();
            let mut ranked: Vec<(usize, f64)> = weights.into_iter().map(|weight| weight / sum).enumerate().collect();
            ranked.sort_by(|a, b| b.1.total_cmp(&a.1).then_with(|| a.0.cmp(&b.0)));
            ranked
        };
        Ok(self.logits.detach().to_vec2::<f32>()?.into_iter().map(rank).collect())
    }
}

/// The network.
///
/// It sees what the denoiser sees of known states, agents and map, no diffused states and no noise level. A learned
/// embedding a future is added to the encoder's features; the decoder works on each future by itself. The logit of a
/// future is that of the mean of its features over valid agents and timesteps. (Scene Transformer reads it from an
/// artificial agent at an artificial timestep; both summarize features that the layers before have mixed over the whole
/// scene, and a mean needs no states in the trunk that other networks do not have.)
#[derive(Debug, Clone)]
pub struct SceneTransformer {
    known: KnownInput,
    /// The layer for the motion of observed agents, which the denoiser sees in the place of diffused motion.
    observed_motion: Option<Linear>,
    input_out: Linear,
    encoder: Trunk,
    /// (F, width).
    modes: Tensor,
    decoder: Trunk,
    norm_out: LayerNorm,
    output: Mlp,
    mode_logit: Mlp,
}

impl SceneTransformer {
    /// A network for states of `state_dim` dimensions in a parametrization, whose parameters live in `params`; missing
    /// ones are drawn from `seed`.
    ///
    /// # Errors
    /// Fails when the layer strings hold other letters than T, A and M, there is no mode, or sizes do not fit.
    pub fn new(
        params: &mut Params,
        config: &SceneTransformerConfig,
        state_dim: usize,
        parametrization: StateParametrization,
        seed: Seed,
    ) -> Result<Self> {
        let SceneTransformerConfig { width, n_heads, feed_forward, n_modes, .. } = *config;
        if n_modes == 0 {
            candle_core::bail!("n_modes is 0, expected at least 1");
        }
        let mut root = Scope::root(params, seed);
        let scope = &mut root;
        let observed_motion = match parametrization {
            StateParametrization::Motion => {
                Some(Linear::new(&mut scope.enter("input"), "observed_motion", state_dim, width)?)
            }
            StateParametrization::Scene => None,
        };
        let trunk = |layers| TrunkConfig { layers, width, n_heads, feed_forward };
        Ok(Self {
            known: KnownInput::new(scope, config.encoding, width, state_dim)?,
            observed_motion,
            input_out: Linear::new(&mut scope.enter("input"), "out", width, width)?,
            encoder: Trunk::new(scope, "encoder", trunk(&config.encoder))?,
            // Uniform over ±1, about the size of the features: futures that begin alike would stay alike.
            modes: scope.tensor("modes", &[n_modes, width], Init::KaimingUniform { fan_in: 1 })?,
            decoder: Trunk::new(scope, "decoder", trunk(&config.decoder))?,
            norm_out: LayerNorm::new(scope, "norm_out", width)?,
            output: Mlp::new(scope, "output", &[width, width, state_dim])?,
            mode_logit: Mlp::new(scope, "mode_logit", &[width, width, 1])?,
        })
    }

    /// Number F of joint futures.
    pub fn n_modes(&self) -> usize {
        self.modes.dims().first().copied().unwrap_or(0)
    }

    /// The futures of the scenes of a batch. Does not look at `batch.x0`.
    ///
    /// # Errors
    /// Fails when the batch does not fit the network.
    pub fn forward(&self, batch: &SceneBatch) -> Result<JointFutures> {
        let valid = &batch.valid;
        let (n_rows, n_modes) = (batch.n_rows(), self.n_modes());
        let lanes = self.known.lanes(&batch.lanes, &batch.lane_valid)?;
        let mut known = self.known.states(&batch.context, &batch.features, valid)?;
        if let (Some(linear), Some(motion)) = (&self.observed_motion, &batch.observed_motion) {
            known = (known + linear.forward_valid(motion, valid)?)?;
        }
        let h = self.input_out.forward_valid(&known.relu()?, valid)?;
        let h = self.encoder.forward(h, valid, valid, &self.encoder.project_keys(&lanes, &batch.lane_valid)?)?;

        let modes = self.modes.unsqueeze(1)?.unsqueeze(1)?.unsqueeze(0)?;
        let h = h.unsqueeze(1)?.broadcast_add(&modes)?.flatten(0, 1)?;
        let each = |mask: &Tensor| mask.unsqueeze(1)?.repeat((1, n_modes, 1, 1))?.flatten(0, 1);
        let valid = each(valid)?;
        let h = self.decoder.forward(h, &valid, &valid, &self.decoder.project_keys(&lanes, &batch.lane_valid)?)?;
        let h = self.norm_out.forward(&h)?;

        let latent = each(&batch.latent)?.unsqueeze(3)?;
        let x0 = self.output.forward_valid(&h, &valid)?.broadcast_mul(&latent)?;
        let valid = valid.unsqueeze(3)?;
        let n_valid = valid.sum((1, 2, 3))?.maximum(1.0)?.unsqueeze(1)?;
        let mean = h.broadcast_mul(&valid)?.sum((1, 2))?.broadcast_div(&n_valid)?;
        let logits = self.mode_logit.forward(&mean)?.reshape((n_rows, n_modes))?;
        Ok(JointFutures { x0, logits })
    }
}
