//! The gradient of a batch in parts, shared among ranks.
//!
//! Each part is a leaf of a binary tree, and gradients are summed along the tree. A rank computes the leaves of an
//! aligned subtree, so the bytes of the sum depend on the number of parts alone. Ranks send each other slices of their
//! sums, the owner of a slice adds them up along the rest of the tree, and all ranks gather the slices: the traffic of
//! a ring, without arithmetic in the transport.

use super::tree_sum::TreeSum;
use super::{BatchPart, Error, Exchange, TrainTask};
use crate::nn::{Params, in_pool};
use candle_core::backprop::GradStore;
use candle_core::{DType, Device, Tensor};

/// The division of batches into parts.
pub(super) struct DataParallel<'a> {
    exchange: &'a dyn Exchange,
    n_parts: usize,
    batch_size: usize,
}

/// The gradient of a batch, the same on all ranks.
pub(super) struct BatchGradient {
    /// The loss. On a GPU it may not be computed yet.
    pub(super) loss: Tensor,
    /// Its gradient.
    pub(super) gradients: GradStore,
}

impl<'a> DataParallel<'a> {
    /// Batches of `batch_size` rows in `n_parts`, by the ranks of `exchange`.
    ///
    /// # Errors
    /// When the ranks cannot share the parts evenly.
    pub(super) fn new(n_parts: usize, batch_size: usize, exchange: &'a dyn Exchange) -> Result<Self, Error> {
        check_ranks(n_parts, exchange.n_ranks())?;
        Ok(Self { exchange, n_parts, batch_size })
    }

    /// The parts of the batch of `step` that this rank computes.
    fn own_parts(&self, step: u64) -> impl Iterator<Item = BatchPart> + use<> {
        let (n_own, batch_size, n_parts) = (self.n_parts / self.exchange.n_ranks(), self.batch_size, self.n_parts);
        let first = self.exchange.rank() * n_own;
        (first..first + n_own).map(move |index| BatchPart::of_batch(step, batch_size, index, n_parts))
    }

    /// Begins a step: returns the divisors of its batch, or `None` on all ranks if one of them is to stop.
    pub(super) fn begin(&self, task: &dyn TrainTask, step: u64, must_stop: bool) -> Result<Option<Vec<f64>>, Error> {
        let mut message = vec![u8::from(must_stop)];
        if self.n_parts > 1 && !must_stop {
            message.extend(self.own_divisors(task, step)?.into_iter().flat_map(f64::to_le_bytes));
        }
        let messages = self.exchange.all_gather(&message)?;
        if messages.iter().any(|message| message.first() != Some(&0)) {
            return Ok(None);
        }
        Ok(Some(totals(&messages, self.n_parts)))
    }

    /// The divisors of this rank's rows, part by part.
    fn own_divisors(&self, task: &dyn TrainTask, step: u64) -> Result<Vec<f64>, Error> {
        let divisors = self.own_parts(step).map(|part| task.divisors(&part)).collect::<Result<Vec<_>, _>>()?;
        Ok(divisors.concat())
    }

    /// The gradient of the loss of the batch of `step`, whose divisors are known.
    ///
    /// The pool computes, and this thread waits for other ranks, which may be threads of the same process and need the
    /// pool.
    pub(super) fn gradient(
        &self,
        params: &Params,
        task: &dyn TrainTask,
        step: u64,
        divisors: &[f64],
    ) -> Result<BatchGradient, Error> {
        if self.n_parts == 1 {
            return in_pool(params.device(), || {
                let loss = task.loss(&BatchPart::whole(step, self.batch_size), None)?;
                Ok(BatchGradient { gradients: loss.backward()?, loss })
            });
        }
        let own = in_pool(params.device(), || self.own_sum(params, task, step, divisors))?;
        unflattened(params, &self.all_reduced(&own)?)
    }

    /// The sum of the gradients of the parts of this rank.
    fn own_sum(&self, params: &Params, task: &dyn TrainTask, step: u64, divisors: &[f64]) -> Result<Vec<f32>, Error> {
        let mut sum = TreeSum::default();
        for part in self.own_parts(step) {
            let loss = task.loss(&part, Some(divisors))?;
            sum.push(flattened(params, &loss.backward()?, &loss)?);
        }
        Ok(sum.finish())
    }

