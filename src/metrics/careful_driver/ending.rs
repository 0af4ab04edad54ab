//! The motion after the last state of a scenario: does the subject drive into another agent, and could a careful driver
//! avoid it?

use super::braking::Braking;
use super::regulation::DELAY_S;
use crate::behavior::footprint::Footprint;
use crate::behavior::time_to_collision::time_to_collision_s;
use crate::geometry::{OrientedBox, Vec2};
use crate::metrics::{Check, Violation};
use crate::scene::{Scene, State, Track};
use serde::{Deserialize, Serialize};

/// Only contacts within this time after the last state count, seconds: later, motion on straight lines predicts little.
const CONTACT_WITHIN_S: f64 = 1.0;
/// A vehicle brakes if its speed falls by at least this much, m/s², over [`BRAKING_S`].
const BRAKING_MPS2: f64 = 1.0;
const BRAKING_S: f64 = 0.5;
/// Step and end of the simulation, seconds.
const STEP_S: f64 = 0.025;
const END_S: f64 = 10.0;
/// The deceleration that stands for "no braking helps", m/s², as for DRAC.
const MOST_MPS2: f64 = 20.0;

/// How a scenario ends for its subject.
///
/// After the last state all other agents keep their velocity, and so does the subject until it brakes. Only agents
/// ahead of it count, since braking is no help against others.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Ending {
    /// When the subject touches another agent if it does not brake, seconds after the last state; `None` if it does not
    /// within a second.
    pub contact_s: Option<f64>,
    /// The least steady deceleration from the last state on that avoids contact, at most 20 m/s²; 0 if none is needed.
    pub required_deceleration_mps2: f64,
    /// The relative speed of the contact that remains if the careful driver takes over at the last state, m/s: it
    /// brakes 0.75 s later, or at once if the subject brakes already. `None` if they do not touch.
    pub remaining_mps: Option<f64>,
    /// Whether the subject reacts: slows down by at least 1 m/s² over half a second, at some time since the event
    /// began.
    pub subject_reacts: bool,
}

impl Ending {
    /// The ending of a scene for this agent, the subject of an event that begins at `start_timestep`. `None` if it is
    /// not tracked in the future.
    pub fn of(scene: &Scene, subject_idx: usize, start_timestep: usize) -> Option<Self> {
        let subject = &scene.tracks[subject_idx];
        let last = subject.trajectory.valid().next_back().map(|(timestep, _)| timestep)?;
        let state = scene.state(subject_idx, last).filter(|state| state.is_finite() && last >= scene.n_history)?;
        let n_braking = (BRAKING_S / scene.dt_s).round().max(1.0) as usize;
        let brakes_at = |timestep: usize| {
            let speed_mps = |timestep: usize| scene.state(subject_idx, timestep).map(State::speed_mps);
            let before = timestep.checked_sub(n_braking).and_then(speed_mps);
            let fallen_mps = before.zip(speed_mps(timestep)).map(|(before, now)| before - now);
            fallen_mps.is_some_and(|fallen_mps| fallen_mps >= BRAKING_MPS2 * n_braking as f64 * scene.dt_s)
        };
        let met = met(scene, subject_idx, last);
        let contact_s = met.iter().map(|(contact_s, ..)| *contact_s).reduce(f64::min);
        let from_s = if brakes_at(last) { 0.0 } else { DELAY_S };
        let remaining = |braking: &Braking| {
            met.iter()
                .filter_map(|(_, track, other)| touched_mps((subject, state), (track, other), braking))
                .reduce(f64::max)
        };
        let careful = |from_s: f64| Braking::careful(state.speed_mps(), Some(from_s));
        let suffices = |max_deceleration_mps2: f64| {
            let at_once = Braking { max_deceleration_mps2, ramp_s: 1e-6, ..careful(0.0) };
            remaining(&at_once).is_none()
        };
        Some(Self {
            contact_s,
            required_deceleration_mps2: if met.is_empty() { 0.0 } else { least(suffices) },
            remaining_mps: remaining(&careful(from_s)),
            subject_reacts: (start_timestep..=last).any(brakes_at),
        })
    }

    /// The violation that it is, if the careful driver does not avoid the contact of this subject.
    pub fn violation(&self, scene: &Scene, subject_idx: usize) -> Option<Violation> {
        let last = scene.tracks[subject_idx].trajectory.valid().next_back().map(|(timestep, _)| timestep)?;
        let remaining_mps = self.remaining_mps?;
        Some(Violation::new(Check::ContactAfterEnd, scene, subject_idx, last, (remaining_mps, 0.0)))
    }
}

