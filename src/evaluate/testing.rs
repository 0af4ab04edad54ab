//! A scenario for tests of texts and drawings of scenarios.

use super::cells::{CellFigures, CellSamples};
use super::judge::Judge;
use super::measures::{Measures, MetricDoc};
use crate::behavior::BehaviorEvent;
use crate::metrics::MetricSettings;
use crate::scenario::ScenarioRecord;
use crate::scene::testing::{self, Drive};
use crate::scene::{GuidanceLevel, GuidanceTag, ObservationMask, Provenance, Roles, Scenario, Scene};
use crate::store::testing::event;

/// A cell of one sample beside its recording, with its figures and the descriptions of the metrics.
pub(super) fn evaluated_cell<'r>(
    record: &'r ScenarioRecord,
    recorded: &Scene,
) -> (CellSamples<'r>, CellFigures, Vec<MetricDoc>) {
    let settings = MetricSettings::default();
    let (measures, judge) = (Measures::new(&settings, None, &[]), Judge::without_recordings(&settings));
    let cell = CellSamples { records: vec![record], with_references: true };
    let figures = cell.evaluate(recorded, &measures, &judge);
    (cell, figures, measures.docs())
}

/// Two cars side by side.
pub(crate) fn recorded() -> Scene {
    testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(-3.0, 3.5, 0.0, 10.0)])
}

/// A sample of it that requests a cut-in of track 2 ahead of track 1.
pub(crate) fn record(strength: f64, verified: bool, recorded_event: bool, scene: Scene) -> ScenarioRecord {
    let roles = Roles::from([("ego", "1"), ("other", "2")]);
    let event = event(&scene.id, "cut_in", &[("gap_m", 4.123)]);
    let event = BehaviorEvent { roles: roles.clone(), start_timestep: 5, ..event };
    let provenance = Provenance {
        classifier: Some("c".into()),
        sample_idx: 4,
        guidance: GuidanceTag { kind: "classifier:cut_in".into(), level: GuidanceLevel::of_strength(strength), roles },
        ..testing::provenance(&scene.id.0)
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
        assessment: None,
        shard: 0,
        request: None,
    }
}
