//! Scenarios for the tests of this module: small, with positions that are easy to work out by hand.

use super::{ExportOutcome, Exporter, Item, Written};
use crate::behavior::BehaviorEvent;
use crate::geometry::{Polyline, Transform2, Vec2, angle_difference};
use crate::ingest::{IngestConfig, scenes_of};
use crate::scenario::ScenarioRecord;
use crate::scene::testing::{Drive, provenance, scene as straight_scene, without_states};
use crate::scene::{
    AgentClass, Dataset, Lane, LaneAttributes, LaneGraph, LaneId, ObservationMask, Provenance, Roles, Scenario, Scene,
};
use crate::store::testing::event;
use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};
use std::f64::consts::FRAC_PI_2;
use std::path::Path;
use std::sync::Arc;

/// Twelve timesteps, four of which are observed, at 10 Hz. The x axis of the scene points north in the recording, its
/// origin is at (1000, 2000).
///
/// Track `1` is the ego and drives 10 m/s: after t steps it is at (1000, 2000 + t). Track `2` drives beside it, 3 m to
/// the left (which is west), and is recorded from the second timestep on. Track `P3` is a pedestrian without a size who
/// walks 1 m/s to the left from 5 m ahead of the origin, and is missing at timestep 2.
pub(super) fn scene() -> Scene {
    let mut scene = straight_scene(&[
        Drive::straight(0.0, 0.0, 0.0, 10.0),
        Drive::straight(0.0, 3.0, 0.0, 10.0),
        Drive::straight(5.0, 0.0, FRAC_PI_2, 1.0),
    ]);
    scene = without_states(scene, 1, |timestep| timestep < 1);
    scene = without_states(scene, 2, |timestep| timestep == 2);
    scene.tracks[2].id = "P3".into();
    scene.tracks[2].class = AgentClass::PedestrianOrCyclist;
    scene.tracks[2].extent = None;
    scene.world_from_scene = Transform2::from_pose(Vec2::new(1000.0, 2000.0), FRAC_PI_2);
    let mut lanes = vec![lane(-5), lane(7)];
    lanes[0].successors = vec![LaneId(7)];
    lanes[1].predecessors = vec![LaneId(-5)];
    scene.lanes = Arc::new(LaneGraph::new(lanes));
    scene
}

/// A lane of 40 m along the x axis, 4 m wide.
pub(super) fn lane(id: i64) -> Lane {
    let line = |y: f64| Polyline(vec![Vec2::new(0.0, y), Vec2::new(40.0, y)]);
    let attributes = LaneAttributes { one_way: true, kind: "road".to_owned(), ..LaneAttributes::default() };
    Lane { attributes: attributes.into(), ..Lane::unconnected(id, line(0.0), [2.0, -2.0].map(line)) }
}

/// A verified scenario of this scene in which track `2` cuts in before track `1`.
pub(super) fn record(scene: &Scene) -> ScenarioRecord {
    let (roles, event) = (Roles::from([("other", "2"), ("ego", "1")]), event(&scene.id, "cut_in", &[("gap_m", 5.25)]));
    let event = BehaviorEvent { roles, start_timestep: 4, end_timestep: 9, ..event };
    ScenarioRecord {
        scenario: Scenario {
            id: "0a1b".to_owned(),
            observed: ObservationMask::from_fn(scene.tracks.len(), scene.n_timesteps, |agent_idx, timestep| {
                timestep < scene.n_history && scene.state(agent_idx, timestep).is_some()
            }),
            scene: scene.clone(),
            provenance: Provenance { seed: 7, sample_idx: 2, ..provenance(&scene.id.0) },
        },
        sweep: "cut_ins".to_owned(),
        requested_behavior: Some("cut_in".to_owned()),
        verified: true,
        events: vec![event],
        recorded_event: false,
        assessment: None,
        shard: 0,
        request: None,
    }
}

/// Adds these scenes, numbered from 1, each with its id made distinct by its number.
pub(super) fn add_all(mut exporter: Box<dyn Exporter>, scenes: &[Scene]) -> Vec<Result<Written, &'static str>> {
    let outcomes = scenes.iter().enumerate().map(|(i, scene)| {
        let mut record = record(scene);
        record.scenario.id = format!("{}{i}", record.scenario.id);
        let item = Item { record: &record, number: i + 1, stem: record.scenario.id.clone(), ego_idx: 0, terms: "none" };
        match exporter.add(&item).unwrap() {
            ExportOutcome::Written(written) => Ok(written),
            ExportOutcome::LeftOut(reason) => Err(reason),
        }
    });
    let outcomes = outcomes.collect();
    exporter.finish().unwrap();
    outcomes
}

