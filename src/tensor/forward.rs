//! Keeps vehicles from driving on backward after they have stopped.
//!
//! A network does not know that zero is the end of braking: the speed of a sample runs through it, and the vehicle goes
//! back the way it came. Recorded ones stand until they start again. While a sample is made, its estimates are bounded
//! ([`LeastProgress`]), so that everybody else sees the vehicle stand; in the end it does so to the millimeter.

use super::{RepeatedRows, SceneBatch};
use crate::geometry::{Transform2, Vec2};
use crate::scene::{AgentClass, Scene, State, Track};
use candle_core::{DType, Result, Tensor};

/// An agent that goes back by less than this, meters, or by less than it was observed to, only trembles.
const BACK_M: f64 = 0.05;
/// An agent that was observed to go back by more than this, meters, reverses on purpose, as in parking.
const REVERSES_M: f64 = 0.3;
/// The direction of an agent is that of its last motion over this distance, meters.
const DIRECTION_M: f64 = 0.3;

/// An agent that has turned by more than the angle of this cosine from its present heading is not bounded.
const LEAST_COSINE: f64 = 0.35;
/// The bound where there is none.
const UNBOUNDED: f32 = -1e9;

/// Whether agents of this kind drive forward, so that they have to stop first to go back.
pub(super) fn drives_forward(track: &Track) -> bool {
    track.class.is_motorized() || track.class == AgentClass::Cyclist
}

/// The least values of the diffused motion along each agent's own frame at which it does not go back, in the motion
/// parametrization.
pub struct LeastProgress {
    /// (B, A, T, 1).
    least: Tensor,
    /// The direction of the base against the agent's own frame, radians, (B, A, T, 1).
    turned: Tensor,
}

impl LeastProgress {
    /// The bounds of a batch, each row `n_samples` times; `sources[b]` is the scene from which row b was made. `None`
    /// in other parametrizations.
    pub fn new(batch: &SceneBatch, sources: &[&Scene], n_samples: usize) -> Result<Option<Self>> {
        if batch.path.is_none() {
            return Ok(None);
        }
        let (b, a, t, _) = batch.x0.dims4()?;
        let host = |tensor: &Tensor| tensor.to_dtype(DType::F32)?.flatten_all()?.to_vec1::<f32>();
        let (base, rotation, unit) = (host(&batch.base)?, host(&batch.rotation)?, host(&batch.unit)?);
        let (latent, valid) = (host(&batch.latent)?, host(&batch.valid)?);
        let (mut least, mut turned) = (vec![UNBOUNDED; b * a * t], vec![0.0; b * a * t]);
        for (row, (frame, scene)) in batch.frames.iter().zip(sources).enumerate() {
            for (slot, agent_idx) in frame.agents.iter().enumerate() {
                let agent = row * a + slot;
                let entry = |timestep: usize| agent * t + timestep;
                let Some(last) = (0..t).rfind(|at| valid[entry(*at)] != 0.0 && latent[entry(*at)] == 0.0) else {
                    continue;
                };
                let track = &scene.tracks[*agent_idx];
                if !drives_forward(track) || reverses(&seen_until(track, last, |at| frame.observed(*agent_idx, at))) {
                    continue;
                }
                let [cos, sin] = [rotation[2 * agent], rotation[2 * agent + 1]];
                for at in (last + 1..t).take_while(|at| latent[entry(*at)] != 0.0) {
                    let [to, from] = [at, at - 1].map(|at| &base[3 * entry(at)..]);
                    let ahead_m = cos * (to[0] - from[0]) + sin * (to[1] - from[1]);
                    least[entry(at)] = -ahead_m / unit[3 * agent];
                    turned[entry(at)] = to[2] - sin.atan2(cos);
                }
            }
        }
        let rows = RepeatedRows::new(b, n_samples, batch.x0.device())?;
        let tensor = |values: Vec<f32>| {
            rows.tensor(&Tensor::from_vec(values, (b, a, t, 1), batch.x0.device())?.to_dtype(batch.x0.dtype())?)
        };
        Ok(Some(Self { least: tensor(least)?, turned: tensor(turned)? }))
    }

    /// The clean estimate `x0` (B, A, T, D) of samples of `batch`, without motion backward.
    ///
    /// # Errors
    /// When `x0` has another shape than the batch.
    pub fn kept(&self, x0: &Tensor, batch: &SceneBatch) -> Result<Tensor> {
        let n_other = x0.dim(3)? - 1;
        let along = x0.narrow(3, 0, 1)?;
        let turned = (batch.decode_offsets(x0)?.narrow(3, 2, 1)? + &self.turned)?;
        let is_ahead = turned.cos()?.ge(LEAST_COSINE)?;
        let along = is_ahead.where_cond(&along.maximum(&self.least)?, &along)?;
        Tensor::cat(&[along, x0.narrow(3, 1, n_other)?], 3)
    }
}

