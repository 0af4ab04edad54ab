//! Headings of agents that are recorded without, from their motion.
//!
//! A vehicle points where its rear axle goes. In a turn of any radius, the chord between two positions of a point `a`
//! ahead of that axle, `2 a` apart, has the direction of the vehicle at the later position: the point moves outward of
//! it by the angle whose sine is `a / r`, and a chord of that length lags behind the motion by the same angle
//! (kinematic bicycle model: Rajamani, Vehicle Dynamics and Control, 2nd edition, section 2.2). Chords are also long
//! compared with the noise of trackers, and end at the present, so that they tell nothing of the future.
//!
//! Wheels do not turn on the spot: before it moves, a vehicle has the heading of its first motion, and one that backs
//! up keeps the way it points.

use super::mapping::PositionOf;
use crate::geometry::{Vec2, angle_difference, wrap_angle};
use crate::ingest::plausible_tracks::recorded_heading;
use crate::ingest::recorded_track::{HeadingSource, Observation};
use crate::scene::{AgentClass, Extent};
use std::f64::consts::{FRAC_PI_2, PI};

/// How far the rear axle of vehicles is behind their center, and the center behind the front, as shares of the length.
const AXLE_FROM_CENTER: f64 = 0.3;
const CENTER_FROM_FRONT: f64 = 0.5;
/// The shortest and the longest chord of a vehicle, meters: the noise of trackers is some centimeters, and the longest
/// fits into a roundabout.
const CHORD_M: (f64, f64) = (1.0, 12.0);
/// At the beginning of a track chords are shorter, by this factor at most.
const SHORTEST_OF_CHORD: f64 = 0.25;
/// The chord of agents without wheels, meters.
const STEP_M: f64 = 0.5;
/// Who moves by less within a second stands, meters.
const STANDING_M: f64 = 0.3;
const FRAMES_PER_S: usize = 10;
/// Who stays within this distance of a place, meters, for this long, seconds, stands for long.
const LONG_STAND_M: f64 = 2.0;
const LONG_STAND_S: f64 = 30.0;

/// The lengths of the chords that tell an agent's heading.
#[derive(Debug, Clone, Copy)]
pub(super) struct Chords {
    usual_m: f64,
    shortest_m: f64,
    /// Whether the agent keeps its heading while it stands and when it moves backward.
    pub(super) is_wheeled: bool,
}

impl Chords {
    /// Those of an agent of which `position` is recorded.
    pub(super) fn of(class: AgentClass, extent: Option<Extent>, position: PositionOf) -> Self {
        let is_wheeled = class.is_motorized() || class == AgentClass::Cyclist;
        if !is_wheeled {
            return Self { usual_m: STEP_M, shortest_m: STEP_M, is_wheeled };
        }
        let from_axle = match position {
            PositionOf::Front => AXLE_FROM_CENTER + CENTER_FROM_FRONT,
            // The rear is behind the axle, where no chord has the direction of the vehicle: this one is off by the
            // angle that the vehicle turns within half its length.
            PositionOf::Center | PositionOf::Corner | PositionOf::Rear => AXLE_FROM_CENTER,
        };
        let length_m = extent.unwrap_or_else(|| class.nominal_extent()).length_m;
        let usual_m = (2.0 * from_axle * length_m).clamp(CHORD_M.0, CHORD_M.1);
        Self { usual_m, shortest_m: (SHORTEST_OF_CHORD * usual_m).max(CHORD_M.0), is_wheeled }
    }

    /// The position from which the chord to the last one comes; `None` if it would be too short.
    fn start_of(&self, path: &[Observation]) -> Option<usize> {
        let (last, before) = path.split_last()?;
        let is_off = |from: &Observation, by_m: f64| from.position.distance(last.position) >= by_m;
        let usual = before.iter().rposition(|from| is_off(from, self.usual_m));
        usual.or_else(|| before.first().filter(|first| is_off(first, self.shortest_m)).map(|_| 0))
    }
}