    /// Prepares the parts of `step` in advance.
    pub(super) fn prepare(&self, task: &dyn TrainTask, step: u64) -> Result<(), Error> {
        self.own_parts(step).try_for_each(|part| task.prepare(&part))
    }

    /// The sum of the ranks' `values` along the tree, on all of them.
    fn all_reduced(&self, values: &[f32]) -> Result<Vec<f32>, Error> {
        let n_ranks = self.exchange.n_ranks();
        let bytes = bytes_of(values);
        let bounds = |rank: usize| 4 * (rank * values.len() / n_ranks);
        let slices: Vec<&[u8]> = (0..n_ranks).map(|rank| &bytes[bounds(rank)..bounds(rank + 1)]).collect();
        let mut own = TreeSum::default();
        for slice in self.exchange.all_to_all(&slices)? {
            own.push(values_of(&slice));
        }
        let whole = self.exchange.all_gather(&bytes_of(&own.finish()))?;
        Ok(whole.iter().flat_map(|slice| values_of(slice)).collect())
    }
}

/// Rejects numbers of ranks that cannot share so many parts evenly.
///
/// # Errors
/// When they cannot.
pub const fn check_ranks(n_parts: usize, n_ranks: usize) -> Result<(), UnevenRanks> {
    match n_ranks > 0 && n_parts.is_power_of_two() && n_parts.is_multiple_of(n_ranks) {
        true => Ok(()),
        false => Err(UnevenRanks { n_parts, n_ranks }),
    }
}

/// Ranks that cannot share the parts of a batch evenly.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "{n_ranks} ranks cannot share {n_parts} parts of a batch, expected a number of ranks that divides that of parts"
)]
pub struct UnevenRanks {
    /// Parts of a batch.
    pub n_parts: usize,
    /// Processes that train together.
    pub n_ranks: usize,
}

/// The divisors of a batch, summed over its parts, from the ranks' messages after their first byte.
fn totals(messages: &[Vec<u8>], n_parts: usize) -> Vec<f64> {
    let values: Vec<f64> = messages
        .iter()
        .flat_map(|message| message[1..].as_chunks().0)
        .map(|bytes| f64::from_le_bytes(*bytes))
        .collect();
    let n_divisors = values.len() / n_parts;
    (0..n_divisors).map(|i| values.iter().skip(i).step_by(n_divisors).sum()).collect()
}

/// The gradients of all parameters in the order of their names, then for each of them 1 if it has a gradient, then the
/// loss.
fn flattened(params: &Params, gradients: &GradStore, loss: &Tensor) -> Result<Vec<f32>, Error> {
    let (mut flat, mut is_there) = (Vec::with_capacity(params.n_parameters()), Vec::new());
    for (_, var) in params.iter() {
        let gradient = gradients.get(var.as_tensor());
        is_there.push(f32::from(u8::from(gradient.is_some())));
        match gradient {
            Some(gradient) => flat.extend(gradient.flatten_all()?.to_vec1::<f32>()?),
            None => flat.resize(flat.len() + var.elem_count(), 0.0),
        }
    }
    flat.append(&mut is_there);
    flat.push(loss.to_dtype(DType::F32)?.to_scalar()?);
    Ok(flat)
}

/// The inverse, for sums of such values.
fn unflattened(params: &Params, flat: &[f32]) -> Result<BatchGradient, Error> {
    let (mut gradients, mut rest) = (GradStore::default(), flat);
    let (mut is_there, loss) = (flat[params.n_parameters()..].iter(), flat.last().copied().unwrap_or(f32::NAN));
    for (_, var) in params.iter() {
        let (values, after) = rest.split_at(var.elem_count());
        rest = after;
        if is_there.next().is_some_and(|n| *n > 0.0) {
            gradients.insert(var.as_tensor(), Tensor::from_slice(values, var.shape(), var.device())?);
        }
    }
    Ok(BatchGradient { loss: Tensor::new(loss, &Device::Cpu)?, gradients })
}

fn bytes_of(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn values_of(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
}
