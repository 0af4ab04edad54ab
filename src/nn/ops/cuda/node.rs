//! Nodes of candle's graph around results that are already computed.

use std::sync::Mutex;

#[cfg(feature = "cuda")]
use candle_core::CudaStorage;
use candle_core::{CpuStorage, CustomOp1, CustomOp2, CustomOp3, Layout, Result, Shape, Storage, Tensor, bail};

/// The gradients at the arguments that need one, from the result and its gradient.
pub(super) trait Backward:
    Fn(&Tensor, &Tensor, &[bool]) -> Result<Vec<Option<Tensor>>> + Send + Sync + 'static
{
}

impl<F: Fn(&Tensor, &Tensor, &[bool]) -> Result<Vec<Option<Tensor>>> + Send + Sync + 'static> Backward for F {}

/// Makes `result` with `shape` the result of an operation on one to three `arguments`, whose gradients `backward` gives.
///
/// # Errors
/// When candle refuses the operation.
pub(super) fn node(
    name: &'static str,
    arguments: &[&Tensor],
    result: Storage,
    shape: impl Into<Shape>,
    backward: impl Backward,
) -> Result<Tensor> {
    let node = Node { name, result: Mutex::new(Some((result, shape.into()))), backward };
    match arguments {
        [a] => a.apply_op1(node),
        [a, b] => a.apply_op2(b, node),
        [a, b, c] => a.apply_op3(b, c, node),
        _ => bail!("{name}: an operation has one to three arguments"),
    }
}

struct Node<F> {
    name: &'static str,
    /// Consumed by the only forward pass.
    result: Mutex<Option<(Storage, Shape)>>,
    backward: F,
}

impl<F: Backward> Node<F> {
    fn take(&self) -> Result<(Storage, Shape)> {
        match self.result.lock().ok().and_then(|mut result| result.take()) {
            Some(result) => Ok(result),
            None => bail!("{}: an operation is applied once", self.name),
        }
    }

    fn on_host(&self) -> Result<(CpuStorage, Shape)> {
        match self.take()? {
            (Storage::Cpu(storage), shape) => Ok((storage, shape)),
            _ => bail!("{}: the result is on another device", self.name),
        }
    }

    #[cfg(feature = "cuda")]
    fn on_gpu(&self) -> Result<(CudaStorage, Shape)> {
        match self.take()? {
            (Storage::Cuda(storage), shape) => Ok((storage, shape)),
            _ => bail!("{}: the result is on another device", self.name),
        }
    }

    fn gradients(&self, arguments: &[&Tensor], result: &Tensor, grad: &Tensor) -> Result<Vec<Option<Tensor>>> {
        let wanted: Vec<bool> = arguments.iter().map(|argument| argument.track_op()).collect();
        let mut gradients = (self.backward)(&result.detach(), &grad.contiguous()?, &wanted)?;
        if gradients.len() != arguments.len() {
            bail!("{}: {} gradients for {} arguments", self.name, gradients.len(), arguments.len());
        }
        gradients.iter_mut().zip(wanted).filter(|(_, wanted)| !wanted).for_each(|(gradient, _)| *gradient = None);
        Ok(gradients)
    }
}

impl<F: Backward> CustomOp1 for Node<F> {
    fn name(&self) -> &'static str {
        self.name
    }

    fn cpu_fwd(&self, _: &CpuStorage, _: &Layout) -> Result<(CpuStorage, Shape)> {
        self.on_host()
    }

    #[cfg(feature = "cuda")]
    fn cuda_fwd(&self, _: &CudaStorage, _: &Layout) -> Result<(CudaStorage, Shape)> {
        self.on_gpu()
    }

    fn bwd(&self, a: &Tensor, result: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        Ok(self.gradients(&[a], result, grad)?.swap_remove(0))
    }
}

impl<F: Backward> CustomOp2 for Node<F> {
    fn name(&self) -> &'static str {
        self.name
    }

    fn cpu_fwd(&self, _: &CpuStorage, _: &Layout, _: &CpuStorage, _: &Layout) -> Result<(CpuStorage, Shape)> {
        self.on_host()
    }

    #[cfg(feature = "cuda")]
    fn cuda_fwd(&self, _: &CudaStorage, _: &Layout, _: &CudaStorage, _: &Layout) -> Result<(CudaStorage, Shape)> {
        self.on_gpu()
    }

    fn bwd(&self, a: &Tensor, b: &Tensor, result: &Tensor, grad: &Tensor) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let mut gradients = self.gradients(&[a, b], result, grad)?.into_iter();
        Ok((gradients.next().flatten(), gradients.next().flatten()))
    }
}

impl<F: Backward> CustomOp3 for Node<F> {
    fn name(&self) -> &'static str {
        self.name
    }

    fn cpu_fwd(
        &self,
        _: &CpuStorage,
        _: &Layout,
        _: &CpuStorage,
        _: &Layout,
        _: &CpuStorage,
        _: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        self.on_host()
    }

    #[cfg(feature = "cuda")]
    fn cuda_fwd(
        &self,
        _: &CudaStorage,
        _: &Layout,
        _: &CudaStorage,
        _: &Layout,
        _: &CudaStorage,
        _: &Layout,
    ) -> Result<(CudaStorage, Shape)> {
        self.on_gpu()
    }

    fn bwd(
        &self,
        a: &Tensor,
        b: &Tensor,
        c: &Tensor,
        result: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let mut gradients = self.gradients(&[a, b, c], result, grad)?.into_iter();
        Ok((gradients.next().flatten(), gradients.next().flatten(), gradients.next().flatten()))
    }
}
