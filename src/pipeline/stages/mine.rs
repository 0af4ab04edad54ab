//! Scenes to an event table and to rates: the detectors run on every scene, in parallel, and their events are kept in
//! order.

use crate::behavior::{self, Behavior, BehaviorConfig, BehaviorEntry, BehaviorEvent};
use crate::coverage::{TaggedScene, Tags};
use crate::engine::{Failure, Result, Stage, StageContext, StageInput, StageKind, Whole, Work};
use crate::evaluate::MiningTally;
use crate::pipeline::StageId;
use crate::pipeline::layout::{EVENTS, EXPOSURE, Layout, MINE_SUMMARY, OCCURRENCES, RATES, TAGS};
use crate::progress::Progress;
use crate::rates::{ExposureRow, ExposureTally, Numbered, OccurrenceTally, SceneExposure, Within};
use crate::scene::Scene;
use crate::settings::Issue;
use crate::store::{EventWriter, SceneStore, read_recorded_traffic, write_json_atomically, write_table};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};

/// Scenes that are mined together: enough for every thread, few enough to show progress and to hold their events in
/// memory.
const SCENES_PER_CHUNK: usize = 256;

/// Which behaviors to mine.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MineConfig {
    /// The behaviors with their definitions; empty: all known ones, by their default definitions.
    pub behaviors: Vec<BehaviorConfig>,
    /// Buckets of events whose rates are counted beside those of all events of a behavior.
    pub rates: Vec<RateBucket>,
}

/// Events of a behavior with parameters in certain ranges.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RateBucket {
    /// The behavior.
    pub behavior: String,
    /// The ranges of its parameters, the lower end included: `{ gap_m = [0, 5] }`.
    pub within: Within,
}

impl MineConfig {
    /// The buckets whose rates are counted.
    pub(super) fn buckets(&self) -> Vec<(String, Within)> {
        self.rates.iter().map(|bucket| (bucket.behavior.clone(), bucket.within.clone())).collect()
    }

    /// The detectors.
    ///
    /// # Errors
    /// When a behavior is listed twice: their events could not be distinguished.
    pub fn build(&self) -> Result<Vec<Box<dyn Behavior>>> {
        let mut configs = self.behaviors.clone();
        if configs.is_empty() {
            configs = behavior::ALL.iter().map(|entry| (entry.default_config)()).collect();
        }
        for (idx, config) in configs.iter().enumerate() {
            let within = |issue: Issue| Failure::input(issue.within(&format!("mine.behaviors.{idx}")));
            config.validate().map_err(within)?;
            if configs[..idx].iter().any(|earlier| earlier.id() == config.id()) {
                let message = format!("mine.behaviors.{idx}: {} is listed twice", config.id());
                return Err(Failure::input_message(message));
            }
        }
        for (idx, RateBucket { behavior, within }) in self.rates.iter().enumerate() {
            let refuse = |issue: Issue| Failure::input(issue.within(&format!("mine.rates.{idx}")));
            let is_mined = configs.iter().any(|config| config.id() == behavior);
            let entry = BehaviorEntry::of(behavior).filter(|_| is_mined).ok_or_else(|| {
                let mined: Vec<&str> = configs.iter().map(BehaviorConfig::id).collect();
                Issue::new("behavior", format_args!("is {behavior}, expected one of {}", mined.join(", ")))
            });
            entry.and_then(|entry| within.validate(entry.parameters)).map_err(refuse)?;
        }
        Ok(configs.iter().map(BehaviorConfig::build).collect())
    }
}

/// The stage.
pub struct Mine<'a> {
    /// Its section.
    pub config: &'a MineConfig,
    /// Where the scenes are.
    pub layout: &'a Layout,
}

impl Stage for Mine<'_> {
    fn kind(&self) -> &'static StageKind {
        StageId::Mine.kind()
    }

    fn version(&self) -> u32 {
        17
    }

    fn check(&self) -> Result<()> {
        self.config.build().map(drop)
    }

    fn config(&self) -> anyhow::Result<Value> {
        Ok(serde_json::to_value(self.config)?)
    }

    fn inputs(&self) -> Vec<StageInput> {
        vec![StageInput::made_by(StageId::Ingest, "scenes", &self.layout.scenes)]
    }

    fn work(&self) -> Work<'_> {
        Work::Whole(self)
    }
}

