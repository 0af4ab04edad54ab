//! The features that distinguish tracks: of one track in one future, without tensors and without the column of
//! velocities.
//!
//! Positions p_t and headings θ_t are rounded to 1 mm and 1 mrad in the frame of the recording, as INTERACTION
//! publishes them, so that digits give nothing away. With Δt the time between timesteps and t₀ the present:
//!
//! - velocity v_t = (p_{t+1} - p_t) / Δt, acceleration a_t = (v_t - v_{t-1}) / Δt, jerk j_t = (a_{t+1} - a_t) / Δt;
//! - a_t along the heading θ_t (`acc_long`) and to the left of it (`acc_lat`);
//! - yaw rate r_t = (θ_{t+1} - θ_t) / Δt and its change; slip, the angle of v_t to θ_t, 0 below 1 m/s.
//!
//! The 10 %, 50 % and 90 % quantiles and the least and greatest value of each are taken over the future (`_q10` …
//! `_max`). `seam_` are values at t₀ whose differences reach across it. `lane_` is the distance to the nearest center
//! line whose direction is within 60° of the heading (to the nearest one if there is none), `lane_dh` the angle to it.
//! `half_second_` are differences of positions and headings every .5 s. `smoothed_` are taken after positions are
//! smoothed: quadratics fitted over .7 s (Savitzky and Golay 1964).

use super::motion::{CenterLines, Motion};
use crate::geometry::{OrientedBox, Vec2};
use crate::scene::{AgentClass, Scene, State, Track};
use crate::settings::named;
use serde::{Deserialize, Serialize};

/// Largest distance at which other agents are seen, meters.
const MAX_GAP_M: f64 = 30.0;

/// A feature.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Feature {
    /// Its name, such as `jerk_q90`.
    pub name: String,
    /// Its unit.
    pub unit: &'static str,
}

/// A part of the features that a classifier may see alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum FeatureSet {
    /// All features.
    All,
    /// Without fine differences: features of smoothed positions and of steps of 0.5 s, lanes, gaps and displacements.
    Smoothed,
    /// Steps of .5 s and displacements.
    HalfSeconds,
    /// Across the present.
    Seam,
    /// Lanes and gaps.
    LanesAndGaps,
}

named! { FeatureSet {
    All = "all", Smoothed = "smoothed", HalfSeconds = "half_seconds", Seam = "seam", LanesAndGaps = "lanes_and_gaps",
} }

impl FeatureSet {
    /// Whether the feature of this name belongs to it.
    fn has(self, name: &str) -> bool {
        let starts = |prefixes: &[&str]| prefixes.iter().any(|prefix| name.starts_with(prefix));
        let displacements = ["dx", "dy", "dh", "speed_now", "stop_share"];
        match self {
            Self::All => true,
            Self::Smoothed => starts(&["smoothed_", "half_second_", "lane", "gap"]) || starts(&displacements),
            Self::HalfSeconds => starts(&["half_second_"]) || starts(&displacements),
            Self::Seam => starts(&["seam", "smoothed_seam", "speed_now"]),
            Self::LanesAndGaps => starts(&["lane", "gap"]),
        }
    }

    /// The indices of its features.
    pub fn indices(self) -> Vec<usize> {
        let features = features();
        (0..features.len()).filter(|idx| self.has(&features[*idx].name)).collect()
    }
}

/// Every feature, in the order of the values of [`Surroundings::features_of`].
pub fn features() -> Vec<Feature> {
    let nobody = Motion { dt_s: 0.1, present: 0, positions: Vec::new(), headings_rad: Vec::new() };
    let mut features = Vec::new();
    nobody.visit(&CenterLines::default(), f64::NAN, &mut |name, statistic, unit, _| {
        features.push(Feature { name: format!("{name}{statistic}"), unit });
    });
    features
}

/// The values of all features of one track in one future, in the order of [`features`]. Single precision keeps a
/// thousandth of a percent, and half the memory.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct TrackFeatures(Vec<f32>);

