//! A maneuver that was solved for what is wanted of it: who moves, and where it is from the present on.
//!
//! A template says what one agent does; the denoiser makes everybody else live with it. It is told from the past and the map alone.

use crate::geometry::{Vec2, angle_difference, wrap_angle};
use crate::scene::{STANDING_STEP_M, Scene, State, Track, Trajectory};

/// What a recorded motion has and a template does not, such as a drift across, fades within this time, seconds.
const FADE_S: f64 = 1.0;
/// Passes of the filter that rounds the corners of center lines off.
const N_ROUNDINGS: usize = 3;
/// Timesteps between those at which a template is compared with where others would be.
const STRIDE: usize = 2;

/// The future of one agent.
#[derive(Debug, Clone, PartialEq)]
pub struct Template {
    /// Whose.
    pub agent_idx: usize,
    /// Its position at each timestep after the present, meters in the scene frame.
    positions: Vec<Vec2>,
}

impl Template {
    /// The maneuver of an agent that would be at `place` so many seconds after the present. It begins where the agent is, as the agent
    /// moves, and comes to be as `place` says within a second. `None` where the agent is not tracked at present, or has no place at some time.
    pub(crate) fn new(scene: &Scene, agent_idx: usize, place: impl Fn(f64) -> Option<Vec2>) -> Option<Self> {
        let state = scene.state(agent_idx, scene.current_timestep()).filter(|state| state.is_finite())?;
        let (start, soon) = (place(0.0)?, place(scene.dt_s / 2.0)?);
        let missing = state.position - start;
        let drift = state.velocity - (soon - start) * (2.0 / scene.dt_s);
        let fading =
            |elapsed_s: f64| (missing + (drift + missing * (1.0 / FADE_S)) * elapsed_s) * (-elapsed_s / FADE_S).exp();
        let times_s = (1..scene.n_timesteps - scene.current_timestep()).map(|step| step as f64 * scene.dt_s);
        let positions: Option<Vec<Vec2>> = times_s.map(|t| Some(place(t)? + fading(t))).collect();
        let past = scene.tracks[agent_idx].trajectory.entries()[..=scene.current_timestep()].iter().flatten();
        let past: Vec<Vec2> = past.map(|state| state.position).collect();
        Some(Self { agent_idx, positions: rounded(&past, positions?) })
    }

    /// Whether nobody is in the way, if all the others go straight on at their speed; the one who is to react, until `reacts_s` after the
    /// present.
    pub(super) fn is_clear(&self, scene: &Scene, (reacting_idx, reacts_s): (usize, f64)) -> bool {
        let own = &scene.tracks[self.agent_idx];
        let Some(futures) = self.states(scene) else { return false };
        let present = |track: &Track| track.trajectory.get(scene.current_timestep()).copied();
        let others = scene.tracks.iter().enumerate().filter(|(idx, _)| *idx != self.agent_idx);
        others.filter_map(|(idx, track)| Some((idx, track, present(track)?))).all(|(idx, track, now)| {
            let until_s = if idx == reacting_idx { reacts_s } else { f64::INFINITY };
            futures.iter().enumerate().step_by(STRIDE).all(|(step, state)| {
                let elapsed_s = (step + 1) as f64 * scene.dt_s;
                let there = now.position + now.velocity * elapsed_s;
                elapsed_s > until_s
                    || !own.footprint(state).overlaps(&track.footprint(&State { position: there, ..now }))
            })
        })
    }

    /// Whether the agent never accelerates harder than this in any direction, from the present on, m/s².
    pub(super) fn is_within(&self, scene: &Scene, limit_mps2: f64) -> bool {
        let now = scene.state(self.agent_idx, scene.current_timestep());
        let Some((now, states)) = now.zip(self.states(scene)) else { return false };
        let velocities: Vec<Vec2> = std::iter::once(now).chain(&states).map(|state| state.velocity).collect();
        velocities.windows(2).all(|pair| (pair[1] - pair[0]).norm() <= limit_mps2 * scene.dt_s)
    }

    /// Puts it into a scene in the place of what was recorded.
    pub fn apply(&self, scene: &mut Scene) {
        let Some(states) = self.states(scene) else { return };
        let n_kept = scene.current_timestep() + 1;
        let trajectory = &mut scene.tracks[self.agent_idx].trajectory;
        let kept = trajectory.entries()[..n_kept].iter().copied();
        *trajectory = Trajectory::new(kept.chain(states.into_iter().map(Some)).collect());
    }

    /// Its states. Velocities are those since the timestep before, headings turn with the motion; where the agent stands, they stay.
    fn states(&self, scene: &Scene) -> Option<Vec<State>> {
        let now = scene.state(self.agent_idx, scene.current_timestep())?;
        // A vehicle may be recorded as turned against its motion.
        let slip_rad = match now.speed_mps() * scene.dt_s < STANDING_STEP_M {
            true => 0.0,
            false => angle_difference(now.heading_rad, now.velocity.angle()),
        };
        let mut before = *now;
        let state = |(step, position): (usize, &Vec2)| {
            let way = *position - before.position;
            let slip_rad = slip_rad * (-((step + 1) as f64) * scene.dt_s / FADE_S).exp();
            let heading_rad = match way.norm() < STANDING_STEP_M {
                true => before.heading_rad,
                false => wrap_angle(way.angle() + slip_rad),
            };
            before = State { position: *position, heading_rad, velocity: way * (1.0 / scene.dt_s) };
            before
        };
        Some(self.positions.iter().enumerate().map(state).collect())
    }
}

/// 0 at 0, 1 at 1, with no velocity and no acceleration at both ends: 10 u³ - 15 u⁴ + 6 u⁵.
pub(super) fn quintic(u: f64) -> f64 {
    let u = u.clamp(0.0, 1.0);
    u * u * u * (10.0 + u * (6.0 * u - 15.0))
}

/// The largest second derivative of [`quintic`]: 10 / √3.
pub(super) const QUINTIC_PEAK: f64 = 5.773_502_691_896_258;

/// Where [`quintic`] has a value from 0 to 1, by bisection.
pub(super) fn quintic_inverse(value: f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..60 {
        let middle = f64::midpoint(low, high);
        if quintic(middle) < value { low = middle } else { high = middle }
    }
    high
}

/// The course after `past` with its corners rounded off, by a binomial filter over half a second that leaves the past as it is.
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
        let template = Template::new(&scene, 0, place).unwrap();
        assert!(template.is_clear(&scene, (1, 0.0)), "the one ahead drives on");
        let before = scene.tracks[0].trajectory.clone();
        template.apply(&mut scene);
        let after = &scene.tracks[0].trajectory;
        assert_eq!(before.entries()[..scene.n_history], after.entries()[..scene.n_history]);
        let state = |timestep: usize| *after.get(timestep).unwrap();
        let seam = state(scene.n_history).velocity - now.velocity;
        assert!(seam.norm() < 0.3, "{seam:?}");
        for timestep in scene.n_history..scene.n_timesteps {
            let step = state(timestep).position - state(timestep - 1).position;
            assert!((step * (1.0 / scene.dt_s) - state(timestep).velocity).norm() < 1e-9);
        }
        // Who comes over to where another drives is in its way, unless that one is to react.
        let scene = testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(0.0, 2.5, 0.0, 10.0)]);
        let over = |t: f64| Some(now.position + Vec2::new(10.0 * t, 2.5 * quintic(t / 0.6)));
        let over = Template::new(&scene, 0, over).unwrap();
        assert_eq!([(0, 0.0), (1, 0.0)].map(|reacting| over.is_clear(&scene, reacting)), [false, true]);
    }
}
