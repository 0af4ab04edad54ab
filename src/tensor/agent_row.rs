//! Writes one agent into a batch: its entries, their base, and the network's input.

use super::batch_buffers::BatchBuffers;
use super::collate::Collator;
use super::hidden_states::generated_timesteps;
use super::motion::MotionChain;
use super::motion_modes::MotionModes;
use super::observation_errors::FadingErrors;
use super::reference::Reference;
use super::{AgentFrame, FeatureLayout, FutureValidity, SceneView, StateParametrization};
use crate::geometry::{Transform2, Vec2, angle_difference, unwrap_angles};
use crate::scene::{Scene, Track};

pub(super) struct AgentRow<'a> {
    collator: &'a Collator,
    frame: &'a AgentFrame,
    track: &'a Track,
    validity: FutureValidity,
    /// Its place in (B, A).
    at: usize,
    reference: Reference<'a>,
    /// Its entries in order of time, and whether they are observed; the others are latent.
    entries: Vec<(usize, bool)>,
    is_observed_at_all: bool,
    /// Whether x is relative to the reference, in the agent's own frame. An agent never observed has no reference: it
    /// is diffused in the ego frame, in scene units.
    is_residual: bool,
    /// The rotation of the ego frame in the agent's frame.
    own_from_ego: Transform2,
    unit: [f64; 3],
    /// Whether its heading follows from its motion instead of being generated.
    derives_heading: bool,
    /// The roughness of its motion, from its recorded steps before errors are removed.
    texture: [f64; 3],
    /// The errors that are added to the reference of latent entries after the present.
    fading: Option<FadingErrors>,
}

/// The pose of an entry when x is 0, in the ego frame.
#[derive(Clone, Copy)]
struct Base {
    position: Vec2,
    heading_rad: f64,
}

impl<'a> AgentRow<'a> {
    /// The agent with index `agent_idx` in the scene, which goes to `at` in (B, A).
    pub(super) fn new(
        collator: &'a Collator,
        view: &SceneView<'a>,
        frame: &'a AgentFrame,
        agent_idx: usize,
        validity: FutureValidity,
        at: usize,
    ) -> Self {
        let track = &view.scene.tracks[agent_idx];
        let shown = |timestep: usize| frame.observed(agent_idx, timestep);
        let recorded = |timestep: usize| track.trajectory.is_valid(timestep);
        let observed = |timestep: usize| shown(timestep) && recorded(timestep);
        let normalizer = &collator.normalizer;
        let derives_heading = frame.derives_heading(track);
        let reference = Reference::new(track, view.scene.dt_s, view.scene.current_timestep(), observed)
            .continued(normalizer.motion_covariance.as_ref(), !derives_heading);
        let is_observed_at_all = reference.at(0).is_some();
        let is_residual = normalizer.parametrization != StateParametrization::Scene && is_observed_at_all;
        let (frame_heading_rad, unit) = if is_residual {
            (reference.frame_heading_rad() + frame.ego_from_scene.rotation_rad(), normalizer.agent_units())
        } else {
            (0.0, normalizer.scene_units())
        };
        let timesteps = 0..collator.n_timesteps;
        let latent: Vec<bool> = match validity {
            FutureValidity::Recorded => timesteps.clone().map(|t| recorded(t) && !shown(t)).collect(),
            FutureValidity::Everything | FutureValidity::Continued => {
                generated_timesteps(collator.n_timesteps, shown, recorded)
            }
        };
        let entries = timesteps
            .filter_map(|t| if observed(t) { Some((t, true)) } else { latent[t].then_some((t, false)) })
            .collect();
        Self {
            collator,
            frame,
            track,
            validity,
            at,
            reference,
            entries,
            is_observed_at_all,
            is_residual,
            own_from_ego: Transform2::from_pose(Vec2::ZERO, -frame_heading_rad),
            unit,
            derives_heading,
            texture: [1.0; 3],
            fading: None,
        }
    }

