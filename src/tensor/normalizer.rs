//! Constants of the training set that scale diffused values to a standard deviation of σ_data = 0.5.

use super::motion::MotionChain;
use super::motion_modes::MotionCovariance;
use super::reference::Reference;
use super::texture::Texture;
use crate::geometry::{angle_difference, unwrap_angles};
use crate::scene::{ObservationMask, Scene};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What is diffused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Default)]
#[serde(rename_all = "snake_case")]
pub enum StateParametrization {
    /// The paper's: positions and headings in the ego frame.
    Scene,
    /// The motion, from timestep to timestep, of each agent's residual to a kinematic reference that follows from the
    /// observed states, in the agent's own frame: its paths are smooth whatever the network's small errors.
    #[default]
    Motion,
}

impl StateParametrization {
    /// Its name in configurations and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Scene => "scene",
            Self::Motion => "motion",
        }
    }
}

/// Scales from normalized units to meters and radians. Constants of the training set, so that nothing of a
/// scene's future leaks into its scaling, and any scene can be mapped back. Readers ignore the units of other
/// parametrizations that a checkpoint has, too.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Normalizer {
    /// The quantity that is diffused.
    pub parametrization: StateParametrization,
    /// Dimensions of a diffused state: 3 (x, y, heading), or 2 where headings are not recorded.
    pub state_dim: usize,
    /// Meters per unit of position in the ego frame, one for both axes; also scales the map.
    pub position_unit_m: f64,
    /// Radians per unit of heading in the ego frame.
    pub heading_unit_rad: f64,
    /// Meters per timestep per unit of residual motion along the agent's heading.
    pub motion_longitudinal_unit_m: f64,
    /// Meters per timestep per unit of residual motion across the agent's heading.
    pub motion_lateral_unit_m: f64,
    /// Radians per timestep per unit of residual turning.
    pub motion_heading_unit_rad: f64,
    /// Meters per second per unit of observed velocity.
    pub velocity_unit_mps: f64,
    /// Meters per unit of an agent's size.
    pub extent_unit_m: f64,
    /// Covariance of diffused motion along time (motion parametrization only); older checkpoints have none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motion_covariance: Option<MotionCovariance>,
}

impl Normalizer {
    /// σ_data: the standard deviation of every diffused feature (paper, Appendix A).
    pub const SIGMA_DATA: f64 = 0.5;

    /// These scales, with the scales of motion of `other`, if that covers as much of the past, and has motion in a
    /// dimension. Recordings differ in their texture: a network that is trained further on others learns theirs only if
    /// the diffused values are white for them, too.
    #[must_use]
    pub fn for_motion_of(&self, other: &Self) -> Self {
        let (Some(own), Some(others)) = (&self.motion_covariance, &other.motion_covariance) else {
            return self.clone();
        };
        let shape =
            |covariance: &MotionCovariance| (covariance.n_past, covariance.n_timesteps, covariance.values.len());
        if shape(own) != shape(others) {
            return self.clone();
        }
        let (mut units, mut values, mut noise) = (self.motion_units(), own.values.clone(), own.noise.clone());
        let texture_of = |covariance: &MotionCovariance, dim: usize| covariance.texture.get(dim).copied();
        let mut texture: Vec<Option<Texture>> = (0..values.len()).map(|dim| texture_of(own, dim)).collect();
        for (dim, of_other) in others.values.iter().enumerate().filter(|(_, values)| values.iter().any(|v| *v > 0.0)) {
            units[dim] = other.motion_units()[dim];
            values[dim].clone_from(of_other);
            texture[dim] = texture_of(others, dim);
            noise.get_mut(dim).zip(others.noise.get(dim)).into_iter().for_each(|(own, other)| *own = *other);
        }
        let covariance = MotionCovariance::new(own.n_past, own.n_timesteps, values, noise);
        Self {
            motion_longitudinal_unit_m: units[0],
            motion_lateral_unit_m: units[1],
            motion_heading_unit_rad: units[2],
            motion_covariance: Some(covariance.with_texture(texture)),
            ..self.clone()
        }
    }

    /// Units of (x, y, heading) in the ego frame.
    pub const fn scene_units(&self) -> [f64; 3] {
        [self.position_unit_m, self.position_unit_m, self.heading_unit_rad]
    }

    /// Units of (longitudinal, lateral, heading) residual motion in an agent's frame.
    pub const fn motion_units(&self) -> [f64; 3] {
        [self.motion_longitudinal_unit_m, self.motion_lateral_unit_m, self.motion_heading_unit_rad]
    }

    /// Units of the diffused values of an agent that is observed at some time.
    pub(super) const fn agent_units(&self) -> [f64; 3] {
        match self.parametrization {
            StateParametrization::Scene => self.scene_units(),
            StateParametrization::Motion => self.motion_units(),
        }
    }
}

