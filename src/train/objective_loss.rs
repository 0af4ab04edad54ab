//! Objectives as a part of a loss: what clean estimates shall keep to, beside being likely.

use super::{DrawnBatch, Error};
use crate::guidance::ObjectiveConfig;
use candle_core::Tensor;

/// Fails where objectives cannot be trained toward: there are no roles in training.
pub(super) fn check_objectives(key: &str, objectives: &[ObjectiveConfig]) -> Result<(), Error> {
    match objectives.iter().find_map(|objective| Some((objective, objective.validate(&[]).err()?))) {
        Some((objective, why)) => Err(Error::Config(format!("{key}: objective {}: {why}", objective.kind()))),
        None => Ok(()),
    }
}

/// Objectives as a checkpoint names them.
pub(super) fn described(objectives: &[ObjectiveConfig]) -> Result<Vec<serde_json::Value>, Error> {
    Ok(objectives.iter().map(serde_json::to_value).collect::<Result<_, _>>().map_err(std::io::Error::from)?)
}

/// What `x0` (B, A, T, D) costs by each objective J beyond what the recording costs by it, (B) each, at least 0. A cost is √(1 - 2 J) - 1:
/// J itself where little is wrong, and linear in lengths where much is, so that a few hopeless scenes do not outweigh all others.
pub(super) fn objective_costs(
    objectives: &[ObjectiveConfig],
    x0: &Tensor,
    drawn: &DrawnBatch,
) -> Result<Vec<Tensor>, Error> {
    let Some(context) = drawn.context.as_ref().filter(|_| !objectives.is_empty()) else { return Ok(Vec::new()) };
    let (states, recorded) = (drawn.batch.decode(x0)?, drawn.batch.decode(&drawn.batch.x0)?);
    let cost = |objective: &ObjectiveConfig, states: &Tensor| -> Result<Tensor, Error> {
        let potential = objective.objective().log_potential(states, context)?;
        Ok(((1.0 - (potential * 2.0)?)?.sqrt()? - 1.0)?)
    };
    objectives.iter().map(|objective| Ok((cost(objective, &states)? - cost(objective, &recorded)?)?.relu()?)).collect()
}

/// The sum of weight · cost over `objectives`, as a mean over the rows where `counts` (B) is 1: their sum over `n_counted`, the number of
/// such rows in the whole batch. `None` where nothing counts.
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
        let mean = ((cost * &counts)?.sum_all()? * (objective.weight() / n_counted))?;
        total = Some(match total {
            Some(total) => (total + mean)?,
            None => mean,
        });
    }
    Ok(total)
}
