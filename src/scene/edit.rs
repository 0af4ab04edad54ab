//! Simple changes of recorded futures, which make the guides of scenario editing (paper, section 5.3).
//!
//! Edits are rough: the denoiser makes them realistic. They change positions smoothly from the present on; velocities
//! and headings follow.

use super::motion::{Motion, hermite, point_along, smooth_step, with_future};
use super::{AgentRef, Scene, UnfitScene};
use crate::geometry::{Polyline, Vec2};
use crate::settings::{self, Issue};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A change of one agent's future: `{ kind = "scale_speed", agent = "ego", factor = 0.5 }`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(extend("unevaluatedProperties" = false))]
pub struct SceneEdit {
    /// Who is moved.
    pub agent: AgentRef,
    /// The change with its options.
    #[serde(flatten)]
    pub kind: EditKind,
}

/// The changes with their options.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum EditKind {
    /// The agent goes the same way earlier or later.
    ShiftTime(ShiftTime),
    /// The agent is shifted sideways, forward or backward from its recorded course.
    Shift(Shift),
    /// The agent goes the same way faster or slower.
    ScaleSpeed(ScaleSpeed),
    /// The agent goes through given points.
    SetPositions(SetPositions),
    /// The agent meets another one at some time.
    Meet(Meet),
}

/// The agent is where it was recorded `by_s` before: position(t) = recorded(t - w(t) · `by_s`), where w rises from 0
/// to 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ShiftTime {
    /// How much later, seconds; negative: earlier.
    #[schemars(range(min = -60.0, max = 60.0))]
    pub by_s: f64,
    /// How long after the present it takes until the shift is complete, seconds; more than 1.5 times `by_s`, so that
    /// nobody drives backwards.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 60.0))]
    pub onset_s: f64,
}

/// The agent's position is shifted in the frame of its recorded heading, smoothly from the present on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Shift {
    /// How far ahead, meters; negative: behind.
    #[serde(default)]
    #[schemars(range(min = -1e4, max = 1e4))]
    pub along_m: f64,
    /// How far to the left, meters; negative: to the right.
    #[serde(default)]
    #[schemars(range(min = -1e4, max = 1e4))]
    pub left_m: f64,
    /// How long after the present it takes until the shift is complete, seconds.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 60.0))]
    pub onset_s: f64,
}

/// The agent follows its recorded course at a multiple of its recorded speed; beyond the course's end it goes straight
/// on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ScaleSpeed {
    /// By which the recorded speed is multiplied; 0 stops.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub factor: f64,
    /// How long after the present it takes until the factor is reached, seconds.
    #[serde(default)]
    #[schemars(range(min = 0.0, max = 60.0))]
    pub onset_s: f64,
}

/// The agent goes from its place at present through points on a smooth curve, and on as it passed the last of them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SetPositions {
    /// The points, in the order of their times.
    pub points: Vec<TimedPoint>,
}

/// A place in the scene frame and the time to be there.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TimedPoint {
    /// When, seconds after the present.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 60.0))]
    pub t_s: f64,
    /// Where: meters ahead of the scene's ego agent at present, along its heading then.
    #[schemars(range(min = -1e6, max = 1e6))]
    pub x_m: f64,
    /// Where: meters to the left of it.
    #[schemars(range(min = -1e6, max = 1e6))]
    pub y_m: f64,
}

/// The agent is shifted, smoothly from the present on, so that at `at_s` it is where the other one is: their paths
/// cross.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Meet {
    /// Whom it meets.
    pub with: AgentRef,
    /// When, seconds after the present.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 60.0))]
    pub at_s: f64,
    /// How far ahead of the other one, meters along its heading; negative: behind.
    #[serde(default)]
    #[schemars(range(min = -1e4, max = 1e4))]
    pub ahead_m: f64,
}

impl SceneEdit {
    /// The agents it names.
    pub fn agents(&self) -> Vec<&AgentRef> {
        match &self.kind {
            EditKind::Meet(Meet { with, .. }) => vec![&self.agent, with],
            _ => vec![&self.agent],
        }
    }

