//! CommonRoad scenarios, versions 2018b and 2020a: one XML file with lanelets and obstacles.
//!
//! The scenes of a file are windows of its time steps, [`IngestConfig::window_stride`] apart. The vehicle of its
//! planning problem is not among the obstacles, and is left out.

mod map;
mod shape;
#[cfg(test)]
mod tests;
mod tracks;

use super::config::IngestConfig;
use super::map_text::read_text;
use super::pairing::{PairNames, PairReader};
use super::raw::{Finding, RawScene, RawUnit, Reject, map_id};
use super::source::{Horizon, PendingScene, RecordingSource, UnitReader};
use super::xml_tree::Element;
use crate::scene::{Dataset, LaneGraph, SceneId, SceneSource};
use std::sync::Arc;
use tracks::{Obstacle, Obstacles};

/// One second of past and three of future, as in INTERACTION.
const USUAL: Horizon = Horizon { n_history: 10, n_future: 30 };
/// Time between timesteps, seconds; scenarios with another one are left out.
const DT_S: f64 = 0.1;
const VERSIONS: [&str; 3] = ["2018a", "2018b", "2020a"];
/// Larger than any scenario.
const MAX_BYTES: u64 = 64 << 20;

pub(super) struct CommonRoad<'a> {
    config: &'a IngestConfig,
    horizon: Horizon,
}

impl<'a> CommonRoad<'a> {
    pub(super) fn new(config: &'a IngestConfig) -> Self {
        Self { config, horizon: Horizon::of(config, USUAL) }
    }
}

impl RecordingSource for CommonRoad<'_> {
    fn horizon(&self) -> Horizon {
        self.horizon
    }

    fn is_recording(&self, path: &str) -> bool {
        path.ends_with(".xml") && self.config.wants_path(path)
    }

    fn pattern(&self) -> &'static str {
        "*.xml"
    }

    fn unit_reader(&self) -> Box<dyn UnitReader + '_> {
        Box::new(PairReader::new(PairNames::single("*.xml")))
    }

    fn parse(&self, unit: RawUnit) -> Vec<PendingScene<'_>> {
        match Scenario::read(unit) {
            Ok(scenario) => scenario.windows(self.horizon, self.config.window_stride),
            Err(reject) => vec![Box::new(|| Err(reject))],
        }
    }

    fn has_own_maps(&self) -> bool {
        true
    }
}

/// A scenario as read from its file.
struct Scenario {
    /// The unit it comes from, without the text.
    unit: RawUnit,
    place: String,
    version: String,
    map: Option<Arc<LaneGraph>>,
    obstacles: Vec<Obstacle>,
    findings: Vec<Finding>,
}

impl Scenario {
    fn read(mut unit: RawUnit) -> Result<Self, Reject> {
        let text = read_text(&mut unit.bytes.as_slice(), MAX_BYTES, &unit.file);
        let text = text.map_err(|error| Reject { reason: "bad_xml", detail: error.to_string() })?;
        let root = Element::parse(&text).map_err(|what| unit.reject("bad_xml", what))?;
        if root.name != "commonRoad" {
            let detail = format!("begins with <{}>, expected <commonRoad>", root.name);
            return Err(unit.reject("not_commonroad", detail));
        }
        let step_s = root.attribute("timeStepSize").and_then(|text| text.parse::<f64>().ok());
        if !step_s.is_some_and(|step_s| (step_s - DT_S).abs() <= 1e-9) {
            let found = root.attribute("timeStepSize").unwrap_or("missing");
            return Err(unit.reject("other_time_step", format!("timeStepSize is {found}, expected {DT_S} s")));
        }
        unit.bytes = Vec::new();
        if let Some(id) = root.attribute("benchmarkID").filter(|id| !id.is_empty()) {
            unit.case_id = id.to_owned();
        }
        let vicinity = map::vicinity_of(&root);
        let (map, report) = map::read(&root, vicinity);
        let Obstacles { read: obstacles, left_out, ignored } = tracks::read(&root, vicinity);
        let mut findings = report.findings(&unit.file);
        let version = root.attribute("commonRoadVersion").unwrap_or_default();
        if !VERSIONS.contains(&version) {
            let detail = format!(
                "{}: commonRoadVersion is \"{version}\", expected one of {}; read as if it were",
                unit.file,
                VERSIONS.join(", ")
            );
            findings.push(Finding { what: "unknown_versions", n: 1, detail });
        }
        for (what, elements) in [("obstacles_left_out", left_out), ("predicted_obstacles_ignored", ignored)] {
            if let Some(first) = elements.first() {
                findings.push(Finding { what, n: elements.len() as u64, detail: format!("{}: {first}", unit.file) });
            }
        }
        Ok(Self {
            place: place_of(&unit.case_id),
            version: version.to_owned(),
            map: (!map.lanes().is_empty()).then(|| Arc::new(map)),
            obstacles,
            findings,
            unit,
        })
    }