impl Whole for Mine<'_> {
    fn run(&self, context: &StageContext<'_>) -> Result<Value> {
        let behaviors = self.config.build()?;
        let store = SceneStore::open(&self.layout.scenes)?;
        let scenes: Vec<usize> = (0..store.len()).collect();
        let ids: Vec<&str> = behaviors.iter().map(|behavior| behavior.id()).collect();
        let mut tally = MiningTally::new(&ids);
        let entries = behavior::ALL.iter().filter(|entry| ids.contains(&entry.id));
        let mut writer = EventWriter::new(&context.root.join(EVENTS), entries.clone());
        let mut counting = Counting::new(EventWriter::new(&context.root.join(OCCURRENCES), entries));
        let mut tagged: Vec<TaggedScene> = Vec::new();
        context.progress.start("mine", scenes.len() as u64, "scenes");
        let has = [AtomicBool::new(false), AtomicBool::new(false)];
        let search_all = |chunk: &[usize]| -> Result<Vec<_>> {
            chunk.par_iter().map(|idx| Ok(search(&store.scene(*idx)?, &behaviors, &has))).collect()
        };
        // The events of a chunk are written while the next one is searched.
        let mut found: Vec<BehaviorEvent> = Vec::new();
        for chunk in scenes.chunks(SCENES_PER_CHUNK) {
            let (next, written) = rayon::join(|| search_all(chunk), || writer.write(&found));
            written?;
            let by_scene = next?;
            found.clear();
            for (idx, (scene, tags, events)) in chunk.iter().zip(by_scene) {
                let entry = store.index().get(*idx);
                tally.add(entry, &events);
                let observed_h = counting.add(&scene, &events);
                tagged.extend(observed_h.map(|observed_h| TaggedScene {
                    scene_id: entry.id.into(),
                    place: entry.place.to_owned(),
                    split: entry.split,
                    tags,
                    observed_h,
                }));
                found.extend(events);
            }
            counting.write()?;
            context.progress.advance(chunk.len() as u64);
            context.progress.note(&tally.words());
        }
        writer.write(&found)?;
        context.progress.finish();
        warn_of_blind(&behaviors, has.map(AtomicBool::into_inner), context.progress);
        writer.finish()?;
        write_table(&context.root.join(TAGS), tagged.into_iter().map(Ok))?;
        let [exposure, occurrences] = [EXPOSURE, OCCURRENCES].map(|name| context.root.join(name));
        write_table(&exposure, counting.finish()?.into_iter().map(Ok))?;
        let traffic = read_recorded_traffic(&exposure, &occurrences)?;
        write_table(&context.root.join(RATES), traffic.rates(&ids, &self.config.buckets()).into_iter().map(Ok))?;
        let n_events = tally.n_events();
        let summary = tally.finish();
        write_json_atomically(&context.root.join(MINE_SUMMARY), &summary)?;
        let n_positive = |id: &str| -> u64 {
            summary.counts.iter().filter(|count| count.behavior == id).map(|count| count.n_positive).sum()
        };
        let n_positive: BTreeMap<&str, u64> = ids.iter().map(|id| (*id, n_positive(id))).collect();
        Ok(json!({ "n_scenes": scenes.len(), "n_events": n_events, "n_positive": n_positive }))
    }
}

/// The exposure, the tags and the events of a scene; notes whether it has lanes and sizes.
fn search(
    scene: &Scene,
    behaviors: &[Box<dyn Behavior>],
    [has_lanes, has_sizes]: &[AtomicBool; 2],
) -> (SceneExposure, Tags, Vec<BehaviorEvent>) {
    has_lanes.fetch_or(!scene.lanes.is_empty(), Ordering::Relaxed);
    has_sizes.fetch_or(scene.tracks.iter().any(|track| track.extent.is_some()), Ordering::Relaxed);
    let found = behaviors.iter().flat_map(|behavior| behavior.detect(scene));
    (SceneExposure::of(scene), Tags::of(scene), found.filter(|event| !event.is_of_parked(scene)).collect())
}

/// Counts every moment and every event once.
struct Counting<'n> {
    exposure: ExposureTally,
    occurrences: OccurrenceTally,
    writer: EventWriter<'n>,
    pending: Vec<Numbered>,
}

impl<'n> Counting<'n> {
    fn new(writer: EventWriter<'n>) -> Self {
        let (exposure, occurrences) = (ExposureTally::default(), OccurrenceTally::default());
        Self { exposure, occurrences, writer, pending: Vec::new() }
    }

    /// Counts a scene. Returns the time that no scene before it shows, hours; `None` if it was not recorded.
    fn add(&mut self, scene: &SceneExposure, events: &[BehaviorEvent]) -> Option<f64> {
        let shown = self.exposure.add(scene)?;
        self.pending.extend(self.occurrences.add(scene, shown, events, &self.exposure));
        Some(shown.new_h)
    }

    /// Writes the events that no later scene can show.
    fn write(&mut self) -> Result<()> {
        let (events, numbers): (Vec<_>, Vec<_>) = std::mem::take(&mut self.pending).into_iter().unzip();
        Ok(self.writer.write_numbered(&events, &numbers)?)
    }

    /// Writes the last events, and returns what recordings show.
    fn finish(mut self) -> Result<Vec<ExposureRow>> {
        self.pending = std::mem::take(&mut self.occurrences).finish();
        self.write()?;
        self.writer.finish()?;
        Ok(self.exposure.rows())
    }
}

/// Warns of behaviors that cannot be found in scenes without lanes, or without sizes.
fn warn_of_blind(behaviors: &[Box<dyn Behavior>], [has_lanes, has_sizes]: [bool; 2], progress: &dyn Progress) {
    for behavior in behaviors {
        let id = behavior.id();
        if !has_lanes && BehaviorEntry::of(id).is_some_and(|entry| entry.needs_lanes) {
            progress.warn(&format!(
                "{id} needs lanes, but no scene has any: ingest with maps, or leave it out of mine.behaviors"
            ));
        }
        if !has_sizes && behavior.needs_sizes() {
            progress.warn(&format!(
                "{id} needs road users of recorded size, but no scene has any: set recorded_sizes = false, or leave it \
                 out of mine.behaviors"
            ));
        }
    }
}
