//! The drawings of one scene, and the keys by which it can be found.

mod drawn;
mod of_drives;
mod of_records;
mod packed;
mod view;

pub use drawn::{DrawnAgent, DrawnLane, DrawnSample, Light, ScenePanel};
pub(super) use packed::{pack_lanes, pack_sample};
pub use view::ViewRect;

use super::accepted::HARDNESS;
use super::model::Fact;
use crate::metrics::closeness_over_time;
use crate::scene::{GuidanceLevel, ObservationMask, Roles, Scene};
use crate::settings::named;

/// Drawings of one scene side by side, at one scale: the recording and its generated continuations.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneCard {
    /// Unique within the report, such as the scenario's id.
    pub id: String,
    /// A short title.
    pub title: String,
    /// Its keys for filters.
    pub key: CardKey,
    /// Provenance, verdict, parameters of the event.
    pub facts: Vec<Fact>,
    /// The visible part of the scene frame.
    pub view: ViewRect,
    /// The lanes in view.
    pub lanes: Vec<DrawnLane>,
    /// The drawings, the recording first.
    pub panels: Vec<ScenePanel>,
    /// Time to collision (seconds) and distance (meters) of the two agents with roles in the only sample, at each
    /// timestep of the future; empty unless exactly two have roles.
    pub closeness: Vec<[Option<f64>; 2]>,
}

/// The keys of a scene for filters.
#[derive(Debug, Clone, PartialEq)]
pub struct CardKey {
    /// The sweep's name.
    pub sweep: String,
    /// The requested behavior.
    pub behavior: Option<String>,
    /// The bucket of a request that accepted it.
    pub bucket: Option<CardBucket>,
    /// The place of the recording.
    pub place: String,
    /// The verdict on the requested behavior.
    pub verdict: Verdict,
    /// Whether it was accepted, and why not; `None` if that was not decided, and for several samples.
    pub acceptance: Option<Acceptance>,
    /// The level of its guidance.
    pub level: GuidanceLevel,
    /// Parameters of the event and metrics of the scenario; means for several samples.
    pub values: Vec<CardValue>,
}

impl CardKey {
    /// Whether the scenario was accepted.
    pub fn is_accepted(&self) -> bool {
        self.acceptance.as_ref().is_some_and(Acceptance::is_accepted)
    }

    /// The figure with this name.
    pub fn value(&self, name: &str) -> Option<f64> {
        self.values.iter().find(|found| found.name == name).map(|found| found.value)
    }

    /// The key by which scenes are sorted: accepted ones first, by their shortest time to collision, seconds.
    pub(super) fn rank_s(&self) -> f64 {
        /// More than any time to collision.
        const WITHOUT_S: f64 = 1e6;
        if self.is_accepted() { self.value(HARDNESS).unwrap_or(WITHOUT_S) } else { f64::INFINITY }
    }
}

/// A bucket of a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CardBucket {
    /// Name of the request.
    pub request: String,
    /// Index of the bucket among those of the request.
    pub idx: usize,
    /// Its ranges: `gap_m 0..5, relative_speed_mps -5..0`.
    pub ranges: String,
}

impl CardBucket {
    /// The request and the ranges of the bucket.
    pub fn words(&self) -> String {
        format!("{}: {}", self.request, self.ranges)
    }
}

/// A figure of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct CardValue {
    /// Its name in the tables, such as `gap_m`.
    pub name: String,
    /// The value, in the unit that ends the name.
    pub value: f64,
}

/// Whether a scenario was accepted: verified, valid and no near-duplicate.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Acceptance {
    /// Why it was not accepted, such as `near_duplicate`; empty if it was.
    pub reasons: Vec<String>,
}

impl Acceptance {
    /// Whether it was accepted.
    pub fn is_accepted(&self) -> bool {
        self.reasons.is_empty()
    }

    /// The decision in words: `rejected: jerk, near duplicate`.
    pub fn words(&self) -> String {
        match self.reasons.as_slice() {
            [] => "accepted".to_owned(),
            reasons => format!("rejected: {}", reasons.join(", ").replace('_', " ")),
        }
    }
}

