//! Event conditioning of a network: a projection that starts at zero.

use crate::nn::{Init, Scope};
use candle_core::{Result, Tensor};

/// The projection of the event inputs of agents, added to their tokens.
///
/// Its weights begin at 0, so that a network that starts from a checkpoint without them gives the same answers. It has
/// no bias: agents without an event are as in such a network at any time.
#[derive(Debug, Clone)]
pub(super) struct EventInput {
    weight: Tensor,
}

impl EventInput {
    /// The name of its parameters in a checkpoint of the geometric network.
    pub(super) const TENSOR: &'static str = "input.event.weight";

    /// A projection of `n_inputs` to `width` features, with the parameter `event.weight` below `scope`.
    ///
    /// # Errors
    /// Fails when the parameter exists with another shape.
    pub(super) fn new(scope: &mut Scope<'_>, n_inputs: usize, width: usize) -> Result<Self> {
        Ok(Self { weight: scope.enter("event").tensor("weight", &[width, n_inputs], Init::Zeros)? })
    }

    /// The addition to the tokens of each agent: (B, A, E) to (B, A, width).
    ///
    /// # Errors
    /// Fails when E is not the number of inputs.
    pub(super) fn forward(&self, events: &Tensor) -> Result<Tensor> {
        let (b, a, n_inputs) = events.dims3()?;
        let projected = events.reshape((b * a, n_inputs))?.matmul(&self.weight.t()?)?;
        projected.reshape((b, a, self.weight.dim(0)?))
    }
}
