//! A maneuver that is solved for a requested event: the agents that take part, and their states after the present.
//!
//! A template fixes the motion of the agents of the event; the denoiser samples everybody else around them. It depends
//! on the past and the map alone.

mod checks;

pub(super) use checks::{InTheWay, distinct, follows};

use crate::geometry::{Vec2, angle_difference, wrap_angle};
use crate::scene::{STANDING_STEP_M, Scene, State, Trajectory, velocity_at};

/// The difference between the recorded motion at present and the template, such as a lateral drift, fades within this
/// time, seconds.
const FADE_S: f64 = 1.0;
/// The difference in acceleration fades within this time, seconds: as long as a foot takes from one pedal to the other.
const PEDAL_S: f64 = 0.5;
/// The largest difference in acceleration that is made up for, m/s²: beyond, one of the two is no motion of a vehicle.
const MOST_SURPLUS_MPS2: f64 = 5.0;
/// The observed acceleration is taken over at most, and at least, so many timesteps.
const N_OBSERVED: usize = 6;
const LEAST_OBSERVED: usize = 4;
/// Agents below this speed stand, m/s.
const STANDING_MPS: f64 = 0.5;
/// Passes of the filter that rounds off the corners of center lines.
const N_ROUNDINGS: usize = 3;

/// The futures of the agents that take part.
#[derive(Debug, Clone, PartialEq)]
pub struct Template {
    motions: Vec<Motion>,
}

/// The future of one agent.
#[derive(Debug, Clone, PartialEq)]
struct Motion {
    /// Whose.
    agent_idx: usize,
    /// Its state at each timestep after the present, in the scene frame.
    states: Vec<State>,
}

impl Template {
    /// A maneuver without agents yet.
    pub(crate) const fn empty() -> Self {
        Self { motions: Vec::new() }
    }

    /// Adds an agent that follows `place`, its position by the seconds after the present. The motion starts at the
    /// agent's present position, velocity and acceleration and joins `place` within a second. `None` if the agent is
    /// not tracked at present, or `place` is undefined at some time.
    pub(crate) fn with(mut self, scene: &Scene, agent_idx: usize, place: impl Fn(f64) -> Option<Vec2>) -> Option<Self> {
        let state = scene.state(agent_idx, scene.current_timestep()).filter(|state| state.is_finite())?;
        let (start, soon) = (place(0.0)?, place(scene.dt_s / 2.0)?);
        let missing = state.position - start;
        let velocity = (soon - start) * (2.0 / scene.dt_s);
        let drift = state.velocity - velocity;
        let past = scene.tracks[agent_idx].trajectory.entries()[..=scene.current_timestep()].iter().flatten();
        let past: Vec<Vec2> = past.map(|state| state.position).collect();
        let observed = acceleration(&past, scene.dt_s).filter(|_| state.speed_mps() > STANDING_MPS);
        let at = |step: usize| place(step as f64 * scene.dt_s);
        let bend = |step: usize| Some(at(step)? - at(step + 1)? * 2.0 + at(step + 2)?);
        // Extrapolated to the present.
        let planned = bend(0).zip(bend(1)).map(|(first, next)| (first * 2.0 - next) * (1.0 / scene.dt_s.powi(2)));
        let surplus = observed.map_or(Vec2::ZERO, |observed| {
            // The fading of position and velocity accelerates, too.
            let fades = (drift * 2.0 + missing * (1.0 / FADE_S)) * (1.0 / FADE_S);
            let surplus = observed - planned.unwrap_or(Vec2::ZERO) + fades;
            surplus * (MOST_SURPLUS_MPS2 / surplus.norm().max(MOST_SURPLUS_MPS2))
        });
        let joins =
            |elapsed_s: f64| (missing + (drift + missing * (1.0 / FADE_S)) * elapsed_s) * (-elapsed_s / FADE_S).exp();
        let eases = |elapsed_s: f64| surplus * (elapsed_s * elapsed_s / 2.0 * (-elapsed_s / PEDAL_S).exp());
        let speed_mps = velocity.norm();
        let (mut before, mut driven_m) = (start, 0.0);
        let position = |step: usize| {
            let (elapsed_s, at) = (step as f64 * scene.dt_s, place(step as f64 * scene.dt_s)?);
            driven_m += at.distance(before);
            before = at;
            // The difference fades over the way, so that an agent that stops does not slide aside.
            let moved_s = if speed_mps > STANDING_MPS { elapsed_s.min(driven_m / speed_mps) } else { elapsed_s };
            Some((at + joins(moved_s), eases(moved_s)))
        };
        let future: Option<Vec<(Vec2, Vec2)>> =
            (1..scene.n_timesteps - scene.current_timestep()).map(position).collect();
        let (future, eased): (Vec<Vec2>, Vec<Vec2>) = future?.into_iter().unzip();
        let positions: Vec<Vec2> = rounded(&past, future).into_iter().zip(eased).map(|(at, by)| at + by).collect();
        let states = states(state, scene.dt_s, &past, &positions);
        self.motions.push(Motion { agent_idx, states });
        Some(self)
    }