    /// Its scenes: whole windows only.
    fn windows(mut self, horizon: Horizon, stride: usize) -> Vec<PendingScene<'static>> {
        let (n_timesteps, stride) = (horizon.n_timesteps() as i64, stride.max(1) as i64);
        let n_steps = tracks::time_steps(&self.obstacles).map_or(0, |(first, last)| last - first + 1);
        if n_steps < n_timesteps {
            let (reason, mut detail) = match n_steps {
                0 => (
                    "no_obstacles",
                    "has no obstacle that moves and can be read; its planning problems are not read".to_owned(),
                ),
                _ => ("recording_too_short", horizon.too_long_for(n_steps, "time steps")),
            };
            // They may say why.
            for Finding { what, n, detail: of_finding } in &self.findings {
                detail += &format!("; {n} {}: {of_finding}", what.replace('_', " "));
            }
            let reject = self.unit.reject(reason, detail);
            return vec![Box::new(|| Err(reject))];
        }
        let first = tracks::time_steps(&self.obstacles).map_or(0, |(first, _)| first);
        // Findings belong to the file, and are counted once.
        let mut findings = std::mem::take(&mut self.findings);
        let scenario = Arc::new(self);
        let window = |index: i64| -> PendingScene<'static> {
            let (scenario, findings) = (Arc::clone(&scenario), std::mem::take(&mut findings));
            Box::new(move || Ok(RawScene { findings, ..scenario.scene(first + index * stride, horizon) }))
        };
        (0..=(n_steps - n_timesteps) / stride).map(window).collect()
    }

    fn scene(&self, first: i64, horizon: Horizon) -> RawScene {
        let (dataset, n_timesteps) = (Dataset::CommonRoad, horizon.n_timesteps());
        let split = self.unit.split.of_scene();
        let case_id = &self.unit.case_id;
        RawScene {
            id: SceneId(format!("{}/{}/{}/{case_id}@{first}", dataset.name(), split.name(), self.place)),
            source: SceneSource {
                version: self.version.clone(),
                ..self.unit.source(dataset, split, self.place.clone(), case_id.clone(), first.to_string())
            },
            dt_s: DT_S,
            n_timesteps,
            n_history: horizon.n_history,
            tracks: self.obstacles.iter().filter_map(|obstacle| obstacle.cut(first, horizon)).collect(),
            heading_gaps: Vec::new(),
            map_id: map_id(dataset, case_id),
            own_map: self.map.clone(),
            findings: Vec::new(),
        }
    }
}

/// The place in the name of a scenario: `USA_Lanker-1` of `USA_Lanker-1_1_T-1`. Cooperative ones begin with `C-`.
fn place_of(benchmark_id: &str) -> String {
    let id = benchmark_id.strip_prefix("C-").unwrap_or(benchmark_id);
    id.split('_').take(2).collect::<Vec<_>>().join("_")
}