/// The agents ahead of the subject that it touches within a second after `last` if nobody brakes: when, and their state
/// at that time.
fn met(scene: &Scene, subject_idx: usize, last: usize) -> Vec<(f64, &Track, &State)> {
    let at = |agent_idx: usize| {
        let (track, state) = (&scene.tracks[agent_idx], scene.state(agent_idx, last)?);
        state.is_finite().then(|| (track, state, Footprint::new(&track.footprint(state))))
    };
    let Some((_, state, own)) = at(subject_idx) else { return Vec::new() };
    let others = (0..scene.tracks.len()).filter(|agent_idx| *agent_idx != subject_idx).filter_map(at);
    let ahead = others.filter(|(_, other, _)| (other.position - state.position).dot(own.forward) > 0.0);
    ahead
        .filter_map(|(track, other, theirs)| {
            let contact_s = time_to_collision_s(&own, state.velocity, &theirs, other.velocity)?;
            (contact_s <= CONTACT_WITHIN_S).then_some((contact_s, track, other))
        })
        .collect()
}

/// The relative speed with which a subject that brakes like this, straight on, touches the other. `None` if it stands
/// or is no faster than the other before.
fn touched_mps((subject, state): (&Track, &State), (track, other): (&Track, &State), braking: &Braking) -> Option<f64> {
    let along = Vec2::from_angle(if state.speed_mps() > 0.0 { state.velocity.angle() } else { state.heading_rad });
    for step in 0..=(END_S / STEP_S) as usize {
        let time_s = step as f64 * STEP_S;
        let body =
            OrientedBox { center: state.position + along * braking.driven_m(time_s), ..subject.footprint(state) };
        let theirs = OrientedBox { center: other.position + other.velocity * time_s, ..track.footprint(other) };
        let own_mps = along * braking.speed_mps(time_s);
        if body.overlaps(&theirs) {
            return Some((own_mps - other.velocity).norm());
        }
        let has_begun = braking.from_s.is_some_and(|from_s| time_s >= from_s);
        if has_begun && own_mps.norm() <= other.velocity.dot(along).max(0.0) {
            break;
        }
    }
    None
}

/// The least deceleration that suffices, by bisection, m/s².
fn least(suffices: impl Fn(f64) -> bool) -> f64 {
    let (mut low, mut high) = (0.0, MOST_MPS2);
    for _ in 0..12 {
        let middle = f64::midpoint(low, high);
        if suffices(middle) { high = middle } else { low = middle }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Trajectory;
    use crate::scene::testing::{Drive, scene};

    /// A car at 20 m/s whose front is `gap_m` behind the rear of one at 10 m/s at the last state. If it brakes, it does
    /// so with 2 m/s² all the time.
    fn ending(gap_m: f64, aside_m: f64, brakes: bool) -> Ending {
        let mut scene = scene(&[Drive::straight(0.0, 0.0, 0.0, 20.0), Drive::straight(0.0, aside_m, 0.0, 10.0)]);
        let last = scene.n_timesteps - 1;
        let place = |timestep: usize, end: Vec2, speed_mps: f64, mps2: f64| {
            let left_s = (last - timestep) as f64 * scene.dt_s;
            let x = end.x - left_s * speed_mps - 0.5 * mps2 * left_s * left_s;
            let velocity = Vec2::new(speed_mps + mps2 * left_s, 0.0);
            Some(State { position: Vec2::new(x, end.y), heading_rad: 0.0, velocity })
        };
        let (n, mps2) = (scene.n_timesteps, if brakes { 2.0 } else { 0.0 });
        let own = (0..n).map(|timestep| place(timestep, Vec2::ZERO, 20.0, mps2)).collect();
        let theirs = (0..n).map(|timestep| place(timestep, Vec2::new(4.5 + gap_m, aside_m), 10.0, 0.0)).collect();
        (scene.tracks[0].trajectory, scene.tracks[1].trajectory) = (Trajectory::new(own), Trajectory::new(theirs));
        Ending::of(&scene, 0, scene.n_history).unwrap()
    }

    #[test]
    fn what_is_required_at_the_end_follows_from_gap_and_speeds() {
        // 8 m at 10 m/s: contact after 0.8 s; 10² / (2 · 8) = 6.25 m/s² are required.
        let near = ending(8.0, 0.0, false);
        assert!((near.contact_s.unwrap() - 0.8).abs() < 1e-6);
        assert!((near.required_deceleration_mps2 - 6.25).abs() < 0.1, "{near:?}");
        // Its reaction takes until 0.5 m are left, so hardly anything of 10 m/s is gone.
        assert!(near.remaining_mps.is_some_and(|mps| (9.5..10.0).contains(&mps)) && !near.subject_reacts, "{near:?}");
        // A subject that brakes already continues: 10 m/s take 1.6 s in all, in which 8.9 m are needed, so 9.9 m are
        // enough.
        let braking = ending(9.9, 0.0, true);
        assert!(braking.subject_reacts && braking.remaining_mps.is_none(), "{braking:?}");
        assert!(braking.contact_s.is_some(), "{braking:?}");
        assert!(ending(8.0, 0.0, true).remaining_mps.is_some());
        // Farther away, or beside it, nobody is touched.
        for clear in [ending(10.5, 0.0, false), ending(3.0, 3.0, false), ending(-9.5, 0.0, false)] {
            assert_eq!((clear.contact_s, clear.required_deceleration_mps2, clear.remaining_mps), (None, 0.0, None));
        }
        // If they touch already, nothing helps.
        assert!(ending(-1.0, 0.0, true).required_deceleration_mps2 > 19.9);
    }
}