    /// Rejects values that cannot work.
    pub fn validate(&self) -> settings::Result {
        settings::check_ranges(self)?;
        match &self.kind {
            EditKind::ShiftTime(e) if e.by_s >= e.onset_s / 1.5 => {
                let message =
                    format!("is {}, expected more than 1.5 times by_s: the agent would drive backwards", e.onset_s);
                Err(Issue::new("onset_s", message))
            }
            EditKind::SetPositions(e) if e.points.is_empty() => {
                Err(Issue::new("points", "is empty, expected at least one entry"))
            }
            EditKind::SetPositions(e) => match e.points.windows(2).position(|pair| pair[1].t_s <= pair[0].t_s) {
                Some(i) => {
                    let (key, t_s) = (format!("points.{}.t_s", i + 1), e.points[i + 1].t_s);
                    Err(Issue::new(key, format_args!("is {t_s}, expected more than at the previous point")))
                }
                None => Ok(()),
            },
            EditKind::Meet(e) if self.agent == e.with => {
                Err(Issue::new("with", format_args!("is {}, the agent that is moved; name another agent", e.with)))
            }
            _ => Ok(()),
        }
    }

    /// The scene with this change; `resolve` finds the agents that it names. The past does not change.
    ///
    /// # Errors
    /// When the scene has no future or no such agent at present.
    pub fn apply(&self, scene: &Scene, resolve: &dyn Fn(&AgentRef) -> Option<usize>) -> Result<Scene, UnfitScene> {
        if !scene.has_future() {
            return Err(UnfitScene("has no recorded future to edit".to_owned()));
        }
        let present = scene.current_timestep();
        let mut indices = Vec::new();
        for agent in self.agents() {
            let agent_idx = resolve(agent).filter(|agent_idx| scene.state(*agent_idx, present).is_some());
            let unfit = || UnfitScene(format!("has no agent {agent} that is tracked at present"));
            indices.push(agent_idx.ok_or_else(unfit)?);
        }
        let motion = |i: usize| Motion::new(&scene.tracks[indices[i]].trajectory, scene.dt_s);
        let Some(own) = motion(0) else { return Ok(scene.clone()) };
        let timesteps = (present + 1..scene.n_timesteps).map(|timestep| timestep as f64);
        let now = present as f64;
        let after = |seconds: f64| now + seconds / scene.dt_s;
        let positions: Vec<Vec2> = match &self.kind {
            EditKind::ShiftTime(e) => timesteps
                .map(|t| own.at(t - smooth_step(t, now, after(e.onset_s)) * e.by_s / scene.dt_s).position)
                .collect(),
            EditKind::Shift(e) => timesteps
                .map(|t| {
                    let state = own.at(t);
                    let shift = Vec2::new(e.along_m, e.left_m).rotated(state.heading_rad);
                    state.position + shift * smooth_step(t, now, after(e.onset_s))
                })
                .collect(),
            EditKind::ScaleSpeed(e) => e.positions(scene, &own),
            EditKind::SetPositions(e) => timesteps.map(|t| e.position(&own.at(now), (t - now) * scene.dt_s)).collect(),
            EditKind::Meet(e) => {
                let Some(other) = motion(1) else { return Ok(scene.clone()) };
                let met = other.at(after(e.at_s));
                let place = met.position + Vec2::from_angle(met.heading_rad) * e.ahead_m;
                let shift = place - own.at(after(e.at_s)).position;
                timesteps.map(|t| own.at(t).position + shift * smooth_step(t, now, after(e.at_s))).collect()
            }
        };
        let mut edited = scene.clone();
        with_future(&mut edited, indices[0], &positions);
        Ok(edited)
    }
}

impl ScaleSpeed {
    fn positions(&self, scene: &Scene, own: &Motion<'_>) -> Vec<Vec2> {
        let present = scene.current_timestep();
        let onset = present as f64 + self.onset_s / scene.dt_s;
        let line = Polyline((present..scene.n_timesteps).map(|t| own.at(t as f64).position).collect());
        let end_heading_rad = own.at(scene.n_timesteps as f64 - 1.0).heading_rad;
        let mut station_m = 0.0;
        let steps = line.0.windows(2).enumerate();
        steps
            .filter_map(|(i, pair)| {
                let middle = (present + i) as f64 + 0.5;
                let factor = 1.0 + (self.factor - 1.0) * smooth_step(middle, present as f64, onset);
                station_m += pair[0].distance(pair[1]) * factor;
                point_along(&line, station_m, end_heading_rad)
            })
            .collect()
    }
}

