//! The operations of layers, and which implementation serves which device and type.
//!
//! Every operation has a plain implementation in differentiable candle operations, which serves every device and type.
//! For `f32` on the processor, a fused one with its own backward pass replaces it. The choice is made only here.

mod adam;
mod attention;
mod cross_attention;
mod gemm;
mod heads;
mod host;
mod kernels;
mod layer_norm;
mod linear;
mod mode_filter;
mod pool;
mod rows;
mod sinusoidal;

use candle_core::{D, DType, Result, Tensor, bail};

pub(super) use self::adam::{AdamStep, Moments};
use super::attention::Axis;
use super::precision::Precision;

/// The activation after an affine map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Activation {
    /// Nothing.
    None,
    /// max(y, 0).
    Relu,
}

/// Whether the fused implementation, in one pass over memory of the host, serves this tensor.
fn is_fused(x: &Tensor) -> bool {
    x.device().is_cpu() && x.dtype() == DType::F32
}

/// activation(x Wᵀ + b): `x` (.., K), `weight` (N, K), `bias` (N) to (.., N). Rows where `valid` (..) is 0 are exactly
/// 0; on the processor they cost nothing.
pub fn linear(
    x: &Tensor,
    weight: &Tensor,
    bias: &Tensor,
    activation: Activation,
    valid: Option<&Tensor>,
    precision: Precision,
) -> Result<Tensor> {
    let (n_out, n_in) = weight.dims2()?;
    if x.dim(D::Minus1)? != n_in || bias.dims() != [n_out] {
        bail!("linear: x {:?}, weight {:?} and bias {:?} do not fit", x.dims(), weight.dims(), bias.dims());
    }
    let valid = valid.map(|valid| mask_of("linear", x, valid)).transpose()?;
    match is_fused(x) && precision == Precision::F32 {
        true => linear::fused(x, weight, bias, activation, valid.as_ref()),
        false => linear::reference(x, weight, bias, activation, valid.as_ref(), precision),
    }
}

/// Normalizes the last dimension of `x` (.., D) to mean 0 and variance 1, then scales by `weight` (D) and adds `bias`
/// (D).
pub fn layer_norm(x: &Tensor, weight: &Tensor, bias: &Tensor, epsilon: f64) -> Result<Tensor> {
    let dim = x.dim(D::Minus1)?;
    if weight.dims() != [dim] || bias.dims() != [dim] {
        bail!("layer_norm: x {:?}, weight {:?} and bias {:?} do not fit", x.dims(), weight.dims(), bias.dims());
    }
    match is_fused(x) {
        true => layer_norm::fused(x, weight, bias, epsilon),
        false => layer_norm::reference(x, weight, bias, epsilon),
    }
}

/// Softmax attention in `n_heads` heads among the valid states along `axis`: `qkv` (B, A, T, 3 D) and `valid` (B, A, T)
/// to (B, A, T, D). Invalid states have weight exactly 0 and get exactly 0.
pub fn self_attention(qkv: &Tensor, valid: &Tensor, n_heads: usize, axis: Axis) -> Result<Tensor> {
    let (_, _, _, width) = qkv.dims4()?;
    let valid = mask_of("self_attention", qkv, valid)?;
    if n_heads == 0 || !width.is_multiple_of(3 * n_heads) {
        bail!("self_attention: {width} features are not queries, keys and values of {n_heads} heads");
    }
    match is_fused(qkv) {
        true => attention::fused(qkv, &valid, n_heads, axis),
        false => attention::reference(qkv, &valid, n_heads, axis),
    }
}

/// Softmax attention in `n_heads` heads from states to lanes: `query` (B, A, T, D), `valid` (B, A, T), `keys` (M, L, 2
/// D) with keys before values, and `lane_valid` (M, L), to (B, A, T, D). M divides B; each map serves B / M consecutive
/// rows. Invalid lanes have weight exactly 0; invalid states and states without a lane get exactly 0.
pub fn cross_attention(
    query: &Tensor,
    valid: &Tensor,
    keys: &Tensor,
    lane_valid: &Tensor,
    n_heads: usize,
) -> Result<Tensor> {
    let (n_batch, _, _, dim) = query.dims4()?;
    let (n_maps, _, width) = keys.dims3()?;
    let (valid, lane_valid) =
        (mask_of("cross_attention", query, valid)?, mask_of("cross_attention", keys, lane_valid)?);
    if n_heads == 0
        || !dim.is_multiple_of(n_heads)
        || width != 2 * dim
        || n_maps == 0
        || !n_batch.is_multiple_of(n_maps)
    {
        bail!("cross_attention: query {:?} and keys {:?} do not fit {n_heads} heads", query.dims(), keys.dims());
    }
    match is_fused(query) {
        true => cross_attention::fused(query, &valid, keys, &lane_valid, n_heads),
        false => cross_attention::reference(query, &valid, keys, &lane_valid, n_heads),
    }
}

/// The states of `valid` (B, A, T) whose map has a valid lane in `lane_valid` (M, L), for which cross-attention has
/// keys.
///
/// # Errors
/// When M does not divide B.
pub fn rows_with_keys(valid: &Tensor, lane_valid: &Tensor) -> Result<Tensor> {
    let (n_batch, n_agents, n_timesteps) = valid.dims3()?;
    let (n_maps, n_lanes) = lane_valid.dims2()?;
    if n_lanes == 0 {
        return valid.zeros_like();
    }
    if n_maps == 0 || !n_batch.is_multiple_of(n_maps) {
        bail!("cross_attention: {n_maps} maps cannot serve a batch of {n_batch}");
    }
    let any = lane_valid.detach().max(1)?.reshape((n_maps, 1))?;
    let states = valid.detach().reshape((n_maps, n_batch / n_maps * n_agents * n_timesteps))?;
    states.broadcast_mul(&any)?.reshape((n_batch, n_agents, n_timesteps))
}

