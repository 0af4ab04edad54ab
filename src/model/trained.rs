//! A trained network on disk: weights, and everything needed to use them on scenes.

use crate::nn::{Compute, Error, Params, read_checkpoint, write_checkpoint};
use crate::seed::Seed;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::Path;

/// The description of a network in its checkpoint, beside the weights.
pub trait ModelSpec: Serialize + DeserializeOwned {
    /// The network.
    type Network;

    /// The network with parameters in `params`; new ones are drawn from `seed`.
    ///
    /// # Errors
    /// Fails when the parameters exist with other shapes.
    fn build(&self, params: &mut Params, seed: Seed) -> candle_core::Result<Self::Network>;

    /// Writes the checkpoint file and returns its fingerprint.
    ///
    /// # Errors
    /// When the folder cannot be written.
    fn write(&self, params: &Params, path: &Path) -> Result<String, Error> {
        write_checkpoint(path, &params.tensors(), self)
    }
}

/// A network ready for use, with its specification and its origin.
#[derive(Debug, Clone)]
pub struct TrainedModel<S: ModelSpec> {
    /// The network; its parameters take no gradients.
    pub network: S::Network,
    /// Its specification.
    pub spec: S,
    /// Hash of its file.
    pub fingerprint: String,
}

impl<S: ModelSpec> TrainedModel<S> {
    /// Reads a checkpoint file.
    ///
    /// # Errors
    /// When the file is not a whole checkpoint of such a network, in this version.
    pub fn read(path: &Path, compute: &Compute) -> Result<Self, Error> {
        let checkpoint = read_checkpoint::<S>(path, &compute.device)?;
        let tensor_error = |source| Error::Tensor { path: path.to_owned(), source };
        let mut params = Params::new(compute).frozen();
        // The drawn parameters are overwritten.
        let network = checkpoint.metadata.build(&mut params, Seed(0)).map_err(tensor_error)?;
        params.load(&checkpoint.tensors).map_err(tensor_error)?;
        Ok(Self { network, spec: checkpoint.metadata, fingerprint: checkpoint.fingerprint })
    }
}