impl SetPositions {
    /// The position of the agent `elapsed_s` after it was in state `now`.
    fn position(&self, now: &super::State, elapsed_s: f64) -> Vec2 {
        let start = TimedPoint { t_s: 0.0, x_m: now.position.x, y_m: now.position.y };
        let points: Vec<TimedPoint> = [start].into_iter().chain(self.points.iter().copied()).collect();
        let place = |i: usize| Vec2::new(points[i].x_m, points[i].y_m);
        let secant = |from: usize, to: usize| (place(to) - place(from)) * (1.0 / (points[to].t_s - points[from].t_s));
        let last = points.len() - 1;
        // The velocity with which a point is passed: as recorded at present, along the chord of its neighbors later.
        let velocity = |i: usize| match i {
            0 => now.velocity,
            i if i == last => secant(i - 1, i),
            i => secant(i - 1, i + 1),
        };
        let after = points.partition_point(|point| point.t_s <= elapsed_s);
        if after > last {
            return place(last) + velocity(last) * (elapsed_s - points[last].t_s);
        }
        let (from, to) = (after.saturating_sub(1), after);
        let duration_s = points[to].t_s - points[from].t_s;
        let end = |i: usize| (place(i), velocity(i) * duration_s);
        hermite(end(from), end(to), (elapsed_s - points[from].t_s) / duration_s)
    }
}

