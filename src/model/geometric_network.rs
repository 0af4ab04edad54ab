//! F_θ of the geometric denoiser: a transformer over short stretches of motion that sees, at every noise level, the
//! pose of each agent's estimate and its surroundings there.
//!
//! Beside the inputs of DJINN's own network it sees the lanes around each agent in the agent's frame, and for each
//! token its own pose, its nearest neighbors and its nearest lanes at the pose of the estimate (`relations`). A token
//! is a stretch of `patch` timesteps of one agent.

use super::relations::{self, Counts, Relations};
use super::trunk::{LaneKeys, Trunk, TrunkConfig};
use super::{GeometryConfig, NetworkConfig};
use crate::nn::ops::pool_positive;
use crate::nn::{LayerNorm, Linear, Mlp, Scope, sinusoidal};
use crate::tensor::{RepeatedRows, SceneBatch, SurroundingsLayout};
use candle_core::{D, Result, Tensor};

/// Features of the encodings of noise level and time.
const ENCODING: usize = 32;
/// Shortest and longest encoding periods of the noise level, in units of c_noise: it spans 2.7 of them.
const NOISE_PERIODS: (f64, f64) = (0.2, 20.0);
/// Shortest and longest encoding periods of time, in tokens.
const TOKEN_PERIODS: (f64, f64) = (2.0, 200.0);
/// Meters per unit of positions in an agent's frame.
const POSITION_M: f64 = 10.0;
/// Meters per unit of positions in the ego frame.
const EGO_POSITION_M: f64 = 50.0;
/// Known features of a timestep: pose of the reference in the agent's frame (4), observed velocity (2), valid,
/// observed, latent.
const KNOWN: usize = 9;

/// Known features of an agent beside its attributes: origin and rotation of its frame in the ego frame (4), size (2),
/// whether it is never observed.
const AGENT_CONSTANTS: usize = 7;

/// The network.
#[derive(Debug, Clone)]
pub(super) struct GeometricNetwork {
    geometry: GeometryConfig,
    state_dim: usize,
    latent: Linear,
    known: Linear,
    agent: Linear,
    time: Linear,
    noise: Linear,
    own: Option<Linear>,
    neighbors: Option<Mlp>,
    lanes: Option<Mlp>,
    pooled: Option<Linear>,
    input_out: Linear,
    lane_encoder: Mlp,
    trunk: Trunk,
    norm_out: LayerNorm,
    output: Mlp,
}

/// The results of F_θ that do not change between calls.
#[derive(Debug, Clone)]
pub(super) struct KnownTokens {
    /// The known part of the input of each token, (B, A, N, width).
    input: Tensor,
    lanes: LaneKeys,
    /// 1 if a token holds a state that is observed or latent, (B, A, N).
    valid: Tensor,
    /// 1 if the result is read, (B, A, N).
    read: Tensor,
}

impl GeometricNetwork {
    /// A network for states of `state_dim` dimensions, with parameters below `scope`.
    pub(super) fn new(
        scope: &mut Scope<'_>,
        config: &NetworkConfig,
        geometry: &GeometryConfig,
        state_dim: usize,
    ) -> Result<Self> {
        let NetworkConfig { width, n_heads, feed_forward, .. } = *config;
        let GeometryConfig { patch, relation_width, n_neighbors, n_nearest_lanes, own_pose, .. } = *geometry;
        if patch == 0 {
            candle_core::bail!("tokens of no timesteps");
        }
        let mut input = scope.enter("input");
        let latent = Linear::new(&mut input, "latent", patch * 4 * state_dim, width)?;
        let known = Linear::new(&mut input, "known", patch * KNOWN, width)?;
        let agent = Linear::new(&mut input, "agent", SurroundingsLayout::AGENT + AGENT_CONSTANTS, width)?;
        let time = Linear::new(&mut input, "time", ENCODING, width)?;
        let noise = Linear::new(&mut input, "noise", ENCODING, width)?;
        let own = own_pose.then(|| Linear::new(&mut input, "own", relations::OWN, width)).transpose()?;
        let mut perceptron = |name: &str, n: usize, features: usize| {
            let made = (n > 0).then(|| Mlp::new(&mut input, name, &[features, relation_width, relation_width]));
            made.transpose()
        };
        let neighbors = perceptron("neighbors", n_neighbors, relations::NEIGHBOR)?;
        let lanes = perceptron("lanes", n_nearest_lanes, relations::LANE)?;
        let n_pooled = [&neighbors, &lanes].into_iter().flatten().count() * relation_width;
        let pooled = (n_pooled > 0).then(|| Linear::new(&mut input, "pooled", n_pooled, width)).transpose()?;
        let input_out = Linear::new(&mut input, "out", width, width)?;
        let lane_encoder = Mlp::new(scope, "lane_encoder", &[SurroundingsLayout::PIECE, width, width])?;
        let trunk = Trunk::new(scope, "trunk", TrunkConfig { layers: &config.layers, width, n_heads, feed_forward })?;
        let norm_out = LayerNorm::new(scope, "norm_out", width)?;
        let output = Mlp::new(scope, "output", &[width, width, patch * state_dim])?;
        Ok(Self {
            geometry: geometry.clone(),
            state_dim,
            latent,
            known,
            agent,
            time,
            noise,
            own,
            neighbors,
            lanes,
            pooled,
            input_out,
            lane_encoder,
            trunk,
            norm_out,
            output,
        })
    }