/// The verdict on the requested behavior.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// Verified, and not in the recording.
    New,
    /// Verified, and also in the recording.
    Recorded,
    /// The miner does not find it.
    NotVerified,
    /// No behavior was requested.
    NotAsked,
}

named! { Verdict { New = "new", Recorded = "recorded", NotVerified = "not_verified", NotAsked = "not_asked" } }

impl Verdict {
    /// The verdict in words.
    pub const fn words(self) -> &'static str {
        match self {
            Self::New => "verified, and not in the recording",
            Self::Recorded => "verified; also in the recording",
            Self::NotVerified => "not verified",
            Self::NotAsked => "no behavior requested",
        }
    }
}

/// A generated scene with its mask.
#[derive(Debug, Clone, Copy)]
pub struct Sample<'a> {
    /// Its name, such as `sample 4`.
    pub name: &'a str,
    /// The scene, in the frame of its recording.
    pub scene: &'a Scene,
    /// Which of its states were observed.
    pub observed: &'a ObservationMask,
}

impl SceneCard {
    /// Draws `recorded` and, overlaid, `samples` of its future with `roles` highlighted; the view follows the tracks
    /// with roles, or the ego if there are none. A recording alone, without roles, is in view with all of its tracks.
    pub fn new(
        (id, title): (String, String),
        key: CardKey,
        facts: Vec<Fact>,
        recorded: &Scene,
        samples: &[Sample<'_>],
        roles: &Roles,
    ) -> Self {
        let ego = Roles::from_iter([("ego".to_owned(), recorded.ego().id.clone())]);
        let (is_alone, given) = (samples.is_empty(), roles);
        let roles = if roles.is_empty() { &ego } else { roles };
        let scenes: Vec<&Scene> = std::iter::once(recorded).chain(samples.iter().map(|sample| sample.scene)).collect();
        let view = ViewRect::around(&scenes, if is_alone { given } else { roles });
        let lanes = DrawnLane::all(recorded, &view);
        let panel = |title: String, is_recorded: bool, samples: Vec<DrawnSample>| ScenePanel {
            title,
            is_recorded,
            dt_s: recorded.dt_s,
            n_history: recorded.n_history,
            samples,
        };
        let history = ObservationMask::predictive(recorded.tracks.len(), recorded.n_timesteps, recorded.n_history);
        // Not all that is continued was recorded.
        let before = recorded.source.situation.name();
        let recording = DrawnSample::of(before, recorded, &history, roles, &view);
        let mut panels = vec![panel(before.to_owned(), true, vec![recording])];
        let title_of_samples = match samples {
            [] => None,
            [one] => Some(format!("generated, {}", one.name)),
            many => Some(format!("generated, {} samples overlaid", many.len())),
        };
        let drawn = samples.iter().map(|s| DrawnSample::of(s.name, s.scene, s.observed, roles, &view)).collect();
        panels.extend(title_of_samples.map(|title| panel(title, false, drawn)));
        let closeness = match samples {
            [Sample { scene, .. }] => pair(scene, roles).and_then(|pair| closeness_over_time(scene, pair)),
            _ => None,
        };
        let closeness = closeness.unwrap_or_default();
        Self { id, title, key, facts, view, lanes, panels, closeness }
    }

    /// The roles of all panels, sorted: their order decides their colors.
    pub(super) fn roles(&self) -> Vec<&str> {
        let agents = self.panels.iter().flat_map(|panel| &panel.samples).flat_map(|sample| &sample.agents);
        let mut roles: Vec<&str> = agents.filter_map(|agent| agent.role.as_deref()).collect();
        roles.sort_unstable();
        roles.dedup();
        roles
    }
}

/// The indices of the two agents that have roles; `None` unless there are exactly two.
fn pair(scene: &Scene, roles: &Roles) -> Option<[usize; 2]> {
    let pair: Vec<usize> = roles.tracks().filter_map(|track| scene.track_idx(track)).collect();
    pair.try_into().ok()
}
