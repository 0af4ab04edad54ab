//! What is compared between recorded and generated scenes: how road users move, and how close they come.

use super::distribution::Distribution;
use crate::behavior::BehaviorEvent;
use crate::geometry::wrap_angle;
use crate::scene::{Scene, Track};
use std::collections::BTreeSet;

/// Bins of each histogram.
const N_BINS: usize = 40;
/// Timesteps between those at which distances are measured: neighboring ones say the same.
const DISTANCE_STRIDE: usize = 5;
/// Below this speed a heading says little, metres per second.
const MOVING_MPS: f64 = 1.0;

/// A quantity with its unit, how it is measured, and the values that one scene adds.
type Quantity = (&'static str, &'static str, &'static str, fn(&Scene) -> Vec<f64>);

const QUANTITIES: [Quantity; 4] = [
    ("speed", "m/s", "from one position to the next", |scene| over_tracks(scene, speeds)),
    ("acceleration", "m/s²", "change of speed from one timestep to the next", |scene| {
        over_tracks(scene, accelerations)
    }),
    ("yaw rate", "rad/s", "change of heading while faster than 1 m/s", |scene| over_tracks(scene, yaw_rates)),
    ("distance to the nearest", "m", "between boxes, 0 when they overlap; every half second", nearest_distances),
];

/// Collects how road users move in the futures of scenes, group by group.
///
/// Everything is derived from positions and headings in the same way for every group, because generated scenes have no
/// measured velocities. Scenes may be dropped once added.
#[derive(Debug, Clone, Default)]
pub struct MotionDistributions {
    groups: Vec<(String, [Vec<f64>; QUANTITIES.len()])>,
}

impl MotionDistributions {
    /// Adds a scene to a group. The first group that is added to is the reference.
    pub fn add(&mut self, group: &str, scene: &Scene) {
        let at = self.groups.iter().position(|(name, _)| name == group).unwrap_or_else(|| {
            self.groups.push((group.to_owned(), Default::default()));
            self.groups.len() - 1
        });
        for (collected, (_, _, _, values)) in self.groups[at].1.iter_mut().zip(QUANTITIES) {
            collected.extend(values(scene));
        }
    }

    /// One distribution for each quantity.
    pub fn finish(&self) -> Vec<Distribution> {
        let one = |(i, (title, unit, description, _)): (usize, Quantity)| {
            let groups: Vec<(&str, &[f64])> =
                self.groups.iter().map(|(name, values)| (name.as_str(), values[i].as_slice())).collect();
            Distribution::of(title, unit, description, N_BINS, &groups)
        };
        QUANTITIES.into_iter().enumerate().map(one).collect()
    }
}

/// Distributions of the parameters of events, one for each parameter that any event has; the first group is the reference.
pub fn event_distributions(groups: &[(&str, &[&BehaviorEvent])]) -> Vec<Distribution> {
    let names: BTreeSet<&String> =
        groups.iter().flat_map(|(_, events)| events.iter()).flat_map(|e| e.parameters.keys()).collect();
    names
        .into_iter()
        .map(|name| {
            let values: Vec<Vec<f64>> = groups
                .iter()
                .map(|(_, events)| events.iter().filter_map(|event| event.parameters.get(name).copied()).collect())
                .collect();
            let groups: Vec<(&str, &[f64])> =
                groups.iter().zip(&values).map(|((group, _), values)| (*group, values.as_slice())).collect();
            let (title, unit) = title_and_unit(name);
            Distribution::of(&title, unit, "of the events", N_BINS / 2, &groups)
        })
        .collect()
}

/// `relative_speed_mps` is the relative speed in m/s.
pub(super) fn title_and_unit(parameter: &str) -> (String, &'static str) {
    for (suffix, unit) in
        [("_mps2", "m/s²"), ("_mps", "m/s"), ("_m", "m"), ("_s", "s"), ("_radps", "rad/s"), ("_rad", "rad")]
    {
        if let Some(name) = parameter.strip_suffix(suffix) {
            return (name.replace('_', " "), unit);
        }
    }
    (parameter.replace('_', " "), "")
}

fn over_tracks(scene: &Scene, values: fn(&Scene, &Track) -> Vec<f64>) -> Vec<f64> {
    scene.tracks.iter().flat_map(|track| values(scene, track)).collect()
}

/// The speed over the step that ends at `timestep`.
fn speed(scene: &Scene, track: &Track, timestep: usize) -> Option<f64> {
    let before = track.trajectory.get(timestep.checked_sub(1)?)?;
    Some(track.trajectory.get(timestep)?.position.distance(before.position) / scene.dt_s)
}

fn speeds(scene: &Scene, track: &Track) -> Vec<f64> {
    (scene.n_history..scene.n_timesteps).filter_map(|timestep| speed(scene, track, timestep)).collect()
}

fn accelerations(scene: &Scene, track: &Track) -> Vec<f64> {
    (scene.n_history..scene.n_timesteps)
        .filter_map(|timestep| {
            Some((speed(scene, track, timestep)? - speed(scene, track, timestep.checked_sub(1)?)?) / scene.dt_s)
        })
        .collect()
}

fn yaw_rates(scene: &Scene, track: &Track) -> Vec<f64> {
    (scene.n_history..scene.n_timesteps)
        .filter(|timestep| speed(scene, track, *timestep).is_some_and(|v| v > MOVING_MPS))
        .filter_map(|timestep| {
            let (before, now) = (track.trajectory.get(timestep.checked_sub(1)?)?, track.trajectory.get(timestep)?);
            Some(wrap_angle(now.heading_rad - before.heading_rad) / scene.dt_s)
        })
        .collect()
}

fn nearest_distances(scene: &Scene) -> Vec<f64> {
    let mut distances = Vec::new();
    for timestep in (scene.n_history..scene.n_timesteps).step_by(DISTANCE_STRIDE) {
        let boxes: Vec<_> = scene.tracks.iter().filter_map(|track| track.footprint_at(timestep)).collect();
        for (i, a) in boxes.iter().enumerate() {
            let others = boxes.iter().enumerate().filter(|(j, _)| *j != i);
            distances.extend(others.map(|(_, b)| a.distance(b)).min_by(f64::total_cmp));
        }
    }
    distances
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vec2;
    use crate::scene::testing::{self, Drive};
    use crate::scene::{SceneId, State, Trajectory};
    use std::collections::BTreeMap;

    /// Two cars at 10 m/s side by side, 6 m apart between centers; the first gains 2 m/s each second.
    fn scene() -> Scene {
        let mut scene = testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(0.0, 6.0, 0.0, 10.0)]);
        let states = (0..scene.n_timesteps).map(|timestep| {
            let t = timestep as f64 * scene.dt_s;
            // The recorded velocity is wrong on purpose: it must not be used.
            let velocity = Vec2::new(99.0, 0.0);
            Some(State { position: Vec2::new(10.0 * t + t * t, 0.0), heading_rad: 0.05 * t, velocity })
        });
        scene.tracks[0].trajectory = Trajectory::new(states.collect());
        scene
    }

    fn all_near(values: &[f64], n: usize, expected: f64) -> bool {
        values.len() == n && values.iter().all(|value| (value - expected).abs() < 1e-6)
    }

    #[test]
    fn motion_follows_from_positions_in_the_future_only() {
        let scene = scene();
        let [first, second] = [&scene.tracks[0], &scene.tracks[1]];
        let n_future = scene.n_timesteps - scene.n_history;
        assert!(all_near(&accelerations(&scene, first), n_future, 2.0));
        assert!(all_near(&yaw_rates(&scene, first), n_future, 0.05));
        assert!(all_near(&speeds(&scene, second), n_future, 10.0));
        let distances = nearest_distances(&scene);
        // Half of each width of 1.8 m lies between the centers.
        assert!(distances.len() == 4 && (distances[0] - 4.2).abs() < 0.1, "{distances:?}");
    }

    #[test]
    fn groups_keep_the_order_in_which_they_came() {
        let mut collected = MotionDistributions::default();
        for group in ["recorded", "generated", "recorded"] {
            collected.add(group, &scene());
        }
        let distributions = collected.finish();
        let series: Vec<(&str, u64)> = distributions[0].series.iter().map(|s| (s.name.as_str(), s.n)).collect();
        let n = 2 * (scene().n_timesteps - scene().n_history) as u64;
        assert_eq!(series, [("recorded", 2 * n), ("generated", n)]);
        assert!(distributions[0].series[1].distance.unwrap() < 1e-9);
    }

    #[test]
    fn event_parameters_get_titles_and_units() {
        let event = |gap_m: f64| BehaviorEvent {
            behavior: "cut_in".into(),
            scene_id: SceneId::from("s"),
            label: crate::behavior::EventLabel::Positive,
            roles: vec![],
            start_timestep: 0,
            end_timestep: 1,
            parameters: BTreeMap::from([("gap_m".to_owned(), gap_m), ("relative_speed_mps".to_owned(), -1.0)]),
        };
        let (a, b) = (event(4.0), event(6.0));
        let distributions = event_distributions(&[("recorded", &[&a]), ("generated", &[&a, &b])]);
        let titles: Vec<(&str, &str)> = distributions.iter().map(|d| (d.title.as_str(), d.unit.as_str())).collect();
        assert_eq!(titles, [("gap", "m"), ("relative speed", "m/s")]);
        assert_eq!(distributions[0].series[1].mean, Some(5.0));
        assert_eq!(distributions[0].series[1].distance, Some(1.0));
    }
}
