//! The number of values that networks keep: parameters, and intermediate results of a pass over a batch.
//!
//! Closed forms in the shapes of layers, counted where networks are defined ([`trunk`](super::trunk),
//! [`network`](super::network), [`geometric_network`](super::geometric_network),
//! [`scene_transformer`](super::scene_transformer)); small parts, such as biases, are left out. They are floating-point
//! numbers: a size that no machine has must not overflow.

use super::relations::{LANE, NEIGHBOR, OWN};
use super::{BehaviorClassifierConfig, NetworkConfig, SceneTransformerConfig};
use crate::tensor::{PairFeatures, SurroundingsLayout};

/// The most of a scene that a network is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SceneSize {
    /// Agents A.
    pub n_agents: usize,
    /// Timesteps T.
    pub n_timesteps: usize,
    /// Lane polylines L, which the geometric network does not read.
    pub n_lanes: usize,
    /// Dimensions D of a diffused state.
    pub state_dim: usize,
}

/// Numbers that a network keeps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NumberCounts {
    /// Its parameters.
    pub parameters: f64,
    /// The results of its operations on one row of a batch, which a backward pass needs.
    pub activations: f64,
    /// The most that is alive at a time for one row of a batch without a backward pass.
    pub alive: f64,
}

/// A stack of layers on the tokens of agents.
struct Stack<'a> {
    layers: &'a str,
    width: f64,
    n_heads: f64,
    feed_forward: f64,
    n_agents: f64,
    n_tokens: f64,
    /// Lanes that a token reads.
    n_lanes: f64,
    /// Lanes of a row of the batch, all of its maps together.
    n_lane_rows: f64,
}

impl Stack<'_> {
    fn counts(&self) -> NumberCounts {
        let Self { width, n_heads, feed_forward, n_agents, n_tokens, n_lanes, n_lane_rows, .. } = *self;
        let rows = n_agents * n_tokens;
        let n_layers = |kind: char| self.layers.chars().filter(|letter| *letter == kind).count() as f64;
        let (time, agents, map) = (n_layers('T'), n_layers('A'), n_layers('M'));
        let keys = map * n_lane_rows * 2.0 * width;
        // Own layers keep two norms, queries, keys and values, the mixture, two results and two sums; map layers a
        // query alone.
        let own = |length: f64| rows * (10.0 * width + feed_forward + n_heads * length);
        let read = rows * (8.0 * width + feed_forward + n_heads * n_lanes);
        NumberCounts {
            parameters: (time + agents + map) * (4.0 * width * width + 2.0 * width * feed_forward),
            activations: time * own(n_tokens) + agents * own(n_agents) + map * read + keys,
            alive: rows * (4.0 * width + feed_forward.max(4.0 * width)) + keys,
        }
    }
}

impl NumberCounts {
    /// The counts for `n` rows in place of one, with the same parameters.
    fn repeated(self, n: f64) -> Self {
        Self { activations: n * self.activations, alive: n * self.alive, ..self }
    }

    /// Adds the layers that turn `inputs` numbers into the features of each of `rows`.
    fn with_input(self, rows: f64, inputs: f64, width: f64) -> Self {
        Self {
            parameters: self.parameters + (inputs + 2.0 * width) * width,
            activations: self.activations + rows * (inputs + 6.0 * width),
            alive: self.alive + rows * (inputs + 2.0 * width),
        }
    }
}

impl NetworkConfig {
    /// Numbers that the denoiser keeps for scenes of this size.
    pub fn number_counts(&self, scene: SceneSize) -> NumberCounts {
        let (width, dim) = (self.width as f64, scene.state_dim as f64);
        let (n_agents, n_timesteps) = (scene.n_agents as f64, scene.n_timesteps as f64);
        let stack = |n_tokens: f64, n_lanes: f64, n_lane_rows: f64| Stack {
            layers: &self.layers,
            width,
            n_heads: self.n_heads as f64,
            feed_forward: self.feed_forward as f64,
            n_agents,
            n_tokens,
            n_lanes,
            n_lane_rows,
        };
        // The batch holds the matrices of each agent's motion along time.
        let matrices = n_agents * n_timesteps * n_timesteps * (1.0 + dim);
        let counts = match &self.geometry {
            None => {
                let lanes = scene.n_lanes as f64;
                let seen = dim * self.encoding as f64 * if self.path_input { 2.0 } else { 1.0 };
                let counts = stack(n_timesteps, lanes, lanes).counts();
                counts.with_input(n_agents * n_timesteps, 2.0 * seen, width).with_input(lanes, width, width)
            }
            Some(geometry) => {
                let (patch, lanes) = (geometry.patch as f64, geometry.n_lanes as f64);
                let n_tokens = scene.n_timesteps.div_ceil(geometry.patch.max(1)) as f64;
                let pooled = 2.0 * geometry.relation_width as f64;
                let relations = geometry.n_neighbors as f64 * (NEIGHBOR as f64 + pooled)
                    + geometry.n_nearest_lanes as f64 * (LANE as f64 + pooled)
                    + OWN as f64;
                let counts = stack(n_tokens, lanes, n_agents * lanes).counts();
                counts.with_input(n_agents * n_tokens, patch * 8.0 * dim + relations, width).with_input(
                    n_agents * lanes,
                    SurroundingsLayout::PIECE as f64,
                    width,
                )
            }
        };
        NumberCounts { alive: counts.alive + matrices, activations: counts.activations + matrices, ..counts }
    }
}