/// Root mean square of the added values; the mean is not removed, as in the paper.
#[derive(Debug, Clone, Copy, Default)]
struct RootMeanSquare {
    sum: f64,
    n: u64,
}

impl RootMeanSquare {
    fn add(&mut self, value: f64) {
        self.sum += value * value;
        self.n += 1;
    }

    /// The unit in which the values have a root mean square of σ_data; 1 without values.
    fn unit(&self) -> f64 {
        let unit = (self.sum / self.n.max(1) as f64).sqrt() / Normalizer::SIGMA_DATA;
        if unit > 1e-6 { unit } else { 1.0 }
    }
}

/// Share of motions that determine the unit. The rest are jumps of recordings, which must not enlarge it.
const KEPT_SHARE: f64 = 0.995;
/// Tracks for each observed step of a prediction.
const TRACKS_PER_STEP: usize = 10;
/// Motions this many times beyond the limit are jumps of a recording.
const JUMP: f64 = 3.0;
/// Errors of observed positions, meters, and headings, radians: slightly more than those of recordings that are rounded
/// to millimeters and milliradians.
const POSITION_NOISE_M: f64 = 1e-3;
const HEADING_NOISE_RAD: f64 = 1e-3;
/// If the past predicts all but less than this share of motion, the motion is as good as known, and units stay those of
/// the motion.
const MIN_REST: f64 = 0.1;
/// Maximum number of motions kept for the constants: enough for three digits.
const MAX_MOTIONS: usize = 2_000_000;

/// Motion along and across the heading, meters, and turn, radians, by timestep.
type Motion = Vec<(usize, [f32; 3])>;

/// The motion of an agent.
#[derive(Debug, Clone, Default)]
struct TrackMotion {
    /// Its observed steps beyond the velocity at the present.
    past: Motion,
    /// The motion that the motion parametrization diffuses without a prediction from the past.
    future: Motion,
}

/// Gathers the constants over training scenes, one after the other.
#[derive(Debug, Clone, Default)]
pub struct NormalizerFit {
    position: RootMeanSquare,
    heading: RootMeanSquare,
    /// Motions of each agent that is present: of the steps in its history, and of the timesteps after it, both counted
    /// from 0; turns are NaN if unknown.
    motions: Vec<TrackMotion>,
    /// Number of steps in a history.
    n_past: usize,
    n_motions: usize,
    velocity: RootMeanSquare,
    extent: RootMeanSquare,
    leaves_out_derived_headings: bool,
}

impl NormalizerFit {
    /// Only datasets with headings count for turning.
    #[must_use]
    pub fn without_derived_headings(self) -> Self {
        Self { leaves_out_derived_headings: true, ..self }
    }

    /// Adds a scene in its stored frame; residuals are those of the predictive task.
    pub fn add(&mut self, scene: &Scene) {
        let mask = ObservationMask::predictive(scene.tracks.len(), scene.n_timesteps, scene.n_history);
        for (agent_idx, track) in scene.tracks.iter().enumerate() {
            let states: Vec<_> = track.trajectory.valid().collect();
            let mut headings: Vec<f64> = states.iter().map(|(_, state)| state.heading_rad).collect();
            unwrap_angles(&mut headings);
            let reference = Reference::new(track, scene.dt_s, scene.current_timestep(), |timestep| {
                mask.is_observed(agent_idx, timestep)
            });
            if let Some(extent) = track.extent {
                self.extent.add(extent.length_m);
                self.extent.add(extent.width_m);
            }
            let mut residuals: Vec<(usize, [f64; 3])> = Vec::new();
            for ((timestep, state), heading) in states.into_iter().zip(headings) {
                self.position.add(state.position.x);
                self.position.add(state.position.y);
                self.heading.add(heading);
                self.velocity.add(state.velocity.x);
                self.velocity.add(state.velocity.y);
                if let Some(expected) = reference.at(timestep).filter(|_| timestep >= scene.n_history) {
                    let residual = (state.position - expected.position).rotated(-reference.frame_heading_rad());
                    let turn = angle_difference(state.heading_rad, expected.heading_rad);
                    residuals.push((timestep, [residual.x, residual.y, turn]));
                }
            }
            let observed: Vec<usize> =
                track.trajectory.valid().map(|(timestep, _)| timestep).filter(|t| *t < scene.n_history).collect();
            let latent: Vec<usize> = residuals.iter().map(|(timestep, _)| *timestep).collect();
            let mut values = residuals.iter().map(|(_, residual)| *residual);
            let motion = MotionChain::new(&observed, &latent).encode(|_| values.next());
            let is_present = observed.last() == Some(&scene.current_timestep());
            if is_present && self.n_motions < MAX_MOTIONS && !motion.is_empty() {
                self.n_motions += motion.len();
                // Derived headings do not count for turning.
                let is_derived = self.leaves_out_derived_headings && !scene.source.dataset.facts().has_headings;
                let turns = track.class.has_recorded_heading() && !is_derived;
                let since = |first: usize| {
                    move |(t, z): (usize, [f64; 3])| {
                        let [along, across, turn] = z.map(|z| z as f32);
                        (t - first, [along, across, if turns { turn } else { f32::NAN }])
                    }
                };
                self.n_past = scene.n_history.saturating_sub(1);
                self.motions.push(TrackMotion {
                    past: reference.observed_motion().map(since(1)).collect(),
                    future: motion.into_iter().map(since(scene.n_history)).collect(),
                });
            }
        }
    }

