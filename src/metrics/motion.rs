//! The quantities of motion whose distributions are compared: speeds, accelerations, distances and others.
//!
//! Everything is derived from positions and headings in the same way for recorded and generated scenes, because
//! generated ones have no measured velocities.

use super::histogram::Histogram;
use super::sample_group::future;
use crate::behavior::footprint::Footprint;
use crate::behavior::time_to_collision::time_to_collision_s;
use crate::geometry::{Vec2, wrap_angle};
use crate::scene::{Scene, Track};
use serde::{Deserialize, Serialize};

/// Distances are measured once in this many timesteps; neighboring timesteps are redundant.
const DISTANCE_STRIDE: usize = 5;
/// Below this speed headings are unreliable, meters per second.
const MOVING_MPS: f64 = 1.0;
/// Time between the positions whose third differences are taken, seconds: the noise of positions is divided by its
/// cube.
const JERK_STRIDE_S: f64 = 0.3;
/// Times to collision are capped at this, seconds (as in the Waymo sim agents challenge).
const MAX_TTC_S: f64 = 5.0;

/// A quantity of motion.
#[derive(Debug, Clone, Copy)]
pub struct MotionQuantity {
    /// Its name, such as `yaw rate`.
    pub title: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// How it is measured.
    pub description: &'static str,
    /// The range of its histograms.
    pub range: [f64; 2],
    values: fn(&Scene) -> Vec<f64>,
}

impl MotionQuantity {
    /// The values in a scene.
    pub fn values(&self, scene: &Scene) -> Vec<f64> {
        (self.values)(scene)
    }
}

/// Every quantity, in the order of tables.
pub static MOTION: [MotionQuantity; 6] = [
    MotionQuantity {
        title: "speed",
        unit: "m/s",
        description: "from one position to the next",
        range: [0.0, 40.0],
        values: |scene| over_tracks(scene, speeds),
    },
    MotionQuantity {
        title: "acceleration",
        unit: "m/s²",
        description: "change of speed from one timestep to the next",
        range: [-12.0, 12.0],
        values: |scene| over_tracks(scene, accelerations),
    },
    MotionQuantity {
        title: "jerk",
        unit: "m/s³",
        description: "change of acceleration, from speeds between positions 0.3 s apart",
        range: [-30.0, 30.0],
        values: |scene| over_tracks(scene, jerks),
    },
    MotionQuantity {
        title: "yaw rate",
        unit: "rad/s",
        description: "change of heading while faster than 1 m/s",
        range: [-1.5, 1.5],
        values: |scene| over_tracks(scene, yaw_rates),
    },
    MotionQuantity {
        title: "distance to the nearest",
        unit: "m",
        description: "between boxes, 0 when they overlap; every half second",
        range: [0.0, 40.0],
        values: nearest_distances,
    },
    MotionQuantity {
        title: "time to collision",
        unit: "s",
        description: "until boxes touch at present velocities, the least over others; 5 s if that is later or never; \
                      every half second",
        range: [0.0, MAX_TTC_S],
        values: times_to_collision,
    },
];

/// A histogram of each quantity, in the order of [`MOTION`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MotionHistograms(Vec<Histogram>);

impl Default for MotionHistograms {
    fn default() -> Self {
        Self(MOTION.iter().map(|quantity| Histogram::new(quantity.range)).collect())
    }
}

impl MotionHistograms {
    /// The histograms of some scenes.
    pub fn of<'s>(scenes: impl IntoIterator<Item = &'s Scene>) -> Self {
        let mut histograms = Self::default();
        for scene in scenes {
            for (histogram, quantity) in histograms.0.iter_mut().zip(&MOTION) {
                quantity.values(scene).into_iter().for_each(|value| histogram.add(value));
            }
        }
        histograms
    }

    /// Adds the values of other scenes.
    pub fn merge(&mut self, other: &Self) {
        self.0.iter_mut().zip(&other.0).for_each(|(own, theirs)| own.merge(theirs));
    }

    /// The histograms with their quantities.
    pub fn iter(&self) -> impl Iterator<Item = (&'static MotionQuantity, &Histogram)> {
        MOTION.iter().zip(&self.0)
    }
}