    /// Encodes the inputs that do not change between calls.
    pub(super) fn encode_known(&self, batch: &SceneBatch) -> Result<KnownTokens> {
        let Some(surroundings) = &batch.surroundings else {
            candle_core::bail!("the batch lacks the geometry that surrounds its agents; collate it with `Sight`");
        };
        let (b, a, _) = batch.valid.dims3()?;
        let any = |mask: &Tensor| self.tokens(&mask.unsqueeze(3)?)?.max(D::Minus1);
        let (valid, read) = (any(&batch.valid)?, any(&batch.latent)?);

        let states = self.known.forward_valid(&self.tokens(&known_features(batch)?)?, &valid)?;
        let origin = (&surroundings.origin * (1.0 / EGO_POSITION_M))?;
        // Sizes and whether an agent is never observed, of any timestep.
        let constants = batch.features.narrow(3, 4, 3)?.max(2)?;
        let agent = Tensor::cat(&[&surroundings.attributes, &origin, &batch.rotation, &constants], 2)?;
        let agent = self.agent.forward(&agent)?.unsqueeze(2)?;
        let n = valid.dim(2)?;
        let present: Vec<f32> = (0..n).map(|token| token as f32).collect();
        let time =
            sinusoidal(&Tensor::from_vec(present, n, valid.device())?, ENCODING, TOKEN_PERIODS.0, TOKEN_PERIODS.1)?;
        let time = self.time.forward(&time)?.unsqueeze(0)?.unsqueeze(0)?;
        let input = states.broadcast_add(&agent)?.broadcast_add(&time)?;

        let (_, _, l, f) = surroundings.lanes.dims4()?;
        let lane_valid = surroundings.lane_valid.reshape((b * a, l))?;
        let lanes = self.lane_encoder.forward_valid(&surroundings.lanes.reshape((b * a, l, f))?, &lane_valid)?;
        Ok(KnownTokens { input, lanes: self.trunk.project_keys(&lanes, &lane_valid)?.of_agents(), valid, read })
    }

    /// F_θ for the noisy states of `seen` (B, A, T, 4 D), whose estimate has `poses` (B, A, T, 3), at `c_noise` (B):
    /// (B, A, T, D).
    pub(super) fn forward(
        &self,
        seen: &Tensor,
        poses: &Tensor,
        batch: &SceneBatch,
        known: &KnownTokens,
        c_noise: &Tensor,
    ) -> Result<Tensor> {
        let valid = &known.valid;
        let counts = Counts {
            patch: self.geometry.patch,
            neighbors: self.geometry.n_neighbors,
            lanes: self.geometry.n_nearest_lanes,
        };
        let relations = Relations::new(batch, poses, counts)?;
        let latent = self.latent.forward_valid(&self.tokens(seen)?, valid)?;
        let noise = sinusoidal(c_noise, ENCODING, NOISE_PERIODS.0, NOISE_PERIODS.1)?;
        let noise = self.noise.forward(&noise)?.unsqueeze(1)?.unsqueeze(1)?;
        let mut hidden = (latent + &known.input)?;
        if let Some(own) = &self.own {
            hidden = (hidden + own.forward_valid(&relations.own, valid)?)?;
        }
        let kinds = [
            (&self.neighbors, &relations.neighbors, &relations.neighbor_valid),
            (&self.lanes, &relations.lanes, &relations.lane_valid),
        ];
        let seen =
            kinds.into_iter().filter_map(|(perceptron, entries, valid)| Some((perceptron.as_ref()?, entries, valid)));
        let seen =
            seen.map(|(perceptron, entries, valid)| pool(perceptron, entries, valid)).collect::<Result<Vec<_>>>()?;
        if let Some(pooled) = &self.pooled {
            hidden = (hidden + pooled.forward_valid(&Tensor::cat(&seen, 3)?, valid)?)?;
        }
        let hidden = self.input_out.forward_valid(&hidden.broadcast_add(&noise)?.relu()?, valid)?;
        let h = self.trunk.forward(hidden, valid, &known.read, &known.lanes)?;
        let f_x = self.output.forward_valid(&self.norm_out.forward(&h)?, &known.read)?;
        let (b, a, n, _) = f_x.dims4()?;
        f_x.reshape((b, a, n * self.geometry.patch, self.state_dim))?.narrow(2, 0, batch.valid.dim(2)?)
    }