/// The observed states of a track up to timestep `last`, without a gap.
fn seen_until(track: &Track, last: usize, observed: impl Fn(usize) -> bool) -> Vec<State> {
    let state = |timestep: usize| track.trajectory.get(timestep).filter(|_| observed(timestep)).copied();
    let mut seen: Vec<State> = (0..=last).rev().map_while(state).collect();
    seen.reverse();
    seen
}

/// Whether an agent was seen to reverse on purpose.
fn reverses(seen: &[State]) -> bool {
    longest_way_back_m(&progress_m(seen)) > REVERSES_M
}

fn longest_way_back_m(ahead_m: &[f64]) -> f64 {
    ways_back(ahead_m, 0.0).map(|[from, to]| ahead_m[from] - ahead_m[to]).fold(0.0, f64::max)
}

/// Removes the motion backward after the last observed state, in place: the agent stands where it would turn back, and
/// what follows starts there. Agents that reverse on purpose are left alone.
pub(super) fn stay_forward(entries: &mut [Option<State>], latent: &[u8]) {
    let Some(last) = (0..entries.len()).rfind(|t| latent[*t] == 0 && entries[*t].is_some()) else { return };
    let run = (0..=last).rev().take_while(|t| entries[*t].is_some()).last().unwrap_or(last);
    let until = (last..entries.len()).take_while(|t| entries[*t].is_some()).last().unwrap_or(last);
    let states: Vec<State> = entries[run..=until].iter().flatten().copied().collect();
    let (ahead_m, present) = (progress_m(&states), last - run);
    let seen_m = longest_way_back_m(&ahead_m[..=present]);
    if seen_m > REVERSES_M {
        return;
    }
    let mut moved = Transform2::IDENTITY;
    let mut done = present;
    for [from, to] in ways_back(&ahead_m[present..], seen_m.max(BACK_M)).map(|way| way.map(|t| present + t)) {
        (done + 1..=from).for_each(|t| entries[run + t] = Some(states[t].transformed(&moved)));
        let stop = states[from].transformed(&moved);
        (from + 1..=to).for_each(|t| entries[run + t] = Some(State { velocity: Vec2::ZERO, ..stop }));
        moved = pose(&stop).compose(&pose(&states[to]).inverse());
        done = to;
    }
    (done + 1..states.len()).for_each(|t| entries[run + t] = Some(states[t].transformed(&moved)));
}

/// How far the agent has gone ahead until each state, meters: its motion along the direction in which it drove last, at
/// first that of its heading.
fn progress_m(states: &[State]) -> Vec<f64> {
    let Some(first) = states.first() else { return Vec::new() };
    let (mut turned_at, mut ahead) = (first.position, Vec2::from_angle(first.heading_rad));
    let (mut before, mut sum_m) = (first.position, 0.0);
    let until = |state: &State| {
        sum_m += (state.position - before).dot(ahead);
        before = state.position;
        let way = before - turned_at;
        if way.norm() >= DIRECTION_M && way.dot(ahead) > 0.0 {
            (turned_at, ahead) = (before, way * way.norm().recip());
        }
        sum_m
    };
    states.iter().map(until).collect()
}

/// The ways back of more than `least_m`: the timesteps of their ends, the farthest place ahead and the farthest back.
fn ways_back(ahead_m: &[f64], least_m: f64) -> impl Iterator<Item = [usize; 2]> {
    let mut ways = Vec::new();
    let (mut farthest, mut back) = (0, None);
    for (t, at_m) in ahead_m.iter().enumerate() {
        match back {
            None if *at_m >= ahead_m[farthest] => farthest = t,
            None if ahead_m[farthest] - at_m > least_m => back = Some(t),
            Some(end) if *at_m <= ahead_m[end] => back = Some(t),
            Some(end) if at_m - ahead_m[end] > least_m => {
                ways.push([farthest, end]);
                (farthest, back) = (t, None);
            }
            _ => (),
        }
    }
    ways.extend(back.map(|end| [farthest, end]));
    ways.into_iter()
}

