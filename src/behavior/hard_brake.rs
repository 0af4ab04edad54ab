//! Hard braking: does an agent slow down faster than comfortable traffic does?

use super::maneuver::Maneuver;
use super::speed_profile::smoothed_accelerations_mps2;
use super::{Behavior, BehaviorEvent, EventLabel};
use crate::scene::{Scene, Track};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;

/// Name of the behavior in configs and tables.
pub(super) const ID: &str = "hard_brake";
/// The agent that brakes.
pub(super) const ROLES: &[&str] = &["agent"];
/// Names of the parameters of its events, defined at [`HardBrake`].
pub(super) const PARAMETERS: &[&str] =
    &["speed_mps", "end_speed_mps", "max_deceleration_mps2", "mean_deceleration_mps2", "duration_s"];

/// Weaker braking that reaches this share of the least deceleration is a hard negative (2.5 of 4 m/s²).
const NEGATIVE_SHARE: f64 = 0.625;
/// Runs with a deceleration beyond this are errors of the tracker, not braking, m/s².
const IMPLAUSIBLE_MPS2: f64 = 12.0;
/// Time over which speeds are smoothed, seconds: noise of positions is less than a brake then.
const SMOOTHING_S: f64 = 0.4;
/// How long the deceleration must last, from its first to its last timestep, seconds.
const MIN_DURATION_S: f64 = 0.3;

/// One agent (`agent`) brakes hard.
///
/// **Positive**: the agent's smoothed deceleration is at least 4 m/s² over at least 0.3 s without a break, beginning at
/// a speed of at least 3 m/s. The deceleration at a timestep is the slope of the least-squares line through the speeds
/// in the 0.4 s around it, so it is not known within 0.2 s of the ends of a track and of its gaps. Where positions are
/// smoothed, it is not known in the second after the present either: observed positions are smoothed without the later
/// ones, and the motion of that second makes up for their error.
///
/// - The event *starts* at the first timestep with that deceleration and is *complete* at the last one.
/// - *What does not count*: single noisy speeds; decelerations beyond 12 m/s², which no tire can achieve; the last
///   moments of a stop from walking speed; braking within a gap of the track.
///
/// **Negative**: a deceleration of at least 2.5 m/s² over at least 0.3 s without hard braking, because it is too weak,
/// too short or begins at too low a speed.
///
/// Parameters: `speed_mps` and `end_speed_mps` (at start and end), `max_deceleration_mps2`, `mean_deceleration_mps2`,
/// `duration_s`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct HardBrake {
    /// Least deceleration of hard braking, m/s². Default 4.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub min_deceleration_mps2: f64,
    /// Least speed at the start, m/s. Default 3.
    #[schemars(range(min = 0.0))]
    pub min_speed_mps: f64,
}

impl Default for HardBrake {
    fn default() -> Self {
        Self { min_deceleration_mps2: 4.0, min_speed_mps: 3.0 }
    }
}

impl HardBrake {
    fn detect_agent(&self, scene: &Scene, agent_idx: usize, track: &Track) -> Vec<BehaviorEvent> {
        let accelerations =
            smoothed_accelerations_mps2(&track.trajectory, scene.current_timestep(), scene.dt_s, SMOOTHING_S);
        let lasts =
            |run: &RangeInclusive<usize>| (run.end() - run.start()) as f64 * scene.dt_s >= MIN_DURATION_S - 1e-9;
        let is_plausible =
            |run: &RangeInclusive<usize>| accelerations[run.clone()].iter().flatten().all(|a| -a <= IMPLAUSIBLE_MPS2);
        let starts_fast =
            |run: &RangeInclusive<usize>| speed_at(track, *run.start()).is_some_and(|v| v >= self.min_speed_mps);
        let hard: Vec<_> = runs_at_or_below(&accelerations, -self.min_deceleration_mps2)
            .into_iter()
            .filter(|run| lasts(run) && is_plausible(run) && starts_fast(run))
            .collect();
        let near: Vec<_> = runs_at_or_below(&accelerations, -NEGATIVE_SHARE * self.min_deceleration_mps2)
            .into_iter()
            .filter(|run| lasts(run) && is_plausible(run) && !hard.iter().any(|h| run.contains(h.start())))
            .collect();
        let labeled = |runs: Vec<_>, label: EventLabel| runs.into_iter().map(move |run| (run, label));
        labeled(hard, EventLabel::Positive)
            .chain(labeled(near, EventLabel::Negative))
            .map(|(run, label)| event(scene, agent_idx, track, &accelerations, run, label))
            .collect()
    }
}

impl Behavior for HardBrake {
    fn id(&self) -> &'static str {
        ID
    }

    fn template_parameters(&self) -> &'static [&'static str] {
        &["max_deceleration_mps2"]
    }

    fn maneuvers(&self, scene: &Scene, agents: &[usize]) -> Vec<Maneuver> {
        agents.first().map_or_else(Vec::new, |agent_idx| self.brakings(scene, *agent_idx))
    }

    /// Agents come in the order of tracks; for each agent, positive events come first, then negative ones, each by
    /// time.
    fn detect(&self, scene: &Scene) -> Vec<BehaviorEvent> {
        let considered = scene.tracks.iter().enumerate().filter(|(_, track)| track.class.is_motorized());
        considered.flat_map(|(agent_idx, track)| self.detect_agent(scene, agent_idx, track)).collect()
    }
}

fn speed_at(track: &Track, timestep: usize) -> Option<f64> {
    track.trajectory.get(timestep).map(crate::scene::State::speed_mps)
}

/// The longest runs of timesteps whose values are known and at most `limit`.
fn runs_at_or_below(values: &[Option<f64>], limit: f64) -> Vec<RangeInclusive<usize>> {
    let mut runs: Vec<RangeInclusive<usize>> = Vec::new();
    for (timestep, _) in values.iter().enumerate().filter(|(_, value)| value.is_some_and(|v| v <= limit)) {
        match runs.last_mut() {
            Some(run) if *run.end() + 1 == timestep => *run = *run.start()..=timestep,
            _ => runs.push(timestep..=timestep),
        }
    }
    runs
}

fn event(
    scene: &Scene,
    agent_idx: usize,
    track: &Track,
    accelerations: &[Option<f64>],
    run: RangeInclusive<usize>,
    label: EventLabel,
) -> BehaviorEvent {
    let decelerations: Vec<f64> = accelerations[run.clone()].iter().flatten().map(|a| -a).collect();
    let (start, end) = (*run.start(), *run.end());
    BehaviorEvent::new((ID, ROLES), scene, label, &[agent_idx], run)
        .with("speed_mps", speed_at(track, start))
        .with("end_speed_mps", speed_at(track, end))
        .with("max_deceleration_mps2", decelerations.iter().copied().reduce(f64::max))
        .with("mean_deceleration_mps2", decelerations.iter().sum::<f64>() / decelerations.len() as f64)
        .with("duration_s", (end - start) as f64 * scene.dt_s)
}
