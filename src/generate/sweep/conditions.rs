//! What are samples conditioned on beside observed states, as it is written?

use crate::diffusion::{Edm, SamplerConfig};
use crate::generate::MaskRule;
use crate::generate::observe::validate_rules;
use crate::scene::{AgentRef, SceneEdit};
use crate::settings::{self, Issue};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// States that samples lean toward without being bound to them (paper, section 5.1).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ClassifierFreeConfig {
    /// The wanted states, beyond those that are observed, as rules of a mask; such as the goal of every agent:
    /// `[{ agents = "all", times = "goal" }]`. They are recorded (or edited) states; those that are not generated are
    /// ignored.
    pub extra: Vec<MaskRule>,
    /// Weights λ, each of which is sampled: 0 ignores the wanted states, 1 observes them, more
    /// exaggerates. The larger λ is, the faster samples approach the wanted states, and the more steps the sampler
    /// needs to follow: 20 steps suffice up to about 1.5, 50 up to 4. A sweep varies either its strengths or its
    /// weights. Weights other than 0 and 1 take two evaluations of the network a step.
    #[serde(default = "one_weight")]
    #[schemars(inner(range(min = -1e6, max = 1e6)))]
    pub weights: Vec<f64>,
    /// Standard deviation of the noise on wanted positions, meters in each direction; drawn once for each agent and
    /// sample.
    #[serde(default = "one_meter")]
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub goal_std_m: f64,
    /// Whether the velocity of wanted states is hidden from the denoiser.
    #[serde(default = "yes")]
    pub mask_velocity: bool,
}

fn one_weight() -> Vec<f64> {
    vec![1.0]
}

const fn one_meter() -> f64 {
    1.0
}

const fn yes() -> bool {
    true
}

/// Recordings that are edited roughly and made realistic by the denoiser (paper, section 5.3): the edited future with
/// noise of level `tau`, denoised from there.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EditConfig {
    /// The noise level at which denoising begins, a standard deviation (the paper prints a variance): 0 leaves the
    /// edited recording as it is, the denoiser's largest noise level discards it except for edited states that are
    /// observed.
    #[serde(default = "default_tau")]
    #[schemars(range(min = 0.0, max = 1e6))]
    pub tau: f64,
    /// The changes, in order. None: the recording itself is denoised again.
    #[serde(default)]
    pub edits: Vec<SceneEdit>,
}

const fn default_tau() -> f64 {
    0.8
}

impl ClassifierFreeConfig {
    /// Rejects target states of agents that a behavior with these roles does not have.
    pub(in crate::generate) fn validate(&self, roles: &[&str]) -> settings::Result {
        validate_rules("extra", &self.extra, roles)
    }
}

impl EditConfig {
    /// Rejects edits that are impossible, or whose agents a behavior with these roles does not have.
    pub(in crate::generate) fn validate(&self, roles: &[&str]) -> settings::Result {
        for (i, edit) in self.edits.iter().enumerate() {
            let key = format!("edits.{i}");
            edit.validate().map_err(|issue| issue.within(&key))?;
            let is_unknown =
                |agent: &&AgentRef| matches!(agent, AgentRef::Role(role) if !roles.contains(&role.as_str()));
            if let Some(agent) = edit.agents().into_iter().find(is_unknown) {
                return Err(Issue::new(
                    key,
                    format_args!("names the agent {agent}, which is not a role of the behavior"),
                ));
            }
        }
        Ok(())
    }

    /// Noise levels of the sampler's steps from τ.
    pub(in crate::generate) fn schedule(&self, edm: &Edm, sampler: &SamplerConfig) -> Vec<f64> {
        match self.tau {
            0.0 => vec![0.0],
            tau => sampler.schedule(edm, tau),
        }
    }

    /// Whether denoising begins below the denoiser's largest noise level, where the edited recording still shows.
    pub(in crate::generate) fn keeps_guide(&self, edm: &Edm) -> bool {
        self.tau < edm.sigma_max
    }
}
