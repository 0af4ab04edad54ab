//! Reduces many samples to a few modes with probabilities, for benchmarks with a fixed number of guesses.
//!
//! The paper draws 60 samples of a scene and takes the means of a mixture of six Gaussians as its prediction.

use super::mixture::Mixture;
use super::sample_group::{future, present_agents};
use crate::geometry::Vec2;
use crate::scene::{Scene, State, Track, Trajectory};
use crate::seed::Seed;

/// The agents whose modes a metric needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ModesOf {
    /// The ego's alone, for single-agent benchmarks.
    Ego,
    /// All agents jointly.
    Scene,
}

impl ModesOf {
    /// The agents whose positions are fitted.
    pub fn agents(self, scene: &Scene) -> Vec<usize> {
        match self {
            Self::Ego => vec![scene.ego_idx],
            Self::Scene => present_agents(scene).collect(),
        }
    }
}

/// Modes of the samples of one scene, by decreasing probability.
#[derive(Debug, Clone, PartialEq)]
pub struct Modes {
    /// One scene a mode.
    pub samples: Vec<Scene>,
    /// Their probabilities, which sum to 1.
    pub probabilities: Vec<f64>,
}

/// A mixture fitted to samples, from which modes are made.
#[derive(Debug, Clone)]
pub struct ModeFit<'a> {
    samples: &'a [Scene],
    mixture: Mixture,
}

impl<'a> ModeFit<'a> {
    /// Fits the mixture of `samples` over the future positions of `agents`. Each agent's positions are in its own frame
    /// at present, so that the axes of the diagonal covariance are along and across its course. For one agent this is
    /// the paper's reduction, for all agents the joint one.
    ///
    /// `None` with fewer samples than modes, or if no agent has a future in all of them.
    pub fn new(samples: &'a [Scene], agents: &[usize], n_modes: usize, seed: Seed) -> Option<Self> {
        let first = samples.first()?;
        let entries: Vec<(usize, usize, State)> = agents
            .iter()
            .filter_map(|agent_idx| Some((*agent_idx, *first.state(*agent_idx, first.current_timestep())?)))
            .flat_map(|(agent_idx, now)| future(first).map(move |timestep| (agent_idx, timestep, now)))
            .filter(|(agent_idx, timestep, _)| samples.iter().all(|s| s.state(*agent_idx, *timestep).is_some()))
            .collect();
        let coordinates = |sample: &Scene| -> Vec<f64> {
            let in_own_frame = |(agent_idx, timestep, now): &(usize, usize, State)| {
                let state = sample.state(*agent_idx, *timestep)?;
                let moved = (state.position - now.position).rotated(-now.heading_rad);
                Some([moved.x, moved.y])
            };
            entries.iter().filter_map(in_own_frame).flatten().collect()
        };
        let points: Vec<Vec<f64>> = samples.iter().map(coordinates).collect();
        let mixture = Mixture::fit(&points, n_modes, seed)?;
        Some(Self { samples, mixture })
    }

    /// The modes, as means of their samples (as in the paper): fewer than configured if samples coincide.
    pub fn modes(&self) -> Modes {
        let samples = (0..self.mixture.components.len()).map(|k| self.mean_scene(k));
        let probabilities = self.mixture.components.iter().map(|component| component.weight);
        Modes { samples: samples.collect(), probabilities: probabilities.collect() }
    }

    /// The first sample with the futures of all agents replaced by the mean over samples, weighted by their probability
    /// of belonging to component `k`. For the fitted agents this is the component's mean; the others follow. Headings
    /// are averaged as directions.
    fn mean_scene(&self, k: usize) -> Scene {
        let first = &self.samples[0];
        let shares: Vec<f64> = self.mixture.responsibilities.iter().map(|shares| shares[k]).collect();
        let track = |(agent_idx, track): (usize, &Track)| {
            let state = |(timestep, state): (usize, &Option<State>)| {
                if timestep < first.n_history { *state } else { self.mean_state(agent_idx, timestep, &shares) }
            };
            let states = track.trajectory.entries().iter().enumerate().map(state);
            Track { trajectory: Trajectory::new(states.collect()), ..track.clone() }
        };
        Scene { tracks: first.tracks.iter().enumerate().map(track).collect(), ..first.clone() }
    }

