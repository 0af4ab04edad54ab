//! How many scenarios of each sweep, place and strength are there, verified, new, colliding, off the road?

use crate::metrics::{CollisionRate, Metric, OffroadRate, SampleGroup};
use crate::scene::{GuidanceLevel, Scene, SceneId};
use crate::store::ScenarioRecord;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// What one sweep gave at one level of guidance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SamplingRow {
    /// The sweep's name in the configuration.
    pub sweep: String,
    /// The requested behavior; `None` without one.
    pub behavior: Option<String>,
    /// The place of the source scenes; empty for all.
    pub place: String,
    /// How strongly it was guided.
    #[serde(flatten)]
    pub level: GuidanceLevel,
    /// The sampler and its steps, such as `heun-20`.
    pub sampler: String,
    /// Source scenes.
    pub n_scenes: u64,
    /// Scenarios sampled.
    pub n_scenarios: u64,
    /// Scenarios in which the miner finds the requested behavior in the requested roles.
    pub n_verified: u64,
    /// Verified scenarios whose recording does not hold the behavior for the same roles.
    pub n_new: u64,
    /// Scenarios in which agents collide, as the metric `collision_rate` defines it.
    pub n_collision: u64,
    /// Share of vehicles that leave the road, as the metric `offroad_rate` defines it; `None` without lanes.
    pub offroad_rate: Option<f64>,
    /// Denoiser evaluations of one scenario; the classifier is evaluated as often where it guides.
    pub n_evaluations: u64,
}

/// Counts scenarios; rows come in the order in which their sweep, place and strength first appear.
pub(super) struct SamplingTally {
    offroad: OffroadRate,
    rows: Vec<CountedRow>,
}

struct CountedRow {
    row: SamplingRow,
    scenes: BTreeSet<SceneId>,
    offroad_sum: f64,
    n_offroad: u64,
}

impl SamplingTally {
    /// Nothing counted yet. At these places maps do not say where the road is.
    pub(super) const fn new(places_without_road: BTreeSet<String>) -> Self {
        Self { offroad: OffroadRate { places_without_road }, rows: Vec::new() }
    }

    /// Counts a scenario that continues `recorded` and took `n_evaluations` evaluations of the denoiser.
    pub(super) fn add(&mut self, record: &ScenarioRecord, recorded: &Scene, n_evaluations: u64) {
        let provenance = &record.scenario.provenance;
        let place = &recorded.source.place;
        let same = |counted: &CountedRow| {
            counted.row.sweep == record.sweep
                && counted.row.place == *place
                && counted.row.level == provenance.guidance.level
        };
        let at = self.rows.iter().position(same).unwrap_or_else(|| {
            let row = SamplingRow {
                sweep: record.sweep.clone(),
                behavior: record.requested_behavior.clone(),
                place: place.clone(),
                level: provenance.guidance.level,
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
        if let Some(rate) = self.offroad.evaluate(&group) {
            counted.offroad_sum += rate;
            counted.n_offroad += 1;
        }
    }

    /// The rows.
    pub(super) fn finish(self) -> Vec<SamplingRow> {
        let finished = |counted: CountedRow| SamplingRow {
            n_scenes: counted.scenes.len() as u64,
            offroad_rate: (counted.n_offroad > 0).then(|| counted.offroad_sum / counted.n_offroad as f64),
            ..counted.row
        };
        self.rows.into_iter().map(finished).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::testing::{record, recorded};
    use crate::scene::testing::{self, Drive};

    #[test]
    fn scenarios_are_counted_by_strength() {
        let mut tally = SamplingTally::new(BTreeSet::new());
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
            .map(|r| (r.level.strength, r.n_scenes, r.n_scenarios, r.n_verified, r.n_new, r.n_collision))
            .collect();
        assert_eq!(counts, [(2.0, 1, 3, 2, 1, 1), (0.0, 1, 1, 0, 0, 0)]);
        assert_eq!(rows[1].offroad_rate, Some(0.0));
    }

    #[test]
    fn the_offroad_rate_is_over_scenarios_that_have_roads() {
        let mut tally = SamplingTally::new(BTreeSet::new());
        // Both cars leave the lane to its left, the one that is on it at present counts.
        let leaving = || {
            let mut scene = recorded();
            let away = testing::scene(&[Drive::straight(0.0, 0.0, 1.0, 20.0)]).tracks.remove(0).trajectory;
            let states = scene.tracks[0].trajectory.entries().iter().zip(away.entries()).enumerate();
            let states = states.map(|(t, (here, away))| if t < scene.n_history { *here } else { *away }).collect();
            scene.tracks[0].trajectory = crate::scene::Trajectory::new(states);
            scene
        };
        let unmapped = || Scene { lanes: std::sync::Arc::default(), ..recorded() };
        tally.add(&record(2.0, true, false, leaving()), &recorded(), 39);
        tally.add(&record(2.0, true, false, unmapped()), &unmapped(), 39);
        assert_eq!(tally.finish()[0].offroad_rate, Some(1.0));
    }
}
