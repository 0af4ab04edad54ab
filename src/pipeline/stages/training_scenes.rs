//! The scenes of one or several stores, as the data of a training.

use super::held_out::TrainingScenes;
use crate::engine::Failure;
use crate::engine::Result as StageResult;
use crate::engine::fingerprint_value;
use crate::model::DenoiserSpec;
use crate::nn::Checkpoint;
use crate::pipeline::layout::{Layout, SCENES};
use crate::progress::Progress;
use crate::scene::{Scene, Split};
use crate::store::{SceneManifest, SceneStore};
use crate::train::{
    MoreScenes, OwnScenes, SceneChoice, SceneDataset, TrainJob, TrainOutcome, TrainingData, TrainingSource,
    calibrate_denoiser,
};
use serde_json::{Value, json};
use std::path::Path;

impl SceneDataset for SceneStore {
    fn scene(&self, idx: usize) -> Result<Scene, Box<dyn std::error::Error + Send + Sync>> {
        Ok(Self::scene(self, idx)?)
    }
}

/// The scenes from which a training draws: those of the run, and of others.
pub(super) struct OpenedScenes {
    section: &'static str,
    sources: Vec<OpenedSource>,
}

/// An ingest, and the part of it to train on.
struct OpenedSource {
    /// Its name for the user: its key, or the run's own scenes.
    name: String,
    store: SceneStore,
    /// Index of its first scene among those of all sources.
    first: usize,
    weight: f64,
    chosen: TrainingScenes,
}

impl SceneDataset for OpenedScenes {
    fn scene(&self, idx: usize) -> Result<Scene, Box<dyn std::error::Error + Send + Sync>> {
        let source = self.sources.iter().rfind(|source| source.first <= idx).ok_or("there are no scenes")?;
        Ok(source.store.scene(idx - source.first)?)
    }
}

impl OpenedScenes {
    /// Opens the run's `own` scenes, unless they have no weight, and the chosen others.
    pub(super) fn open(choice: SceneChoice<'_>, own: &Path, progress: &dyn Progress) -> StageResult<Self> {
        let SceneChoice { section, own: chosen, own_weight, data } = choice;
        let own = (own_weight > 0.0).then(|| ("the ingest of this run".to_owned(), own, own_weight, chosen));
        let more = data.iter().enumerate().map(|(i, MoreScenes { scenes, weight })| {
            (format!("{section}.data.{i}"), scenes.as_path(), *weight, OwnScenes::default())
        });
        let mut sources: Vec<OpenedSource> = Vec::new();
        for (name, path, weight, chosen) in own.into_iter().chain(more) {
            let first = sources.last().map_or(0, |last| last.first + last.store.len());
            let store = SceneStore::open(path)?;
            let chosen = TrainingScenes::of(&store, chosen, progress)?;
            sources.push(OpenedSource { name, store, first, weight, chosen });
        }
        Ok(Self { section, sources })
    }

    /// The held-out scenes of the first source, by their position in its store.
    pub(super) fn held_out(&self) -> Option<(&SceneStore, &[usize])> {
        self.sources.first().map(|source| (&source.store, source.chosen.held_out.as_slice()))
    }

    /// The scenes for a denoiser that was trained already.
    pub(super) fn data_of(&self, denoiser: &DenoiserSpec) -> StageResult<TrainingData<'_>> {
        self.training_data(Some(denoiser.normalizer.state_dim), denoiser.network.geometry.is_some())
    }

    /// The scenes to train on and the held-out ones. `state_dim` defaults to that of the datasets. Only a network that
    /// derives headings can learn from vehicles with recorded headings and from others at once.
    pub(super) fn training_data(
        &self,
        state_dim: Option<usize>,
        derives_headings: bool,
    ) -> StageResult<TrainingData<'_>> {
        let mut sources: Vec<TrainingSource> = Vec::new();
        let mut has_headings = Vec::new();
        for source in &self.sources {
            let Some(first) = source.chosen.train.first() else {
                let message = format_args!("{} has no scene to train on in train.splits and train.places", source.name);
                return Err(Failure::input_message(message));
            };
            has_headings.push(source.store.index().get(*first).dataset.facts().has_headings);
            let n_places = sources.iter().flat_map(|source| &source.places).max().map_or(0, |last| last + 1);
            sources.push(source.training_source(n_places));
        }
        self.check_shapes(&sources)?;
        // If headings are derived from positions, those of samples are, too.
        let state_dim = state_dim.unwrap_or(if has_headings.contains(&true) { 3 } else { 2 });
        let without = has_headings.iter().position(|has| !has).filter(|_| has_headings.contains(&true));
        if let Some(without) = without.filter(|_| state_dim == 3 && !derives_headings) {
            let message = format_args!(
                "{} has no recorded headings, but other scenes of {} do; this network cannot train on both",
                self.sources[without].name, self.section
            );
            return Err(Failure::input_message(message).with_hint(
                "set state_dim = 2, and headings follow from the motion; or train a denoiser with network.geometry",
            ));
        }
        Ok(TrainingData { fingerprint: self.fingerprint()?, dataset: self, sources, state_dim })
    }

    /// Refuses sources whose scenes have another shape than those of the first one.
    fn check_shapes(&self, sources: &[TrainingSource]) -> StageResult<()> {
        let mut expected: Option<(usize, usize, f64)> = None;
        for (opened, source) in self.sources.iter().zip(sources) {
            let scene = opened.store.scene(source.train[0] - opened.first)?;
            let found = (scene.n_history, scene.n_timesteps - scene.n_history, scene.dt_s);
            let expected = *expected.get_or_insert(found);
            if found != expected {
                let words = |(n_history, n_future, dt_s)| format!("{n_history} + {n_future} timesteps of {dt_s} s");
                return Err(Failure::input_message(format_args!(
                    "{} has scenes of {}, expected {} as in {}",
                    opened.name,
                    words(found),
                    words(expected),
                    self.sources[0].name
                ))
                .with_hint(format!("ingest it with n_history = {} and n_future = {}", expected.0, expected.1)));
            }
        }
        Ok(())
    }

    /// Hash of the scenes and their mixture; that of the store if there is only one.
    fn fingerprint(&self) -> StageResult<String> {
        let mixed: Vec<_> = self.sources.iter().map(|source| (source.store.fingerprint(), source.weight)).collect();
        Ok(match mixed.as_slice() {
            [(fingerprint, _)] => (*fingerprint).to_owned(),
            _ => fingerprint_value(&mixed)?,
        })
    }
}