fn over_tracks(scene: &Scene, values: fn(&Scene, &Track) -> Vec<f64>) -> Vec<f64> {
    scene.tracks.iter().flat_map(|track| values(scene, track)).collect()
}

/// The velocity over the `stride` timesteps that end at `timestep`, meters per second.
fn velocity(scene: &Scene, track: &Track, timestep: usize, stride: usize) -> Option<Vec2> {
    let before = track.trajectory.get(timestep.checked_sub(stride)?)?;
    Some((track.trajectory.get(timestep)?.position - before.position) * (1.0 / (stride as f64 * scene.dt_s)))
}

fn speed(scene: &Scene, track: &Track, timestep: usize, stride: usize) -> Option<f64> {
    velocity(scene, track, timestep, stride).map(Vec2::norm)
}

fn speeds(scene: &Scene, track: &Track) -> Vec<f64> {
    future(scene).filter_map(|timestep| speed(scene, track, timestep, 1)).collect()
}

fn accelerations(scene: &Scene, track: &Track) -> Vec<f64> {
    let acceleration = |timestep: usize| -> Option<f64> {
        let (now, before) = (speed(scene, track, timestep, 1)?, speed(scene, track, timestep.checked_sub(1)?, 1)?);
        Some((now - before) / scene.dt_s)
    };
    future(scene).filter_map(acceleration).collect()
}

fn jerks(scene: &Scene, track: &Track) -> Vec<f64> {
    let stride = (JERK_STRIDE_S / scene.dt_s).round().max(1.0) as usize;
    let stride_s = stride as f64 * scene.dt_s;
    let jerk = |timestep: usize| -> Option<f64> {
        let speed = |n_before: usize| speed(scene, track, timestep.checked_sub(n_before * stride)?, stride);
        Some((speed(0)? - 2.0 * speed(1)? + speed(2)?) / (stride_s * stride_s))
    };
    future(scene).filter_map(jerk).collect()
}

fn yaw_rates(scene: &Scene, track: &Track) -> Vec<f64> {
    let yaw_rate = |timestep: usize| -> Option<f64> {
        let (before, now) = (track.trajectory.get(timestep.checked_sub(1)?)?, track.trajectory.get(timestep)?);
        Some(wrap_angle(now.heading_rad - before.heading_rad) / scene.dt_s)
    };
    let is_moving = |timestep: &usize| speed(scene, track, *timestep, 1).is_some_and(|v| v > MOVING_MPS);
    future(scene).filter(is_moving).filter_map(yaw_rate).collect()
}

fn nearest_distances(scene: &Scene) -> Vec<f64> {
    let mut distances = Vec::new();
    for timestep in future(scene).step_by(DISTANCE_STRIDE) {
        let boxes = scene.tracks.iter().filter_map(|track| track.footprint_at(timestep));
        let boxes: Vec<Footprint> = boxes.map(|oriented_box| Footprint::new(&oriented_box)).collect();
        for (i, a) in boxes.iter().enumerate() {
            let others = boxes.iter().enumerate().filter(|(j, _)| *j != i);
            distances.extend(others.map(|(_, b)| b).fold(None, |least_m: Option<f64>, b| match least_m {
                Some(least_m) if a.distance_lower_bound_m(b) >= least_m => Some(least_m),
                _ => Some(least_m.unwrap_or(f64::INFINITY).min(a.distance_m(b))),
            }));
        }
    }
    distances
}

