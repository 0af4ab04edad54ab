//! How much harder could a scenario be? The other agents of the event do everything later, and so closer to the ego:
//! which delay does a driver survive?

use super::Result;
use crate::quantile::quantile;
use crate::simulate::{Outcome, Situation};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The longest delay to be tried, seconds.
const MOST_DELAY_S: f64 = 1.5;
/// Delays are tried in steps of this many timesteps, and the first step that ends in a failure is bisected. With a long
/// delay the ego may pass before the others come: surviving it says nothing of shorter ones.
const STRIDE: usize = 3;

/// The longest delays of the other agents that two drivers survive in a scenario.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Margin {
    /// The scenario.
    pub scenario_id: String,
    /// The requested behavior.
    pub behavior: Option<String>,
    /// The longest possible delay, seconds: at most 1.5, and without new overlaps in the past.
    pub most_delay_s: f64,
    /// For the driver under test.
    pub own: DelaySurvived,
    /// For the careful driver.
    pub careful: DelaySurvived,
}

/// The longest delay that a driver survives.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DelaySurvived {
    /// The delay, seconds: the driver fails a timestep later, or this is the longest one. Missing if it fails without
    /// any.
    pub delay_s: Option<f64>,
    /// Parameters of the event then, as its definition with default options finds them if the ego moves as in the
    /// scenario; none if the event then ends after the scenario.
    pub parameters: BTreeMap<String, f64>,
}

/// Summary of the margins of a corpus.
#[derive(Debug, Clone, PartialEq, Serialize, Default)]
pub struct Margins {
    /// The delayed scenarios, sorted by how much longer a delay the careful driver survives: the largest difference
    /// first.
    pub scenarios: Vec<Margin>,
    /// Their number.
    pub n_scenarios: u64,
    /// Scenarios in which the driver under test fails at a shorter delay than the careful one, and those with the
    /// opposite.
    pub n_sooner: u64,
    /// See `n_sooner`.
    pub n_later: u64,
    /// The median of the delays that the driver under test and the careful driver survive, seconds; 0 if there are
    /// none.
    pub median_delay_s: [f64; 2],
}

impl Margins {
    /// The summary of these margins.
    pub(super) fn of(margins: Vec<Margin>) -> Self {
        let delays = |of: fn(&Margin) -> &DelaySurvived| {
            let mut delays: Vec<f64> = margins.iter().map(|margin| of(margin).or_least()).collect();
            delays.sort_by(f64::total_cmp);
            quantile(&delays, 0.5).unwrap_or_default().max(0.0)
        };
        let median_delay_s = [delays(|margin| &margin.own), delays(|margin| &margin.careful)];
        let n_scenarios = margins.len() as u64;
        let count = |has: fn(f64) -> bool| margins.iter().filter(|margin| has(margin.lead_s())).count() as u64;
        let [n_sooner, n_later] = [count(|lead_s| lead_s > 0.0), count(|lead_s| lead_s < 0.0)];
        let mut scenarios = margins;
        scenarios.sort_by(|a, b| b.lead_s().total_cmp(&a.lead_s()).then_with(|| a.scenario_id.cmp(&b.scenario_id)));
        Self { n_scenarios, n_sooner, n_later, median_delay_s, scenarios }
    }
}

impl Margin {
    /// The margin of a situation. `outcomes` are those of the driver under test and of the careful driver, and
    /// `outcome` gives that of driver 0 or 1 in a delayed situation. `None` if the event has no other agent, or none of
    /// them can be later.
    pub(super) fn find(
        situation: &Situation,
        outcomes: [Outcome; 2],
        mut outcome: impl FnMut(usize, &Situation) -> Result<Outcome>,
    ) -> Result<Option<Self>> {
        let dt_s = situation.scene.dt_s;
        let n_most = (MOST_DELAY_S / dt_s).round() as usize;
        let delayed: Vec<Situation> = (1..=n_most).map_while(|n_steps| situation.delayed(n_steps)).collect();
        if delayed.is_empty() {
            return Ok(None);
        }
        let later = |n_steps: usize| n_steps.checked_sub(1).map(|i| &delayed[i]);
        let mut survived = |driver: usize| -> Result<DelaySurvived> {
            let mut ends = |n_steps| later(n_steps).map_or(Ok(outcomes[driver]), |later| outcome(driver, later));
            let latest = latest(delayed.len(), |n_steps| Ok(ends(n_steps)? == Outcome::Survived))?;
            Ok(DelaySurvived {
                delay_s: latest.map(|n_steps| n_steps as f64 * dt_s),
                parameters: latest
                    .map(|n_steps| later(n_steps).unwrap_or(situation))
                    .and_then(|situation| situation.event_in(&situation.scene))
                    .map_or_else(BTreeMap::new, |event| event.parameters),
            })
        };
        Ok(Some(Self {
            scenario_id: situation.scenario_id.clone(),
            behavior: situation.behavior.clone(),
            most_delay_s: delayed.len() as f64 * dt_s,
            own: survived(0)?,
            careful: survived(1)?,
        }))
    }