    /// The weighted mean of a state; `None` if any sample lacks it.
    fn mean_state(&self, agent_idx: usize, timestep: usize, shares: &[f64]) -> Option<State> {
        let (mut position, mut velocity, mut direction) = (Vec2::ZERO, Vec2::ZERO, Vec2::ZERO);
        for (sample, share) in self.samples.iter().zip(shares) {
            let state = sample.state(agent_idx, timestep)?;
            position = position + state.position * *share;
            velocity = velocity + state.velocity * *share;
            direction = direction + Vec2::from_angle(state.heading_rad) * *share;
        }
        let per_share = 1.0 / shares.iter().sum::<f64>();
        Some(State { position: position * per_share, velocity: velocity * per_share, heading_rad: direction.angle() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::testing::{random_scene, transformed};
    use crate::geometry::Transform2;
    use crate::metrics::constant_velocity;
    use crate::scene::testing::{self, Drive};

    /// Two cars. The first goes straight on or turns left, by which the samples differ; samples of one kind differ
    /// little.
    fn samples() -> Vec<Scene> {
        let sample = |curvature_1pm: f64, y: f64| {
            let first = Drive { curvature_1pm, ..Drive::straight(0.0, 0.0, 0.0, 10.0) };
            let mut scene = testing::scene(&[first, Drive::straight(0.0, 9.0, 0.0, 10.0)]);
            let history = testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0)]);
            let states: Vec<Option<State>> = scene.tracks[0]
                .trajectory
                .entries()
                .iter()
                .zip(history.tracks[0].trajectory.entries())
                .enumerate()
                .map(|(t, (turning, straight))| if t < scene.n_history { *straight } else { *turning })
                .map(|state| state.map(|s| State { position: s.position + Vec2::new(0.0, y), ..s }))
                .collect();
            scene.tracks[0].trajectory = Trajectory::new(states);
            scene
        };
        vec![sample(0.0, 0.0), sample(0.05, 0.0), sample(0.05, 0.5), sample(0.05, 0.25), sample(0.0, -0.5)]
    }

    #[test]
    fn modes_are_means_of_what_is_alike_with_the_likelier_one_first() {
        let samples = samples();
        for agents in [vec![0], vec![0, 1]] {
            let fit = ModeFit::new(&samples, &agents, 2, Seed(3)).expect("fits");
            let means = fit.modes();
            assert!((means.probabilities[0] - 0.6).abs() < 1e-9 && (means.probabilities[1] - 0.4).abs() < 1e-9);
            let last = samples[0].n_timesteps - 1;
            let end = |scene: &Scene| scene.state(0, last).expect("driven").position;
            // The mean of the three turning samples is the middle one, that of the two others is halfway between them.
            assert!(end(&means.samples[0]).distance(end(&samples[3])) < 1e-9);
            assert!(end(&means.samples[1]).distance(end(&samples[0]).lerp(end(&samples[4]), 0.5)) < 1e-9);
            let velocity = |scene: &Scene| scene.state(0, last).expect("driven").velocity;
            assert!(velocity(&means.samples[0]).distance(velocity(&samples[1])) < 1e-9);
            let heading_rad = |scene: &Scene| scene.state(0, last).expect("driven").heading_rad;
            assert!((heading_rad(&means.samples[0]) - heading_rad(&samples[1])).abs() < 1e-9);
            // The second car does the same in all samples, and so in all modes; histories stay.
            for mode in &means.samples {
                for t in 0..=last {
                    let (mode, sample) = (mode.state(1, t).expect("driven"), samples[0].state(1, t).expect("driven"));
                    assert!(mode.position.distance(sample.position) < 1e-9);
                }
                assert_eq!(mode.state(0, 0), samples[0].state(0, 0));
            }
        }
    }

    #[test]
    fn the_frame_does_not_matter() {
        let scene = random_scene(3, 9, 25.0);
        let mut samples = samples();
        samples.iter_mut().for_each(|sample| sample.id = scene.id.clone());
        let moved_by = Transform2::from_pose(Vec2::new(-431.0, 77.0), 2.1);
        let moved: Vec<Scene> = samples.iter().map(|sample| transformed(sample, &moved_by)).collect();
        let modes = |samples: &[Scene]| ModeFit::new(samples, &[0, 1], 2, Seed(3)).expect("fits").modes();
        let (here, there) = (modes(&samples), modes(&moved));
        for (a, b) in here.samples.iter().zip(&there.samples) {
            for (t, state) in a.tracks[0].trajectory.valid() {
                let there = b.state(0, t).expect("as here");
                assert!(moved_by.point(state.position).distance(there.position) < 1e-6);
            }
        }
    }

    #[test]
    fn too_few_samples_or_no_futures_have_no_modes() {
        let samples = samples();
        assert!(ModeFit::new(&samples[..1], &[0], 2, Seed(3)).is_none());
        assert!(ModeFit::new(&[], &[0], 2, Seed(3)).is_none());
        assert!(ModeFit::new(&samples, &[], 2, Seed(3)).is_none());
        // An agent that is missing in one sample does not take part, and has no state in the mean.
        let mut lacking = samples.clone();
        let n_history = samples[0].n_history;
        lacking[2] = testing::without_states(lacking[2].clone(), 1, |t| t >= n_history);
        assert!(ModeFit::new(&lacking, &[1], 2, Seed(3)).is_none());
        let fit = ModeFit::new(&lacking, &[0, 1], 2, Seed(3)).expect("the other one is in all");
        assert!(fit.modes().samples[0].state(1, n_history).is_none());
    }

    #[test]
    fn equal_samples_are_one_mode() {
        let scene = constant_velocity(&samples()[0]);
        let equal = vec![scene.clone(); 9];
        let fit = ModeFit::new(&equal, &[0, 1], 6, Seed(3)).expect("fits");
        assert_eq!(fit.modes().probabilities, [1.0]);
    }
}
