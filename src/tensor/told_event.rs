//! The event that a network is conditioned on, for each row of a batch.
//!
//! A row is conditioned on one event or none. None means that nothing is known, not that nothing happens: a network
//! learns it from ordinary traffic, in which events happen as often as they do. Each value has a flag, so that a value
//! of 0 differs from a missing one.

use super::{EventVocabulary, SceneBatch, SceneTensors};
use crate::scene::Scene;
use candle_core::{Result, Tensor, bail};
use std::collections::BTreeMap;

/// An event that a network is conditioned on.
#[derive(Debug, Clone, PartialEq)]
pub struct ToldEvent {
    /// The behavior.
    pub behavior: String,
    /// The agents that take part: the scene's tracks, in the order of the roles.
    pub agents: Vec<usize>,
    /// The known values, by name; the others are unknown.
    pub values: BTreeMap<String, f64>,
}

impl SceneBatch {
    /// The batch with each row conditioned on an event, or on none: `told` has an entry for each row. Values that the
    /// vocabulary does not have are left out, and so are roles of agents that the row leaves out.
    ///
    /// # Errors
    /// Fails when there are not as many entries as rows, or the vocabulary lacks a behavior.
    pub fn telling(&self, vocabulary: &EventVocabulary, told: &[Option<ToldEvent>]) -> Result<Self> {
        let (n_rows, n_agents, n_inputs) = (self.n_rows(), self.x0.dim(1)?, vocabulary.n_inputs());
        if told.len() != n_rows {
            bail!("{} events for {n_rows} rows, expected one per row", told.len());
        }
        let mut inputs = vec![0f32; n_rows * n_agents * n_inputs];
        for (row, event) in told.iter().enumerate() {
            let Some(event) = event else { continue };
            let Some((first, known)) = vocabulary.place(&event.behavior) else {
                bail!("the network was not trained on {}, but on {}", event.behavior, vocabulary.names());
            };
            for (role, agent) in event.agents.iter().enumerate().take(known.roles.len()) {
                let Some(slot) = self.frames[row].slot(*agent) else { continue };
                let at = (row * n_agents + slot) * n_inputs + first + role * known.n_inputs_of_role();
                inputs[at] = 1.0;
                for (i, unit) in known.values.iter().enumerate() {
                    let Some(value) = event.values.get(&unit.name) else { continue };
                    inputs[at + 1 + 2 * i] = 1.0;
                    inputs[at + 2 + 2 * i] = unit.scaled(*value) as f32;
                }
            }
        }
        let events = Tensor::from_vec(inputs, (n_rows, n_agents, n_inputs), self.x0.device())?;
        let events = Some(events.to_dtype(self.x0.dtype())?);
        Self::new(SceneTensors { events, ..SceneTensors::clone(self) })
    }
}

/// The state of these agents at the present of `scene`, to find events that began alike: their speeds, and where the
/// others are in the frame of the first (ahead, left), meters. `None` if one of them is not there.
pub fn present_of(scene: &Scene, agents: &[usize]) -> Option<Vec<f64>> {
    let state = |agent: &usize| scene.state(*agent, scene.current_timestep());
    let states = agents.iter().map(state).collect::<Option<Vec<_>>>()?;
    let (first, others) = states.split_first()?;
    let mut present: Vec<f64> = states.iter().map(|state| state.speed_mps()).collect();
    for other in others {
        let offset = (other.position - first.position).rotated(-first.heading_rad);
        present.extend([offset.x, offset.y]);
    }
    Some(present)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::testing::values;
    use crate::scene::testing::{Drive, scene};
    use crate::tensor::testing::collator;
    use crate::tensor::{FutureValidity, KnownBehavior, StateParametrization};

    fn event(values: &[(&str, f64)]) -> BTreeMap<String, f64> {
        values.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect()
    }

    fn vocabulary() -> EventVocabulary {
        let single = KnownBehavior::new("hard_brake", &["agent"], &[event(&[("onset_s", 2.0)])], vec![]);
        let sides = [event(&[("gap_m", 4.0), ("side", 1.0)]), event(&[("gap_m", 8.0), ("side", -1.0)])];
        EventVocabulary { behaviors: vec![single, KnownBehavior::new("cut_in", &["ego", "other"], &sides, vec![])] }
    }

    fn told(behavior: &str, agents: &[usize], values: &[(&str, f64)]) -> Option<ToldEvent> {
        Some(ToldEvent { behavior: behavior.to_owned(), agents: agents.to_vec(), values: event(values) })
    }

    #[test]
    fn each_role_has_its_flag_and_each_told_value_its_own() {
        let scene = scene(&[Drive::straight(0.0, 0.0, 0.0, 9.0), Drive::straight(9.0, 0.0, 0.0, 8.0)]);
        let batch = collator([&scene], StateParametrization::Motion)
            .predictive(&[&scene, &scene, &scene], FutureValidity::Continued);
        let told = [
            told("cut_in", &[1, 0], &[("side", -1.0), ("unheard_of", 3.0)]),
            None,
            told("hard_brake", &[1], &[("onset_s", 2.0)]),
        ];
        let told = batch.telling(&vocabulary(), &told).unwrap();
        let found = told.events.as_ref().unwrap();
        assert_eq!(found.dims(), [3, 2, 3 + 2 * 5]);
        // One block for the behavior, then one for each of its roles: the flag, and for gap and side whether it is
        // given, and the value.
        let (ego, other) = ([1.0, 0.0, 0.0, 1.0, -1.0], [0.0; 5]);
        let row = |first: [f64; 3], ego: [f64; 5], other: [f64; 5]| [&first[..], &ego[..], &other[..]].concat();
        let expected = [
            row([0.0; 3], other, ego),
            row([0.0; 3], ego, other),
            vec![0.0; 13],
            vec![0.0; 13],
            vec![0.0; 13],
            // A given value that is 0 in its unit.
            row([1.0, 1.0, 0.0], other, other),
        ];
        assert_eq!(values(found), expected.concat());
        let repeated = told.repeated(2).unwrap();
        let rows = values(&repeated.events.as_ref().unwrap().get(1).unwrap());
        assert_eq!(rows, expected[..2].concat());
    }

    #[test]
    fn unknown_behaviors_and_wrong_numbers_of_rows_are_refused() {
        let scene = scene(&[Drive::straight(0.0, 0.0, 0.0, 9.0)]);
        let batch = collator([&scene], StateParametrization::Motion).predictive(&[&scene], FutureValidity::Continued);
        let error = batch.telling(&vocabulary(), &[told("near_miss", &[0], &[])]).unwrap_err().to_string();
        assert!(error.contains("not trained on near_miss, but on hard_brake, cut_in"), "{error}");
        assert!(batch.telling(&vocabulary(), &[]).unwrap_err().to_string().contains("0 events"));
    }

    #[test]
    fn the_present_is_seen_from_the_first_agent() {
        let north = std::f64::consts::FRAC_PI_2;
        let scene = scene(&[Drive::straight(0.0, 0.0, north, 9.0), Drive::straight(-3.0, 0.0, north, 9.0)]);
        // Who is at smaller x is to the left of somebody who drives north.
        let found = present_of(&scene, &[0, 1]).unwrap();
        for (found, expected) in found.iter().zip([9.0, 9.0, 0.0, 3.0]) {
            assert!((found - expected).abs() < 1e-9, "{found}, expected {expected}");
        }
        assert_eq!(present_of(&scene, &[0]).unwrap().len(), 1);
    }
}
