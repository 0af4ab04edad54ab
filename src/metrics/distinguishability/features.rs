//! The features by which tracks are told apart: one track in one future, without tensors and without the column of
//! velocities.
//!
//! Positions p_t and headings θ_t are rounded to 1 mm and 1 mrad in the frame of the recording, as INTERACTION
//! publishes them, so that digits tell nothing. With Δt the time between timesteps and t₀ the present:
//!
//! - velocity v_t = (p_{t+1} - p_t) / Δt, acceleration a_t = (v_t - v_{t-1}) / Δt, jerk j_t = (a_{t+1} - a_t) / Δt;
//! - a_t along the heading θ_t (`acc_long`) and to the left of it (`acc_lat`);
//! - yaw rate r_t = (θ_{t+1} - θ_t) / Δt and its change; slip, the angle of v_t to θ_t, 0 below 1 m/s.
//!
//! Of each, the 10 %, 50 % and 90 % quantiles, least and greatest value over the future (`_q10` … `_max`). `seam_` are
//! values at t₀ whose differences reach across it. `lane_` is the distance to the nearest center line whose direction
//! is within 60° of the heading (to the nearest one if there is none), `lane_dh` the angle to it. `B_` are differences of
//! positions and headings every .5 s. `S_` are taken after positions are smoothed: quadratics fitted over .7 s
//! (Savitzky and Golay 1964).

use crate::geometry::{OrientedBox, Vec2, wrap_angle};
use crate::scene::{AgentClass, Scene, State, Track};
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_PI_3;

/// Nobody is seen farther away, meters.
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
    /// All.
    All,
    /// None of fine differences: those of smoothed positions and of steps of .5 s, lanes, gaps and displacements.
    Smoothed,
    /// Steps of .5 s and displacements.
    HalfSeconds,
    /// Across the present.
    Seam,
    /// Lanes and gaps.
    LanesAndGaps,
}

impl FeatureSet {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::All, Self::Smoothed, Self::HalfSeconds, Self::Seam, Self::LanesAndGaps];

    /// The name in tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::All => "all",
            Self::Smoothed => "smoothed",
            Self::HalfSeconds => "half_seconds",
            Self::Seam => "seam",
            Self::LanesAndGaps => "lanes_and_gaps",
        }
    }

    /// Whether the feature of this name belongs to it.
    fn has(self, name: &str) -> bool {
        let starts = |prefixes: &[&str]| prefixes.iter().any(|prefix| name.starts_with(prefix));
        let displacements = ["dx", "dy", "dh", "speed_now", "stop_share"];
        match self {
            Self::All => true,
            Self::Smoothed => starts(&["S_", "B_", "lane", "gap"]) || starts(&displacements),
            Self::HalfSeconds => starts(&["B_"]) || starts(&displacements),
            Self::Seam => starts(&["seam", "S_seam", "speed_now"]),
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
    nobody.visit(&[], f64::NAN, &mut |name, statistic, unit, _| {
        features.push(Feature { name: format!("{name}{statistic}"), unit });
    });
    features
}

/// What receives the name of a feature, in two parts, its unit and its value.
type Visitor<'v> = dyn FnMut(&str, &str, &'static str, f64) + 'v;

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

/// By bits: a value that is not defined equals itself.
impl PartialEq for TrackFeatures {
    fn eq(&self, other: &Self) -> bool {
        self.0.iter().map(|value| value.to_bits()).eq(other.0.iter().map(|value| value.to_bits()))
    }
}

/// A piece of a center line.
struct Segment {
    start: Vec2,
    along: Vec2,
    length_m: f64,
    direction_rad: f64,
}

/// Everybody in a scene, as features see them.
pub struct Surroundings<'s> {
    scene: &'s Scene,
    /// Rounded poses of each track at each timestep.
    poses: Vec<Vec<Option<(Vec2, f64)>>>,
    segments: Vec<Segment>,
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
        let lines = scene.lanes.lanes().iter().flat_map(|lane| lane.centerline.0.windows(2));
        let segments = lines.map(|ends| {
            let along = ends[1] - ends[0];
            Segment { start: ends[0], along, length_m: along.norm(), direction_rad: along.angle() }
        });
        Self {
            scene,
            poses: scene.tracks.iter().map(poses).collect(),
            segments: segments.filter(|segment| segment.length_m > 1e-6).collect(),
        }
    }

    /// Whether the track is judged: motorized or of no known class, and tracked from two timesteps before the present to
    /// the end.
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
        motion.visit(&self.segments, self.gap_m(track), &mut |_, _, _, value| values.push(value as f32));
        TrackFeatures(values)
    }

    /// The least distance between the boxes of the track and of anybody else whose center comes within 30 m in the future,
    /// at most 30 m.
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