    /// Makes its motion as rough as the `recorded` track.
    pub(super) fn rough_like(mut self, view: &SceneView<'_>, recorded: &Track, agent_idx: usize) -> Self {
        let Some(covariance) = &self.collator.normalizer.motion_covariance else { return self };
        let present = view.scene.current_timestep();
        let reference = Reference::new(recorded, view.scene.dt_s, present, |timestep| {
            self.frame.observed(agent_idx, timestep) && recorded.trajectory.is_valid(timestep)
        });
        let steps: Vec<[f64; 3]> = reference.observed_motion().map(|(_, step)| step).collect();
        if self.reference.n_past() == covariance.n_past && steps.len() >= covariance.n_past {
            let last = &steps[steps.len() - covariance.n_past..];
            let in_units = |dim: usize| last.iter().map(|step| step[dim] / self.unit[dim]).collect::<Vec<f64>>();
            self.texture = std::array::from_fn(|dim| covariance.texture_factor(dim, &in_units(dim)));
        }
        self
    }

    /// Makes errors that were removed from the `recorded` track fade after the present, so that samples begin where the
    /// recording ends.
    pub(super) fn fading_from(mut self, scene: &Scene, recorded: &Track) -> Self {
        self.fading = FadingErrors::between(scene, recorded, self.track);
        self
    }

    /// Writes every entry, and returns the modes of the agent's motion if the collator has `Sight`.
    pub(super) fn write(&self, rows: &mut BatchBuffers) -> Option<MotionModes> {
        // The agent's frame in the ego frame is turned the other way.
        let Vec2 { x: cos, y: sin } = self.own_from_ego.vector(Vec2::new(1.0, 0.0));
        rows.rotation[self.at * 2..self.at * 2 + 2].copy_from_slice(&[cos as f32, (0.0 - sin) as f32]);
        rows.unit[self.at * 3..self.at * 3 + 3].copy_from_slice(&self.unit.map(|unit| unit as f32));
        let headings = self.recorded_headings();
        let bases = self.bases(&headings);
        let mut residuals: Vec<Option<[f64; 3]>> = vec![None; self.collator.n_timesteps];
        for (((timestep, is_observed), base), recorded_heading) in self.entries.iter().zip(&bases).zip(&headings) {
            self.write_entry(rows, *timestep, *is_observed, *base);
            if !is_observed {
                residuals[*timestep] = self.residual(*timestep, *base, *recorded_heading);
            }
        }
        if self.collator.normalizer.parametrization == StateParametrization::Motion {
            return self.write_motion(rows, &residuals);
        }
        rows.write_x0(self.at, residuals.into_iter().enumerate().filter_map(|(t, r)| Some((t, r?))), &self.unit);
        None
    }

    /// Recorded headings of the entries in the ego frame, continuous along time; 0 if there is no recorded state.
    fn recorded_headings(&self) -> Vec<f64> {
        let mut last: Option<f64> = None;
        let heading = |(timestep, _): &(usize, bool)| {
            self.track.trajectory.get(*timestep).map_or(0.0, |state| {
                let heading = self.frame.ego_from_scene.heading(state.heading_rad);
                let unwrapped = last.map_or(heading, |last| last + angle_difference(heading, last));
                last = Some(unwrapped);
                unwrapped
            })
        };
        self.entries.iter().map(heading).collect()
    }

    /// The decoded entries at x = 0: observed states unchanged, latent ones from the reference (0 without one).
    fn bases(&self, recorded_headings: &[f64]) -> Vec<Base> {
        let base = |((timestep, is_observed), recorded): (&(usize, bool), &f64)| {
            let pose = self.reference.at(*timestep).filter(|_| *is_observed || self.is_residual);
            let fading = self.fading.as_ref().filter(|_| !*is_observed);
            let pose = pose.map(|pose| fading.map_or(pose, |fading| fading.added_to(pose, *timestep)));
            let heading_rad = match *is_observed && !self.is_residual {
                true => *recorded,
                false => pose.map_or(0.0, |pose| self.frame.ego_from_scene.heading(pose.heading_rad)),
            };
            (pose.map_or(Vec2::ZERO, |pose| self.frame.ego_from_scene.point(pose.position)), heading_rad)
        };
        let (positions, mut headings): (Vec<Vec2>, Vec<f64>) =
            self.entries.iter().zip(recorded_headings).map(base).unzip();
        if self.is_residual {
            unwrap_angles(&mut headings);
        }
        positions.into_iter().zip(headings).map(|(position, heading_rad)| Base { position, heading_rad }).collect()
    }