    /// The agents that take part.
    pub fn agents(&self) -> impl Iterator<Item = usize> {
        self.motions.iter().map(|motion| motion.agent_idx)
    }

    /// Replaces the recorded futures of the agents in `scene`.
    pub fn apply(self, scene: &mut Scene) {
        let n_kept = scene.current_timestep() + 1;
        for Motion { agent_idx, states } in self.motions {
            let trajectory = &mut scene.tracks[agent_idx].trajectory;
            let kept = trajectory.entries()[..n_kept].iter().copied();
            *trajectory = Trajectory::new(kept.chain(states.into_iter().map(Some)).collect());
        }
    }
}

/// The acceleration at the end of a past, m/s²: that of the parabola fitted to its last positions. `None` if they are
/// too few.
fn acceleration(past: &[Vec2], dt_s: f64) -> Option<Vec2> {
    let last = &past[past.len().saturating_sub(N_OBSERVED)..];
    let n = last.len() as f64;
    // Least squares: the squares of the offsets from the middle, which are these less their mean.
    let weight = |i: usize| (i as f64 - (n - 1.0) / 2.0).powi(2) - (n * n - 1.0) / 12.0;
    let (mut bend, mut norm) = (Vec2::ZERO, 0.0);
    for (i, position) in last.iter().enumerate() {
        bend = bend + (*position - last[0]) * weight(i);
        norm += weight(i).powi(2);
    }
    (last.len() >= LEAST_OBSERVED).then(|| bend * (2.0 / (norm * dt_s * dt_s)))
}

/// The states of an agent that was at the positions of its `past`, is `now` somewhere and then at `positions`.
/// Velocities are slopes of the positions, as those of sampled states are. Headings follow the motion, and stay while
/// the agent stands.
fn states(now: &State, dt_s: f64, past: &[Vec2], positions: &[Vec2]) -> Vec<State> {
    // A vehicle may be recorded with a heading that differs from its motion.
    let slip_rad = match now.speed_mps() * dt_s < STANDING_STEP_M {
        true => 0.0,
        false => angle_difference(now.heading_rad, now.velocity.angle()),
    };
    let course: Vec<Vec2> = past.iter().chain(positions).copied().collect();
    let mut held_rad = now.heading_rad;
    let state = |(step, position): (usize, &Vec2)| {
        let at = |offset: isize| course.get((past.len() + step).checked_add_signed(offset)?).copied();
        let velocity = velocity_at(at, dt_s).unwrap_or_default();
        let slip_rad = slip_rad * (-((step + 1) as f64) * dt_s / FADE_S).exp();
        if velocity.norm() * dt_s >= STANDING_STEP_M {
            held_rad = wrap_angle(velocity.angle() + slip_rad);
        }
        State { position: *position, heading_rad: held_rad, velocity }
    };
    positions.iter().enumerate().map(state).collect()
}

/// 0 at 0, 1 at 1, with no velocity and no acceleration at both ends: 10 u³ - 15 u⁴ + 6 u⁵.
pub(super) fn quintic(u: f64) -> f64 {
    let u = u.clamp(0.0, 1.0);
    u * u * u * (10.0 + u * (6.0 * u - 15.0))
}

/// The largest second derivative of [`quintic`]: 10 / √3.
pub(super) const QUINTIC_PEAK: f64 = 5.773_502_691_896_258;

/// The inverse of [`quintic`] for a value from 0 to 1, by bisection.
pub(super) fn quintic_inverse(value: f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..60 {
        let middle = f64::midpoint(low, high);
        if quintic(middle) < value { low = middle } else { high = middle }
    }
    high
}

