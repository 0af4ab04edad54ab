//! Cards of generated scenarios: one beside its recording, or many samples of one scene.

use super::{Acceptance, CardBucket, CardKey, CardValue, Sample, SceneCard, Verdict};
use crate::report::model::Fact;
use crate::report::number::{level, value};
use crate::report::quantities::title_and_unit;
use crate::scenario::{BucketTag, RequestOutcome, ScenarioRecord};
use crate::scene::{GuidanceLevel, Roles, Scene};

impl Verdict {
    /// The verdict on this scenario's requested behavior.
    pub fn of(record: &ScenarioRecord) -> Self {
        match (&record.requested_behavior, record.verified, record.recorded_event) {
            (None, _, _) => Self::NotAsked,
            (Some(_), false, _) => Self::NotVerified,
            (Some(_), true, true) => Self::Recorded,
            (Some(_), true, false) => Self::New,
        }
    }
}

impl SceneCard {
    /// Draws a scenario beside the recording it continues, with its provenance, verdict, the parameters of its event
    /// and its `metrics`. `acceptance` is `None` if it was not decided.
    pub fn of_record(
        record: &ScenarioRecord,
        recorded: &Scene,
        metrics: &[CardValue],
        acceptance: Option<&Acceptance>,
    ) -> Self {
        let scenario = &record.scenario;
        let event = record.main_event();
        let roles: &Roles = event.map_or(&scenario.provenance.guidance.roles, |event| &event.roles);
        let parameters = event.iter().flat_map(|event| &event.parameters);
        let values: Vec<CardValue> = parameters
            .map(|(name, value)| CardValue { name: name.clone(), value: *value })
            .chain(metrics.iter().cloned())
            .collect();
        let key = CardKey { acceptance: acceptance.cloned(), ..key(record, recorded, values) };
        let asked = record.requested_behavior.as_deref().unwrap_or("continuation").replace('_', " ");
        // The reasons include a missing behavior.
        let verdict = match acceptance {
            Some(acceptance) if !record.verified => acceptance.words(),
            Some(acceptance) => format!("{}; {}", key.verdict.words(), acceptance.words()),
            None => key.verdict.words().to_owned(),
        };
        let title = format!("{asked}, {}, {}: {verdict}", key.place, key.level);
        let mut facts = vec![Fact::new("Scenario", &scenario.id)];
        facts.extend(acceptance.map(|acceptance| Fact::new("Decision", acceptance.words())));
        facts.extend(key.bucket.as_ref().map(|bucket| Fact::new("Requested", bucket.words())));
        facts.extend(facts_of_source(record, recorded));
        facts.push(Fact::new("Sample", scenario.provenance.sample_idx));
        facts.extend(scenario.provenance.probability.map(|p| Fact::new("Probability", value(p))));
        facts.extend(roles.iter().map(|(role, track)| Fact::new(format!("Track of {role}"), track)));
        facts.extend(facts_of_values(&key.values));
        let name = sample_name(record);
        let sample = Sample { name: &name, scene: &scenario.scene, observed: &scenario.observed };
        Self::new((scenario.id.clone(), title), key, facts, recorded, &[sample], roles)
    }

    /// Draws samples of one scene with the same settings, overlaid, beside their recording. `metrics` are means over
    /// them. `None` without samples.
    pub fn of_samples(records: &[ScenarioRecord], recorded: &Scene, metrics: &[CardValue]) -> Option<Self> {
        let first = records.first()?;
        let provenance = &first.scenario.provenance;
        let key = key(first, recorded, metrics.to_vec());
        let guided = match key.level {
            GuidanceLevel::UNGUIDED => String::new(),
            level => format!(", {level}"),
        };
        let observation = provenance.observation.replace('_', " ");
        let case = &recorded.source.case_id;
        let title = format!(
            "{}, {} {case}: {} samples, observed: {observation}{guided}",
            first.sweep,
            key.place,
            records.len()
        );
        let mut facts = facts_of_source(first, recorded);
        facts.push(Fact::new("Samples", records.len()));
        facts.extend(facts_of_values(&key.values));
        let names: Vec<String> = records.iter().map(sample_name).collect();
        let samples: Vec<Sample<'_>> = records
            .iter()
            .zip(&names)
            .map(|(record, name)| Sample { name, scene: &record.scenario.scene, observed: &record.scenario.observed })
            .collect();
        let id = format!("{}:{}:{}", first.sweep, provenance.scene_id, level(key.level));
        Some(Self::new((id, title), key, facts, recorded, &samples, &provenance.guidance.roles))
    }
}

fn sample_name(record: &ScenarioRecord) -> String {
    format!("sample {}", record.scenario.provenance.sample_idx)
}

fn key(record: &ScenarioRecord, recorded: &Scene, values: Vec<CardValue>) -> CardKey {
    CardKey {
        sweep: record.sweep.clone(),
        behavior: record.requested_behavior.clone(),
        bucket: bucket(record),
        place: recorded.source.place.clone(),
        verdict: Verdict::of(record),
        acceptance: None,
        level: record.scenario.provenance.guidance.level,
        values,
    }
}