/// The motion of one track without gaps, timestep by timestep.
struct Motion {
    dt_s: f64,
    /// The index of the present.
    present: usize,
    positions: Vec<Vec2>,
    headings_rad: Vec<f64>,
}

/// Differences of positions: velocities, accelerations, jerks, by the timestep of the first position that they use.
struct Differences([Vec<Vec2>; 3]);

impl Differences {
    fn of(positions: &[Vec2], dt_s: f64) -> Self {
        let difference = |of: &[Vec2]| of.windows(2).map(|two| (two[1] - two[0]) * (1.0 / dt_s)).collect::<Vec<_>>();
        let velocities = difference(positions);
        let accelerations = difference(&velocities);
        let jerks = difference(&accelerations);
        Self([velocities, accelerations, jerks])
    }
}

impl Motion {
    /// Visits the features, always in the same order.
    fn visit(&self, segments: &[Segment], gap_m: f64, put: &mut Visitor<'_>) {
        let headings = &self.headings_rad;
        let fine = Differences::of(&self.positions, self.dt_s);
        let Differences([velocities, accelerations, jerks]) = &fine;
        let yaw_rates: Vec<f64> = headings.windows(2).map(|two| wrap_angle(two[1] - two[0]) / self.dt_s).collect();
        let slips = velocities.iter().zip(headings).map(|(v, heading)| match v.norm() > 1.0 {
            true => wrap_angle(v.angle() - heading),
            false => 0.0,
        });
        let [along, across] = self.components(accelerations);
        let speeds: Vec<f64> = velocities.iter().map(|v| v.norm()).collect();
        let future = |values: Vec<f64>| values.get(self.present + 1..).unwrap_or_default().to_vec();
        let yaw_rates_ahead = future(yaw_rates.clone());
        let yaw_accelerations = yaw_rates_ahead.windows(2).map(|two| (two[1] - two[0]) / self.dt_s).collect();
        spread("speed", "m/s", future(speeds.clone()), put);
        spread("acc_long", "m/s^2", future(along), put);
        spread("acc_lat", "m/s^2", future(across), put);
        spread("jerk", "m/s^3", future(norms(jerks)), put);
        spread("yaw_rate", "rad/s", future(yaw_rates.clone()), put);
        spread("slip", "rad", future(slips.collect()), put);
        spread("yaw_acc", "rad/s^2", yaw_accelerations, put);
        self.visit_seam(&fine, &yaw_rates, put);
        self.visit_lanes(segments, put);
        put("gap_min", "", "m", gap_m);
        self.visit_displacements(&speeds, put);
        self.visit_half_seconds(put);
        self.visit_smoothed(put);
    }

    /// Accelerations along the heading at their timestep, and to the left of it.
    fn components(&self, accelerations: &[Vec2]) -> [Vec<f64>; 2] {
        let with_heading = || accelerations.iter().zip(self.headings_rad.iter().skip(1));
        let local = || with_heading().map(|(a, heading)| a.rotated(-heading));
        [local().map(|a| a.x).collect(), local().map(|a| a.y).collect()]
    }

    fn visit_seam(
        &self,
        Differences([_, accelerations, jerks]): &Differences,
        yaw_rates: &[f64],
        put: &mut Visitor<'_>,
    ) {
        let now = |values: &[Vec2], before: usize| {
            let value = self.present.checked_sub(before).and_then(|at| values.get(at).copied());
            value.unwrap_or(Vec2::new(f64::NAN, f64::NAN))
        };
        let heading_rad = self.headings_rad.get(self.present).copied().unwrap_or(f64::NAN);
        for (name, unit, value) in [
            ("seam_acc", "m/s^2", now(accelerations, 1)),
            ("seam_jerk", "m/s^3", now(jerks, 1)),
            ("seam_jerk0", "m/s^3", now(jerks, 2)),
        ] {
            let local = value.rotated(-heading_rad);
            put(name, "_long", unit, local.x);
            put(name, "_lat", unit, local.y);
        }
        put("seam_jerk_norm", "", "m/s^3", now(jerks, 1).norm().max(now(jerks, 2).norm()));
        let turn = |before: usize| {
            self.present.checked_sub(before).and_then(|at| yaw_rates.get(at).copied()).unwrap_or(f64::NAN)
        };
        put("seam_turn", "", "rad/s", turn(0));
        put("seam_turn_jump", "", "rad/s", turn(0) - turn(1));
        put("seam_acc_change", "", "m/s^2", (now(accelerations, 0) - now(accelerations, 2)).norm());
    }

