//! The selection of scenarios to export.

use crate::scenario::{Assessment, ScenarioRecord};
use crate::store::CorpusReader;
use serde::Serialize;

/// The scenarios to export; all by default.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Selection {
    /// Only scenarios in which the requested behavior was found.
    pub only_verified: bool,
    /// Only accepted scenarios: verified, valid and not a near-duplicate.
    pub only_accepted: bool,
    /// Also valid scenarios of which nothing was requested.
    pub also_ordinary: bool,
    /// Only scenarios for which this behavior was requested.
    pub behavior: Option<String>,
    /// Only scenarios of this sweep.
    pub sweep: Option<String>,
    /// Only scenarios with these ids; empty: all.
    pub scenario_ids: Vec<String>,
    /// At most this many, the first ones.
    pub limit: Option<usize>,
}

impl Selection {
    /// The positions of the candidates, ascending: of all scenarios, or of the named ones.
    pub(crate) fn positions(&self, reader: &CorpusReader) -> crate::store::Result<Vec<usize>> {
        if self.scenario_ids.is_empty() {
            let is_wanted = |(behavior, accepted): (Option<&str>, bool)| {
                let is_ordinary = self.also_ordinary && behavior.is_none();
                (!self.only_accepted || accepted || is_ordinary)
                    && self.behavior.as_deref().is_none_or(|own| behavior == Some(own))
            };
            let requests = reader.requests()?.enumerate();
            return Ok(requests.filter(|(_, request)| is_wanted(*request)).map(|(position, _)| position).collect());
        }
        let found = self.scenario_ids.iter().map(|id| reader.position(id));
        let mut positions = found.collect::<crate::store::Result<Vec<usize>>>()?;
        positions.sort_unstable();
        positions.dedup();
        Ok(positions)
    }

    /// Whether a scenario passes, whatever its id.
    pub(crate) fn wants(&self, record: &ScenarioRecord) -> bool {
        (!self.only_verified || record.verified)
            && (!self.only_accepted || is_accepted(record) || (self.also_ordinary && is_ordinary(record)))
            && self.behavior.as_ref().is_none_or(|behavior| record.requested_behavior.as_ref() == Some(behavior))
            && self.sweep.as_ref().is_none_or(|sweep| record.sweep == *sweep)
    }

    /// The selection, in words that follow "is".
    pub(crate) fn words(&self) -> String {
        let mut words = Vec::new();
        if self.only_verified {
            words.push("verified".to_owned());
        }
        if self.only_accepted {
            words.push("accepted".to_owned());
        }
        words.extend(self.behavior.iter().map(|behavior| format!("requested as {behavior}")));
        words.extend(self.sweep.iter().map(|sweep| format!("from sweep {sweep}")));
        if !self.scenario_ids.is_empty() {
            words.push(format!("one of {}", self.scenario_ids.join(", ")));
        }
        if words.is_empty() { "there".to_owned() } else { words.join(" and ") }
    }
}

/// Whether a scenario is valid and nothing was requested of it.
fn is_ordinary(record: &ScenarioRecord) -> bool {
    let is_valid = record.assessment.as_ref().is_some_and(Assessment::is_valid);
    record.requested_behavior.is_none() && is_valid
}

/// Whether a scenario was accepted.
pub(super) fn is_accepted(record: &ScenarioRecord) -> bool {
    record.assessment.as_ref().is_some_and(|assessment| assessment.accepted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing;

    #[test]
    fn each_filter_takes_away_and_all_must_pass() {
        let record = testing::record(&testing::scene());
        let unverified = ScenarioRecord { verified: false, ..record.clone() };
        let all = Selection::default();
        assert!(all.wants(&record) && all.wants(&unverified));
        let verified = Selection { only_verified: true, ..Selection::default() };
        assert!(verified.wants(&record) && !verified.wants(&unverified));
        let accepted = Selection { only_accepted: true, ..verified.clone() };
        let judged = |accepted| {
            let assessment = Some(Assessment { accepted, ..Assessment::default() });
            ScenarioRecord { assessment, ..record.clone() }
        };
        assert!(accepted.wants(&judged(true)) && !accepted.wants(&judged(false)) && !accepted.wants(&record));
        // Valid ordinary scenarios are never accepted, but may be asked for.
        let ordinary = ScenarioRecord { requested_behavior: None, ..judged(false) };
        let also = Selection { also_ordinary: true, only_verified: false, ..accepted.clone() };
        assert!(also.wants(&ordinary) && !accepted.wants(&ordinary) && !also.wants(&judged(false)));
        let mut invalid = ordinary.clone();
        invalid.assessment.as_mut().unwrap().violations.push(crate::metrics::Violation {
            check: crate::metrics::Check::Jerk,
            track: "2".into(),
            timestep: 7,
            value: 31.0,
            limit: 25.0,
        });
        assert!(!also.wants(&invalid));
        let behavior = |name: &str| Selection { behavior: Some(name.to_owned()), ..verified.clone() };
        assert!(behavior("cut_in").wants(&record) && !behavior("left_turn").wants(&record));
        let sweep = |name: &str| Selection { sweep: Some(name.to_owned()), ..behavior("cut_in") };
        assert!(sweep("cut_ins").wants(&record) && !sweep("others").wants(&record));
        assert_eq!(sweep("others").words(), "verified and requested as cut_in and from sweep others");
    }
}
