//! The figures of the samples of one scene, beside those of the recording and the baseline.

use super::distinguishability::CellTracks;
use super::judge::{Judge, ReferenceJudgment};
use super::measures::{Measures, Requested};
use crate::metrics::{SampleGroup, SeriesKey, constant_velocity};
use crate::scenario::{Assessment, ScenarioRecord};
use crate::scene::{GuidanceLevel, Scene, SituationKind, Track, Trajectory};
use crate::seed::Seed;
use serde::{Deserialize, Serialize};

/// The samples of one scene with the same requested agents at the same level.
pub(super) struct CellSamples<'a> {
    /// The samples, in order.
    pub(super) records: Vec<&'a ScenarioRecord>,
    /// Whether the recording and the baseline are measured, too: once per scene and roles of a sweep.
    pub(super) with_references: bool,
}

/// The figures of a cell, each in the order of the measures.
#[derive(Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct CellFigures {
    /// The recording, measured as its own only sample.
    pub(super) recorded: Option<Vec<Option<f64>>>,
    /// The constant-velocity baseline.
    pub(super) constant_velocity: Option<Vec<Option<f64>>>,
    /// All samples together.
    pub(super) together: Vec<Option<f64>>,
    /// Each sample alone.
    pub(super) alone: Vec<Vec<Option<f64>>>,
    pub(super) assessments: Vec<Assessment>,
    /// The judgments of the recording and of the baseline, if they are measured.
    pub(super) references_judged: Option<[ReferenceJudgment; 2]>,
    /// The features of everybody for classifiers.
    pub(super) tracks: CellTracks,
}

/// Puts the records of a shard into cells, in order of first appearance.
pub(super) fn into_cells(records: &[ScenarioRecord]) -> Vec<CellSamples<'_>> {
    let mut cells: Vec<CellSamples<'_>> = Vec::new();
    for record in records {
        let same_roles = |cell: &&mut CellSamples<'_>| is_same_question(cell.records[0], record);
        let same_cell = |cell: &&mut CellSamples<'_>| same_roles(cell) && level(cell.records[0]) == level(record);
        match cells.iter_mut().find(same_cell) {
            Some(cell) => cell.records.push(record),
            None => {
                let with_references = !cells.iter().any(|cell| is_same_question(cell.records[0], record));
                cells.push(CellSamples { records: vec![record], with_references });
            }
        }
    }
    cells
}

fn is_same_question(a: &ScenarioRecord, b: &ScenarioRecord) -> bool {
    let (a, b) = (&a.scenario.provenance, &b.scenario.provenance);
    a.scene_id == b.scene_id && a.guidance.roles == b.guidance.roles
}

const fn level(record: &ScenarioRecord) -> GuidanceLevel {
    record.scenario.provenance.guidance.level
}

