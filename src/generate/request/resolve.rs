//! Resolves requests into sweeps: one for each request, arm and strength, after the configured sweeps.

use super::buckets::Buckets;
use super::config::{Divisions, RequestConfig, Requirement};
use super::facts::check_name;
use super::limits;
use crate::behavior::{self, Behavior};
use crate::generate::sweep::mined;
use crate::generate::{Error, GenerateConfig, ResolvedSweep};
use crate::metrics::DUPLICATE_DISTANCE_M;
use crate::scene::{GuidanceLevel, Split};
use crate::settings::{self, Issue};
use std::collections::BTreeSet;

/// The section `[generate]`, checked and resolved, with sweeps in place of requests.
#[derive(Debug, Clone, PartialEq)]
pub struct ResolvedGeneration {
    /// Splits whose scenes are continued. Empty: `val`, or all unsplit scenes if there is no such split, none of them
    /// `learned`.
    pub splits: Vec<Split>,
    /// Places whose scenes are continued; empty: all.
    pub places: Vec<String>,
    /// Scenes, by index, that models of the run learned from: none is sampled unless `splits` wants it.
    pub learned: BTreeSet<usize>,
    /// Samples that are denoised together.
    pub batch_size: usize,
    /// Scenes of a shard.
    pub scenes_per_shard: usize,
    /// Seed of everything random.
    pub seed: u64,
    /// Templates in which the requested agents move closer to another of the shard than this are not sampled, meters.
    pub duplicate_distance_m: f64,
    /// The configured sweeps first, then those of requests.
    pub sweeps: Vec<ResolvedSweep>,
    /// The number of configured sweeps.
    pub n_sweeps: usize,
    /// The requests.
    pub requests: Vec<ResolvedRequest>,
}

/// A request with its buckets and the sweeps that are tried for it.
#[derive(Debug, Clone, PartialEq)]
pub struct ResolvedRequest {
    /// Its place among the requests.
    pub idx: usize,
    /// The configuration as it was written.
    pub config: RequestConfig,
    /// The buckets to fill.
    pub buckets: Buckets,
    /// The ways of sampling that may be tried.
    pub arms: Vec<Arm>,
    /// A scenario in which the requested agents move closer to an accepted one than this is a near-duplicate of it,
    /// meters.
    pub duplicate_distance_m: f64,
}

/// One way of sampling that a request may try.
#[derive(Debug, Clone, PartialEq)]
pub struct Arm {
    /// Its name, with the strength (or weight) if the arm has several: `guided@10`.
    pub name: String,
    /// Index of its sweep in the resolved configuration.
    pub sweep_idx: usize,
    /// Samples of a scene at a time.
    pub n_samples: usize,
    /// Evaluations of the network for a sample.
    pub n_evaluations: u64,
    /// The level of guidance of its samples.
    pub level: GuidanceLevel,
    /// Whether its template or one of its objectives aims at the open bucket.
    pub aims: bool,
}

impl GenerateConfig {
    /// Adds the requests, and a sweep for each of their arms and levels.
    pub(in crate::generate) fn resolve_requests(
        &self,
        behaviors: &[Box<dyn Behavior>],
        resolved: &mut ResolvedGeneration,
    ) -> Result<(), Error> {
        let mut names = BTreeSet::new();
        for (idx, request) in self.requests.iter().enumerate() {
            let section = format!("generate.requests.{idx}");
            let within = |issue: Issue| Error::Setting(issue.within(&section));
            let refuse = |issue: Issue| Error::Config(format!("{section} ({}): {issue}", request.name));
            settings::printable_name("name", &request.name).map_err(within)?;
            request.validate().map_err(refuse)?;
            let behavior = mined(&request.behavior, behaviors).map_err(within)?;
            if !names.insert(&request.name) {
                let why = format_args!("is \"{}\", which another request already uses", request.name);
                return Err(within(Issue::new("name", why)));
            }
            let mut arms = Vec::new();
            for name in &request.arms {
                let Some(at) = self.arms.iter().position(|arm| arm.name == *name) else {
                    let known: Vec<&str> = self.arms.iter().map(|arm| arm.name.as_str()).collect();
                    let why = format!("names the unknown arm \"{name}\"; [[generate.arms]] has {}", known.join(", "));
                    return Err(refuse(Issue::new("arms", why)));
                };
                let of_arm = |issue: Issue| Error::Setting(issue.within(&format!("generate.arms.{at}")));
                for (sweep, level) in self.arms[at].resolve_arm(request, self, behavior).map_err(of_arm)? {
                    if let Some(other) = resolved.sweeps.iter().position(|other| other.name == sweep.name) {
                        let key = if other < self.sweeps.len() { "generate.sweeps" } else { "generate.requests" };
                        let why = format_args!(
                            "is \"{}\": samples of its arm {name} are called {}, as are those of one of {key}; choose \
                             another",
                            request.name, sweep.name
                        );
                        return Err(within(Issue::new("name", why)));
                    }
                    arms.push(Arm {
                        name: sweep.name[request.name.len() + 1..].to_owned(),
                        sweep_idx: resolved.sweeps.len(),
                        n_samples: sweep.n_samples,
                        n_evaluations: sweep.n_evaluations(),
                        level,
                        aims: !sweep.aims_at().is_empty(),
                    });
                    resolved.sweeps.push(sweep);
                }
            }
            let buckets = Buckets::new(request);
            resolved.requests.push(ResolvedRequest {
                idx,
                config: request.clone(),
                buckets,
                arms,
                duplicate_distance_m: DUPLICATE_DISTANCE_M,
            });
        }
        Ok(())
    }
}