impl TrackFeatures {
    /// The value of feature `idx`; NaN where it is not defined.
    pub fn get(&self, idx: usize) -> f64 {
        self.0.get(idx).map_or(f64::NAN, |value| f64::from(*value))
    }
}

/// Compares bits: an undefined value equals itself.
impl PartialEq for TrackFeatures {
    fn eq(&self, other: &Self) -> bool {
        self.0.iter().map(|value| value.to_bits()).eq(other.0.iter().map(|value| value.to_bits()))
    }
}

/// All agents of a scene, as features see them.
pub struct Surroundings<'s> {
    scene: &'s Scene,
    /// Rounded poses of each track at each timestep.
    poses: Vec<Vec<Option<(Vec2, f64)>>>,
    lines: CenterLines,
}

impl<'s> Surroundings<'s> {
    /// The surroundings in a scene.
    pub fn new(scene: &'s Scene) -> Self {
        let (to_world, from_world) = (scene.world_from_scene, scene.world_from_scene.inverse());
        let thousandth = |value: f64| (value * 1000.0).round_ties_even() / 1000.0;
        let rounded = |state: &State| {
            let Vec2 { x, y } = to_world.point(state.position);
            let heading_rad = thousandth(to_world.heading(state.heading_rad));
            (from_world.point(Vec2::new(thousandth(x), thousandth(y))), from_world.heading(heading_rad))
        };
        let poses = |track: &Track| track.trajectory.entries().iter().map(|s| s.as_ref().map(rounded)).collect();
        Self { scene, poses: scene.tracks.iter().map(poses).collect(), lines: CenterLines::new(&scene.lanes) }
    }

    /// Whether the track is judged: motorized or of no known class, and tracked from two timesteps before the present
    /// to the end.
    pub fn is_judged(&self, track: usize) -> bool {
        let from = self.scene.n_history.saturating_sub(3);
        let class = self.scene.tracks[track].class;
        let is_meant = class.is_motorized() || class == AgentClass::Unknown;
        is_meant && self.poses[track][from..].iter().all(Option::is_some)
    }

    /// The features of a track that is judged.
    pub fn features_of(&self, track: usize) -> TrackFeatures {
        let poses = &self.poses[track];
        let first = poses.iter().rposition(Option::is_none).map_or(0, |last_missing| last_missing + 1);
        let (positions, headings_rad) = poses[first..].iter().flatten().copied().unzip();
        let present = (self.scene.n_history - 1).saturating_sub(first);
        let motion = Motion { dt_s: self.scene.dt_s, present, positions, headings_rad };
        let mut values = Vec::new();
        motion.visit(&self.lines, self.gap_m(track), &mut |_, _, _, value| values.push(value as f32));
        TrackFeatures(values)
    }

    /// The least distance between the boxes of the track and of any other agent whose center comes within 30 m in the
    /// future, at most 30 m.
    fn gap_m(&self, track: usize) -> f64 {
        let future = |of: usize| self.poses[of].iter().enumerate().skip(self.scene.n_history);
        let outline = |of: usize, (center, heading_rad): (Vec2, f64)| {
            let extent = self.scene.tracks[of].extent_or_nominal();
            OrientedBox { center, heading_rad, length_m: extent.length_m, width_m: extent.width_m }
        };
        let mut gap_m = MAX_GAP_M;
        for other in (0..self.poses.len()).filter(|other| *other != track) {
            let both = || future(track).zip(future(other)).filter_map(|((_, own), (_, other))| (*own).zip(*other));
            if both().all(|(own, other)| own.0.distance(other.0) >= MAX_GAP_M) {
                continue;
            }
            for (own, of_other) in both() {
                let [own, of_other] = [outline(track, own), outline(other, of_other)];
                if own.center.distance(of_other.center) - own.radius() - of_other.radius() < gap_m {
                    gap_m = gap_m.min(own.distance(&of_other));
                }
            }
        }
        gap_m
    }
}
