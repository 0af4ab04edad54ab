//! The motion of one track, and its features: the definitions in [`super::features`] as differences.

use crate::geometry::{Polyline, SegmentIndex, Vec2, wrap_angle};
use crate::quantile::quantile;
use crate::scene::LaneGraph;
use std::f64::consts::FRAC_PI_3;

/// Callback for the values of features: the name in two parts, the unit and the value.
type Visitor<'v> = dyn FnMut(&str, &str, &'static str, f64) + 'v;

/// A lane in another direction than the agent's counts as this much farther, meters, which makes it the last choice.
const ASTRAY_M: f64 = 100.0;

/// The center lines of all lanes.
#[derive(Default)]
pub(super) struct CenterLines {
    segments: Vec<Segment>,
    index: SegmentIndex,
}

/// A piece of a center line.
struct Segment {
    start: Vec2,
    along: Vec2,
    length_squared: f64,
    direction_rad: f64,
}

/// The motion of one track without gaps, timestep by timestep.
pub(super) struct Motion {
    pub(super) dt_s: f64,
    pub(super) present: usize,
    pub(super) positions: Vec<Vec2>,
    pub(super) headings_rad: Vec<f64>,
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
    pub(super) fn visit(&self, lines: &CenterLines, gap_m: f64, put: &mut Visitor<'_>) {
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
        self.visit_lanes(lines, put);
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

    fn visit_lanes(&self, lines: &CenterLines, put: &mut Visitor<'_>) {
        let from_present = self.positions.iter().zip(&self.headings_rad).skip(self.present);
        let found: Option<Vec<(f64, f64)>> = from_present.map(|(p, heading)| lines.nearest(*p, *heading)).collect();
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
        put("half_second_speed_min", "", "m/s", least(speeds.clone()));
        put("half_second_speed_max", "", "m/s", greatest(speeds.clone()));
        put("half_second_speed_last", "", "m/s", speeds.last().copied().unwrap_or(f64::NAN));
        for (name, unit, values) in
            [("half_second_acc", "m/s^2", &accelerations), ("half_second_yaw_rate", "rad/s", &yaw_rates)]
        {
            put(name, "_min", unit, least(values.clone()));
            put(name, "_max", unit, greatest(values.clone()));
            put(name, "_std", unit, standard_deviation(values));
        }
        put("half_second_acc_lat_max", "", "m/s^2", greatest(lateral.collect()));
        put("half_second_jerk_max", "", "m/s^3", greatest(rates(&accelerations).into_iter().map(f64::abs).collect()));
    }

    fn visit_smoothed(&self, put: &mut Visitor<'_>) {
        let smoothed = smoothed(&self.positions, (((0.7 / self.dt_s).round() as usize).max(1) - 1) / 2);
        let Differences([_, accelerations, jerks]) = Differences::of(&smoothed, self.dt_s);
        let [along, across] = self.components(&accelerations);
        let now = self.present.checked_sub(1).and_then(|at| along.get(at).copied()).unwrap_or(f64::NAN);
        let future = |values: Vec<f64>| values.get(self.present + 1..).unwrap_or_default().to_vec();
        spread("smoothed_acc_long", "m/s^2", future(along), put);
        spread("smoothed_acc_lat", "m/s^2", future(across), put);
        spread("smoothed_jerk", "m/s^3", future(norms(&jerks)), put);
        put("smoothed_seam_acc", "", "m/s^2", now);
    }
}

impl CenterLines {
    pub(super) fn new(lanes: &LaneGraph) -> Self {
        let ends: Vec<[Vec2; 2]> = lanes.lanes().iter().flat_map(|lane| ends(&lane.centerline)).collect();
        let segment = |[start, end]: &[Vec2; 2]| {
            let along = *end - *start;
            Segment { start: *start, along, length_squared: along.dot(along), direction_rad: along.angle() }
        };
        Self { segments: ends.iter().map(segment).collect(), index: SegmentIndex::new(ends) }
    }

    /// The distance to the nearest center line and the angle to it, radians; `None` without lanes.
    fn nearest(&self, position: Vec2, heading_rad: f64) -> Option<(f64, f64)> {
        let distance_m = |segment: &Segment| {
            let from_start = position - segment.start;
            let share = (from_start.dot(segment.along) / segment.length_squared).clamp(0.0, 1.0);
            (from_start - segment.along * share).norm()
        };
        let angle_rad = |segment: &Segment| wrap_angle(heading_rad - segment.direction_rad).abs();
        let cost = |i: usize| {
            let segment = &self.segments[i];
            let astray_m = if angle_rad(segment) < FRAC_PI_3 { 0.0 } else { ASTRAY_M };
            Some(distance_m(segment) + astray_m)
        };
        let (i, _) = self.index.nearest(position, f64::sqrt, cost)?;
        Some((distance_m(&self.segments[i]), angle_rad(&self.segments[i])))
    }
}

/// The ends of the segments of a line that are long enough to have a direction.
fn ends(line: &Polyline) -> impl Iterator<Item = [Vec2; 2]> {
    line.0.windows(2).map(|pair| [pair[0], pair[1]]).filter(|[start, end]| start.distance(*end) > 1e-6)
}

/// Quadratics fitted to each position and `half` positions on either side; the first and last such quadratic continue
/// to the ends. Empty for a track that is shorter than a window.
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
    [0.1, 0.5, 0.9, 0.0, 1.0].map(|share| quantile(&values, share).unwrap_or(f64::NAN))
}

fn standard_deviation(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / n).sqrt()
}