impl RequestConfig {
    /// Rejects settings that cannot work.
    fn validate(&self) -> settings::Result {
        let refuse = |key: &str, why: &str| Err(Issue::new(key, why));
        let Some(behavior) = behavior::ALL.iter().find(|known| known.id == self.behavior) else {
            let known: Vec<&str> = behavior::ALL.iter().map(|known| known.id).collect();
            return refuse("behavior", &format!("is unknown ({}); known: {}", self.behavior, known.join(", ")));
        };
        if self.buckets.is_empty() {
            return refuse("buckets", "is empty; add a parameter with edges, such as gap_m = [0, 10]");
        }
        for (name, divisions) in &self.buckets {
            let texts = if let Divisions::Texts(texts) = divisions { Some(texts.as_slice()) } else { None };
            let checked = check_name(behavior, name, texts).and_then(|()| divisions.validate(name));
            checked.map_err(|issue| issue.within("buckets"))?;
        }
        for (name, condition) in &self.conditions {
            let texts = if let Requirement::Texts(texts) = condition { Some(texts.as_slice()) } else { None };
            let checked = check_name(behavior, name, texts).and_then(|()| condition.validate(name));
            checked.map_err(|issue| issue.within("where"))?;
        }
        self.validate_counts()?;
        limits::validate(&self.limits, behavior.roles.len() > 1)?;
        if self.arms.is_empty() {
            return refuse("arms", "is empty; list at least one of [[generate.arms]]");
        }
        settings::distinct("arms", &self.arms)?;
        match self.budget.n_samples.or(self.budget.n_evaluations) {
            None => refuse("budget", "is empty; set n_samples or n_evaluations"),
            Some(_) => Ok(()),
        }
    }

    fn validate_counts(&self) -> settings::Result {
        let refuse = |key: &str, why: &str| Err(Issue::new(key, why));
        match (self.per_bucket, self.n_total) {
            (Some(_), Some(_)) => {
                return refuse("n_total", "is set beside per_bucket; set either per_bucket or n_total");
            }
            (None, None) => return refuse("per_bucket", "is missing; set either per_bucket or n_total"),
            (Some(_), None) if !self.weights.is_empty() => {
                return refuse("weights", "need n_total; with per_bucket all buckets are equal");
            }
            _ => {}
        }
        for (name, weights) in &self.weights {
            let refuse = |why: &str| refuse(&format!("weights.{name}"), why);
            let Some(divisions) = self.buckets.get(name) else {
                return refuse("is not among the buckets");
            };
            let (n, n_parts) = (weights.len(), divisions.len());
            if n != n_parts {
                return refuse(&format!("has {n} entries for {n_parts} parts"));
            }
            if weights.iter().any(|weight| !weight.is_finite() || *weight < 0.0) || weights.iter().sum::<f64>() <= 0.0 {
                return refuse("are not all 0 or more, or all 0");
            }
        }
        Ok(())
    }
}

impl Requirement {
    /// Rejects a condition on the parameter `key` that nothing can meet.
    fn validate(&self, key: &str) -> settings::Result {
        match self {
            Self::Range([least, most]) if !(least <= most && least.is_finite() && most.is_finite()) => {
                Err(Issue::new(key, "is not a range of finite numbers"))
            }
            Self::Texts(texts) if texts.is_empty() => Err(Issue::new(key, "is empty")),
            _ => Ok(()),
        }
    }
}