/// The scenes in files of Waymo Open Motion, with so many observed timesteps and later ones.
pub(super) fn womd_scenes(path: &Path, [n_history, n_future]: [usize; 2]) -> Vec<Scene> {
    let config = IngestConfig {
        n_history: Some(n_history),
        n_future: Some(n_future),
        map_radius_m: 1e6,
        ..IngestConfig::new(Dataset::Womd, vec![path.to_owned()])
    };
    let (scenes, report) = scenes_of(&config).unwrap();
    assert!(report.n_rejects() == 0 && report.warnings.is_empty(), "{:?} {:?}", report.rejects, report.warnings);
    scenes
}

/// Fails unless a track that was read back has the same states in the world, `later` timesteps later, up to rounding:
/// of positions and headings, and of velocities.
pub(super) fn assert_same_states(
    (own, agent_idx): (&Scene, usize),
    (read, read_idx): (&Scene, usize),
    later: isize,
    [rounding, rounding_mps]: [f64; 2],
) {
    let of = |scene: &Scene, agent_idx: usize| scene.tracks[agent_idx].trajectory.transformed(&scene.world_from_scene);
    let (own, read) = (of(own, agent_idx), of(read, read_idx));
    for timestep in 0..own.n_timesteps() {
        let Some(then) = timestep.checked_add_signed(later) else { continue };
        let (a, b) = (own.get(timestep), read.get(then));
        assert_eq!(a.is_some(), b.is_some(), "track {agent_idx} at {timestep}");
        let Some((a, b)) = a.zip(b) else { continue };
        assert!(a.position.distance(b.position) < rounding && a.velocity.distance(b.velocity) < rounding_mps);
        assert!(angle_difference(a.heading_rad, b.heading_rad).abs() < rounding, "{a:?}, {b:?}");
    }
}

/// The content of a written file.
pub(super) fn read(dir: &Path, name: &str) -> String {
    fs_err::read_to_string(dir.join(name)).unwrap()
}

/// An element of a document that was read back.
#[derive(Debug, Clone, Default)]
pub(super) struct Node {
    pub(super) name: String,
    pub(super) attributes: Vec<(String, String)>,
    pub(super) children: Vec<Self>,
    pub(super) text: String,
}

impl Node {
    /// The root of a document.
    pub(super) fn parse(text: &str) -> Self {
        let mut reader = Reader::from_str(text);
        let mut open = vec![Self::default()];
        loop {
            match reader.read_event().unwrap() {
                Event::Start(start) => open.push(Self::of(&start)),
                Event::Empty(start) => open.last_mut().unwrap().children.push(Self::of(&start)),
                Event::Text(text) => open.last_mut().unwrap().text.push_str(text.trim()),
                Event::End(_) => {
                    let node = open.pop().unwrap();
                    open.last_mut().unwrap().children.push(node);
                }
                Event::Eof => break,
                _ => {}
            }
        }
        assert_eq!(open.len(), 1, "unclosed elements");
        open.remove(0).children.remove(0)
    }

    fn of(start: &BytesStart<'_>) -> Self {
        let attribute =
            |a: quick_xml::events::attributes::Attribute<'_>| (a.key.as_ref().to_owned(), a.value.to_string());
        Self {
            name: start.name().as_ref().to_owned(),
            attributes: start.attributes().map(|a| attribute(a.unwrap())).collect(),
            ..Self::default()
        }
    }

    /// The value of an attribute.
    #[track_caller]
    pub(super) fn attr(&self, name: &str) -> &str {
        let found = self.attributes.iter().find(|(key, _)| key == name);
        found.map_or_else(|| panic!("{} has no attribute {name}", self.name), |(_, value)| value)
    }

    /// The value of an attribute that is a number.
    #[track_caller]
    pub(super) fn attr_number(&self, name: &str) -> f64 {
        self.attr(name).parse().unwrap()
    }

    /// The first child with this name.
    #[track_caller]
    pub(super) fn at(&self, name: &str) -> &Self {
        let found = self.children.iter().find(|child| child.name == name);
        found.unwrap_or_else(|| panic!("{} has no {name}", self.name))
    }

    pub(super) fn all(&self, name: &str) -> Vec<&Self> {
        self.children.iter().filter(|child| child.name == name).collect()
    }

    /// All descendants with this name, in document order.
    pub(super) fn below(&self, name: &str) -> Vec<&Self> {
        let own = |child: &'_ Self| child.name == name;
        self.children.iter().flat_map(|c| own(c).then_some(c).into_iter().chain(c.below(name))).collect()
    }

    /// The number that the first child of this name holds.
    #[track_caller]
    pub(super) fn number(&self, name: &str) -> f64 {
        self.at(name).text.parse().unwrap()
    }
}