    /// (B, A, T, F) to tokens (B, A, N, patch · F); the missing end of the last token is zero.
    fn tokens(&self, x: &Tensor) -> Result<Tensor> {
        let (b, a, t, f) = x.dims4()?;
        let n = t.div_ceil(self.geometry.patch);
        let missing = n * self.geometry.patch - t;
        let padded = if missing > 0 { x.pad_with_zeros(2, 0, missing)? } else { x.contiguous()? };
        padded.reshape((b, a, n, self.geometry.patch * f))
    }
}

impl KnownTokens {
    /// The tokens with each row taken `n` times in a row.
    pub(super) fn repeated(&self, n: usize) -> Result<Self> {
        let n_rows = self.valid.dim(0)?;
        let rows = RepeatedRows::new(n_rows, n, self.valid.device())?;
        Ok(Self {
            input: rows.tensor(&self.input)?,
            lanes: self.lanes.repeated(&rows, n_rows)?,
            valid: rows.tensor(&self.valid)?,
            read: rows.tensor(&self.read)?,
        })
    }
}

/// The maximum of a perceptron's outputs over the valid entries of (.., K, F), and 0 without any: (.., width).
fn pool(perceptron: &Mlp, entries: &Tensor, valid: &Tensor) -> Result<Tensor> {
    // Entries that are not valid are exactly 0, which no entry is below.
    pool_positive(&perceptron.forward_valid(entries, valid)?)
}

/// The known features of each state, in the agent's own frame: (B, A, T, `KNOWN`).
fn known_features(batch: &SceneBatch) -> Result<Tensor> {
    let Some(surroundings) = &batch.surroundings else {
        candle_core::bail!("the batch lacks the geometry that surrounds its agents; collate it with `Sight`");
    };
    let cos = batch.rotation.narrow(2, 0, 1)?.unsqueeze(2)?;
    let sin = batch.rotation.narrow(2, 1, 1)?.unsqueeze(2)?;
    let turned = |v: &Tensor| -> Result<[Tensor; 2]> {
        let (x, y) = (v.narrow(3, 0, 1)?, v.narrow(3, 1, 1)?);
        Ok([(x.broadcast_mul(&cos)? + y.broadcast_mul(&sin)?)?, (y.broadcast_mul(&cos)? - x.broadcast_mul(&sin)?)?])
    };
    let position = batch.base.narrow(3, 0, 2)?.broadcast_sub(&surroundings.origin.unsqueeze(2)?)?;
    let [along, across] = turned(&(position * (1.0 / POSITION_M))?)?;
    let heading = batch.base.narrow(3, 2, 1)?;
    let heading = Tensor::cat(&[heading.cos()?, heading.sin()?], 3)?;
    let [ahead, aside] = turned(&heading)?;
    let [forward, sideways] = turned(&batch.features.narrow(3, 0, 2)?)?;
    let masks = [&batch.valid, &batch.observed, &batch.latent];
    let [valid, observed, latent] = [masks[0].unsqueeze(3)?, masks[1].unsqueeze(3)?, masks[2].unsqueeze(3)?];
    let features = Tensor::cat(&[&along, &across, &ahead, &aside, &forward, &sideways], 3)?.broadcast_mul(&valid)?;
    Tensor::cat(&[&features, &valid, &observed, &latent], 3)
}