/// Where an agent pointed while it stood for long, from all rows of a table: a part of it may show no motion.
#[derive(Debug, Default)]
pub(super) struct LongStands {
    /// The last place by which the heading was taken, and when.
    since: Option<(f64, Vec2)>,
    heading_rad: Option<f64>,
    found: Vec<(f64, f64)>,
}

impl LongStands {
    /// Adds the next position, by ascending time.
    pub(super) fn see(&mut self, time_s: f64, position: Vec2) {
        let Some((since_s, from)) = self.since else {
            self.since = Some((time_s, position));
            return;
        };
        if position.distance(from) < LONG_STAND_M {
            return;
        }
        let heading_rad = (position - from).angle();
        if time_s - since_s > LONG_STAND_S {
            self.found.push((time_s, self.heading_rad.unwrap_or(heading_rad)));
        }
        (self.since, self.heading_rad) = (Some((time_s, position)), Some(heading_rad));
    }

    /// Ends the rows of an agent, at the time of the next one that has its id.
    pub(super) fn end(&mut self, until_s: f64) {
        self.since = None;
        self.found.extend(self.heading_rad.take().map(|heading_rad| (until_s, heading_rad)));
    }

    /// The headings, radians from x to y, each with the time until which it stood.
    pub(super) fn into_headings(self) -> Vec<(f64, f64)> {
        self.found
    }
}

/// The heading at each observation and its source. A wheeled agent that never moves has none: 0, of unknown source.
pub(super) fn headings(seen: &[Observation], class: AgentClass, chords: Chords) -> Vec<(f64, HeadingSource)> {
    let mut found: Vec<Option<(f64, HeadingSource)>> = Vec::with_capacity(seen.len());
    // Nothing is known of the motion in gaps.
    for path in seen.chunk_by(|a, b| b.frame == a.frame + 1) {
        found.extend(along(path, class, chords));
    }
    let first = found.iter().flatten().next().copied().filter(|_| chords.is_wheeled);
    let mut known_rad = first.map(|(heading_rad, _)| heading_rad);
    let filled = found.into_iter().zip(seen).map(|(found, seen)| match (found, known_rad) {
        (Some((heading_rad, source)), _) => {
            known_rad = Some(heading_rad);
            (heading_rad, source)
        }
        (None, Some(known_rad)) => (known_rad, HeadingSource::Held),
        (None, None) if chords.is_wheeled => (0.0, HeadingSource::Unknown),
        (None, None) => (seen.velocity.angle(), HeadingSource::Unknown),
    });
    filled.collect()
}