fn pose(state: &State) -> Transform2 {
    Transform2::from_pose(state.position, state.heading_rad)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{Drive, scene};
    use crate::tensor::testing::collator;
    use crate::tensor::{FutureValidity, StateParametrization};

    /// States along x by timestep, of which the first `n_seen` are observed, after `stay_forward`.
    fn forward(x_m: impl Fn(usize) -> f64, n_seen: usize) -> Vec<State> {
        let state = |t: usize| Some(State { position: Vec2::new(x_m(t), 0.0), ..State::default() });
        let mut entries: Vec<Option<State>> = (0..40).map(state).collect();
        let latent: Vec<u8> = (0..40).map(|t| u8::from(t >= n_seen)).collect();
        stay_forward(&mut entries, &latent);
        assert!((0..n_seen).all(|t| entries[t] == state(t)), "observed states stay as they are");
        entries.into_iter().flatten().collect()
    }

    /// Braking from 2 m/s with 1 m/s², past zero after 2 s.
    fn braking(t: usize) -> f64 {
        let s = 0.1 * t as f64;
        2.0 * s - 0.5 * s * s
    }

    #[test]
    fn who_stops_stands_and_starts_from_there() {
        let stopped = forward(braking, 10);
        for (t, state) in stopped.iter().enumerate() {
            assert_eq!(state.position.x, braking(t.min(20)), "{t}");
        }
        // Back by 0.9 m until 2.9 s, then ahead with 2 m/s².
        let again = |t: usize| match t.checked_sub(29) {
            Some(since) => braking(29) + (0.1 * since as f64).powi(2),
            None => braking(t),
        };
        let started = forward(again, 10);
        assert!((20..30).all(|t| started[t].position.x == 2.0));
        assert!((30..40).all(|t| (started[t].position.x - 2.0 - (again(t) - again(29))).abs() < 1e-12));
        // On both sides of the present.
        assert!(forward(|t| braking(t + 15), 6)[5..].iter().all(|state| state.position.x == braking(20)));
    }

    #[test]
    fn who_trembles_and_who_parks_is_left_alone() {
        let trembles = |t: usize| 0.04 * (t % 2) as f64;
        assert!(forward(trembles, 10).iter().enumerate().all(|(t, state)| state.position.x == trembles(t)));
        let more = |t: usize| trembles(t) * if t < 10 { 3.0 } else { 2.9 };
        assert!(forward(more, 10).iter().enumerate().all(|(t, state)| state.position.x == more(t)), "as observed");
        let parks = |t: usize| -0.1 * t as f64;
        assert!(forward(parks, 10).iter().enumerate().all(|(t, state)| state.position.x == parks(t)));
    }

    #[test]
    fn estimates_of_motion_backward_become_a_stand() {
        // A car that brakes, one that parks, and a pedestrian; all are sampled to go back.
        let mut scene = scene(&[2.0, -2.0, 2.0].map(|speed_mps| Drive::straight(0.0, 0.0, 0.7, speed_mps)));
        scene.tracks[2].class = AgentClass::Pedestrian;
        let present = scene.current_timestep();
        let batch = collator([&scene], StateParametrization::Motion).predictive(&[&scene], FutureValidity::Everything);
        let bounds = LeastProgress::new(&batch, &[&scene], 1).unwrap().unwrap();
        let back = Tensor::cat(
            &[
                (batch.x0.ones_like().unwrap().narrow(3, 0, 1).unwrap() * -50.0).unwrap(),
                batch.x0.narrow(3, 1, 2).unwrap().zeros_like().unwrap(),
            ],
            3,
        )
        .unwrap();
        let moved_m = |x0: &Tensor, agent: usize| {
            let sample = &batch.decode(x0).unwrap().get(0).unwrap().get(agent).unwrap().to_vec2::<f32>().unwrap();
            let state = |t: usize| Vec2::new(f64::from(sample[t][0]), f64::from(sample[t][1]));
            state(scene.n_timesteps - 1).distance(state(present))
        };
        let kept = bounds.kept(&back, &batch).unwrap();
        assert!(moved_m(&back, 0) > 1.0 && moved_m(&kept, 0) < 1e-3, "{}", moved_m(&kept, 0));
        for agent in [1, 2] {
            assert_eq!(moved_m(&kept, agent), moved_m(&back, agent));
        }
        assert_eq!(moved_m(&bounds.kept(&batch.x0, &batch).unwrap(), 0), moved_m(&batch.x0, 0));
        let scene_states = collator([&scene], StateParametrization::Scene);
        let batch = scene_states.predictive(&[&scene], FutureValidity::Everything);
        assert!(LeastProgress::new(&batch, &[&scene], 1).unwrap().is_none());
    }

    #[test]
    fn what_follows_a_way_back_around_a_bend_goes_on_in_the_direction_of_the_stop() {
        // Around a circle of 10 m, ahead by 4 m, back by 2, ahead again.
        let at_m = |t: usize| (4.0 - 0.2 * (t as f64 - 20.0).abs()).max(0.0) + 0.4 * t.saturating_sub(30) as f64;
        let state = |way_m: f64| State {
            position: Vec2::new(10.0 * (way_m / 10.0).sin(), 10.0 - 10.0 * (way_m / 10.0).cos()),
            heading_rad: way_m / 10.0,
            velocity: Vec2::ZERO,
        };
        let mut entries: Vec<Option<State>> = (0..40).map(|t| Some(state(at_m(t)))).collect();
        stay_forward(&mut entries, &std::array::from_fn::<u8, 40, _>(|t| u8::from(t >= 5)));
        for (t, entry) in entries.iter().enumerate() {
            let (found, expected) = (entry.unwrap(), state(at_m(t.min(20)) + at_m(t.max(30)) - at_m(30)));
            assert!(found.position.distance(expected.position) < 1e-9, "{t}: {found:?}, {expected:?}");
            assert!((found.heading_rad - expected.heading_rad).abs() < 1e-9, "{t}");
        }
    }
}
