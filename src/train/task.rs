//! Training tasks: the loss of a batch, and of a part of it.

use super::Error;
use candle_core::Tensor;
use std::collections::BTreeMap;
use std::ops::Range;

/// Rows of the batch of a step: one of its parts, or all of them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BatchPart {
    /// The step.
    pub step: u64,
    /// The rows, from 0.
    pub rows: Range<usize>,
}

impl BatchPart {
    /// All rows of the batch of `step`.
    pub const fn whole(step: u64, batch_size: usize) -> Self {
        Self { step, rows: 0..batch_size }
    }

    /// Part `index` of `n_parts` of the batch of `step`.
    pub const fn of_batch(step: u64, batch_size: usize, index: usize, n_parts: usize) -> Self {
        Self { step, rows: index * batch_size / n_parts..(index + 1) * batch_size / n_parts }
    }
}

/// A training task.
///
/// A loss is a sum of means over the rows of a batch, or over their states. A part of the batch sums over its own rows
/// and divides by the divisors of the whole batch, so that the losses and gradients of all parts add up to those of the
/// batch.
pub trait TrainTask: Sync {
    /// Number of rows of a batch, B.
    fn batch_size(&self) -> usize;

    /// The contribution of `part` to the divisors of the means, such as its number of scored states, which are known
    /// only after the rows are drawn.
    ///
    /// # Errors
    /// When the rows cannot be made.
    fn divisors(&self, _part: &BatchPart) -> Result<Vec<f64>, Error> {
        Ok(Vec::new())
    }

    /// The share of `part` in the loss of its batch, a scalar. `divisors` are the sums of [`divisors`](Self::divisors) over all parts;
    /// `None` if the part is the whole batch. It must depend on the parameters, the part and these alone, so that a resumed run takes
    /// the same steps.
    ///
    /// # Errors
    /// When the rows cannot be made.
    fn loss(&self, part: &BatchPart, divisors: Option<&[f64]>) -> Result<Tensor, Error>;

    /// Prepares a `part` of the next step in advance. It is called while a GPU computes the previous step, and must not
    /// wait for it.
    ///
    /// # Errors
    /// When the rows cannot be made.
    fn prepare(&self, _part: &BatchPart) -> Result<(), Error> {
        Ok(())
    }

    /// Figures on held-out data with the present parameters, by name.
    ///
    /// # Errors
    /// When the data cannot be loaded.
    fn evaluate(&self) -> Result<BTreeMap<String, f64>, Error>;
}
