//! How do requests become sweeps? One for each request, arm and strength, after the sweeps that were written down.

use super::buckets::Buckets;
use super::config::{Condition, Divisions, RequestConfig};
use super::facts::check_name;
use crate::behavior;
use crate::generate::{ClassifierScope, Error, GenerateConfig, PairSelectionConfig, SelectConfig, SweepConfig};
use crate::guidance::ObjectiveConfig;
use crate::settings::{self, Issue};
use std::collections::BTreeSet;

/// A configuration in which requests are sweeps.
#[derive(Debug, Clone, PartialEq)]
pub struct ResolvedGeneration {
    /// The configuration: first the sweeps as they were written, then those of requests.
    pub config: GenerateConfig,
    /// How many sweeps were written.
    pub n_sweeps: usize,
    /// The requests.
    pub requests: Vec<ResolvedRequest>,
}

/// A request with its buckets and the sweeps that are tried for it.
#[derive(Debug, Clone, PartialEq)]
pub struct ResolvedRequest {
    /// Its place among the requests.
    pub idx: usize,
    /// As it was written.
    pub config: RequestConfig,
    /// What it asks for.
    pub buckets: Buckets,
    /// What may be tried.
    pub arms: Vec<Arm>,
}

/// One way of sampling that a request may try.
#[derive(Debug, Clone, PartialEq)]
pub struct Arm {
    /// Its name, with the strength (or weight) where the arm has several: `guided@10`.
    pub name: String,
    /// Index of its sweep in the resolved configuration.
    pub sweep_idx: usize,
    /// Samples of a scene at a time.
    pub n_samples: usize,
    /// Calls of the network for a sample.
    pub n_evaluations: u64,
    /// Strength or weight; 0 is unguided.
    pub level: f64,
    /// Whether an objective of it aims at the bucket that is asked for.
    pub aims: bool,
}

impl GenerateConfig {
    /// The configuration with sweeps in place of requests.
    ///
    /// # Errors
    /// When a request or arm makes no sense; the message names it.
    pub fn resolve(&self) -> Result<ResolvedGeneration, Error> {
        let refuse = |key: String, why: String| Error::Config(format!("generate.{key}: {why}"));
        let mut names = BTreeSet::new();
        for (i, arm) in self.arms.iter().enumerate() {
            let within = |issue: Issue| Error::Config(issue.within(&format!("generate.arms.{i}")).to_string());
            settings::printable_name("name", &arm.name).and_then(|()| arm.check_levels()).map_err(within)?;
            check_arm(arm).map_err(|why| refuse(format!("arms.{i} ({})", arm.name), why))?;
            if !names.insert(&arm.name) {
                return Err(refuse(
                    format!("arms.{i}.name"),
                    format!("is \"{}\", the name of another arm: choose another", arm.name),
                ));
            }
        }
        let mut config = Self { arms: Vec::new(), requests: Vec::new(), ..self.clone() };
        let (n_sweeps, mut requests) = (self.sweeps.len(), Vec::new());
        let mut names = BTreeSet::new();
        for (idx, request) in self.requests.iter().enumerate() {
            let within = |issue: Issue| Error::Config(issue.within(&format!("generate.requests.{idx}")).to_string());
            settings::printable_name("name", &request.name).map_err(within)?;
            let key = || format!("requests.{idx} ({})", request.name);
            request.validate().map_err(|why| refuse(key(), why))?;
            if !names.insert(&request.name) {
                return Err(refuse(format!("requests.{idx}.name"), "is taken by another request".to_owned()));
            }
            let mut arms = Vec::new();
            for name in &request.arms {
                let Some(arm) = self.arms.iter().find(|arm| arm.name == *name) else {
                    let known: Vec<&str> = self.arms.iter().map(|arm| arm.name.as_str()).collect();
                    let why = format!("arms names {name:?}, which there is not; [[generate.arms]] has {known:?}");
                    return Err(refuse(key(), why));
                };
                for (sweep, level) in request.sweeps(arm) {
                    sweep.validate(self).map_err(|why| refuse(key(), why))?;
                    let aims = |objective: &ObjectiveConfig| !objective.objective().aims_at().is_empty();
                    arms.push(Arm {
                        name: sweep.name[request.name.len() + 1..].to_owned(),
                        sweep_idx: config.sweeps.len(),
                        n_samples: sweep.n_samples,
                        n_evaluations: sweep.n_evaluations(self),
                        level,
                        aims: sweep.is_guided() && sweep.objectives.iter().any(aims),
                    });
                    config.sweeps.push(sweep);
                }
            }
            requests.push(ResolvedRequest { idx, config: request.clone(), buckets: Buckets::new(request), arms });
        }
        Ok(ResolvedGeneration { config, n_sweeps, requests })
    }
}

