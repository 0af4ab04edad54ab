//! Can particles and optimized noise work with the rest of a sweep?

use super::Diffusion;
use crate::diffusion::SamplerConfig;
use crate::guidance::{MOST_STEPS, ParticleConfig};
use crate::settings::{Issue, Result};

impl Diffusion {
    /// Refuses particles and optimized noise that cannot work in a sweep of so many samples of each scene, in batches of
    /// `batch_size`.
    pub(super) fn check_steering(&self, n_samples: usize, batch_size: usize) -> Result {
        for (key, is_set) in
            [("particles", self.particles.is_some()), ("noise_optimization", self.noise_optimization.is_some())]
        {
            if is_set && self.guidance.objectives.is_empty() {
                return Err(Issue::new(key, "needs objectives, such as objectives = [{ kind = \"cut_in\" }]"));
            }
            if is_set && !self.template.is_empty() {
                return Err(Issue::new(
                    key,
                    "cannot be combined with template = true, which brings the event; remove one",
                ));
            }
        }
        if let Some(particles) = &self.particles {
            self.check_particles(particles, n_samples, batch_size)?;
        }
        if self.noise_optimization.is_some() { self.check_optimization() } else { Ok(()) }
    }

    fn check_particles(
        &self,
        ParticleConfig { n, .. }: &ParticleConfig,
        n_samples: usize,
        batch_size: usize,
    ) -> Result {
        if !self.sampler.adds_noise() {
            return Err(Issue::new(
                "particles",
                format_args!(
                    "needs a sampler that adds noise, or copies of a particle stay identical; {} adds none: set sampler = {{ kind \
                     = \"dpmpp_2m\", eta = 1.0 }}, or s_churn of \"heun\"",
                    self.sampler.name()
                ),
            ));
        }
        if !n_samples.is_multiple_of(*n) {
            let why = format_args!("is {n_samples}, expected a multiple of particles.n, {n}");
            return Err(Issue::new("n_samples", why));
        }
        match *n <= batch_size {
            true => Ok(()),
            false => Err(Issue::new(
                "particles.n",
                format_args!(
                    "is {n}, expected at most generate.batch_size, {batch_size}: a group is denoised together"
                ),
            )),
        }
    }

    fn check_optimization(&self) -> Result {
        let refuse = |why: std::fmt::Arguments<'_>| Err(Issue::new("noise_optimization", why));
        match &self.sampler {
            SamplerConfig::Euler(euler) if euler.n_steps > MOST_STEPS => refuse(format_args!(
                "differentiates through {} steps at once, expected at most {MOST_STEPS}: set sampler.n_steps, or use model = \
                 \"distilled\"",
                euler.n_steps
            )),
            SamplerConfig::Euler(_) if self.edit.is_some() => {
                refuse(format_args!("has no noise to start from where recordings are edited; remove edit"))
            }
            SamplerConfig::Euler(_) if self.classifier_free.is_some() => {
                refuse(format_args!("does not see the states of classifier_free; remove one of the two"))
            }
            SamplerConfig::Euler(_) => Ok(()),
            other => refuse(format_args!(
                "needs a sampler that can be differentiated, such as sampler = {{ kind = \"euler\", n_steps = 2, grid = … }} of a \
                 distilled model; {} cannot",
                other.name()
            )),
        }
    }
}