    /// The constants.
    pub fn finish(&self, parametrization: StateParametrization, state_dim: usize) -> Normalizer {
        let limits: [f64; 3] = std::array::from_fn(|dim| self.limit(dim));
        let mut motion_units: [f64; 3] = std::array::from_fn(|dim| self.motion_unit(dim, limits[dim]));
        let motion_covariance = (parametrization == StateParametrization::Motion)
            .then(|| self.covariance(&limits[..state_dim], &mut motion_units))
            .flatten();
        Normalizer {
            parametrization,
            state_dim,
            position_unit_m: self.position.unit(),
            heading_unit_rad: self.heading.unit(),
            motion_longitudinal_unit_m: motion_units[0],
            motion_lateral_unit_m: motion_units[1],
            motion_heading_unit_rad: motion_units[2],
            velocity_unit_mps: self.velocity.unit(),
            extent_unit_m: self.extent.unit(),
            motion_covariance,
        }
    }

    /// The magnitude of motion that `KEPT_SHARE` of all motions do not exceed.
    fn limit(&self, dim: usize) -> f64 {
        let mut sizes: Vec<f32> = self.known_motion(dim).map(f32::abs).collect();
        if sizes.is_empty() {
            return f64::INFINITY;
        }
        let rank = ((sizes.len() - 1) as f64 * KEPT_SHARE).ceil() as usize;
        f64::from(*sizes.select_nth_unstable_by(rank, f32::total_cmp).1)
    }

    fn motion_unit(&self, dim: usize, limit: f64) -> f64 {
        let mut moment = RootMeanSquare::default();
        self.known_motion(dim).for_each(|z| moment.add(f64::from(z).clamp(-limit, limit)));
        moment.unit()
    }

