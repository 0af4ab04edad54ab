//! A maneuver that is solved for a requested event: the agents that take part, and their states after the present.
//!
//! A template fixes the motion of the agents of the event; the denoiser samples everybody else around them. It depends
//! on the past and the map alone.

mod checks;

pub(super) use checks::{InTheWay, distinct, follows};

use crate::geometry::{Vec2, angle_difference, wrap_angle};
use crate::scene::{STANDING_STEP_M, Scene, State, Trajectory, velocity_at};

/// The time within which an agent comes from its observed motion over to the template, seconds.
const FADE_S: f64 = 1.5;
/// Corners of center lines are rounded off: motion above this frequency is damped, Hz.
const CUTOFF_HZ: f64 = 1.0;
/// How much stiffer a course is where it continues the observed motion, and for how long, seconds.
const SEAM_STIFFNESS: f64 = 20.0;
const SEAM_S: f64 = 0.4;
/// The largest observed acceleration from which to continue, m/s²: beyond it, it is no motion of a vehicle.
const MOST_OBSERVED_MPS2: f64 = 5.0;
/// The most and the fewest timesteps over which the observed acceleration is measured.
const N_OBSERVED: usize = 6;
const LEAST_OBSERVED: usize = 4;
/// Within this time pedals are let go of, seconds, from accelerations up to this, m/s².
const SETTLING_S: f64 = 1.0;
const SETTLED_MPS2: f64 = 3.0;
/// The largest angle to the lane of a vehicle that moves over to the lane beside, radians.
pub(super) const MOST_ANGLE_RAD: f64 = 0.35;
/// Agents below this speed stand, m/s.
pub(super) const STANDING_MPS: f64 = 0.5;

/// The futures of the agents that take part.
#[derive(Debug, Clone, PartialEq)]
pub struct Template {
    motions: Vec<Motion>,
}

/// The future of one agent.
#[derive(Debug, Clone, PartialEq)]
struct Motion {
    agent_idx: usize,
    /// Its state at each timestep after the present, in the scene frame.
    states: Vec<State>,
}

impl Template {
    /// A maneuver without agents yet.
    pub(crate) const fn empty() -> Self {
        Self { motions: Vec::new() }
    }

    /// Adds an agent that follows `place`, its position in the scene frame, meters, by the seconds after the present.
    /// The motion starts at the agent's present position, velocity and acceleration and comes over to `place` within
    /// [`FADE_S`]. `None` if the agent is not tracked at present, or `place` is undefined at some time.
    pub(crate) fn with(mut self, scene: &Scene, agent_idx: usize, place: impl Fn(f64) -> Option<Vec2>) -> Option<Self> {
        let state = scene.state(agent_idx, scene.current_timestep()).filter(|state| state.is_finite())?;
        let start = place(0.0)?;
        let missing = state.position - start;
        let (mut before, mut driven_m) = (start, 0.0);
        let speed_mps = state.speed_mps();
        let planned = |step: usize| {
            let (elapsed_s, at) = (step as f64 * scene.dt_s, place(step as f64 * scene.dt_s)?);
            driven_m += at.distance(before);
            before = at;
            // The remaining difference fades with distance, so that an agent that stops does not slide aside.
            let moved_s = if speed_mps > STANDING_MPS { elapsed_s.min(driven_m / speed_mps) } else { elapsed_s };
            Some(at + missing * (1.0 + moved_s / FADE_S) * (-moved_s / FADE_S).exp())
        };
        let planned: Option<Vec<Vec2>> = (1..scene.n_timesteps - scene.current_timestep()).map(planned).collect();
        let observed = observed_acceleration(scene, agent_idx).unwrap_or_default();
        let observed = observed * (MOST_OBSERVED_MPS2 / observed.norm().max(MOST_OBSERVED_MPS2));
        let is_motorized = scene.tracks[agent_idx].class.is_motorized();
        let start = if is_motorized { without_slip(state) } else { *state };
        let mut positions = joined(&start, observed, &planned?, scene.dt_s);
        if is_motorized {
            hold_who_stops(state, &mut positions);
        }
        let states = states(state, scene.dt_s, &past(scene, agent_idx), &positions);
        self.motions.push(Motion { agent_idx, states });
        Some(self)
    }