    /// Masks, base and features of an entry.
    fn write_entry(&self, rows: &mut BatchBuffers, timestep: usize, is_observed: bool, base: Base) {
        let normalizer = &self.collator.normalizer;
        let entry = self.at * self.collator.n_timesteps + timestep;
        rows.write_base(entry, base.position, base.heading_rad, normalizer, is_observed || self.is_residual);
        let state = self.track.trajectory.get(timestep);
        let is_scored = !is_observed && (self.validity != FutureValidity::Continued || state.is_some());
        let number = |flag: bool| f32::from(u8::from(flag));
        rows.observed[entry] = number(is_observed);
        rows.latent[entry] = number(!is_observed);
        rows.scored[entry] = number(is_scored);
        let velocity = state.filter(|_| is_observed).map_or(Vec2::ZERO, |state| {
            self.frame.ego_from_scene.vector(state.velocity) * (1.0 / normalizer.velocity_unit_mps)
        });
        let size = |length_m: f64| (length_m / normalizer.extent_unit_m) as f32;
        let extent = self.track.extent;
        let features: [f32; FeatureLayout::AGENT] = [
            velocity.x as f32,
            velocity.y as f32,
            number(is_observed),
            1.0,
            extent.map_or(0.0, |extent| size(extent.length_m)),
            extent.map_or(0.0, |extent| size(extent.width_m)),
            number(!self.is_observed_at_all),
        ];
        rows.features[entry * FeatureLayout::AGENT..(entry + 1) * FeatureLayout::AGENT].copy_from_slice(&features);
    }

    /// The recorded state of a latent entry relative to its base, in the agent's frame, meters and radians.
    fn residual(&self, timestep: usize, base: Base, recorded_heading_rad: f64) -> Option<[f64; 3]> {
        let state = self.track.trajectory.get(timestep)?;
        let offset = self.frame.ego_from_scene.point(state.position) - base.position;
        let offset = self.own_from_ego.vector(offset);
        let turn = match (self.derives_heading, self.is_residual) {
            (true, _) => 0.0,
            (false, true) => angle_difference(recorded_heading_rad, base.heading_rad),
            (false, false) => recorded_heading_rad,
        };
        Some([offset.x, offset.y, turn])
    }

    /// Writes the changes of residuals from timestep to timestep, and their running sums.
    fn write_motion(&self, rows: &mut BatchBuffers, residuals: &[Option<[f64; 3]>]) -> Option<MotionModes> {
        let timesteps = |are_observed: bool| -> Vec<usize> {
            self.entries.iter().filter(|(_, is_observed)| *is_observed == are_observed).map(|(t, _)| *t).collect()
        };
        let (observed, latent) = (timesteps(true), timesteps(false));
        let chain = MotionChain::new(&observed, &latent);
        let mut motion = chain.encode(|timestep| residuals[timestep]);
        if self.validity == FutureValidity::Continued {
            for i in 1..motion.len() {
                if residuals[motion[i].0].is_none() {
                    motion[i].1 = motion[i - 1].1;
                }
            }
        }
        let n_timesteps = self.collator.n_timesteps;
        rows.write_x0(self.at, motion, &self.unit);
        rows.write_path(self.at, &chain.matrix(n_timesteps));
        let seen = |(t, [along, across, turn]): (usize, [f64; 3])| {
            (t, [along, across, if self.derives_heading { 0.0 } else { turn }])
        };
        rows.write_observed_motion(self.at, self.reference.observed_motion().map(seen), &self.unit);
        let (sight, covariance) =
            self.collator.sight.as_ref().zip(self.collator.normalizer.motion_covariance.as_ref())?;
        let observed = (observed.as_slice(), self.reference.n_past(), self.texture);
        let mut modes = sight.modes_of_motion(covariance, observed, &latent, n_timesteps);
        if self.derives_heading {
            modes.clear_from(2, n_timesteps);
        }
        Some(modes)
    }
}
