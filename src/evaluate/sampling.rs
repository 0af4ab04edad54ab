//! How many scenarios does each sweep have by place and strength, and how many are verified, new, colliding or off the
//! road?

use super::cells::CellSamples;
use crate::metrics::{CollisionRate, Metric, OffroadRate, SampleGroup, SeriesKey};
use crate::scenario::ScenarioRecord;
use crate::scene::{GuidanceLevel, Scene};
use crate::store::SceneSet;
use serde::{Deserialize, Serialize};

/// The yield of one sweep at one level of guidance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SamplingRow {
    /// The sweep's name in the configuration.
    pub sweep: String,
    /// The requested behavior; `None` without one.
    pub behavior: Option<String>,
    /// The place of the source scenes; empty for all.
    pub place: String,
    /// The level of its guidance.
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
    /// Verified scenarios whose recording does not show the behavior for the same roles.
    pub n_new: u64,
    /// Scenarios in which agents collide, as the metric `collision_rate` defines it.
    pub n_collision: u64,
    /// Share of vehicles that leave the road, as the metric `offroad_rate` defines it; `None` without lanes.
    pub offroad_rate: Option<f64>,
    /// Evaluations of the denoiser per scenario; if the classifier guides, it is evaluated as often.
    pub n_evaluations: u64,
}

#[cfg(test)]
impl SamplingRow {
    /// 100 samples of 10 scenes of a place, a tenth of which collide.
    pub(crate) fn example(strength: f64, n_verified: u64) -> Self {
        Self {
            sweep: "cut_ins".to_owned(),
            behavior: Some("cut_in".to_owned()),
            place: "X".to_owned(),
            level: GuidanceLevel::of_strength(strength),
            sampler: "heun-10".to_owned(),
            n_scenes: 10,
            n_scenarios: 100,
            n_verified,
            n_new: 0,
            n_collision: 10,
            offroad_rate: None,
            n_evaluations: 19,
        }
    }
}

/// The counts of the scenarios of a cell.
pub(super) struct SampledCell {
    behavior: Option<String>,
    sampler: String,
    scenarios: Vec<SampledScenario>,
}

/// The counted facts of a scenario.
struct SampledScenario {
    verified: bool,
    is_new: bool,
    conduct: Conduct,
}

/// Violations by agents of a scenario.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Conduct {
    /// Whether agents collide.
    collides: bool,
    /// The share of vehicles that leave the road; `None` without lanes.
    offroad_rate: Option<f64>,
}

impl Conduct {
    /// The conduct in each sample of a cell that continues `recorded`.
    pub(super) fn of(cell: &CellSamples<'_>, recorded: &Scene, offroad: &OffroadRate) -> Vec<Self> {
        let of_sample = |sample: Scene| {
            let group = SampleGroup::equally_likely(recorded, std::slice::from_ref(&sample));
            Self {
                collides: CollisionRate.evaluate(&group).is_some_and(|rate| rate > 0.0),
                offroad_rate: offroad.evaluate(&group),
            }
        };
        cell.scenes(recorded).into_iter().map(of_sample).collect()
    }
}

impl SampledCell {
    /// The counts of a cell with these samples, in order.
    pub(super) fn new(cell: &CellSamples<'_>, conduct: Vec<Conduct>) -> Self {
        let scenario = |(record, conduct): (&&ScenarioRecord, Conduct)| SampledScenario {
            verified: record.verified,
            is_new: record.verified && !record.recorded_event,
            conduct,
        };
        let first = cell.records[0];
        Self {
            behavior: first.requested_behavior.clone(),
            sampler: first.scenario.provenance.sampler.clone(),
            scenarios: cell.records.iter().zip(conduct).map(scenario).collect(),
        }
    }
}

/// Counts scenarios; rows come in the order in which their sweep, place and strength first appear.
#[derive(Default)]
pub(super) struct SamplingTally {
    rows: Vec<CountedRow>,
}

struct CountedRow {
    row: SamplingRow,
    scenes: SceneSet,
    offroad_sum: f64,
    n_offroad: u64,
}