impl Scene {
    /// The scene with a state at every timestep for which `is_wanted(agent_idx, timestep)`, for tracks with any state:
    /// missing states are interpolated, or extrapolated at constant velocity.
    #[must_use]
    pub fn completed(&self, is_wanted: impl Fn(usize, usize) -> bool) -> Self {
        let mut completed = self.clone();
        for (agent_idx, track) in completed.tracks.iter_mut().enumerate() {
            let recorded = &self.tracks[agent_idx].trajectory;
            let Some(motion) = Motion::new(recorded, self.dt_s) else { continue };
            let entry = |timestep: usize| {
                let known = recorded.get(timestep).copied();
                known.or_else(|| is_wanted(agent_idx, timestep).then(|| motion.at(timestep as f64)))
            };
            track.trajectory = super::Trajectory::new((0..self.n_timesteps).map(entry).collect());
        }
        completed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{Drive, scene, without_states};

    #[derive(Deserialize)]
    struct Edits {
        edits: Vec<SceneEdit>,
    }

    fn edit(toml: &str) -> SceneEdit {
        let mut edits = toml::from_str::<Edits>(&format!("edits = [{toml}]")).unwrap().edits;
        let edit = edits.remove(0);
        edit.validate().unwrap();
        edit
    }

    /// Two cars at 10 Hz, the present is timestep 3: one along x at 10 m/s (x = t), one along y at 5 m/s from (30,
    /// -10).
    fn crossing() -> Scene {
        scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(30.0, -10.0, std::f64::consts::FRAC_PI_2, 5.0)])
    }

    fn applied(toml: &str) -> Scene {
        let scene = crossing();
        edit(toml).apply(&scene, &|agent| agent.resolve(&scene, 0, crate::scene::Roles::none())).unwrap()
    }

    fn position(scene: &Scene, agent_idx: usize, timestep: usize) -> Vec2 {
        scene.state(agent_idx, timestep).unwrap().position
    }

    #[test]
    fn a_later_agent_is_where_it_was() {
        let edited = applied("{ kind = 'shift_time', agent = 'ego', by_s = 0.2, onset_s = 0.4 }");
        // Complete from timestep 7 on: two timesteps behind. Half way, at timestep 5: one behind.
        for (timestep, x) in [(3, 3.0), (5, 4.0), (7, 5.0), (11, 9.0)] {
            assert!((position(&edited, 0, timestep).x - x).abs() < 1e-9, "{timestep}");
        }
        assert_eq!(edited.tracks[1], crossing().tracks[1]);
        // An earlier one goes beyond the end of its recording.
        let edited = applied("{ kind = 'shift_time', agent = 'ego', by_s = -0.3, onset_s = 0.4 }");
        assert!((position(&edited, 0, 11).x - 14.0).abs() < 1e-9);
        assert!((edited.state(0, 11).unwrap().speed_mps() - 10.0).abs() < 1e-9);
    }

    #[test]
    fn a_shift_is_in_the_agents_own_frame() {
        let edited = applied("{ kind = 'shift', agent = { track = '2' }, along_m = 2.0, left_m = 1.0, onset_s = 0.4 }");
        // It heads along y: ahead is +y, left is -x. Its y is -10 + t / 2.
        assert!(position(&edited, 1, 11).distance(Vec2::new(29.0, -2.5)) < 1e-9);
        assert!(position(&edited, 1, 5).distance(Vec2::new(29.5, -6.5)) < 1e-9);
        assert_eq!(edited.tracks[0], crossing().tracks[0]);
    }

    #[test]
    fn speeds_are_scaled_along_the_path() {
        let edited = applied("{ kind = 'scale_speed', agent = 'ego', factor = 1.5 }");
        for timestep in 4..12 {
            let x = 3.0 + 1.5 * (timestep - 3) as f64;
            assert!((position(&edited, 0, timestep).x - x).abs() < 1e-9);
        }
        let stopped = applied("{ kind = 'scale_speed', agent = 'ego', factor = 0.0 }");
        assert_eq!(position(&stopped, 0, 11), position(&stopped, 0, 3));
        // On a bend the path is kept: half the speed for twice the steps ends on the same circle.
        let bend = scene(&[Drive { x: 0.0, y: 0.0, heading_rad: 0.0, speed_mps: 10.0, curvature_1pm: 0.1 }]);
        let slow = edit("{ kind = 'scale_speed', agent = 'ego', factor = 0.5 }").apply(&bend, &|_| Some(0)).unwrap();
        assert!(position(&slow, 0, 11).distance(position(&bend, 0, 7)) < 1e-2);
    }

    #[test]
    fn given_points_are_passed_in_time() {
        let edited = applied(
            "{ kind = 'set_positions', agent = 'ego', points = [
                { t_s = 0.4, x_m = 7.0, y_m = 1.0 }, { t_s = 0.6, x_m = 9.0, y_m = 2.0 }] }",
        );
        assert!(position(&edited, 0, 7).distance(Vec2::new(7.0, 1.0)) < 1e-9);
        assert!(position(&edited, 0, 9).distance(Vec2::new(9.0, 2.0)) < 1e-9);
        // Beyond the last point it goes on at (10, 5) m/s.
        assert!(position(&edited, 0, 11).distance(Vec2::new(11.0, 3.0)) < 1e-9);
        // The first tangent is the velocity at present, so the first step is nearly the recorded one.
        assert!(position(&edited, 0, 4).distance(Vec2::new(4.0, 0.0)) < 0.2);
    }

    #[test]
    fn who_meets_is_there_in_time() {
        let edited = applied("{ kind = 'meet', agent = 'ego', with = { track = '2' }, at_s = 0.5, ahead_m = 1.0 }");
        // At timestep 8 the other one is at (30, -6) and heads along y.
        assert!(position(&edited, 0, 8).distance(Vec2::new(30.0, -5.0)) < 1e-9);
        assert_eq!(edited.tracks[1], crossing().tracks[1]);
        assert_eq!(edited.tracks[0].trajectory.entries()[..4], crossing().tracks[0].trajectory.entries()[..4]);
    }

    #[test]
    fn who_is_not_tracked_at_present_cannot_be_moved() {
        let scene = without_states(crossing(), 0, |t| t == 3);
        let resolve = |agent: &AgentRef| agent.resolve(&scene, 0, crate::scene::Roles::none());
        let error = edit("{ kind = 'scale_speed', agent = 'ego', factor = 2.0 }").apply(&scene, &resolve).unwrap_err();
        assert!(error.0.contains("tracked at present"), "{error}");
    }

    #[test]
    fn missing_states_are_completed_where_wanted() {
        let gone = without_states(crossing(), 0, |t| t == 5 || t > 9);
        let completed = gone.completed(|_, timestep| timestep > 4);
        for timestep in 0..12 {
            assert!(position(&completed, 0, timestep).distance(position(&crossing(), 0, timestep)) < 1e-9);
        }
        assert_eq!(gone.completed(|_, _| false), gone);
    }
}