impl CellSamples<'_> {
    /// The series of its samples, which belong to `sweep`.
    pub(super) fn series(&self, sweep: &str) -> SeriesKey {
        SeriesKey::of(sweep, &self.records[0].scenario.provenance)
    }

    /// The probability of each sample, if the model gives one.
    pub(super) fn probabilities(&self) -> Option<Vec<f64>> {
        self.records.iter().map(|record| record.scenario.provenance.probability).collect()
    }

    /// The seed of the reduction of its samples to modes.
    pub(super) fn mode_seed(&self) -> Seed {
        let provenance = &self.records[0].scenario.provenance;
        Seed(provenance.seed).derive_named("modes", &provenance.scene_id.0)
    }

    /// Its samples as scenes, as far as the recording goes: closed loops last longer, and others arrive in them.
    pub(super) fn scenes(&self, recorded: &Scene) -> Vec<Scene> {
        self.records.iter().map(|record| as_far_as_recorded(&record.scenario.scene, recorded)).collect()
    }

    /// Measures the cell against the scene it continues; one that no recording holds has no future to compare with.
    pub(super) fn evaluate(&self, recorded: &Scene, measures: &Measures<'_>, judge: &Judge<'_>) -> CellFigures {
        let samples = self.scenes(recorded);
        let lasts_longer = |record: &&ScenarioRecord| record.scenario.scene.n_timesteps > samples[0].n_timesteps;
        let whole: Vec<&Scene> = self.records.iter().map(|record| &record.scenario.scene).collect();
        let whole = self.records.iter().any(lasts_longer).then_some(&whole[..]);
        let was_recorded = recorded.source.situation == SituationKind::Recorded;
        let with_references = self.with_references && was_recorded;
        let recorded = as_far_as_generated(recorded, &samples);
        let tracks = CellTracks::of(&recorded, &samples);
        let (recorded, tracks) = match was_recorded {
            true => (recorded, tracks),
            false => (without_future(recorded), tracks.without_recording()),
        };
        let first = self.records[0];
        let requested = first
            .requested_behavior
            .as_deref()
            .map(|behavior| Requested { behavior, roles: &first.scenario.provenance.guidance.roles });
        let evaluate = |group: &SampleGroup<'_>, mode_seed| measures.evaluate(group, requested, mode_seed);
        let asked = &first.scenario.provenance.guidance.roles;
        let asked_to_collide = first.asks_for_collision();
        let figures = |samples: &[Scene], whole: Option<&[&Scene]>| {
            let alone = SampleGroup::equally_likely(&recorded, samples);
            evaluate(&SampleGroup { whole, asked, asked_to_collide, ..alone }, None)
        };
        let probabilities = self.probabilities();
        let together = SampleGroup {
            recorded: &recorded,
            samples: &samples,
            whole,
            probabilities: probabilities.as_deref(),
            asked,
            asked_to_collide,
        };
        let baseline = constant_velocity(&recorded);
        // Guided samples are not forecasts, and tell nothing of how likely the recording is.
        let n_forecasts = if first.scenario.provenance.is_unguided() { samples.len() } else { 0 };
        let one = std::slice::from_ref;
        let has_road = judge.sees_road(&recorded);
        let [by_itself, by_baseline, by_samples, undefined] =
            measures.likelihoods(&recorded, has_road, [one(&recorded), one(&baseline), &samples, &[]], n_forecasts);
        let reference = |scene: &Scene, likelihoods: Vec<Option<f64>>| {
            with_references.then(|| [figures(one(scene), None), likelihoods].concat())
        };
        CellFigures {
            recorded: reference(&recorded, by_itself),
            constant_velocity: reference(&baseline, by_baseline),
            together: [evaluate(&together, Some(self.mode_seed())), by_samples].concat(),
            alone: (samples.iter().enumerate())
                .map(|(i, sample)| [figures(one(sample), whole.map(|whole| &whole[i..=i])), undefined.clone()].concat())
                .collect(),
            assessments: self.records.iter().map(|record| judge.assess(record)).collect(),
            references_judged: with_references
                .then(|| [&recorded, &baseline].map(|scene| judge.judge_reference(scene))),
            tracks,
        }
    }
}

/// The sample with the tracks, and the timesteps if there is a future, of the recording that it continues.
fn as_far_as_recorded(sample: &Scene, recorded: &Scene) -> Scene {
    let n_timesteps = if recorded.has_future() { recorded.n_timesteps } else { sample.n_timesteps };
    if sample.n_timesteps == n_timesteps && sample.tracks.len() == recorded.tracks.len() {
        return sample.clone();
    }
    let within = |track: &Track| {
        let states = (0..n_timesteps).map(|timestep| track.trajectory.get(timestep).copied()).collect();
        Track { trajectory: Trajectory::new(states), ..track.clone() }
    };
    let tracks = sample.tracks.iter().take(recorded.tracks.len()).map(within).collect();
    Scene { tracks, n_timesteps, ..sample.clone() }
}

/// The scene with its observed states alone.
fn without_future(scene: Scene) -> Scene {
    let observed = |track: Track| {
        let states = track.trajectory.entries().iter().enumerate();
        let states = states.map(|(timestep, state)| state.filter(|_| timestep < scene.n_history)).collect();
        Track { trajectory: Trajectory::new(states), ..track }
    };
    Scene { tracks: scene.tracks.into_iter().map(observed).collect(), ..scene }
}