impl SceneTransformerConfig {
    /// Numbers that the baseline keeps for scenes of this size.
    pub fn number_counts(&self, scene: SceneSize) -> NumberCounts {
        let (width, lanes) = (self.width as f64, scene.n_lanes as f64);
        let stack = |layers: &str| {
            let stack = Stack {
                layers,
                width,
                n_heads: self.n_heads as f64,
                feed_forward: self.feed_forward as f64,
                n_agents: scene.n_agents as f64,
                n_tokens: scene.n_timesteps as f64,
                n_lanes: lanes,
                n_lane_rows: lanes,
            };
            stack.counts()
        };
        let (encoder, decoder) = (stack(&self.encoder), stack(&self.decoder).repeated(self.n_modes as f64));
        let counts = NumberCounts {
            parameters: encoder.parameters + decoder.parameters,
            activations: encoder.activations + decoder.activations,
            alive: encoder.alive.max(decoder.alive),
        };
        let rows = (scene.n_agents * scene.n_timesteps) as f64;
        counts.with_input(rows, (scene.state_dim * self.encoding) as f64, width).with_input(lanes, width, width)
    }
}

impl BehaviorClassifierConfig {
    /// Numbers that the classifier keeps for pairs in scenes of this size.
    pub fn number_counts(&self, scene: SceneSize) -> NumberCounts {
        let inputs = (PairFeatures::n_features(scene.n_timesteps, scene.state_dim) + self.encoding) as f64;
        let (width, n_hidden) = (self.width as f64, self.n_hidden as f64);
        let activations = inputs + n_hidden * width;
        NumberCounts { parameters: inputs * width + n_hidden * width * width, activations, alive: activations }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diffusion::Edm;
    use crate::model::{GeometryConfig, SceneDenoiser};
    use crate::nn::Compute;
    use crate::nn::Params;
    use crate::seed::Seed;

    const SCENE: SceneSize = SceneSize { n_agents: 4, n_timesteps: 40, n_lanes: 16, state_dim: 3 };

    #[test]
    fn parameters_are_those_of_the_networks() {
        for geometry in [None, Some(GeometryConfig { relation_width: 48, ..GeometryConfig::default() })] {
            let config = NetworkConfig {
                layers: "TMATMAT".into(),
                width: 96,
                n_heads: 4,
                feed_forward: 384,
                encoding: 32,
                geometry,
                ..NetworkConfig::default()
            };
            let mut params = Params::new(&Compute::cpu());
            SceneDenoiser::new(&mut params, &config, SCENE.state_dim, Edm::default(), Seed(0)).unwrap();
            let found: usize = params.iter().map(|(_, var)| var.elem_count()).sum();
            let ratio = config.number_counts(SCENE).parameters / found as f64;
            assert!((0.9..1.1).contains(&ratio), "{ratio}");
        }
    }

    #[test]
    fn activations_grow_with_every_layer_and_agent() {
        let network = |layers: &str| NetworkConfig { layers: layers.into(), ..NetworkConfig::default() };
        let of = |layers: &str, scene: SceneSize| network(layers).number_counts(scene).activations;
        let (few, more) = (of("TA", SCENE), of("TATA", SCENE));
        // A layer of the default network: 256 wide, 1024 fed forward, 4 heads, on 160 states that see 40 or 4 others.
        let layer = |length: f64| 160.0 * (10.0 * 256.0 + 1024.0 + 4.0 * length);
        assert!((more - few - layer(40.0) - layer(4.0)).abs() < 1.0);
        assert!(of("TA", SceneSize { n_agents: 8, ..SCENE }) > 1.9 * few);
    }
}