    fn visit_lanes(&self, segments: &[Segment], put: &mut Visitor<'_>) {
        let from_present = self.positions.iter().zip(&self.headings_rad).skip(self.present);
        let found: Option<Vec<(f64, f64)>> =
            from_present.map(|(p, heading)| nearest_lane(*p, *heading, segments)).collect();
        let found = found.unwrap_or_default();
        let [distances, angles]: [Vec<f64>; 2] = {
            let (distances, angles) = found.iter().skip(1).copied().unzip();
            [distances, angles]
        };
        let last = distances.last().copied().unwrap_or(f64::NAN);
        let first = found.first().map_or(f64::NAN, |(distance, _)| *distance);
        spread("lane", "m", distances, put);
        put("lane_last", "", "m", last);
        let [_, median, _, _, greatest] = statistics(angles);
        put("lane_dh_max", "", "rad", greatest);
        put("lane_dh_med", "", "rad", median);
        put("lane_change", "", "m", last - first);
    }

    fn visit_displacements(&self, speeds: &[f64], put: &mut Visitor<'_>) {
        let [now, last] = [self.positions.get(self.present), self.positions.last()];
        let heading_rad = self.headings_rad.get(self.present).copied().unwrap_or(f64::NAN);
        let ahead =
            now.zip(last).map_or(Vec2::new(f64::NAN, f64::NAN), |(now, last)| (*last - *now).rotated(-heading_rad));
        put("dx", "", "m", ahead.x);
        put("dy", "", "m", ahead.y);
        put("dh", "", "rad", self.headings_rad.last().map_or(f64::NAN, |last| wrap_angle(last - heading_rad)));
        let before = self.present.checked_sub(1).and_then(|at| speeds.get(at).copied());
        put("speed_now", "", "m/s", before.unwrap_or(f64::NAN));
        let onward = speeds.get(self.present..).unwrap_or_default();
        for (name, below_mps) in [("stop_share", 0.1), ("exactly_still", 1e-6)] {
            let n = onward.iter().filter(|speed| **speed < below_mps).count();
            put(name, "", "1", n as f64 / onward.len() as f64);
        }
    }

    fn visit_half_seconds(&self, put: &mut Visitor<'_>) {
        let step = ((0.5 / self.dt_s).round() as usize).max(1);
        let step_s = step as f64 * self.dt_s;
        let each: Vec<Vec2> = self.positions.iter().skip(self.present).step_by(step).copied().collect();
        let headings: Vec<f64> = self.headings_rad.iter().skip(self.present).step_by(step).copied().collect();
        let velocities: Vec<Vec2> = each.windows(2).map(|two| (two[1] - two[0]) * (1.0 / step_s)).collect();
        let speeds = norms(&velocities);
        let rates = |of: &[f64]| of.windows(2).map(|two| (two[1] - two[0]) / step_s).collect::<Vec<f64>>();
        let accelerations = rates(&speeds);
        let yaw_rates: Vec<f64> = headings.windows(2).map(|two| wrap_angle(two[1] - two[0]) / step_s).collect();
        let lateral = velocities.windows(2).map(|two| match two[0].norm() > 1.0 && two[1].norm() > 1.0 {
            true => (two[0].norm() * wrap_angle(two[1].angle() - two[0].angle()) / step_s).abs(),
            false => 0.0,
        });
        let greatest = |values: Vec<f64>| statistics(values)[4];
        let least = |values: Vec<f64>| statistics(values)[3];
        put("B_speed_min", "", "m/s", least(speeds.clone()));
        put("B_speed_max", "", "m/s", greatest(speeds.clone()));
        put("B_speed_last", "", "m/s", speeds.last().copied().unwrap_or(f64::NAN));
        for (name, unit, values) in [("B_acc", "m/s^2", &accelerations), ("B_yaw_rate", "rad/s", &yaw_rates)] {
            put(name, "_min", unit, least(values.clone()));
            put(name, "_max", unit, greatest(values.clone()));
            put(name, "_std", unit, standard_deviation(values));
        }
        put("B_acc_lat_max", "", "m/s^2", greatest(lateral.collect()));
        put("B_jerk_max", "", "m/s^3", greatest(rates(&accelerations).into_iter().map(f64::abs).collect()));
    }

