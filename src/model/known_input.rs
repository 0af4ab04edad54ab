//! The known inputs of networks of scenes: observed states, agent features and the map.

use crate::nn::{Linear, Mlp, Scope, sinusoidal};
use crate::tensor::FeatureLayout;
use candle_core::{Result, Tensor};

/// Shortest and longest encoding periods (paper, Appendix A, table "periods").
const STATE_PERIODS: [f64; 2] = [0.01, 10.0];
const TIMESTEP_PERIODS: (f64, f64) = (1.0, 100.0);

/// The first layers over known states and over lane polylines.
#[derive(Debug, Clone)]
pub(super) struct KnownInput {
    encoding: usize,
    states: Linear,
    lane_encoder: Mlp,
}

impl KnownInput {
    /// Layers for states of `state_dim` dimensions, with parameters `input.known` and `lane_encoder` below `scope`.
    pub(super) fn new(scope: &mut Scope<'_>, encoding: usize, width: usize, state_dim: usize) -> Result<Self> {
        let n_known = encoding * (state_dim + 1) + FeatureLayout::AGENT;
        let states = Linear::new(&mut scope.enter("input"), "known", n_known, width)?;
        let lane_encoder = Mlp::new(scope, "lane_encoder", &[FeatureLayout::LANE, width, width, width, width])?;
        Ok(Self { encoding, states, lane_encoder })
    }

    /// Known states `context` (B, A, T, D), agent features (B, A, T, C) and `valid` (B, A, T) to (B, A, T, width).
    pub(super) fn states(&self, context: &Tensor, features: &Tensor, valid: &Tensor) -> Result<Tensor> {
        let (n_rows, n_agents, n_timesteps, _) = context.dims4()?;
        let states = encode_states(context, self.encoding, STATE_PERIODS)?;
        let timesteps: Vec<f32> = (0..n_timesteps).map(|t| t as f32).collect();
        let timesteps = Tensor::from_vec(timesteps, n_timesteps, context.device())?;
        let timesteps = sinusoidal(&timesteps, self.encoding, TIMESTEP_PERIODS.0, TIMESTEP_PERIODS.1)?
            .reshape((1, 1, n_timesteps, self.encoding))?
            .broadcast_as((n_rows, n_agents, n_timesteps, self.encoding))?;
        let known = Tensor::cat(&[&states, &timesteps, features], 3)?;
        self.states.forward_valid(&known, valid)
    }

    /// Lane polylines (M, L, F) with `valid` (M, L) to (M, L, width).
    pub(super) fn lanes(&self, lanes: &Tensor, valid: &Tensor) -> Result<Tensor> {
        self.lane_encoder.forward_valid(lanes, valid)
    }
}

/// Sinusoidal encodings of every scalar, concatenated: (B, A, T, D) to (B, A, T, D · encoding).
pub(super) fn encode_states(states: &Tensor, encoding: usize, periods: [f64; 2]) -> Result<Tensor> {
    sinusoidal(states, encoding, periods[0], periods[1])?.flatten_from(3)
}
