//! Objectives as a part of a loss.

use super::{DrawnBatch, Error};
use crate::guidance::ObjectiveConfig;
use candle_core::Tensor;

/// Fails if an objective needs roles, which training does not have.
pub(super) fn check_objectives(key: &str, objectives: &[ObjectiveConfig]) -> Result<(), Error> {
    match objectives.iter().find_map(|objective| Some((objective, objective.validate(&[]).err()?))) {
        Some((objective, why)) => Err(Error::Config(format!("{key}: objective {}: {why}", objective.kind()))),
        None => Ok(()),
    }
}

/// Objectives in the form of a checkpoint.
pub(super) fn described(objectives: &[ObjectiveConfig]) -> Result<Vec<serde_json::Value>, Error> {
    Ok(objectives
        .iter()
        .map(|objective| serde_json::to_value(objective.spelled_out()))
        .collect::<Result<_, _>>()
        .map_err(std::io::Error::from)?)
}

/// The cost of `x0` (B, A, T, D) by each objective J beyond that of the recording, (B) each, at least 0.
///
/// A cost is √(1 - 2 J) - 1: approximately -J for small violations, and linear in lengths for large ones, so that a few
/// scenes do not dominate.
pub(super) fn objective_costs(
    objectives: &[ObjectiveConfig],
    x0: &Tensor,
    drawn: &DrawnBatch,
) -> Result<Vec<Tensor>, Error> {
    let Some(context) = drawn.context.as_ref().filter(|_| !objectives.is_empty()) else { return Ok(Vec::new()) };
    let (states, recorded) = (drawn.batch.decode(x0)?, drawn.batch.decode(&drawn.batch.x0)?);
    let cost = |objective: &ObjectiveConfig, states: &Tensor| -> Result<Tensor, Error> {
        let potential = objective.log_potential(states, context)?;
        Ok(((1.0 - (potential * 2.0)?)?.sqrt()? - 1.0)?)
    };
    objectives.iter().map(|objective| Ok((cost(objective, &states)? - cost(objective, &recorded)?)?.relu()?)).collect()
}

/// The sum of weight · cost over `objectives`, as a mean over the rows with `counts` (B) 1: their sum divided by
/// `n_counted`, the number of such rows in the whole batch. `None` if no row counts.
pub(super) fn objective_loss(
    objectives: &[ObjectiveConfig],
    x0: &Tensor,
    drawn: &DrawnBatch,
    counts: &[f32],
    n_counted: f64,
) -> Result<Option<Tensor>, Error> {
    if objectives.is_empty() || counts.iter().all(|count| *count == 0.0) {
        return Ok(None);
    }
    let counts = Tensor::from_slice(counts, counts.len(), x0.device())?;
    let mut total: Option<Tensor> = None;
    for (objective, cost) in objectives.iter().zip(objective_costs(objectives, x0, drawn)?) {
        let mean = ((cost * &counts)?.sum_all()? * (objective.weight / n_counted))?;
        total = Some(match total {
            Some(total) => (total + mean)?,
            None => mean,
        });
    }
    Ok(total)
}