/// An arm says how, the request says where and what for.
fn check_arm(arm: &SweepConfig) -> Result<(), String> {
    let decided_by_requests = [
        ("behavior", arm.behavior.is_some()),
        ("n_scenes", arm.n_scenes != 0),
        ("pairs", arm.pairs != PairSelectionConfig::default()),
        ("select", arm.select.is_some()),
        ("stop_after_verified", arm.stop_after_verified.is_some()),
    ];
    if let Some((key, _)) = decided_by_requests.iter().find(|(_, is_set)| *is_set) {
        return Err(format!("{key} is for sweeps; of arms, the request that names them decides it"));
    }
    if arm.uses_baseline() {
        return Err("model = \"baseline\" has a few futures a scene, and cannot be tried again and again".to_owned());
    }
    if arm.classifier_scope == ClassifierScope::AnyPair {
        return Err("classifier_scope = \"any_pair\" asks nobody in particular; a request asks pairs".to_owned());
    }
    if arm.name.contains(['/', '@']) {
        return Err(format!("name is \"{}\", expected one without / and @", arm.name));
    }
    Ok(())
}

impl RequestConfig {
    /// The sweeps of one of its arms: one for each strength or weight, with it.
    fn sweeps<'a>(&'a self, arm: &'a SweepConfig) -> impl Iterator<Item = (SweepConfig, f64)> + 'a {
        let levels = arm.levels();
        let is_one = levels.len() == 1;
        levels.into_iter().map(move |level| {
            let name = if is_one { arm.name.clone() } else { format!("{}@{}", arm.name, level.value) };
            let mut sweep = SweepConfig {
                name: format!("{}/{name}", self.name),
                n_scenes: self.n_scenes,
                behavior: Some(self.behavior.clone()),
                pairs: self.pairs.clone(),
                ..arm.clone()
            };
            sweep.strengths = vec![level.strength];
            if let Some(config) = &mut sweep.classifier_free {
                config.weights = vec![level.weight];
            }
            if level.strength == 0.0 {
                // Objectives act at strengths other than 0 alone.
                sweep.objectives.clear();
            }
            (sweep, level.value)
        })
    }

    /// Says what makes no sense.
    fn validate(&self) -> Result<(), String> {
        let Some(behavior) = behavior::ALL.iter().find(|known| known.id == self.behavior) else {
            let known: Vec<&str> = behavior::ALL.iter().map(|known| known.id).collect();
            return Err(format!("there is no behavior {}; known: {}", self.behavior, known.join(", ")));
        };
        if self.buckets.is_empty() {
            return Err("buckets is empty: name a parameter with edges, such as gap_m = [0, 10]".to_owned());
        }
        for (name, divisions) in &self.buckets {
            let texts = if let Divisions::Texts(texts) = divisions { Some(texts.as_slice()) } else { None };
            check_name(behavior, name, texts).map_err(|why| format!("buckets: {why}"))?;
            divisions.validate().map_err(|why| format!("buckets.{name} {why}"))?;
        }
        for (name, condition) in &self.conditions {
            let texts = if let Condition::Texts(texts) = condition { Some(texts.as_slice()) } else { None };
            check_name(behavior, name, texts).map_err(|why| format!("where: {why}"))?;
            match condition {
                Condition::Range([least, most]) if !(least <= most && least.is_finite() && most.is_finite()) => {
                    return Err(format!("where.{name} is no range of finite numbers"));
                }
                Condition::Texts(texts) if texts.is_empty() => return Err(format!("where.{name} is empty")),
                _ => {}
            }
        }
        self.validate_counts()?;
        if !self.limits.is_empty() {
            self.limits().validate(&[], behavior.roles.len() > 1)?;
        }
        if self.arms.is_empty() {
            return Err("arms is empty: name at least one of [[generate.arms]]".to_owned());
        }
        settings::distinct("arms", &self.arms).map_err(|issue| issue.to_string())?;
        match self.budget.n_samples.or(self.budget.n_evaluations) {
            None => Err("budget is empty: say n_samples or n_evaluations".to_owned()),
            Some(_) => Ok(()),
        }
    }

    fn validate_counts(&self) -> Result<(), String> {
        match (self.per_bucket, self.n_total) {
            (Some(_), Some(_)) | (None, None) => return Err("say either per_bucket or n_total".to_owned()),
            (Some(_), None) if !self.weights.is_empty() => {
                return Err("weights distribute n_total; with per_bucket all buckets want the same".to_owned());
            }
            _ => {}
        }
        for (name, weights) in &self.weights {
            let Some(divisions) = self.buckets.get(name) else {
                return Err(format!("weights.{name} is not among the buckets"));
            };
            let (n, n_parts) = (weights.len(), divisions.len());
            if n != n_parts {
                return Err(format!("weights.{name} has {n} entries for {n_parts} parts"));
            }
            if weights.iter().any(|weight| !weight.is_finite() || *weight < 0.0) || weights.iter().sum::<f64>() <= 0.0 {
                return Err(format!("weights.{name} are not all 0 or more, or all 0"));
            }
        }
        Ok(())
    }

    /// The limits as a selection.
    pub(super) fn limits(&self) -> SelectConfig {
        SelectConfig { limits: self.limits.clone(), ..SelectConfig::default() }
    }
}