fn times_to_collision(scene: &Scene) -> Vec<f64> {
    let mut times = Vec::new();
    for timestep in future(scene).step_by(DISTANCE_STRIDE) {
        let moving_box = |track: &Track| {
            Some((Footprint::new(&track.footprint_at(timestep)?), velocity(scene, track, timestep, 1)?))
        };
        let boxes: Vec<(Footprint, Vec2)> = scene.tracks.iter().filter_map(moving_box).collect();
        for (i, (a, velocity_a)) in boxes.iter().enumerate() {
            let others = boxes.iter().enumerate().filter(|(j, _)| *j != i);
            let time_s = |(_, (b, velocity_b)): (usize, &(Footprint, Vec2))| {
                time_to_collision_s(a, *velocity_a, b, *velocity_b).unwrap_or(MAX_TTC_S).min(MAX_TTC_S)
            };
            times.extend(others.map(time_s).min_by(f64::total_cmp));
        }
    }
    times
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::testing::{random_scene, transformed};
    use crate::geometry::Transform2;
    use crate::scene::testing::{self, Drive};
    use crate::scene::{State, Trajectory};

    /// Two cars at 10 m/s side by side, 6 m apart between centers; the first gains 2 m/s each second, and with `jerk` 6
    /// m/s² each second.
    fn scene(jerk: f64) -> Scene {
        let mut scene = testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(0.0, 6.0, 0.0, 10.0)]);
        let states = (0..scene.n_timesteps).map(|timestep| {
            let t = timestep as f64 * scene.dt_s;
            // The recorded velocity is wrong on purpose: it must not be used.
            let velocity = Vec2::new(99.0, 0.0);
            let position = Vec2::new(10.0 * t + t * t + jerk * t * t * t / 6.0, 0.0);
            Some(State { position, heading_rad: 0.05 * t, velocity })
        });
        scene.tracks[0].trajectory = Trajectory::new(states.collect());
        scene
    }

    fn all_near(values: &[f64], n: usize, expected: f64) -> bool {
        values.len() == n && values.iter().all(|value| (value - expected).abs() < 1e-6)
    }

    #[test]
    fn motion_follows_from_positions_in_the_future_only() {
        let still = scene(0.0);
        let [first, second] = [&still.tracks[0], &still.tracks[1]];
        let n_future = still.n_timesteps - still.n_history;
        assert!(all_near(&accelerations(&still, first), n_future, 2.0));
        assert!(all_near(&yaw_rates(&still, first), n_future, 0.05));
        assert!(all_near(&speeds(&still, second), n_future, 10.0));
        let distances = nearest_distances(&still);
        // Half of each width of 1.8 m lies between the centers.
        assert!(distances.len() == 4 && (distances[0] - 4.2).abs() < 0.1, "{distances:?}");
        // Third differences over 0.3 s reach back 0.9 s, and timesteps 9 to 11 have that much before them.
        assert!(all_near(&jerks(&still, first), 3, 0.0));
        let pushed = scene(6.0);
        assert!(all_near(&jerks(&pushed, &pushed.tracks[0]), 3, 6.0));
    }

    #[test]
    fn times_to_collision_by_hand() {
        // The follower is 4 m/s faster; at the first future timestep, after 0.4 s, its center is 20 - 1.6 m behind, and
        // a length of 4.5 m less between boxes: 13.9 m. Half a second later 2 m less. A third car drives alone.
        let drives = [Drive::straight(20.0, 0.0, 0.0, 10.0), Drive::straight(0.0, 0.0, 0.0, 14.0)];
        let times = times_to_collision(&testing::scene(&[drives[0], drives[1], Drive::straight(0.0, 30.0, 0.0, 10.0)]));
        let expected = [13.9 / 4.0, 13.9 / 4.0, 5.0, 11.9 / 4.0, 11.9 / 4.0, 5.0];
        assert!(times.len() == 6 && times.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{times:?}");
        assert!(times_to_collision(&testing::scene(&drives[..1])).is_empty());
    }

    #[test]
    fn the_frame_does_not_matter_and_parts_add_up() {
        let scenes: Vec<Scene> = (0..4).map(|seed| random_scene(seed, 6, 25.0)).collect();
        let moved_by = Transform2::from_pose(Vec2::new(-431.0, 77.0), 2.1);
        for scene in &scenes {
            let moved = transformed(scene, &moved_by);
            for quantity in &MOTION {
                let (here, there) = (quantity.values(scene), quantity.values(&moved));
                assert!(!here.is_empty() && here.len() == there.len(), "{}", quantity.title);
                assert!(here.iter().zip(&there).all(|(a, b)| (a - b).abs() < 1e-6), "{}", quantity.title);
            }
        }
        let mut parts = MotionHistograms::of(&scenes[..2]);
        parts.merge(&MotionHistograms::of(&scenes[2..]));
        assert_eq!(MotionHistograms::of(&scenes), parts);
    }
}