/// The course after `past` with its corners rounded off, by a binomial filter over half a second that leaves the past
/// as it is.
fn rounded(past: &[Vec2], future: Vec<Vec2>) -> Vec<Vec2> {
    let n_past = past.len();
    let mut course: Vec<Vec2> = past.iter().copied().chain(future).collect();
    for _ in 0..N_ROUNDINGS {
        // Beyond its ends the course goes straight on.
        let at = |i: isize| {
            let last = course.len() - 1;
            let beyond = |end: Vec2, inner: Vec2, by: f64| end + (end - inner) * by;
            match usize::try_from(i) {
                Err(_) => beyond(course[0], course[1.min(last)], -i as f64),
                Ok(i) if i > last => beyond(course[last], course[last.saturating_sub(1)], (i - last) as f64),
                Ok(i) => course[i],
            }
        };
        let smooth = |i: usize| {
            let i = i as isize;
            (at(i - 2) + at(i + 2)) * (1.0 / 16.0) + (at(i - 1) + at(i + 1)) * 0.25 + at(i) * 0.375
        };
        let next: Vec<Vec2> = (n_past..course.len()).map(smooth).collect();
        course.truncate(n_past);
        course.extend(next);
    }
    course.split_off(n_past)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{self, Drive};

    #[test]
    fn the_quintic_has_the_shape_that_is_said_of_it() {
        assert_eq!((quintic(0.0), quintic(0.5), quintic(1.0), quintic(2.0)), (0.0, 0.5, 1.0, 1.0));
        let h = 1e-4;
        let second = |u: f64| (quintic(u + h) - 2.0 * quintic(u) + quintic(u - h)) / (h * h);
        let peak = (1..1000).map(|i| second(f64::from(i) / 1000.0).abs()).fold(0.0, f64::max);
        assert!((peak - QUINTIC_PEAK).abs() < 1e-3, "{peak}");
        for value in [0.0, 0.1, 0.5, 0.97] {
            assert!((quintic(quintic_inverse(value)) - value).abs() < 1e-12);
        }
    }

    #[test]
    fn a_template_goes_on_from_where_and_how_the_agent_moves() {
        let mut scene = testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(30.0, 0.0, 0.0, 10.0)]);
        let now = *scene.state(0, scene.current_timestep()).unwrap();
        // Half a meter aside, and 1 m/s slower than it drives.
        let place = |t: f64| Some(now.position + Vec2::new(9.0 * t, 0.5));
        let template = Template::empty().with(&scene, 0, place).unwrap();
        assert!(template.is_clear(&scene, InTheWay::Everybody), "the one ahead drives on");
        let before = scene.tracks[0].trajectory.clone();
        template.apply(&mut scene);
        let after = &scene.tracks[0].trajectory;
        assert_eq!(before.entries()[..scene.n_history], after.entries()[..scene.n_history]);
        let state = |timestep: usize| *after.get(timestep).unwrap();
        let seam = state(scene.n_history).velocity - now.velocity;
        assert!(seam.norm() < 0.3, "{seam:?}");
        // Velocities are those at the timesteps, and not half a timestep earlier.
        for timestep in scene.n_history..scene.n_timesteps - 1 {
            let steps = state(timestep + 1).position - state(timestep - 1).position;
            assert!((steps * (0.5 / scene.dt_s) - state(timestep).velocity).norm() < 1e-9);
        }
        // Who brakes goes on braking for a moment.
        let mut braking = testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0)]);
        let entries = braking.tracks[0].trajectory.entries().iter().enumerate().map(|(i, state)| {
            let t = (i as f64 - braking.current_timestep() as f64) * braking.dt_s;
            state.map(|state| State {
                position: Vec2::new(10.0 * t - 1.5 * t * t, 0.0),
                velocity: Vec2::new(10.0 - 3.0 * t, 0.0),
                ..state
            })
        });
        braking.tracks[0].trajectory = Trajectory::new(entries.collect());
        let along = |t: f64| Some(Vec2::new(10.0 * t, 0.0));
        Template::empty().with(&braking, 0, along).unwrap().apply(&mut braking);
        let x = |timestep: usize| braking.state(0, timestep).unwrap().position.x;
        let step = |timestep: usize| (x(timestep + 1) - 2.0 * x(timestep) + x(timestep - 1)) / braking.dt_s.powi(2);
        let n = braking.n_history;
        assert!((step(n - 1) + 3.0).abs() < 1.0 && (step(n) + 3.0).abs() < 2.0, "{} {}", step(n - 1), step(n));
        let last = braking.n_timesteps - 1;
        assert!((x(last) - 10.0 * (last - n + 1) as f64 * braking.dt_s).abs() < 0.3, "it soon follows the plan");
        // Who comes over to where another drives is in its way, unless that one takes part and makes room.
        let scene = testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(0.0, 2.5, 0.0, 10.0)]);
        let over = |t: f64| Some(now.position + Vec2::new(10.0 * t, 2.5 * quintic(t / 0.6)));
        let over = Template::empty().with(&scene, 0, over).unwrap();
        let theirs = *scene.state(1, scene.current_timestep()).unwrap();
        let beside = |aside_m: f64| {
            let place = move |t: f64| Some(theirs.position + Vec2::new(10.0 * t, aside_m * quintic(t / 0.6)));
            over.clone().with(&scene, 1, place).unwrap()
        };
        let is_free =
            |template: Template| template.is_clear(&scene, InTheWay::Everybody) && template.keeps_apart(&scene);
        assert_eq!([over.clone(), beside(0.0), beside(2.5)].map(is_free), [false, false, true]);
    }
}