impl SamplingTally {
    /// Counts a cell of `series`, whose scene has this place and position in its store; each sample took
    /// `n_evaluations` evaluations of the denoiser.
    pub(super) fn add(
        &mut self,
        series: &SeriesKey,
        (place, scene_idx): (&str, usize),
        cell: &SampledCell,
        n_evaluations: u64,
    ) {
        let same = |CountedRow { row, .. }: &CountedRow| {
            row.sweep == series.sweep && row.place == place && row.level == series.level
        };
        let at = self.rows.iter().position(same).unwrap_or_else(|| {
            let row = SamplingRow {
                sweep: series.sweep.clone(),
                behavior: cell.behavior.clone(),
                place: place.to_owned(),
                level: series.level,
                sampler: cell.sampler.clone(),
                n_scenes: 0,
                n_scenarios: 0,
                n_verified: 0,
                n_new: 0,
                n_collision: 0,
                offroad_rate: None,
                n_evaluations,
            };
            self.rows.push(CountedRow { row, scenes: SceneSet::default(), offroad_sum: 0.0, n_offroad: 0 });
            self.rows.len() - 1
        });
        let counted = &mut self.rows[at];
        counted.scenes.insert(scene_idx);
        for SampledScenario { verified, is_new, conduct: Conduct { collides, offroad_rate } } in &cell.scenarios {
            counted.row.n_scenarios += 1;
            counted.row.n_verified += u64::from(*verified);
            counted.row.n_new += u64::from(*is_new);
            counted.row.n_collision += u64::from(*collides);
            if let Some(rate) = offroad_rate {
                counted.offroad_sum += rate;
                counted.n_offroad += 1;
            }
        }
    }

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

    /// Counts a sample of scene 7 alone.
    fn add(tally: &mut SamplingTally, record: &ScenarioRecord, recorded: &Scene) {
        let cell = CellSamples { records: vec![record], with_references: false };
        let offroad = OffroadRate { places_without_road: std::collections::BTreeSet::new() };
        let sampled = SampledCell::new(&cell, Conduct::of(&cell, recorded, &offroad));
        tally.add(&cell.series("guided"), (&recorded.source.place, 7), &sampled, 39);
    }

    #[test]
    fn scenarios_are_counted_by_strength() {
        let mut tally = SamplingTally::default();
        // The second car drives into the first one, which is at (8, 0) after 0.8 s, from 45 degrees to its left.
        let mut crash = recorded();
        let veering = testing::scene(&[Drive::straight(-3.3, 11.3, -std::f64::consts::FRAC_PI_4, 20.0)]);
        crash.tracks[1].trajectory = veering.tracks[0].trajectory.clone();
        add(&mut tally, &record(2.0, true, false, recorded()), &recorded());
        add(&mut tally, &record(2.0, true, true, crash), &recorded());
        add(&mut tally, &record(2.0, false, false, recorded()), &recorded());
        add(&mut tally, &record(0.0, false, false, recorded()), &recorded());
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
        let mut tally = SamplingTally::default();
        // Both cars leave the lane to its left; only the car that is on it at present counts.
        let leaving = || {
            let mut scene = recorded();
            let away = testing::scene(&[Drive::straight(0.0, 0.0, 1.0, 20.0)]).tracks.remove(0).trajectory;
            let states = scene.tracks[0].trajectory.entries().iter().zip(away.entries()).enumerate();
            let states = states.map(|(t, (here, away))| if t < scene.n_history { *here } else { *away }).collect();
            scene.tracks[0].trajectory = crate::scene::Trajectory::new(states);
            scene
        };
        let unmapped = || Scene { lanes: std::sync::Arc::default(), ..recorded() };
        add(&mut tally, &record(2.0, true, false, leaving()), &recorded());
        add(&mut tally, &record(2.0, true, false, unmapped()), &unmapped());
        assert_eq!(tally.finish()[0].offroad_rate, Some(1.0));
    }
}
