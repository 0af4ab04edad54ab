//! Access to the values of tensors in host memory, without copies.

use std::cell::RefCell;
use std::ops::Deref;

use candle_core::{CpuStorage, InplaceOp1, Layout, Result, Storage, Tensor, bail};

/// The values of a contiguous tensor inside `storage`.
pub(super) fn slice<'a>(storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [f32]> {
    let Some((start, end)) = layout.contiguous_offsets() else { bail!("a fused operation needs contiguous tensors") };
    Ok(&storage.as_slice::<f32>()?[start..end])
}

/// The values of a contiguous `f32` tensor in host memory, readable for as long as the result lives.
pub(super) fn values(tensor: &Tensor) -> Result<impl Deref<Target = [f32]>> {
    let (storage, layout) = tensor.storage_and_layout();
    let Some((start, end)) = layout.contiguous_offsets() else { bail!("a fused operation needs contiguous tensors") };
    match &*storage {
        Storage::Cpu(CpuStorage::F32(_)) => Ok(Values { storage, start, end }),
        _ => bail!("a fused operation needs f32 tensors in host memory"),
    }
}

/// Part of a storage that is locked for reading.
struct Values<S> {
    storage: S,
    start: usize,
    end: usize,
}

impl<S: Deref<Target = Storage>> Deref for Values<S> {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        match &*self.storage {
            Storage::Cpu(CpuStorage::F32(values)) => &values[self.start..self.end],
            // `values` has checked the type, which cannot change under the lock.
            _ => &[],
        }
    }
}

/// The gradient at `argument`, if one was computed and the argument is tracked.
pub(super) fn gradient(values: Option<Vec<f32>>, argument: &Tensor) -> Result<Option<Tensor>> {
    let values = values.filter(|_| argument.track_op());
    values.map(|values| Tensor::from_vec(values, argument.shape(), argument.device())).transpose()
}

/// Calls `change` with the values of a contiguous `f32` tensor in host memory. Other tensors that share its memory see
/// the new values.
pub(super) fn change_values(tensor: &Tensor, change: impl FnOnce(&mut [f32]) -> Result<()>) -> Result<()> {
    tensor.detach().inplace_op1(&Change(RefCell::new(Some(change))))
}

struct Change<F>(RefCell<Option<F>>);

impl<F: FnOnce(&mut [f32]) -> Result<()>> InplaceOp1 for Change<F> {
    fn name(&self) -> &'static str {
        "change_values"
    }

    fn cpu_fwd(&self, storage: &mut CpuStorage, layout: &Layout) -> Result<()> {
        let Some((start, end)) = layout.contiguous_offsets() else {
            bail!("only contiguous tensors can be changed in place")
        };
        let (CpuStorage::F32(values), Some(change)) = (storage, self.0.take()) else {
            bail!("only f32 tensors can be changed in place");
        };
        change(&mut values[start..end])
    }
}