/// The headings along a path without gaps; `None` where nothing tells.
fn along(path: &[Observation], class: AgentClass, chords: Chords) -> Vec<Option<(f64, HeadingSource)>> {
    let mut found: Vec<Option<(f64, HeadingSource)>> = Vec::with_capacity(path.len());
    // Where the heading was last taken.
    let (mut known_rad, mut taken): (Option<f64>, usize) = (None, 0);
    let (mut is_recorded, mut forward_m) = (false, 0.0);
    for (at, now) in path.iter().enumerate() {
        if let Some(heading_rad) = now.heading_rad {
            let heading_rad = recorded_heading(heading_rad, class);
            (known_rad, taken, is_recorded) = (Some(heading_rad), at, true);
            found.push(Some((heading_rad, HeadingSource::Recorded)));
            continue;
        }
        let is_near = |before: usize| path[before].position.distance(now.position) < STANDING_M;
        let stands = known_rad.is_some() && is_near(taken) && is_near(at.saturating_sub(FRAMES_PER_S));
        let start = if stands { None } else { chords.start_of(&path[..=at]) };
        let Some(start) = start else {
            found.push(known_rad.map(|known_rad| (known_rad, HeadingSource::Held)));
            continue;
        };
        let along_rad = (now.position - path[start].position).angle();
        let is_back = |known_rad: f64| angle_difference(along_rad, known_rad).abs() > FRAC_PI_2;
        let backs_up = chords.is_wheeled && known_rad.is_some_and(is_back);
        let moved_m = now.position.distance(path[taken].position);
        forward_m += if backs_up { -moved_m } else { moved_m };
        let heading_rad = if backs_up { wrap_angle(along_rad + PI) } else { along_rad };
        (known_rad, taken) = (Some(heading_rad), at);
        found.push(Some((heading_rad, HeadingSource::Motion)));
    }
    if chords.is_wheeled {
        // It was in reverse when it began to move.
        if forward_m < 0.0 && !is_recorded {
            found.iter_mut().flatten().for_each(|(heading_rad, _)| *heading_rad = wrap_angle(*heading_rad + PI));
        }
        let n_before = found.iter().take_while(|found| found.is_none()).count();
        if let Some((first_rad, _)) = found.get(n_before).copied().flatten() {
            found[..n_before].fill(Some((first_rad, HeadingSource::Held)));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seed::Seed;

    const CAR: Extent = Extent { length_m: 4.5, width_m: 1.8 };
    const TRUCK: Extent = Extent { length_m: 16.0, width_m: 2.5 };

    fn observations(position: impl Fn(f64) -> Vec2, n: i64) -> Vec<Observation> {
        let seen = |frame: i64| Observation {
            frame,
            position: position(frame as f64 / 10.0),
            velocity: Vec2::ZERO,
            heading_rad: None,
        };
        (0..n).map(seen).collect()
    }

    fn of(seen: &[Observation], extent: Extent, position: PositionOf) -> Vec<(f64, HeadingSource)> {
        headings(seen, AgentClass::Vehicle, Chords::of(AgentClass::Vehicle, Some(extent), position))
    }

    fn noise(seed: u64, of: u64) -> f64 {
        Seed(seed).derive("noise", &[of]).rng().normal()
    }

    #[test]
    fn a_vehicle_in_a_turn_points_along_its_rear_axle() {
        // The axle goes around a circle at 4 m/s; the point is ahead of it along the tangent.
        for radius_m in [5.0, 9.0, 40.0] {
            for (extent, position, ahead_m) in
                [(CAR, PositionOf::Center, 1.35), (CAR, PositionOf::Front, 3.6), (TRUCK, PositionOf::Center, 4.8)]
            {
                let heading = |t: f64| 4.0 / radius_m * t + FRAC_PI_2;
                let at = |t: f64| {
                    Vec2::from_angle(heading(t) - FRAC_PI_2) * radius_m + Vec2::from_angle(heading(t)) * ahead_m
                };
                let found = of(&observations(at, 120), extent, position);
                for (frame, (heading_rad, source)) in found.iter().enumerate().skip(60) {
                    let late_rad = angle_difference(heading(frame as f64 / 10.0), *heading_rad);
                    // Chords begin at a frame, up to one too early.
                    let from_center_m = f64::hypot(radius_m, ahead_m);
                    let step_m = 0.4 * from_center_m / radius_m;
                    let lag = |chord_m: f64| (chord_m / 2.0 / from_center_m).asin();
                    let most_rad = lag(2.0 * ahead_m + step_m) - lag(2.0 * ahead_m);
                    assert!((-1e-9..=most_rad).contains(&late_rad), "{radius_m} {ahead_m} {frame}: {late_rad}");
                    assert_eq!(*source, HeadingSource::Motion);
                }
            }
        }
    }

    #[test]
    fn who_stands_has_the_heading_of_the_first_motion_or_the_last_and_noise_does_not_turn_it() {
        // North: stands for 6 s, speeds up, brakes to a halt, and stands again; 2 cm of noise.
        let y = |t: f64| match t {
            _ if t < 6.0 => 0.0,
            _ if t < 10.0 => (t - 6.0).powi(2),
            _ if t < 14.0 => 32.0 - (14.0 - t).powi(2),
            _ => 32.0,
        };
        for seed in 0..20 {
            let at = |t: f64| {
                let of = (t * 10.0).round() as u64;
                Vec2::new(0.02 * noise(seed, 2 * of), y(t) + 0.02 * noise(seed, 2 * of + 1))
            };
            let found = of(&observations(at, 250), CAR, PositionOf::Center);
            let off_deg = |(heading_rad, _): &(f64, HeadingSource)| angle_difference(*heading_rad, FRAC_PI_2).abs();
            let worst_deg = found.iter().map(off_deg).fold(0.0, f64::max).to_degrees();
            // Two positions at the ends of a chord of 1 m, off to the side by four deviations of their difference.
            assert!(worst_deg < (0.08 * 2_f64.sqrt()).atan().to_degrees(), "{seed}: {worst_deg}");
            for stands in [0..60, 155..250] {
                let first = found[stands.start];
                assert!(found[stands].iter().all(|found| *found == (first.0, HeadingSource::Held)), "{seed}");
            }
        }
        let parked = |t: f64| Vec2::new(0.09 * noise(7, (t * 10.0) as u64), 0.09 * noise(8, (t * 10.0) as u64));
        let found = of(&observations(parked, 3000), CAR, PositionOf::Front);
        assert!(found.iter().all(|found| *found == (0.0, HeadingSource::Unknown)));
    }

    #[test]
    fn who_backs_up_keeps_its_way() {
        // Forward by 20 m, back by 8 m, forward again, along x.
        let x = |t: f64| match t {
            _ if t < 5.0 => 4.0 * t,
            _ if t < 9.0 => 20.0 - 2.0 * (t - 5.0),
            _ => 12.0 + 5.0 * (t - 9.0),
        };
        let seen = observations(|t| Vec2::new(x(t), 0.0), 140);
        assert!(of(&seen, CAR, PositionOf::Center).iter().all(|(heading_rad, _)| heading_rad.abs() < 1e-12));
        // Out of a parking space, and off.
        let found = of(&seen[50..], CAR, PositionOf::Center);
        assert!(found.iter().all(|(heading_rad, _)| heading_rad.abs() < 1e-12), "{found:?}");
    }

    #[test]
    fn gaps_and_recorded_headings_are_known_places() {
        // East, unseen while it turns, then standing: nothing tells more than the last heading.
        let mut seen = observations(|t| Vec2::new(f64::min(8.0 * t, 40.0), 0.0), 100);
        seen.retain(|seen| !(30..60).contains(&seen.frame));
        let found = of(&seen, CAR, PositionOf::Center);
        assert!(found.iter().all(|(heading_rad, _)| heading_rad.abs() < 1e-12));
        assert!(found[30..].iter().all(|(_, source)| *source == HeadingSource::Held));
        // A recorded heading holds while nothing moves, as well before.
        let mut seen = observations(|_| Vec2::ZERO, 30);
        seen[10].heading_rad = Some(2.0);
        let found = of(&seen, CAR, PositionOf::Center);
        assert!(found.iter().all(|(heading_rad, _)| *heading_rad == 2.0));
        assert_eq!([found[0].1, found[10].1], [HeadingSource::Held, HeadingSource::Recorded]);
    }

    #[test]
    fn long_stands_are_known_from_before_or_after() {
        // Stands for a minute, goes north, stands for two, and goes east; then another agent, which never moves.
        let mut stands = LongStands::default();
        for t in (0..300).map(f64::from) {
            let (x, y) = (f64::max(0.0, 5.0 * (t - 190.0)), (5.0 * (t - 60.0)).clamp(0.0, 50.0));
            stands.see(1000.0 + t, Vec2::new(x, y));
        }
        stands.end(1300.0);
        (0..100).for_each(|t| stands.see(1300.0 + f64::from(t), Vec2::ZERO));
        stands.end(f64::INFINITY);
        assert_eq!(stands.into_headings(), [(1061.0, FRAC_PI_2), (1191.0, FRAC_PI_2), (1300.0, 0.0)]);
    }

    #[test]
    fn people_may_face_anywhere_before_they_walk() {
        let seen = observations(|t| Vec2::new(0.0, f64::max(0.0, 1.3 * (t - 2.0))), 60);
        let found =
            headings(&seen, AgentClass::Pedestrian, Chords::of(AgentClass::Pedestrian, None, PositionOf::Center));
        assert!(found[..=20].iter().all(|(_, source)| *source == HeadingSource::Unknown));
        assert!(found[30..].iter().all(|found| *found == (FRAC_PI_2, HeadingSource::Motion)));
    }
}
