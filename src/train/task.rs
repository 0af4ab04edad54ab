//! Training tasks: the loss of a batch, and figures on held-out data.

use super::Error;
use candle_core::Tensor;
use std::collections::BTreeMap;

/// A training task.
pub trait TrainTask: Sync {
    /// The loss of the batch of `step`, a scalar. It must depend on the parameters and the step alone, so that a
    /// resumed run takes the same steps.
    fn loss(&self, step: u64) -> Result<Tensor, Error>;

    /// Prepares the batch of the next step in advance. It is called while the device computes the previous step, and
    /// must not wait for it.
    fn prepare(&self, _step: u64) -> Result<(), Error> {
        Ok(())
    }

    /// Figures on held-out data with the present parameters, by name.
    fn evaluate(&self) -> Result<BTreeMap<String, f64>, Error>;

    /// The badness of these figures, to compare evaluations of one training; `None` if nothing is held out.
    fn badness(&self, _figures: &BTreeMap<String, f64>) -> Option<f64> {
        None
    }
}