/// The bucket of the request that accepted the scenario.
fn bucket(record: &ScenarioRecord) -> Option<CardBucket> {
    let tag = record.request.as_ref().filter(|tag| tag.outcome == RequestOutcome::Accepted)?;
    let BucketTag { idx, ranges } = tag.bucket.clone()?;
    Some(CardBucket { request: tag.request.clone(), idx, ranges })
}

fn facts_of_source(record: &ScenarioRecord, recorded: &Scene) -> Vec<Fact> {
    let provenance = &record.scenario.provenance;
    let mut facts = vec![
        Fact::new("Source scene", &provenance.scene_id),
        Fact::new("Source file", &recorded.source.file),
        Fact::new("Sweep", &record.sweep),
        Fact::new("Observed", provenance.observation.replace('_', " ")),
        Fact::new("Guidance", format!("{}, {}", provenance.guidance.kind, provenance.guidance.level)),
        Fact::new("Sampler", &provenance.sampler),
        Fact::new("Seed", provenance.seed),
        Fact::new("Model", &provenance.checkpoint),
    ];
    facts.extend(provenance.edit_tau.map(|tau| Fact::new("Edited, denoised from τ", value(tau))));
    facts.extend(provenance.classifier.as_ref().map(|classifier| Fact::new("Classifier", classifier)));
    facts
}

fn facts_of_values(values: &[CardValue]) -> impl Iterator<Item = Fact> + '_ {
    values.iter().map(|CardValue { name, value: number }| {
        let (title, unit) = title_and_unit(name);
        Fact::new(title, format!("{} {unit}", value(*number)).trim_end())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::testing::{record, recorded};

    fn metric() -> Vec<CardValue> {
        vec![CardValue { name: "offroad_rate".to_owned(), value: 0.25 }]
    }

    #[test]
    fn the_card_says_what_was_found() {
        let card = SceneCard::of_record(&record(2.0, true, false, recorded()), &recorded(), &metric(), None);
        assert!(card.title.ends_with("α = 2: verified, and not in the recording"), "{}", card.title);
        assert!(card.facts.contains(&Fact::new("gap", "4.12 m")), "{:?}", card.facts);
        assert!(card.facts.contains(&Fact::new("offroad rate", "0.250")), "{:?}", card.facts);
        let values: Vec<(&str, f64)> = card.key.values.iter().map(|v| (v.name.as_str(), v.value)).collect();
        assert_eq!(values, [("gap_m", 4.123), ("offroad_rate", 0.25)]);
        assert_eq!((card.key.verdict, card.roles()), (Verdict::New, vec!["ego", "other"]));
        assert_eq!(card.panels.iter().map(|panel| panel.is_recorded).collect::<Vec<_>>(), [true, false]);
        let failed = SceneCard::of_record(&record(2.0, false, false, recorded()), &recorded(), &[], None);
        assert_eq!((failed.key.verdict, failed.key.values), (Verdict::NotVerified, vec![]));
    }

    #[test]
    fn the_card_says_whether_it_was_accepted_and_why_not() {
        let acceptance =
            |reasons: &[&str]| Acceptance { reasons: reasons.iter().map(|reason| (*reason).to_owned()).collect() };
        let card = |verified: bool, reasons: &[&str]| {
            let record = record(2.0, verified, false, recorded());
            SceneCard::of_record(&record, &recorded(), &[], Some(&acceptance(reasons)))
        };
        let accepted = card(true, &[]);
        assert!(accepted.title.ends_with("not in the recording; accepted"), "{}", accepted.title);
        assert!(accepted.key.acceptance.is_some_and(|acceptance| acceptance.is_accepted()));
        let rejected = card(true, &["yaw_rate", "near_duplicate"]);
        assert!(rejected.title.ends_with("recording; rejected: yaw rate, near duplicate"), "{}", rejected.title);
        assert!(rejected.facts.contains(&Fact::new("Decision", "rejected: yaw rate, near duplicate")));
        let missed = card(false, &["not_verified", "jerk"]);
        assert!(missed.title.ends_with("α = 2: rejected: not verified, jerk"), "{}", missed.title);
    }

    #[test]
    fn samples_of_a_scene_share_a_drawing_in_which_given_states_are_marked() {
        let mut records: Vec<ScenarioRecord> = (0..3).map(|_| record(0.0, false, false, recorded())).collect();
        for (i, record) in records.iter_mut().enumerate() {
            record.requested_behavior = None;
            record.scenario.provenance.sample_idx = i;
            record.scenario.provenance.guidance.roles = Roles::default();
        }
        let card = SceneCard::of_samples(&records, &recorded(), &[]).unwrap();
        assert_eq!((card.key.verdict, card.panels[1].samples.len()), (Verdict::NotAsked, 3));
        assert!(card.title.contains("3 samples, observed: predictive"), "{}", card.title);
        assert_eq!(card.roles(), ["ego"], "the ego stands out where nobody has a role");
        let agent = &card.panels[1].samples[2].agents[0];
        assert_eq!(agent.stretches(), [(true, 0, 4), (false, 4, 12)], "the history of the predictive task was given");
        assert!(SceneCard::of_samples(&[], &recorded(), &[]).is_none());
    }
}
