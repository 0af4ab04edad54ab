//! The stack of transformer layers in all networks of scenes, by which the states of a scene see each other.

use crate::nn::{Axis, CrossAttention, LayerNorm, Mlp, Scope, SelfAttention};
use crate::settings::{self, Issue};
use crate::tensor::RepeatedRows;
use candle_core::{Result, Tensor};

/// Shape of a stack of layers.
#[derive(Debug, Clone, Copy)]
pub(super) struct TrunkConfig<'a> {
    /// One letter a layer: T attends over time, A over agents, M reads the map. Blanks are ignored.
    pub(super) layers: &'a str,
    /// Features per agent state.
    pub(super) width: usize,
    pub(super) n_heads: usize,
    /// Hidden features of the feed-forward part of each layer.
    pub(super) feed_forward: usize,
}

/// Refuses letters that are no layers.
pub(super) fn check_layers(key: &str, layers: &str) -> settings::Result {
    match layers.chars().find(|letter| !matches!(letter, 'T' | 'A' | 'M') && !letter.is_whitespace()) {
        Some(letter) => {
            let expected = "expected the letters T (time), A (agents) and M (map), one a layer";
            Err(Issue::new(key, format_args!("is \"{layers}\", but {letter} is not a layer; {expected}")))
        }
        None if layers.trim().is_empty() => Err(Issue::new(key, "is empty, expected at least one layer")),
        None => Ok(()),
    }
}

/// Refuses heads that would not be of one size.
pub(super) fn check_heads(width: usize, n_heads: usize) -> settings::Result {
    match n_heads > 0 && width.is_multiple_of(n_heads) {
        true => Ok(()),
        false => {
            Err(Issue::new("n_heads", format_args!("is {n_heads}, expected a divisor of width, which is {width}")))
        }
    }
}

/// How one layer mixes states.
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

/// Layers that attend over time, over agents and to the map, one after the other.
#[derive(Debug, Clone)]
pub(super) struct Trunk {
    layers: Vec<Layer>,
}

/// The map as the layers of a trunk read it.
#[derive(Debug, Clone)]
pub(super) struct LaneKeys {
    /// Keys and values of each map layer, (M, L, 2 width).
    keys: Vec<Tensor>,
    /// 1 if a polyline is not padding, (M, L).
    valid: Tensor,
    /// Whether each agent has a map of its own (M = B A), and not each scene.
    of_agents: bool,
}

impl LaneKeys {
    /// Marks the keys as one map for each agent.
    pub(super) fn of_agents(self) -> Self {
        Self { of_agents: true, ..self }
    }

    /// The maps of agents, with `n_rows` rows of scenes, for rows taken several times.
    pub(super) fn repeated(&self, rows: &RepeatedRows, n_rows: usize) -> Result<Self> {
        let repeat = |tensor: &Tensor| {
            let dims = tensor.dims();
            let n_agents = dims[0] / n_rows.max(1);
            let split: Vec<usize> = [n_rows, n_agents].into_iter().chain(dims[1..].iter().copied()).collect();
            rows.tensor(&tensor.reshape(split)?)?.flatten(0, 1)
        };
        let keys = self.keys.iter().map(repeat).collect::<Result<_>>()?;
        Ok(Self { keys, valid: repeat(&self.valid)?, of_agents: self.of_agents })
    }
}

impl Trunk {
    /// Layers with parameters `{name}.{i}.…` below `scope`.
    pub(super) fn new(scope: &mut Scope<'_>, name: &str, config: TrunkConfig<'_>) -> Result<Self> {
        let TrunkConfig { layers, width, n_heads, feed_forward } = config;
        let layer = |(i, letter): (usize, char)| {
            let mut trunk = scope.enter(name);
            let mut scope = trunk.enter(&i.to_string());
            let mixing = match letter {
                'T' => Mixing::Own(SelfAttention::new(&mut scope, "time", width, n_heads)?, Axis::Time),
                'A' => Mixing::Own(SelfAttention::new(&mut scope, "agent", width, n_heads)?, Axis::Agent),
                'M' => Mixing::Map(CrossAttention::new(&mut scope, "map", width, n_heads)?),
                other => candle_core::bail!("layer string {layers:?} holds {other:?}; use T, A and M"),
            };
            Ok(Layer {
                norm_mix: LayerNorm::new(&mut scope, "norm_mix", width)?,
                mixing,
                norm_feed: LayerNorm::new(&mut scope, "norm_feed", width)?,
                feed_forward: Mlp::new(&mut scope, "feed_forward", &[width, feed_forward, width])?,
            })
        };
        let letters = layers.chars().filter(|letter| !letter.is_whitespace()).enumerate();
        Ok(Self { layers: letters.map(layer).collect::<Result<_>>()? })
    }

    /// The keys that its map layers need of encoded polylines `lanes` (M, L, width) with `valid` (M, L).
    pub(super) fn project_keys(&self, lanes: &Tensor, valid: &Tensor) -> Result<LaneKeys> {
        let map_layers = self.layers.iter().filter_map(|layer| match &layer.mixing {
            Mixing::Map(attention) => Some(attention.project_keys(lanes)),
            Mixing::Own(..) => None,
        });
        Ok(LaneKeys { keys: map_layers.collect::<Result<_>>()?, valid: valid.clone(), of_agents: false })
    }

    /// Features (B, A, T, width) to features of the same shape, with `valid` (B, A, T). B is a multiple of the number
    /// of maps M: each map belongs to B / M consecutive rows. Results are meaningful only if `read` (B, A, T) is 1:
    /// elsewhere the last layer does only what it must.
    ///
    /// # Errors
    /// Fails when shapes do not fit, or the map was projected by another trunk.
    pub(super) fn forward(&self, mut h: Tensor, valid: &Tensor, read: &Tensor, lanes: &LaneKeys) -> Result<Tensor> {
        let mut lane_keys = lanes.keys.iter();
        let n_layers = self.layers.len();
        for (i, layer) in self.layers.iter().enumerate() {
            let normed = layer.norm_mix.forward(&h)?;
            let mixed = match (&layer.mixing, lane_keys.as_slice().first()) {
                (Mixing::Own(attention, axis), _) => attention.forward(&normed, *axis, valid)?,
                (Mixing::Map(attention), Some(keys)) => {
                    lane_keys.next();
                    match lanes.of_agents {
                        false => attention.forward_with_keys(&normed, valid, keys, &lanes.valid)?,
                        true => {
                            let (b, a, n, width) = normed.dims4()?;
                            let (own, own_valid) =
                                (normed.reshape((b * a, 1, n, width))?, valid.reshape((b * a, 1, n))?);
                            let read = attention.forward_with_keys(&own, &own_valid, keys, &lanes.valid)?;
                            read.reshape((b, a, n, width))?
                        }
                    }
                }
                (Mixing::Map(_), None) => candle_core::bail!("the known inputs were encoded by another network"),
            };
            h = (h + mixed)?;
            let normed = layer.norm_feed.forward(&h)?;
            let fed = if i + 1 == n_layers { read } else { valid };
            h = (&h + layer.feed_forward.forward_valid(&normed, fed)?)?;
        }
        Ok(h)
    }
}
