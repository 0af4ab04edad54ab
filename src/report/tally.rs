//! How many scenarios of each sweep, place and strength are there, verified, new, colliding, off the road?

use super::model::{Fact, SamplingRow};
use super::number::{setting, value};
use super::quantities::title_and_unit;
use super::scene_card::SceneCard;
use crate::metrics::{CollisionRate, Metric, OffroadRate, SampleGroup};
use crate::scene::{Scene, SceneId, TrackId};
use crate::store::ScenarioRecord;
use std::collections::BTreeSet;

/// Counts scenarios; rows come in the order in which their sweep, place and strength first appear.
#[derive(Debug, Clone, Default)]
pub struct SamplingTally {
    rows: Vec<CountedRow>,
}

#[derive(Debug, Clone)]
struct CountedRow {
    row: SamplingRow,
    scenes: BTreeSet<SceneId>,
    offroad_sum: f64,
    n_offroad: u64,
}

impl SamplingTally {
    /// Counts a scenario that continues `recorded` and took `n_evaluations` evaluations of the denoiser.
    pub fn add(&mut self, record: &ScenarioRecord, recorded: &Scene, n_evaluations: u64) {
        let provenance = &record.scenario.provenance;
        let place = &recorded.source.place;
        let same = |counted: &CountedRow| {
            counted.row.sweep == record.sweep
                && counted.row.place == *place
                && counted.row.strength.to_bits() == provenance.guidance.strength.to_bits()
        };
        let at = self.rows.iter().position(same).unwrap_or_else(|| {
            let row = SamplingRow {
                sweep: record.sweep.clone(),
                behavior: record.requested_behavior.clone(),
                place: place.clone(),
                strength: provenance.guidance.strength,
                sampler: provenance.sampler.clone(),
                n_scenes: 0,
                n_scenarios: 0,
                n_verified: 0,
                n_new: 0,
                n_collision: 0,
                offroad_rate: None,
                n_evaluations,
            };
            self.rows.push(CountedRow { row, scenes: BTreeSet::new(), offroad_sum: 0.0, n_offroad: 0 });
            self.rows.len() - 1
        });
        let counted = &mut self.rows[at];
        let group = SampleGroup::equally_likely(recorded, std::slice::from_ref(&record.scenario.scene));
        counted.scenes.insert(provenance.scene_id.clone());
        counted.row.n_scenarios += 1;
        counted.row.n_verified += u64::from(record.verified);
        counted.row.n_new += u64::from(record.verified && !record.recorded_event);
        counted.row.n_collision += u64::from(CollisionRate.evaluate(&group).is_some_and(|rate| rate > 0.0));
        if let Some(rate) = OffroadRate.evaluate(&group) {
            counted.offroad_sum += rate;
            counted.n_offroad += 1;
        }
    }

    /// The rows.
    pub fn finish(self) -> Vec<SamplingRow> {
        let finished = |counted: CountedRow| SamplingRow {
            n_scenes: counted.scenes.len() as u64,
            offroad_rate: (counted.n_offroad > 0).then(|| counted.offroad_sum / counted.n_offroad as f64),
            ..counted.row
        };
        self.rows.into_iter().map(finished).collect()
    }
}