    /// How much longer a delay the careful driver survives, seconds.
    pub(super) fn lead_s(&self) -> f64 {
        self.careful.or_least() - self.own.or_least()
    }
}

impl DelaySurvived {
    /// The delay, or a value below all delays for a driver that fails without any.
    fn or_least(&self) -> f64 {
        self.delay_s.unwrap_or(-1.0)
    }
}

/// The largest number that is `survived` before one that is not; up to it only multiples of [`STRIDE`] are tried, then
/// the last step is bisected. `n_most` if all are survived, `None` if 0 is not.
fn latest(n_most: usize, mut survived: impl FnMut(usize) -> Result<bool>) -> Result<Option<usize>> {
    if !survived(0)? {
        return Ok(None);
    }
    let mut latest = 0;
    let mut fails = loop {
        let next = (latest + STRIDE).min(n_most);
        match survived(next)? {
            true if next == n_most => return Ok(Some(n_most)),
            true => latest = next,
            false => break next,
        }
    };
    while fails - latest > 1 {
        let middle = usize::midpoint(latest, fails);
        if survived(middle)? {
            latest = middle;
        } else {
            fails = middle;
        }
    }
    Ok(Some(latest))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::testing::{records, situation};

    #[test]
    fn the_first_failure_is_found() {
        for limit in 0..=15 {
            let mut n_tried = 0;
            let found = latest(15, |n| {
                n_tried += 1;
                Ok(n <= limit)
            });
            assert_eq!(found.unwrap(), Some(limit));
            assert!(n_tried <= 8, "{n_tried} tried");
        }
        assert_eq!(latest(15, |n| Ok(!(5..=9).contains(&n))).unwrap(), Some(4));
        assert_eq!(latest(1, |_| Ok(true)).unwrap(), Some(1));
        assert_eq!(latest(15, |_| Ok(false)).unwrap(), None);
    }

    #[test]
    fn parameters_are_those_of_the_longest_delay_that_is_survived() {
        let mut n_changed = 0;
        for record in records() {
            let situation = situation(&record);
            let later = |driver: usize, _: &Situation| Ok([Outcome::Survived, Outcome::Hit][driver]);
            let Some(margin) = Margin::find(&situation, [Outcome::Survived; 2], later).unwrap() else { continue };
            let of = |situation: &Situation| {
                situation.event_in(&situation.scene).map_or_else(BTreeMap::new, |event| event.parameters)
            };
            let n_steps = (margin.most_delay_s / situation.scene.dt_s).round() as usize;
            assert_eq!((margin.own.delay_s, margin.careful.delay_s), (Some(margin.most_delay_s), Some(0.0)));
            assert_eq!(margin.own.parameters, of(&situation.delayed(n_steps).unwrap()));
            assert_eq!(margin.careful.parameters, of(&situation));
            n_changed += usize::from(margin.own.parameters != margin.careful.parameters);
        }
        assert!(n_changed > 0);
    }

    #[test]
    fn margins_count_who_fails_sooner() {
        let margin = |id: &str, own: Option<f64>, careful: Option<f64>| {
            let survived = |delay_s| DelaySurvived { delay_s, parameters: BTreeMap::new() };
            let (own, careful) = (survived(own), survived(careful));
            Margin { scenario_id: id.to_owned(), behavior: None, most_delay_s: 1.5, own, careful }
        };
        let margins = Margins::of(vec![
            margin("a", Some(0.2), Some(0.5)),
            margin("b", None, Some(0.1)),
            margin("c", Some(1.5), Some(1.5)),
            margin("d", Some(0.4), None),
        ]);
        let ids: Vec<&str> = margins.scenarios.iter().map(|margin| margin.scenario_id.as_str()).collect();
        assert_eq!((ids, margins.n_scenarios), (vec!["b", "a", "c", "d"], 4));
        assert_eq!([margins.n_sooner, margins.n_later], [2, 1]);
        assert!((margins.median_delay_s[0] - 0.3).abs() < 1e-9 && (margins.median_delay_s[1] - 0.3).abs() < 1e-9);
    }
}
