//! The `[generate]` section: how many scenarios of what kind, from which scenes.

use super::{Error, RequestConfig, ResolvedGeneration, SweepConfig};
use crate::behavior::Behavior;
use crate::diffusion::SamplerConfig;
use crate::metrics::{DUPLICATE_DISTANCE_M, Group};
use crate::scene::Split;
use crate::settings::{self, Issue};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Strong enough to separate nearly all overlaps, and weak enough to leave everything else in place.
const DEFAULT_VALIDITY_STRENGTH: f64 = 200.0;

/// What to generate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GenerateConfig {
    /// Splits whose scenes are continued. Empty: `val`, or all unsplit scenes if there is no such split, but none that
    /// models of the run learn from.
    #[schemars(extend("uniqueItems" = true))]
    pub splits: Vec<Split>,
    /// Places whose scenes are continued. Empty: all.
    #[schemars(extend("uniqueItems" = true))]
    pub places: Vec<String>,
    /// The sampler of sweeps that set none.
    pub sampler: SamplerConfig,
    /// How strongly samples are kept apart and on the road while they are denoised (the objectives `no_collision`
    /// and `stay_on_road`), for sweeps that do not set it. 0: not at all, as in the paper. It costs no evaluations of
    /// the network.
    #[schemars(range(min = 0.0, max = 1e6))]
    pub validity_strength: f64,
    /// Number of samples that are denoised together. Memory grows with it; it affects only the last digits of results.
    #[schemars(range(min = 1, max = 10_000))]
    pub batch_size: usize,
    /// Scenes of a shard, the unit in which generation is resumed.
    #[schemars(range(min = 1, max = 100_000))]
    pub scenes_per_shard: usize,
    /// Seed of everything random.
    pub seed: u64,
    /// The sweeps, generated in order.
    pub sweeps: Vec<SweepConfig>,
    /// Ways of sampling that requests may try: settings of sweeps, without `behavior`, `n_scenes`, `pairs` and
    /// `aim`, which the request decides.
    pub arms: Vec<SweepConfig>,
    /// Events requested by their parameters, generated after the sweeps.
    pub requests: Vec<RequestConfig>,
}

impl Default for GenerateConfig {
    fn default() -> Self {
        Self {
            splits: Vec::new(),
            places: Vec::new(),
            sampler: SamplerConfig::heun(20),
            validity_strength: DEFAULT_VALIDITY_STRENGTH,
            batch_size: 12,
            scenes_per_shard: 8,
            seed: 0,
            sweeps: Vec::new(),
            arms: Vec::new(),
            requests: Vec::new(),
        }
    }
}

impl GenerateConfig {
    /// Checks and resolves the section for these mined behaviors: fills in what sweeps leave out, and turns requests
    /// into sweeps.
    ///
    /// # Errors
    /// [`Error::Setting`] names the key that cannot work, its value and what is allowed.
    pub fn resolve(&self, behaviors: &[Box<dyn Behavior>]) -> Result<ResolvedGeneration, Error> {
        let within = |section: String| move |issue: Issue| Error::Setting(issue.within(&section));
        let own = || within("generate".to_owned());
        settings::check_ranges(self).map_err(own())?;
        self.sampler.validate().map_err(|issue| issue.within("sampler")).map_err(own())?;
        if self.sweeps.is_empty() && self.requests.is_empty() {
            let why = "is empty: add a [[generate.sweeps]] table with a name and n_scenes, or [[generate.requests]]";
            return Err(own()(Issue::new("sweeps", why)));
        }
        distinct_names(self.sweeps.iter().map(|sweep| &sweep.name), "sweep")
            .map_err(within("generate.sweeps".to_owned()))?;
        distinct_names(self.arms.iter().map(|arm| &arm.name), "arm").map_err(within("generate.arms".to_owned()))?;
        let mut resolved = ResolvedGeneration {
            splits: self.splits.clone(),
            places: self.places.clone(),
            learned: BTreeSet::new(),
            batch_size: self.batch_size,
            scenes_per_shard: self.scenes_per_shard,
            seed: self.seed,
            duplicate_distance_m: DUPLICATE_DISTANCE_M,
            sweeps: Vec::new(),
            n_sweeps: self.sweeps.len(),
            requests: Vec::new(),
        };
        for (i, sweep) in self.sweeps.iter().enumerate() {
            resolved.sweeps.push(sweep.resolve(self, behaviors).map_err(within(format!("generate.sweeps.{i}")))?);
        }
        for (i, arm) in self.arms.iter().enumerate() {
            arm.validate_arm().map_err(within(format!("generate.arms.{i}")))?;
        }
        self.resolve_requests(behaviors, &mut resolved)?;
        Ok(resolved)
    }

    /// Whether requests limit metrics for which `is_such` holds.
    pub fn limits_any(&self, is_such: impl Fn(&str) -> bool) -> bool {
        self.requests.iter().flat_map(|request| request.limits.keys()).any(|id| is_such(id))
    }
}

/// Rejects names that cannot be printed, are used twice, or mean other traffic in tables. `what` is the kind of thing
/// that has these names.
fn distinct_names<'a>(names: impl Iterator<Item = &'a String>, what: &str) -> settings::Result {
    let mut known = BTreeSet::new();
    for (i, name) in names.enumerate() {
        let key = format!("{i}.name");
        settings::printable_name(&key, name)?;
        let other = match name.as_str() {
            // Tables name each group of traffic by one word; for guided or edited samples it is the name of the sweep.
            name if what == "sweep" && Group::RESERVED.contains(&name) => "which tables call other traffic".to_owned(),
            _ if known.insert(name) => continue,
            _ => format!("the name of another {what}"),
        };
        return Err(Issue::new(key, format_args!("is \"{name}\", {other}: choose another")));
    }
    Ok(())
}
