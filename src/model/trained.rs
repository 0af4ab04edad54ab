//! A trained network on disk: weights, and everything needed to use them on scenes.

use crate::nn::{Compute, Error, Params, read_checkpoint, write_checkpoint};
use crate::seed::Seed;
use crate::settings::{self, Issue};
use crate::tensor::{MotionCovariance, Normalizer};
use candle_core::DType;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fmt::Display;
use std::path::Path;

/// The description of a network in its checkpoint, beside the weights.
pub trait ModelSpec: Serialize + DeserializeOwned {
    /// The network.
    type Network;

    /// The scenes that it fits.
    fn shape(&self) -> SceneShape<'_>;

    /// Refuses sizes of the network that nobody can mean.
    fn check_network(&self) -> settings::Result {
        Ok(())
    }

    /// The network with parameters in `params`; new ones are drawn from `seed`.
    fn build(&self, params: &mut Params, seed: Seed) -> candle_core::Result<Self::Network>;

    /// Writes the checkpoint file and returns its fingerprint.
    fn write(&self, params: &Params, path: &Path) -> Result<String, Error> {
        write_checkpoint(path, &params.tensors(), self)
    }
}

/// The scenes that a model fits, as its checkpoint describes them.
#[derive(Debug, Clone, Copy)]
pub struct SceneShape<'a> {
    /// The scales.
    pub normalizer: &'a Normalizer,
    /// Observed timesteps.
    pub n_history: usize,
    /// Timesteps.
    pub n_timesteps: usize,
    /// Time between timesteps, seconds.
    pub dt_s: f64,
}

impl SceneShape<'_> {
    /// The most timesteps of a part of a scene, as for the ingest.
    const MAX_TIMESTEPS: usize = 10_000;

    fn check(&self) -> settings::Result {
        let Self { normalizer, n_history, n_timesteps, dt_s } = *self;
        let check = |is_right: bool, key: &str, found: &dyn Display, expected: &str| match is_right {
            true => Ok(()),
            false => Err(Issue::new(key, format_args!("is {found}, expected {expected}"))),
        };
        let future = n_timesteps.saturating_sub(n_history);
        let is_length = |n: usize| (1..=Self::MAX_TIMESTEPS).contains(&n);
        check(is_length(n_history), "n_history", &n_history, "1 to 10000")?;
        check(is_length(future), "n_timesteps", &n_timesteps, "n_history and 1 to 10000 more")?;
        check(dt_s.is_finite() && dt_s > 0.0, "dt_s", &dt_s, "a positive number")?;
        let state_dim = normalizer.state_dim;
        check([2, 3].contains(&state_dim), "normalizer.state_dim", &state_dim, "2 or 3")?;
        for unit in normalizer.scene_units().into_iter().chain(normalizer.motion_units()) {
            check(unit.is_finite() && unit > 0.0, "a unit of normalizer", &unit, "a positive number")?;
        }
        let Some(MotionCovariance { n_past, n_timesteps: n, values, .. }) = &normalizer.motion_covariance else {
            return Ok(());
        };
        check(*n_past <= n_history, "normalizer.motion_covariance.n_past", n_past, "at most n_history")?;
        check(*n <= n_timesteps, "normalizer.motion_covariance.n_timesteps", n, "at most n_timesteps")?;
        let n_values = (n_past + n) * (n_past + n);
        let is_whole = values.iter().all(|values| values.len() == n_values);
        check(is_whole, "normalizer.motion_covariance", &"cut off", "a square of all timesteps for each dimension")
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
        let unfit = |what: String| Error::Unfit { path: path.to_owned(), what };
        let spec = &checkpoint.metadata;
        spec.check_network().and_then(|()| spec.shape().check()).map_err(|issue| unfit(issue.to_string()))?;
        for (name, tensor) in &checkpoint.tensors {
            if !tensor.dtype().is_float() {
                return Err(unfit(format!("{name} holds {:?}, expected numbers with fractions", tensor.dtype())));
            }
            let sum = tensor.to_dtype(DType::F64).and_then(|tensor| tensor.abs()?.sum_all()?.to_scalar::<f64>());
            if !sum.map_err(tensor_error)?.is_finite() {
                return Err(unfit(format!("{name} has values that are no numbers")));
            }
        }
        let mut params = Params::new(compute);
        // The drawn parameters are overwritten.
        checkpoint.metadata.build(&mut params, Seed(0)).map_err(tensor_error)?;
        params.load(&checkpoint.tensors).map_err(tensor_error)?;
        let network = checkpoint.metadata.build(&mut params.settled(), Seed(0)).map_err(tensor_error)?;
        Ok(Self { network, spec: checkpoint.metadata, fingerprint: checkpoint.fingerprint })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::DenoiserSpec;
    use crate::nn::Checkpoint;
    use candle_core::Device;

    #[test]
    fn models_that_cannot_work_are_refused_by_what_is_wrong() {
        type Damage = fn(&mut Checkpoint<DenoiserSpec>);
        fn with_first(checkpoint: &mut Checkpoint<DenoiserSpec>, dtype: DType, factor: f64) {
            let first = checkpoint.tensors.values_mut().next().unwrap();
            *first = ((first.zeros_like().unwrap() + 1.0).unwrap() * factor).unwrap().to_dtype(dtype).unwrap();
        }
        let bundled = Path::new("pipelines/models/geometric.safetensors");
        let folder = tempfile::tempdir().unwrap();
        let cases: [(&str, Damage); 9] = [
            ("n_history is 0", |of| of.metadata.n_history = 0),
            ("n_timesteps is 10", |of| of.metadata.n_timesteps = of.metadata.n_history),
            ("dt_s is 0", |of| of.metadata.dt_s = 0.0),
            ("max_agents is 0", |of| of.metadata.max_agents = 0),
            ("network.geometry.patch is 0", |of| of.metadata.network.geometry.as_mut().unwrap().patch = 0),
            ("state_dim is 18446744073709551615", |of| of.metadata.normalizer.state_dim = usize::MAX),
            ("motion_covariance.n_past is 18446744073709551615", |of| {
                of.metadata.normalizer.motion_covariance.as_mut().unwrap().n_past = usize::MAX;
            }),
            ("has values that are no numbers", |of| with_first(of, DType::F32, f64::NAN)),
            ("holds I64, expected numbers with fractions", |of| with_first(of, DType::I64, 1.0)),
        ];
        for (told, damage) in cases {
            let mut checkpoint = read_checkpoint::<DenoiserSpec>(bundled, &Device::Cpu).unwrap();
            damage(&mut checkpoint);
            let path = folder.path().join("model.safetensors");
            write_checkpoint(&path, &checkpoint.tensors, &checkpoint.metadata).unwrap();
            let error = TrainedModel::<DenoiserSpec>::read(&path, &Compute::cpu()).unwrap_err().to_string();
            assert!(error.contains(told) && error.contains("model.safetensors"), "{told}: {error}");
        }
    }
}
