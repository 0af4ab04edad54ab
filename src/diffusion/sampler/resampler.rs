//! Which samples go on, and how often? A sampler asks at each step, before it adds noise.

use candle_core::{Result, Tensor};

/// What a resampler sees of a step.
#[derive(Debug)]
pub struct Going<'a> {
    /// The noise level of the states from which the estimates were made.
    pub sigma: f64,
    /// The clean estimates, (B, …). Those of the last step are the samples.
    pub x0_hat: &'a Tensor,
    /// Whether noise will be added before the end. Copies that are made later stay identical.
    pub adds_noise: bool,
}

/// Called at each step with its clean estimates: for each row the row that goes on in its place, (B) of u32; `None` if
/// each goes on itself. Samplers that never add noise do not call it.
pub type Resampler<'a> = dyn FnMut(&Going<'_>) -> Result<Option<Tensor>> + 'a;

/// Replaces the rows of each tensor as `resampler` says.
pub(super) fn resample(
    resampler: &mut Resampler<'_>,
    (sigma, adds_noise): (f64, bool),
    x0_hat: &mut Tensor,
    others: &mut [&mut Tensor],
) -> Result<()> {
    let Some(rows) = resampler(&Going { sigma, x0_hat, adds_noise })? else { return Ok(()) };
    *x0_hat = x0_hat.index_select(&rows, 0)?;
    for other in others {
        **other = other.index_select(&rows, 0)?;
    }
    Ok(())
}