impl OpenedSource {
    /// The chosen scenes, whose places are numbered from `first_place`.
    fn training_source(&self, first_place: usize) -> TrainingSource {
        let TrainingScenes { train, held_out, .. } = &self.chosen;
        let place = |idx: &usize| self.store.index().get(*idx).place;
        let mut names: Vec<&str> = train.iter().map(place).collect();
        names.sort_unstable();
        names.dedup();
        let number = |idx: &usize| first_place + names.partition_point(|other| *other < place(idx));
        let among_all = |scenes: &[usize]| scenes.iter().map(|idx| self.first + idx).collect();
        TrainingSource {
            weight: self.weight,
            places: train.iter().map(number).collect(),
            train: among_all(train),
            held_out: among_all(held_out),
        }
    }
}

/// Refuses splits without futures, folders of other runs without ingested scenes, and the run's own folder among them.
pub(super) fn check_folders(
    SceneChoice { section, own: OwnScenes { splits, .. }, own_weight, data }: SceneChoice<'_>,
    own: &Path,
) -> StageResult<()> {
    if own_weight > 0.0 && !splits.is_empty() && splits.iter().all(|split| *split == Split::Test) {
        let message = "train.splits is [\"test\"], whose scenes have no futures to learn from";
        return Err(Failure::input_message(message).with_hint("add \"train\", \"val\" or \"unsplit\""));
    }
    let is_same = |one: &Path, other: &Path| {
        one.canonicalize().is_ok_and(|one| other.canonicalize().is_ok_and(|other| one == other))
    };
    for (i, MoreScenes { scenes, .. }) in data.iter().enumerate() {
        let refuse = |why: &str, hint: String| {
            let message = format!("{section}.data.{i}.scenes is {}, {why}", scenes.display());
            Err(Failure::input_message(message).with_hint(hint))
        };
        if let Err(error) = SceneManifest::read(scenes) {
            let inside = scenes.join(SCENES);
            let hint = match SceneManifest::read(&inside) {
                Ok(_) => format!("name {}", inside.display()),
                Err(_) => {
                    "`djinn ingest` makes such folders; relative paths are relative to the pipeline file".to_owned()
                }
            };
            return refuse(&format!("expected a folder of ingested scenes: {error}"), hint);
        }
        if is_same(scenes, own) {
            return refuse("the run's own scenes", format!("remove the entry, and set {section}.own_weight"));
        }
        if data[..i].iter().any(|earlier| is_same(scenes, &earlier.scenes)) {
            return refuse("as in an earlier entry", "list it once, with the sum of the weights".to_owned());
        }
    }
    Ok(())
}

/// The part of a training stage's summary that all trainings share.
pub(super) fn training_summary<S>(data: &TrainingData<'_>, steps: u64, outcome: &TrainOutcome<S>) -> Value {
    json!({
        "fingerprint": outcome.fingerprint,
        "steps": steps,
        "trained": true,
        "n_parameters": outcome.n_parameters,
        "n_train_scenes": data.n_train(),
        "n_held_out_scenes": data.n_held_out(),
        "last_evaluation": outcome.statistics.iter().rev().find(|line| !line.evaluation.is_empty()),
    })
}

/// Calibrates a denoiser on the chosen scenes ([`calibrate_denoiser`]).
pub(super) fn calibrate(
    checkpoint: &Checkpoint<DenoiserSpec>,
    choice: SceneChoice<'_>,
    layout: &Layout,
    job: TrainJob<'_>,
) -> StageResult<String> {
    let scenes = OpenedScenes::open(choice, &layout.scenes, job.progress)?;
    Ok(calibrate_denoiser(checkpoint, &scenes.data_of(&checkpoint.metadata)?, job)?)
}