/// The recording without the futures of agents that were not generated (beyond the denoiser's number of agents), or
/// leave in a closed loop, so that recording, baseline and samples are measured on the same agents.
fn as_far_as_generated(recorded: &Scene, samples: &[Scene]) -> Scene {
    let n_history = recorded.n_history;
    let was_generated = |agent_idx: usize, track: &Track| {
        let mut later = track.trajectory.valid().filter(|(timestep, _)| *timestep >= n_history);
        later.all(|(timestep, _)| samples.iter().all(|sample| sample.state(agent_idx, timestep).is_some()))
    };
    let tracks = recorded.tracks.iter().enumerate().map(|(agent_idx, track)| {
        let mut track = track.clone();
        if !was_generated(agent_idx, &track) {
            let observed = |(timestep, state): (usize, &Option<_>)| state.filter(|_| timestep < n_history);
            track.trajectory = Trajectory::new(track.trajectory.entries().iter().enumerate().map(observed).collect());
        }
        track
    });
    Scene { tracks: tracks.collect(), ..recorded.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::testing::{record, recorded};
    use crate::geometry::Vec2;
    use crate::metrics::{Likelihoods, MetricSettings};
    use crate::scene::{GuidanceTag, Roles, State};

    #[test]
    fn who_is_asked_tells_cells_apart_and_references_are_measured_once_for_each() {
        let mut exchanged = record(2.0, false, false, recorded());
        exchanged.scenario.provenance.guidance.roles = Roles::from([("other", "2"), ("ego", "1")]);
        let asked = || record(2.0, false, false, recorded());
        let records = [asked(), record(0.0, false, false, recorded()), exchanged, asked()];
        let cells = into_cells(&records);
        let found: Vec<(usize, bool)> = cells.iter().map(|cell| (cell.records.len(), cell.with_references)).collect();
        assert_eq!(found, [(2, true), (1, false), (1, true)]);
    }

    #[test]
    fn a_closed_loop_is_compared_as_far_as_the_recording_goes_and_judged_as_a_whole() {
        let sampled = record(2.0, true, false, recorded());
        let mut driven = sampled.clone();
        let scene = &mut driven.scenario.scene;
        // Later the first car stops within a tenth of a second, the second one close behind, and a third one arrives.
        let last = scene.n_timesteps - 1;
        let stands = State { velocity: Vec2::ZERO, ..*scene.state(0, last).unwrap() };
        let along = Vec2::from_angle(stands.heading_rad);
        let follows = State { position: stands.position - along * 9.0, velocity: along * 5.0, ..stands };
        for (track, later) in scene.tracks.iter_mut().zip([stands, follows]) {
            let states = track.trajectory.entries().to_vec();
            track.trajectory = Trajectory::new([states, vec![Some(later); 30]].concat());
        }
        let mut arrival = scene.tracks[0].clone();
        arrival.id = crate::scene::TrackId("arrival".to_owned());
        scene.tracks.push(arrival);
        scene.n_timesteps += 30;
        let (agents, timesteps) = (scene.tracks.len(), scene.n_timesteps);
        driven.scenario.observed = crate::scene::ObservationMask::from_fn(agents, timesteps, |_, t| t <= 3);
        let settings = MetricSettings::default();
        let (measures, judge) = (Measures::new(&settings, None, &[]), Judge::without_recordings(&settings));
        let figures = |record: &ScenarioRecord| {
            CellSamples { records: vec![record], with_references: true }.evaluate(&recorded(), &measures, &judge)
        };
        let [short, long] = [&sampled, &driven].map(figures);
        // Only figures of samples alone are of the whole loop.
        let docs = measures.docs();
        let differ = |short: &[Option<f64>], long: &[Option<f64>]| -> Vec<String> {
            let all = docs.iter().zip(short.iter().zip(long));
            all.filter(|(_, (short, long))| short != long).map(|(doc, _)| doc.metric.clone()).collect()
        };
        let of_whole = ["pair_min_headway_s", "pair_pet_s", "preventable_rate"];
        assert_eq!(differ(&short.together, &long.together), of_whole);
        assert_eq!(differ(&short.alone[0], &long.alone[0]), of_whole);
        assert_eq!(short.recorded, long.recorded);
        assert!(short.tracks == long.tracks);
        assert!(long.assessments[0].violations.len() > short.assessments[0].violations.len());
    }

    #[test]
    fn likelihoods_are_those_of_several_forecasts() {
        let of = |n_samples: usize, kind: &str, place_without_road: &str| {
            let mut settings = MetricSettings::default();
            settings.map_gaps.places.insert(place_without_road.to_owned());
            let (measures, judge) = (Measures::new(&settings, None, &[]), Judge::without_recordings(&settings));
            let mut record = record(0.0, false, false, recorded());
            record.scenario.provenance.guidance.kind = kind.to_owned();
            let cell = CellSamples { records: vec![&record; n_samples], with_references: true };
            let figures = cell.evaluate(&recorded(), &measures, &judge);
            let docs = measures.docs();
            let find = |values: &[Option<f64>], name: &str| {
                assert_eq!(docs.len(), values.len());
                docs.iter().zip(values).find(|(doc, _)| doc.metric == name).and_then(|(_, value)| *value)
            };
            let whole = |values: &[Option<f64>]| find(values, Likelihoods::META_METRIC);
            assert!(figures.alone.iter().all(|values| whole(values).is_none()));
            let road = find(&figures.together, "realism_map_based");
            (
                [&figures.recorded.unwrap(), &figures.constant_velocity.unwrap(), &figures.together]
                    .map(|of| whole(of)),
                road,
            )
        };
        let ([by_itself, by_baseline, by_samples], road) = of(2, GuidanceTag::NONE, "elsewhere");
        // Both cars go straight on at constant speed, and the samples do as recorded.
        assert!(by_itself.is_some() && by_itself == by_samples && by_itself == by_baseline && road.is_some());
        assert_eq!(of(1, GuidanceTag::NONE, "elsewhere"), ([None; 3], None));
        assert_eq!(of(2, "classifier:cut_in", "elsewhere"), ([None; 3], None));
        let (blind, road) = of(2, GuidanceTag::NONE, "Test");
        assert!(road.is_none() && blind[0].is_some());
    }
}