    fn visit_smoothed(&self, put: &mut Visitor<'_>) {
        let smoothed = smoothed(&self.positions, (((0.7 / self.dt_s).round() as usize).max(1) - 1) / 2);
        let Differences([_, accelerations, jerks]) = Differences::of(&smoothed, self.dt_s);
        let [along, across] = self.components(&accelerations);
        let now = self.present.checked_sub(1).and_then(|at| along.get(at).copied()).unwrap_or(f64::NAN);
        let future = |values: Vec<f64>| values.get(self.present + 1..).unwrap_or_default().to_vec();
        spread("S_acc_long", "m/s^2", future(along), put);
        spread("S_acc_lat", "m/s^2", future(across), put);
        spread("S_jerk", "m/s^3", future(norms(&jerks)), put);
        put("S_seam_acc", "", "m/s^2", now);
    }
}

/// The distance to the nearest center line and the angle to it, radians; `None` without lanes.
fn nearest_lane(position: Vec2, heading_rad: f64, segments: &[Segment]) -> Option<(f64, f64)> {
    let mut best: Option<(f64, f64, f64)> = None;
    let mut nearest_m = f64::INFINITY;
    for segment in segments {
        let from_start = position - segment.start;
        let share = (from_start.dot(segment.along) / (segment.length_m * segment.length_m)).clamp(0.0, 1.0);
        let distance_m = (from_start - segment.along * share).norm();
        nearest_m = nearest_m.min(distance_m);
        // Another direction counts as 100 m farther, which makes it the last choice.
        if best.is_none_or(|(penalized_m, ..)| distance_m < penalized_m) {
            let angle_rad = wrap_angle(heading_rad - segment.direction_rad).abs();
            let penalized_m = if angle_rad < FRAC_PI_3 { distance_m } else { distance_m + 100.0 };
            if best.is_none_or(|(least_m, ..)| penalized_m < least_m) {
                best = Some((penalized_m, distance_m, angle_rad));
            }
        }
    }
    best.map(|(penalized_m, _, angle_rad)| (if penalized_m > 100.0 { nearest_m } else { penalized_m }, angle_rad))
}

/// Quadratics fitted to each position and `half` on either side; at the ends, the first and last such quadratic
/// continues. Empty for a track that is shorter than a window.
fn smoothed(positions: &[Vec2], half: usize) -> Vec<Vec2> {
    let n = 2 * half + 1;
    if positions.len() < n {
        return Vec::new();
    }
    let offset = |i: usize| i as f64 - half as f64;
    let moment = |power: i32| (0..n).map(|i| offset(i).powi(power)).sum::<f64>();
    let (s0, s2, s4) = (n as f64, moment(2), moment(4));
    let fitted = |at: usize| {
        let center = at.clamp(half, positions.len() - 1 - half);
        let window = &positions[center - half..=center + half];
        let sum =
            |power: i32| window.iter().enumerate().fold(Vec2::ZERO, |sum, (i, p)| sum + *p * offset(i).powi(power));
        let (sum, first, second) = (sum(0), sum(1), sum(2));
        let x = at as f64 - center as f64;
        if half == 0 {
            return sum;
        }
        let scale = 1.0 / (s0 * s4 - s2 * s2);
        (sum * s4 - second * s2) * scale + first * (x / s2) + (second * s0 - sum * s2) * (x * x * scale)
    };
    (0..positions.len()).map(fitted).collect()
}

fn norms(vectors: &[Vec2]) -> Vec<f64> {
    vectors.iter().map(|vector| vector.norm()).collect()
}

/// Visits the statistics of a quantity.
fn spread(name: &str, unit: &'static str, values: Vec<f64>, put: &mut Visitor<'_>) {
    let names = ["_q10", "_q50", "_q90", "_min", "_max"];
    names.into_iter().zip(statistics(values)).for_each(|(statistic, value)| put(name, statistic, unit, value));
}

/// The 10 %, 50 % and 90 % quantiles (linear between values), the least and the greatest value; NaN without values.
fn statistics(mut values: Vec<f64>) -> [f64; 5] {
    values.retain(|value| value.is_finite());
    values.sort_by(f64::total_cmp);
    let (Some(least), Some(greatest)) = (values.first(), values.last()) else { return [f64::NAN; 5] };
    let quantile = |share: f64| {
        let at = share * (values.len() - 1) as f64;
        let (below, above) = (values[at as usize], values[at.ceil() as usize]);
        below + (above - below) * at.fract()
    };
    [quantile(0.1), quantile(0.5), quantile(0.9), *least, *greatest]
}

fn standard_deviation(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / n).sqrt()
}