impl SceneCard {
    /// Draws a scenario beside the recording it continues, with its provenance, verdict and the parameters of its event.
    pub fn of_record(record: &ScenarioRecord, recorded: &Scene) -> Self {
        let scenario = &record.scenario;
        let provenance = &scenario.provenance;
        let event = record.main_event();
        let roles: &[(String, TrackId)] = event.map_or(&provenance.guidance.roles, |event| &event.roles);
        let verdict = match (&record.requested_behavior, record.verified, record.recorded_event) {
            (None, _, _) => "nothing was asked for",
            (Some(_), false, _) => "not verified",
            (Some(_), true, true) => "verified; the recording holds it too",
            (Some(_), true, false) => "verified, and not in the recording",
        };
        let asked = record.requested_behavior.as_deref().unwrap_or("continuation").replace('_', " ");
        let strength = setting(provenance.guidance.strength);
        let title = format!("{asked}, {}, α = {strength}: {verdict}", recorded.source.place);
        let mut facts = vec![
            Fact::new("Scenario", &scenario.id),
            Fact::new("Source scene", &provenance.scene_id),
            Fact::new("Source file", &recorded.source.file),
            Fact::new("Sweep", &record.sweep),
            Fact::new("Guidance", format!("{}, α = {strength}", provenance.guidance.kind)),
            Fact::new("Sample", provenance.sample_idx),
            Fact::new("Sampler", &provenance.sampler),
            Fact::new("Seed", provenance.seed),
            Fact::new("Denoiser", &provenance.checkpoint),
        ];
        facts.extend(provenance.classifier.as_ref().map(|classifier| Fact::new("Classifier", classifier)));
        facts.extend(roles.iter().map(|(role, track)| Fact::new(format!("Track of {role}"), track)));
        for (name, parameter) in event.iter().flat_map(|event| &event.parameters) {
            let (title, unit) = title_and_unit(name);
            facts.push(Fact::new(title, format!("{} {unit}", value(*parameter)).trim_end()));
        }
        let generated = format!("generated, sample {}", provenance.sample_idx);
        let scenes = [("recorded", recorded), (generated.as_str(), &scenario.scene)];
        Self::new(&scenario.id, title, facts, &scenes, roles)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::{BehaviorEvent, EventLabel};
    use crate::scene::testing::{self, Drive};
    use crate::scene::{GuidanceTag, ObservationMask, Provenance, Scenario};
    use std::collections::BTreeMap;

    fn recorded() -> Scene {
        testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(-3.0, 3.5, 0.0, 10.0)])
    }

    fn record(strength: f64, verified: bool, recorded_event: bool, scene: Scene) -> ScenarioRecord {
        let roles = vec![("ego".to_owned(), TrackId::from("1")), ("other".to_owned(), TrackId::from("2"))];
        let event = BehaviorEvent {
            behavior: "cut_in".into(),
            scene_id: scene.id.clone(),
            label: EventLabel::Positive,
            roles: roles.clone(),
            start_timestep: 5,
            end_timestep: 8,
            parameters: BTreeMap::from([("gap_m".to_owned(), 4.123)]),
        };
        let provenance = Provenance {
            scene_id: scene.id.clone(),
            observation: "predictive".into(),
            edit_tau: None,
            checkpoint: "d".into(),
            classifier: Some("c".into()),
            seed: 1,
            sample_idx: 4,
            probability: None,
            guidance: GuidanceTag { kind: "classifier:cut_in".into(), strength, roles },
            sampler: "heun-20".into(),
            settings: String::new(),
        };
        ScenarioRecord {
            scenario: Scenario {
                id: "s-4".into(),
                observed: ObservationMask::predictive(scene.tracks.len(), scene.n_timesteps, scene.n_history),
                scene,
                provenance,
            },
            sweep: "guided".into(),
            requested_behavior: Some("cut_in".into()),
            verified,
            events: verified.then_some(event).into_iter().collect(),
            recorded_event,
            shard: 0,
            request: None,
        }
    }

    #[test]
    fn scenarios_are_counted_by_strength() {
        let mut tally = SamplingTally::default();
        // The second car drives into the first one, which is at (8, 0) after 0.8 s, from 45 degrees to its left.
        let mut crash = recorded();
        let veering = testing::scene(&[Drive::straight(-3.3, 11.3, -std::f64::consts::FRAC_PI_4, 20.0)]);
        crash.tracks[1].trajectory = veering.tracks[0].trajectory.clone();
        tally.add(&record(2.0, true, false, recorded()), &recorded(), 39);
        tally.add(&record(2.0, true, true, crash), &recorded(), 39);
        tally.add(&record(2.0, false, false, recorded()), &recorded(), 39);
        tally.add(&record(0.0, false, false, recorded()), &recorded(), 39);
        let rows = tally.finish();
        let counts: Vec<_> = rows
            .iter()
            .map(|r| (r.strength, r.n_scenes, r.n_scenarios, r.n_verified, r.n_new, r.n_collision))
            .collect();
        assert_eq!(counts, [(2.0, 1, 3, 2, 1, 1), (0.0, 1, 1, 0, 0, 0)]);
        assert_eq!(rows[1].offroad_rate, Some(0.0));
    }

    #[test]
    fn the_card_says_what_was_found() {
        let card = SceneCard::of_record(&record(2.0, true, false, recorded()), &recorded());
        assert!(card.title.ends_with("α = 2: verified, and not in the recording"), "{}", card.title);
        assert!(card.facts.contains(&Fact::new("gap", "4.12 m")), "{:?}", card.facts);
        let roles: Vec<_> = card.panels[1].agents.iter().map(|agent| agent.role.as_deref()).collect();
        assert_eq!((card.panels.len(), roles), (2, vec![Some("ego"), Some("other")]));
    }
}