    fn known_motion(&self, dim: usize) -> impl Iterator<Item = f32> + '_ {
        let futures = self.motions.iter().flat_map(|motion| &motion.future);
        futures.map(move |(_, z)| z[dim]).filter(|z| !z.is_nan())
    }

    /// The covariance of motion in units of the diffused values, which are set to those of the motion that is not
    /// predicted from the past. Only tracks that are recorded throughout count, so that the smallest variances are not
    /// errors of the estimate, and only tracks without jumps far beyond the `limits`. `None` without any.
    fn covariance(&self, limits: &[f64], units: &mut [f64; 3]) -> Option<MotionCovariance> {
        let n_timesteps = self.motions.iter().map(|motion| motion.future.len()).max()?;
        let is_whole = |motion: &&TrackMotion| motion.past.len() == self.n_past && motion.future.len() == n_timesteps;
        let whole: Vec<&TrackMotion> = self.motions.iter().filter(is_whole).collect();
        if whole.is_empty() {
            return None;
        }
        // A prediction from k steps is fitted to many more tracks, or it would fit their noise.
        let n_past = self.n_past.min(whole.len() / TRACKS_PER_STEP);
        let size = n_past + n_timesteps;
        let of_dim = |(dim, limit): (usize, &f64)| {
            let mut sums = vec![0.0; size * size];
            let mut n = 0u32;
            for motion in &whole {
                let past = &motion.past[self.n_past - n_past..];
                let values: Vec<f64> = past.iter().chain(&motion.future).map(|(_, z)| f64::from(z[dim])).collect();
                // A value that is NaN is not within the limit either.
                if !values.iter().all(|value| value.abs() <= JUMP * limit) {
                    continue;
                }
                n += 1;
                for (row, a) in sums.chunks_exact_mut(size).zip(&values) {
                    row.iter_mut().zip(&values).for_each(|(sum, b)| *sum += a * b);
                }
            }
            sums.iter().map(|sum| sum / f64::from(n.max(1))).collect::<Vec<f64>>()
        };
        let meters: Vec<Vec<f64>> = limits.iter().enumerate().map(of_dim).collect();
        let noise = if n_past > 0 { &[POSITION_NOISE_M, POSITION_NOISE_M, HEADING_NOISE_RAD][..] } else { &[] };
        let in_units = |units: &[f64; 3]| {
            let values = meters.iter().zip(units).map(|(own, unit)| own.iter().map(|v| v / (unit * unit)).collect());
            let noise = noise.iter().zip(units).map(|(noise, unit)| noise / unit).take(meters.len());
            MotionCovariance::new(n_past, n_timesteps, values.collect(), noise.collect())
        };
        let before = in_units(units);
        for (covariance, unit) in before.continuation(n_past).iter().flat_map(|rest| &rest.covariance).zip(&mut *units)
        {
            let variance =
                (0..n_timesteps).map(|i| covariance[i * (n_timesteps + 1)]).sum::<f64>() / n_timesteps as f64;
            let share = variance.max(0.0).sqrt() / Normalizer::SIGMA_DATA;
            *unit *= if share > MIN_REST { share } else { 1.0 };
        }
        let covariance = in_units(units);
        let of_dim = |(dim, limit): (usize, &f64)| {
            let tracks = whole.iter().filter_map(|motion| {
                let values = |motions: &[(usize, [f32; 3])]| {
                    motions.iter().map(|(_, z)| f64::from(z[dim])).collect::<Vec<f64>>()
                };
                let (past, future) = (values(&motion.past[self.n_past - n_past..]), values(&motion.future));
                let is_possible = past.iter().chain(&future).all(|value| value.abs() <= JUMP * limit);
                let in_units = |values: Vec<f64>| values.into_iter().map(|value| value / units[dim]).collect();
                is_possible.then(|| (in_units(past), in_units(future)))
            });
            covariance.fit_texture(dim, &tracks.collect::<Vec<_>>())
        };
        let texture = limits.iter().enumerate().map(of_dim).collect();
        Some(covariance.with_texture(texture))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_of_motion_are_exchanged_where_they_are_known() {
        let normalizer = |unit: f64, n_past: usize, turning: f64| {
            let values = vec![vec![1.0 / unit; 9], vec![1.0 / unit; 9], vec![turning; 9]];
            let mut covariance = MotionCovariance::new(n_past, 3 - n_past, values, vec![0.1 / unit; 3]);
            covariance.texture = vec![Texture { exponent: unit / 10.0, factor: 1.0 }; 3];
            let fit = NormalizerFit::default().finish(StateParametrization::Motion, 3);
            Normalizer {
                position_unit_m: unit,
                motion_longitudinal_unit_m: unit,
                motion_lateral_unit_m: unit,
                motion_heading_unit_rad: unit,
                motion_covariance: Some(covariance),
                ..fit
            }
        };
        let (own, other) = (normalizer(1.0, 2, 0.5), normalizer(4.0, 2, 0.0));
        let mixed = own.for_motion_of(&other);
        assert_eq!((mixed.position_unit_m, mixed.motion_units()), (1.0, [4.0, 4.0, 1.0]));
        let covariance = mixed.motion_covariance.unwrap();
        assert_eq!(covariance.values, [vec![0.25; 9], vec![0.25; 9], vec![0.5; 9]]);
        assert_eq!(covariance.noise, [0.025, 0.025, 0.1]);
        assert_eq!(covariance.texture.iter().map(|texture| texture.exponent).collect::<Vec<_>>(), [0.4, 0.4, 0.1]);
        assert_eq!(own.for_motion_of(&normalizer(4.0, 1, 0.0)), own, "too few tracks to predict from as many steps");
    }

    #[test]
    fn a_jump_of_a_recording_decides_no_unit() {
        // 999 motions of 1 m forward and back, none sideways, and one jump.
        let future = |along: f32| TrackMotion { past: Vec::new(), future: vec![(0, [along, 0.0, f32::NAN])] };
        let mut motions: Vec<TrackMotion> = (0..999).map(|i| future(if i % 2 == 0 { 1.0 } else { -1.0 })).collect();
        motions.push(future(500.0));
        let fit = NormalizerFit { motions, ..NormalizerFit::default() };
        let normalizer = fit.finish(StateParametrization::Motion, 3);
        // A root mean square of 1 m is σ_data units; a dimension without motion or data has a unit of 1.
        assert!((normalizer.motion_longitudinal_unit_m - 1.0 / Normalizer::SIGMA_DATA).abs() < 1e-9);
        assert_eq!((normalizer.motion_lateral_unit_m, normalizer.motion_heading_unit_rad), (1.0, 1.0));
        let covariance = normalizer.motion_covariance.unwrap();
        assert!((covariance.values[0][0] - 0.25).abs() < 1e-9 && covariance.n_timesteps == 1);
    }
}
