//! Distances between scenarios by the future paths of the requested agents.

use super::nearest::NearestIndex;
use crate::geometry::{Transform2, Vec2};
use crate::metrics::sample_group::future;
use crate::scene::{Roles, Scene};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Scenarios whose paths are closer to each other than this are near-duplicates by default, meters.
pub const DUPLICATE_DISTANCE_M: f64 = 0.25;
/// Time between the positions of a path, seconds.
const SPACING_S: f64 = 0.5;

/// The future positions of the requested agents (both of a pair), in the frame of the first of them at present: origin
/// at its position, x axis along its heading. Scenarios of different places are thus comparable, and only relative
/// motion counts.
///
/// Because motion is smooth and all accepted scenarios stay in memory, the position in the middle of each half second
/// represents it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PairPath {
    /// One position for each agent and half second, meters. An agent without a state stays at its last position.
    points: Box<[[f32; 2]]>,
    n_agents: usize,
}

/// Positions are finite.
impl Eq for PairPath {}

impl PairPath {
    /// The path of the agents with these roles; `None` without roles, or if one of the agents is not tracked at
    /// present.
    pub fn of(scene: &Scene, asked: &Roles) -> Option<Self> {
        let present = scene.current_timestep();
        let agents: Vec<usize> = asked.tracks().map(|track| scene.track_idx(track)).collect::<Option<_>>()?;
        let first = scene.state(*agents.first()?, present)?;
        let own_from_scene = Transform2::from_pose(first.position, first.heading_rad).inverse();
        let every = ((SPACING_S / scene.dt_s).round() as usize).clamp(1, future(scene).len().max(1));
        let mut points = Vec::new();
        for agent_idx in &agents {
            let mut last = scene.state(*agent_idx, present)?.position;
            for (i, timestep) in future(scene).enumerate() {
                last = scene.state(*agent_idx, timestep).map_or(last, |state| state.position);
                if i % every == every / 2 {
                    let Vec2 { x, y } = own_from_scene.point(last);
                    points.push([x as f32, y as f32]);
                }
            }
        }
        Some(Self { points: points.into(), n_agents: agents.len() })
    }

    /// Mean distance between the positions of the same agent at the same time, meters. It is a metric: the mean of
    /// norms.
    pub fn distance_m(&self, other: &Self) -> f64 {
        let apart = |(a, b): (&[f32; 2], &[f32; 2])| {
            Vec2::new(f64::from(a[0]) - f64::from(b[0]), f64::from(a[1]) - f64::from(b[1])).norm()
        };
        let sum: f64 = self.points.iter().zip(&other.points).map(apart).sum();
        sum / self.points.len().max(1) as f64
    }
}

/// The scenarios so far. Only scenarios with the same requested behavior, number of agents and duration are compared.
///
/// A search is exact; `NearestIndex` states its cost. A scenario takes 16 bytes for each agent and second, beside its
/// id.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct PathIndex {
    kinds: BTreeMap<Kind, OfKind>,
}

/// The behavior, the number of agents and the number of points.
type Kind = (String, usize, usize);

/// The scenarios of one kind, by number.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
struct OfKind {
    ids: Vec<String>,
    paths: NearestIndex<PairPath>,
}

impl PathIndex {
    /// The id of the nearest earlier scenario of this kind, and its distance in meters; `None` if there is none.
    pub fn nearest(&self, behavior: &str, path: &PairPath) -> Option<(&str, f64)> {
        let OfKind { ids, paths } = self.kinds.get(&kind(behavior, path))?;
        let (idx, distance_m) = paths.nearest(path, PairPath::distance_m)?;
        Some((ids.get(idx)?, distance_m))
    }

    /// Adds a scenario.
    pub fn insert(&mut self, behavior: &str, path: PairPath, scenario_id: &str) {
        let OfKind { ids, paths } = self.kinds.entry(kind(behavior, &path)).or_default();
        ids.push(scenario_id.to_owned());
        paths.insert(path, PairPath::distance_m);
    }
}

fn kind(behavior: &str, path: &PairPath) -> Kind {
    (behavior.to_owned(), path.n_agents, path.points.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::testing::transformed;
    use crate::scene::testing::{Drive, scene};

    fn asked() -> Roles {
        Roles::from([("ego", "1"), ("other", "2")])
    }

    fn path(offset_m: f64) -> PairPath {
        let scene = scene(&[Drive::straight(3.0, 1.0, 0.7, 10.0), Drive::straight(offset_m, 9.0, 0.7, 10.0)]);
        PairPath::of(&scene, &asked()).expect("tracked")
    }

    #[test]
    fn distances_are_means_over_agents_and_do_not_depend_on_the_place() {
        // One of two agents is 2 m off throughout.
        assert!((path(0.0).distance_m(&path(2.0)) - 1.0).abs() < 1e-6);
        let here = scene(&[Drive::straight(3.0, 1.0, 0.7, 10.0), Drive::straight(0.0, 9.0, 0.7, 10.0)]);
        let there = transformed(&here, &Transform2::from_pose(Vec2::new(100.0, -50.0), 2.0));
        let [a, b] = [&here, &there].map(|scene| PairPath::of(scene, &asked()).expect("tracked"));
        assert!(a.distance_m(&b) < 1e-5);
        assert_eq!(PairPath::of(&here, Roles::none()), None);
        assert_eq!(PairPath::of(&here, &[("ego", "7")].into()), None);
    }

    #[test]
    fn the_first_of_its_kind_has_no_neighbor() {
        let mut index = PathIndex::default();
        assert!(index.nearest("cut_in", &path(0.0)).is_none());
        index.insert("cut_in", path(0.0), "a");
        index.insert("cut_in", path(10.0), "b");
        assert!(index.nearest("near_miss", &path(0.0)).is_none());
        let (id, distance_m) = index.nearest("cut_in", &path(6.0)).expect("there are two");
        assert!(id == "b" && (distance_m - 2.0).abs() < 1e-6);
    }
}