/// The sines, then the cosines, of 2 π f x for every frequency f: `x` (..) to (.., 2 · frequencies).
pub fn sinusoidal(x: &Tensor, frequencies: &[f64]) -> Result<Tensor> {
    match is_fused(x) {
        true => sinusoidal::fused(x, frequencies),
        false => sinusoidal::reference(x, frequencies),
    }
}

/// Uᵀ g U x for the states `x` (B, A, T, D), each agent and dimension with `modes` U (B, A, D, T, T), one mode a row,
/// and `gains` g (B, A, D, T) of its own. Differentiable in `x` alone.
pub fn mode_filter(x: &Tensor, modes: &Tensor, gains: &Tensor) -> Result<Tensor> {
    let (b, a, t, d) = x.dims4()?;
    if modes.dims() != [b, a, d, t, t] || gains.dims() != [b, a, d, t] {
        bail!("mode_filter: x {:?}, modes {:?} and gains {:?} do not fit", x.dims(), modes.dims(), gains.dims());
    }
    match is_fused(x) {
        true => mode_filter::fused(x, modes, gains),
        false => mode_filter::reference(x, &modes.detach(), &gains.detach()),
    }
}

/// The largest positive one of K entries in each feature, or 0 if there is none: `x` (.., K, F) to (.., F).
pub fn pool_positive(x: &Tensor) -> Result<Tensor> {
    match is_fused(x) {
        true => pool::fused(x),
        false => pool::reference(x),
    }
}

/// Moves a parameter and its moments by one step of Adam, in place.
pub(super) fn adam_step(parameter: &Tensor, moments: &mut Moments, grad: &Tensor, step: AdamStep) -> Result<()> {
    if parameter.dims() != grad.dims() || parameter.dims() != moments.first.dims() {
        bail!("adam: a gradient {:?} does not fit a parameter {:?}", grad.dims(), parameter.dims());
    }
    match are_fused(&[parameter, grad, &moments.first, &moments.second]) {
        true => adam::fused(parameter, moments, grad, step),
        false => adam::reference(parameter, moments, grad, step),
    }
}

/// The sum of the squares of all entries of all `tensors`, in double precision and a fixed order.
pub(super) fn sum_of_squares(tensors: &[&Tensor]) -> Result<f64> {
    // A GPU's sums are fetched once, not tensor by tensor.
    let mut elsewhere = Vec::new();
    let mut sum = 0.0;
    for x in tensors {
        match is_fused(x) {
            true => sum += adam::fused_sum_of_squares(x)?,
            false => elsewhere.push(x.detach().to_dtype(DType::F64)?.sqr()?.sum_all()?),
        }
    }
    if !elsewhere.is_empty() {
        sum += Tensor::stack(&elsewhere, 0)?.to_vec1::<f64>()?.into_iter().sum::<f64>();
    }
    Ok(sum)
}

/// Moves `average` by the share 1 - `decay` toward `value`, in place.
pub(super) fn average_step(average: &mut Tensor, value: &Tensor, decay: f64) -> Result<()> {
    if average.dims() != value.dims() {
        bail!("an average of {:?} does not fit {:?}", average.dims(), value.dims());
    }
    match are_fused(&[average, value]) {
        true => adam::fused_average_step(average, value, decay)?,
        false => *average = ((&*average * decay)? + (value.detach() * (1.0 - decay))?)?,
    }
    Ok(())
}

/// Whether the fused implementation supports all of these tensors, the first of which is changed in place.
fn are_fused(tensors: &[&Tensor]) -> bool {
    tensors.iter().all(|x| is_fused(x)) && tensors.first().is_some_and(|x| x.is_contiguous())
}

/// `valid` as a mask of the rows of `x`, in its type and outside every gradient.
fn mask_of(name: &str, x: &Tensor, valid: &Tensor) -> Result<Tensor> {
    if x.dims().split_last().is_none_or(|(_, rows)| rows != valid.dims()) {
        bail!("{name}: mask {:?} does not fit rows of {:?}", valid.dims(), x.dims());
    }
    valid.detach().to_dtype(x.dtype())
}

/// Softmax over the last dimension of `scores` among entries where `mask` (broadcast to `scores`) is 1. The others get
/// exactly 0, even if no entry is left.
fn masked_softmax(scores: &Tensor, mask: &Tensor) -> Result<Tensor> {
    let mask = mask.broadcast_as(scores.shape())?.contiguous()?;
    let keep = mask.ne(0.0)?;
    let lowest = Tensor::full(f32::MIN, scores.shape(), scores.device())?.to_dtype(scores.dtype())?;
    let max = keep.where_cond(&scores.detach(), &lowest)?.max_keepdim(D::Minus1)?;
    // Scores of masked entries are replaced before the exponential: it can neither overflow nor become denormal.
    let shifted = keep.where_cond(&scores.broadcast_sub(&max)?, &scores.zeros_like()?)?;
    let weights = (shifted.exp()? * mask)?;
    let total = weights.sum_keepdim(D::Minus1)?;
    weights.broadcast_div(&(&total + total.eq(0.0)?.to_dtype(scores.dtype())?)?)
}

#[cfg(test)]
mod tests;