    /// The agents that take part.
    pub fn agents(&self) -> impl Iterator<Item = usize> {
        self.motions.iter().map(|motion| motion.agent_idx)
    }

    /// The last state of an agent that takes part.
    pub(super) fn last_state(&self, agent_idx: usize) -> Option<State> {
        self.motions.iter().find(|motion| motion.agent_idx == agent_idx)?.states.last().copied()
    }

    /// The positions of an agent that takes part, at present and at each timestep after it.
    pub(super) fn positions(&self, scene: &Scene, agent_idx: usize) -> Option<Vec<Vec2>> {
        let motion = self.motions.iter().find(|motion| motion.agent_idx == agent_idx)?;
        let now = scene.state(agent_idx, scene.current_timestep())?;
        Some(std::iter::once(now).chain(&motion.states).map(|state| state.position).collect())
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

/// The state of a vehicle with its velocity; if it stands, with the part along its heading alone: the rest is an error
/// of the tracker, and would carry it aside.
fn without_slip(now: &State) -> State {
    let forward = Vec2::from_angle(now.heading_rad);
    let along = forward * now.velocity.dot(forward).max(0.0);
    State { velocity: if now.speed_mps() > STANDING_MPS { now.velocity } else { along }, ..*now }
}

/// Keeps an agent that has stopped where it is: coming over to a plan would push it back.
fn hold_who_stops(now: &State, positions: &mut [Vec2]) {
    let (mut before, mut forward) = (now.position, Vec2::from_angle(now.heading_rad));
    for position in positions {
        let step = *position - before;
        if step.dot(forward) <= 0.0 {
            *position = before;
        } else if step.norm() >= STANDING_STEP_M {
            forward = step * step.norm().recip();
        }
        before = *position;
    }
}

/// The acceleration of an agent at present in the scene frame, m/s². `None` if it stands, or was hardly observed.
pub(super) fn observed_acceleration(scene: &Scene, agent_idx: usize) -> Option<Vec2> {
    let is_moving = scene.state(agent_idx, scene.current_timestep())?.speed_mps() > STANDING_MPS;
    acceleration(&past(scene, agent_idx), scene.dt_s).filter(|_| is_moving)
}

/// The speed that an agent reaches if it lets go of its pedals within a second, m/s: v + a / 2 s.
pub(super) fn settled_mps(scene: &Scene, agent_idx: usize, speed_mps: f64) -> f64 {
    let state = scene.state(agent_idx, scene.current_timestep());
    let observed = state.zip(observed_acceleration(scene, agent_idx));
    let along_mps2 = observed.map_or(0.0, |(state, observed)| observed.dot(Vec2::from_angle(state.heading_rad)));
    (speed_mps + along_mps2.clamp(-SETTLED_MPS2, SETTLED_MPS2) * SETTLING_S / 2.0).max(0.0)
}

/// The positions of an agent up to the present, in the scene frame, meters.
fn past(scene: &Scene, agent_idx: usize) -> Vec<Vec2> {
    let past = scene.tracks[agent_idx].trajectory.entries()[..=scene.current_timestep()].iter().flatten();
    past.map(|state| state.position).collect()
}

/// The acceleration at the end of a past, m/s²: that of the parabola fitted to its last positions. `None` if there are
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

/// The states of an agent with the positions `past`, the present state `now` and the later `positions`. Velocities are
/// slopes of the positions, as those of sampled states are. Headings follow the motion, and stay while the agent
/// stands.
fn states(now: &State, dt_s: f64, past: &[Vec2], positions: &[Vec2]) -> Vec<State> {
    let course: Vec<Vec2> = past.iter().chain(positions).copied().collect();
    let velocity = |idx: usize| velocity_at(|offset| course.get(idx.checked_add_signed(offset)?).copied(), dt_s);
    // A vehicle may be recorded with a heading that differs from its motion.
    let at_present = past.len().checked_sub(1).and_then(velocity).unwrap_or(now.velocity);
    let slip_rad = match at_present.norm() * dt_s < STANDING_STEP_M {
        true => 0.0,
        false => angle_difference(now.heading_rad, at_present.angle()),
    };
    let mut held_rad = now.heading_rad;
    let state = |(step, position): (usize, &Vec2)| {
        let velocity = velocity(past.len() + step).unwrap_or_default();
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

/// The largest slope of [`quintic`]: 15 / 8.
pub(super) const QUINTIC_SLOPE: f64 = 1.875;

/// The positions of an agent at as many timesteps after the present as are `planned`. From its state `now`, with an
/// `observed` acceleration, m/s², it comes over to the `planned` positions: x minimizes Σ w (x - planned)² + Σ λ
/// (Δ³x)², where w grows to 1 within [`FADE_S`], λ is largest at the start, and the values before x are the observed
/// motion.
fn joined(now: &State, observed: Vec2, planned: &[Vec2], dt_s: f64) -> Vec<Vec2> {
    const THIRD: [f64; 4] = [-1.0, 3.0, -3.0, 1.0];
    let n = planned.len();
    let stiffness = (2.0 * (std::f64::consts::PI * (CUTOFF_HZ * dt_s).min(0.5)).sin()).powi(-6);
    // At two, one and no timesteps before the present.
    let before: [Vec2; 3] = std::array::from_fn(|i| {
        let t_s = (i as f64 - 2.0) * dt_s;
        now.velocity * t_s + observed * (t_s * t_s / 2.0)
    });
    // The normal equations: a symmetric matrix of bandwidth 3, its diagonal first.
    let (mut matrix, mut values) = (vec![[0.0; 4]; n], vec![Vec2::ZERO; n]);
    for (i, at) in planned.iter().enumerate() {
        let weight = ((i + 1) as f64 * dt_s / FADE_S).min(1.0).powi(4);
        matrix[i][0] += weight;
        values[i] = values[i] + (*at - now.position) * weight;
    }
    // The difference that ends at x[last] takes x[last - 3] to x[last], the first of which may be before the present.
    for last in 0..n {
        let stiffness = stiffness * (1.0 + SEAM_STIFFNESS * (-(last as f64) * dt_s / SEAM_S).exp());
        for (a, of_a) in THIRD.iter().enumerate() {
            let Some(row) = (last + a).checked_sub(3) else { continue };
            for (b, of_b) in THIRD.iter().enumerate() {
                match (last + b).checked_sub(3) {
                    Some(column) if column <= row => matrix[row][row - column] += stiffness * of_a * of_b,
                    Some(_) => {}
                    None => values[row] = values[row] - before[last + b] * (stiffness * of_a * of_b),
                }
            }
        }
    }
    solved(matrix, values).into_iter().map(|moved| now.position + moved).collect()
}

/// The solution of M x = `values` for a positive definite M of bandwidth 3, by M = L D Lᵀ; `matrix[i][k]` is
/// M(i, i - k), and L(i, i - k) afterwards.
fn solved(mut matrix: Vec<[f64; 4]>, mut values: Vec<Vec2>) -> Vec<Vec2> {
    let n = matrix.len();
    for i in 0..n {
        for j in i.saturating_sub(3)..=i {
            let shared = i.saturating_sub(3)..j;
            let known: f64 =
                shared.map(|k| matrix[i][i - k] * matrix[j].get(j - k).unwrap_or(&0.0) * matrix[k][0]).sum();
            matrix[i][i - j] -= known;
            if j < i {
                matrix[i][i - j] /= matrix[j][0];
            }
        }
    }
    for i in 0..n {
        for k in 1..=i.min(3) {
            values[i] = values[i] - values[i - k] * matrix[i][k];
        }
    }
    for i in (0..n).rev() {
        values[i] = values[i] * (1.0 / matrix[i][0]);
        for k in 1..=3.min(n - 1 - i) {
            values[i] = values[i] - values[i + k] * matrix[i + k][k];
        }
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{self, Drive};

    #[test]
    fn the_quintic_has_the_shape_that_is_said_of_it() {
        assert_eq!((quintic(0.0), quintic(0.5), quintic(1.0), quintic(2.0)), (0.0, 0.5, 1.0, 1.0));
        let h = 1e-4;
        let slope = |u: f64| (quintic(u + h) - quintic(u - h)) / (2.0 * h);
        assert!((slope(0.5) - QUINTIC_SLOPE).abs() < 1e-6 && slope(0.4) < QUINTIC_SLOPE);
    }

    #[test]
    fn a_course_that_goes_on_as_observed_stays_and_any_other_is_the_smoothest_near_its_plan() {
        let now = State { position: Vec2::new(3.0, -1.0), velocity: Vec2::new(8.0, 1.0), ..State::default() };
        let (observed, dt_s) = (Vec2::new(-2.0, 0.5), 0.1);
        let steady = |t_s: f64| now.position + now.velocity * t_s + observed * (t_s * t_s / 2.0);
        let planned: Vec<Vec2> = (1..=25).map(|i| steady(f64::from(i) * dt_s)).collect();
        let found = joined(&now, observed, &planned, dt_s);
        assert!(found.iter().zip(&planned).all(|(a, b)| a.distance(*b) < 1e-9));
        // With a plan that is aside and slower, no small change lowers the minimized sum.
        let planned: Vec<Vec2> = (1..=25).map(|i| Vec2::new(3.0 + 0.6 * f64::from(i), 0.5)).collect();
        let found = joined(&now, observed, &planned, dt_s);
        let cost = |course: &[Vec2]| {
            let all: Vec<Vec2> = [-0.2, -0.1, 0.0].map(steady).into_iter().chain(course.iter().copied()).collect();
            let bends = all.windows(4).enumerate().map(|(i, w)| {
                let third = w[3] - w[2] * 3.0 + w[1] * 3.0 - w[0];
                let stiffness = (2.0 * (std::f64::consts::PI * CUTOFF_HZ * dt_s).sin()).powi(-6);
                stiffness * (1.0 + SEAM_STIFFNESS * (-(i as f64) * dt_s / SEAM_S).exp()) * third.dot(third)
            });
            let misses = course.iter().zip(&planned).enumerate().map(|(i, (at, plan))| {
                ((i + 1) as f64 * dt_s / FADE_S).min(1.0).powi(4) * (*at - *plan).dot(*at - *plan)
            });
            bends.sum::<f64>() + misses.sum::<f64>()
        };
        let least = cost(&found);
        for i in 0..found.len() {
            for by in [Vec2::new(1e-3, 0.0), Vec2::new(-1e-3, 0.0), Vec2::new(0.0, 1e-3), Vec2::new(0.0, -1e-3)] {
                let mut moved = found.clone();
                moved[i] = moved[i] + by;
                assert!(cost(&moved) > least, "{i}");
            }
        }
    }

    #[test]
    fn who_has_stopped_is_not_pushed_back() {
        let now = State { position: Vec2::new(1.0, 0.0), velocity: Vec2::new(2.0, 0.0), ..State::default() };
        let mut positions = [1.2, 1.3, 1.28, 1.25, 1.29, 1.4].map(|x| Vec2::new(x, 0.0));
        hold_who_stops(&now, &mut positions);
        assert_eq!(positions.map(|at| at.x), [1.2, 1.3, 1.3, 1.3, 1.3, 1.4]);
        // To a stop at once, which takes some distance that the plan does not have.
        let scene = testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 4.0)]);
        let now = *scene.state(0, scene.current_timestep()).unwrap();
        let stops = |_: f64| Some(now.position);
        let mut changed = scene.clone();
        Template::empty().with(&scene, 0, stops).unwrap().apply(&mut changed);
        let states = &changed.tracks[0].trajectory.entries()[scene.current_timestep()..];
        let back_m = states.windows(2).map(|pair| pair[0].unwrap().position.x - pair[1].unwrap().position.x);
        assert!(back_m.fold(0.0, f64::max) <= 0.0);
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
        // An agent that brakes keeps braking for a moment.
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
        assert!((step(n - 1) + 3.0).abs() < 0.6 && (step(n) + 3.0).abs() < 1.1, "{} {}", step(n - 1), step(n));
        // Braking on, it would be t_s² · 1.5 behind; it comes over to the plan instead.
        let t_s = (braking.n_timesteps - n) as f64 * braking.dt_s;
        let behind_m = 10.0 * t_s - x(braking.n_timesteps - 1);
        assert!(behind_m > 0.0 && behind_m < 0.5 * 1.5 * t_s * t_s, "{behind_m} after {t_s}");
        // An agent that comes over to where another drives is in its way, unless the other takes part and makes room.
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
