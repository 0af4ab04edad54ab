//! Which states of a scene does the denoiser observe? A training task by name, or a mask written as rules.

use crate::scene::{AgentRef, ObservationMask, Roles, Scene, UnfitScene};
use crate::seed::Seed;
use crate::settings::{self, Issue};
use crate::tensor::MaskTask;
use schemars::JsonSchema;
use serde::de::value::{SeqAccessDeserializer, StrDeserializer};
use serde::de::{Deserialize, Deserializer, Error as _, IntoDeserializer, SeqAccess, Visitor};
use serde::{Deserialize as DeserializeDerive, Serialize};

/// Which states are observed; everything else is generated.
///
/// TaskOrRules the name of a training task, drawn for each scene and pair: `observe = "windowed"`; or rules, of which
/// later ones take precedence: `observe = [{ agents = "all", times = "history" }, { agents = "ego", times = "goal" }]`.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum ObserveConfig {
    /// One of the seven tasks that the denoiser is trained on.
    Task(MaskTask),
    /// A mask. States without a rule are not observed; agents that are never observed are hidden from the denoiser.
    Mask(Vec<MaskRule>),
}

/// A rule that observes states, or hides them again.
#[derive(Debug, Clone, PartialEq, Serialize, DeserializeDerive, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MaskRule {
    /// The agents.
    pub agents: AgentChoice,
    /// The times.
    pub times: TimeChoice,
    /// Whether to hide the states instead, even if an earlier rule observes them.
    #[serde(default)]
    pub hide: bool,
}

/// Agents: `"all"`, `"ego"`, `{ role = "other" }`, `{ track = "12" }` or `{ n_random = 3 }`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, DeserializeDerive, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AgentChoice {
    /// Every agent.
    All,
    /// The agent at the center: the one with the first role of the requested behavior, else the scene's ego agent.
    Ego,
    /// The agent with this role in the requested behavior.
    Role(String),
    /// The agent with this track id in the recording.
    Track(String),
    /// This many agents, drawn from those tracked at all of the rule's times; all of them if there are fewer.
    NRandom(usize),
}

/// Times: `"all"`, `"history"`, `"future"`, `"goal"`, or a range in seconds.
#[derive(Debug, Clone, PartialEq, Serialize, DeserializeDerive, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TimeChoice {
    /// The whole scene.
    All,
    /// Up to and with the present.
    History,
    /// After the present.
    Future,
    /// The last timestep, for agents that are tracked then.
    Goal,
    /// A stretch of time around the present.
    Seconds(SecondRange),
}

/// The timesteps between two times, inclusive.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, DeserializeDerive, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SecondRange {
    /// The first time, seconds after the present (negative: before it).
    #[schemars(range(min = -1e6, max = 1e6))]
    pub from_s: f64,
    /// The last time, seconds after the present.
    #[schemars(range(min = -1e6, max = 1e6))]
    pub to_s: f64,
}

/// A scene with requested agents.
#[derive(Debug, Clone, Copy)]
pub(super) struct Subject<'a> {
    pub(super) scene: &'a Scene,
    /// The agent at the center.
    pub(super) ego_idx: usize,
    /// The roles of the requested behavior.
    pub(super) roles: &'a Roles,
}

impl Default for ObserveConfig {
    fn default() -> Self {
        Self::Task(MaskTask::Predictive)
    }
}

impl<'de> Deserialize<'de> for ObserveConfig {
    /// Written by hand, so that a mistake within a rule is reported as such.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct TaskOrRules;
        impl<'de> Visitor<'de> for TaskOrRules {
            type Value = ObserveConfig;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("the name of a task or a list of rules")
            }

            fn visit_str<E: serde::de::Error>(self, name: &str) -> Result<Self::Value, E> {
                let name: StrDeserializer<'_, E> = name.into_deserializer();
                MaskTask::deserialize(name).map(ObserveConfig::Task)
            }

            fn visit_seq<A: SeqAccess<'de>>(self, rules: A) -> Result<Self::Value, A::Error> {
                Vec::deserialize(SeqAccessDeserializer::new(rules)).map(ObserveConfig::Mask).map_err(A::Error::custom)
            }
        }
        deserializer.deserialize_any(TaskOrRules)
    }
}

impl ObserveConfig {
    /// The name for provenance: that of the task, or `mask`.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Task(task) => task.name(),
            Self::Mask(_) => "mask",
        }
    }

    /// Refuses a rule that cannot work in a sweep whose behavior has these roles.
    pub(super) fn validate(&self, roles: &[&str]) -> settings::Result {
        match self {
            Self::Task(_) => Ok(()),
            Self::Mask(rules) => validate_rules("observe", rules, roles),
        }
    }

    /// The mask of a scene. Its randomness comes from `seed` alone.
    pub(super) fn mask(&self, subject: &Subject<'_>, seed: Seed) -> Result<ObservationMask, UnfitScene> {
        let scene = subject.scene;
        let mask = match self {
            Self::Task(MaskTask::Predictive) => {
                ObservationMask::predictive(scene.tracks.len(), scene.n_timesteps, scene.n_history)
            }
            Self::Task(task) if !scene.has_future() => {
                let why = format!("has no recorded future, which the task {} needs", task.name());
                return Err(UnfitScene(why));
            }
            Self::Task(task) => task.sample(scene, subject.ego_idx, &mut seed.derive("task", &[]).rng()),
            Self::Mask(rules) => rule_mask(rules, subject, seed),
        };
        let is_given = |agent_idx: usize, timestep: usize| {
            mask.is_observed(agent_idx, timestep) && scene.state(agent_idx, timestep).is_some()
        };
        match (0..scene.tracks.len()).any(|agent| (0..scene.n_timesteps).any(|timestep| is_given(agent, timestep))) {
            true => Ok(mask),
            false => Err(UnfitScene("has no observed state; change the rules of `observe`".to_owned())),
        }
    }
}

/// Refuses rules under the key `key` that observe nothing, and rules that cannot work in a sweep whose behavior has
/// these roles.
pub(super) fn validate_rules(key: &str, rules: &[MaskRule], roles: &[&str]) -> settings::Result {
    if rules.iter().all(|rule| rule.hide) {
        return Err(Issue::new(key, "has no rule that observes states; add one without hide"));
    }
    for (i, rule) in rules.iter().enumerate() {
        let refuse = |part: &str, why: String| Err(Issue::new(format!("{key}.{i}.{part}"), why));
        match (&rule.agents, &rule.times) {
            (AgentChoice::Role(role), _) if !roles.contains(&role.as_str()) => {
                let known = if roles.is_empty() { "no behavior is requested".into() } else { roles.join(", ") };
                return refuse("agents.role", format!("is \"{role}\", expected a role of the behavior ({known})"));
            }
            (AgentChoice::NRandom(n), _) if !(1..=10_000).contains(n) => {
                return refuse("agents.n_random", format!("is {n}, expected 1 to 10000"));
            }
            (_, TimeChoice::Seconds(SecondRange { from_s, to_s })) => {
                settings::ascending(("from_s", *from_s), ("to_s", *to_s))
                    .map_err(|issue| issue.within(&format!("{key}.{i}.times.seconds")))?;
            }
            _ => {}
        }
    }
    Ok(())
}

/// The mask that rules give for a scene.
pub(super) fn rule_mask(rules: &[MaskRule], subject: &Subject<'_>, seed: Seed) -> ObservationMask {
    let scene = subject.scene;
    let (n_agents, n_timesteps) = (scene.tracks.len(), scene.n_timesteps);
    let mut observed = vec![false; n_agents * n_timesteps];
    for (i, rule) in rules.iter().enumerate() {
        let timesteps: Vec<usize> = (0..n_timesteps).filter(|timestep| rule.times.holds(scene, *timestep)).collect();
        for agent_idx in rule.agents.of(subject, &timesteps, seed.derive("rule", &[i as u64])) {
            for timestep in &timesteps {
                let is_meant = rule.times != TimeChoice::Goal || scene.state(agent_idx, *timestep).is_some();
                if is_meant {
                    observed[agent_idx * n_timesteps + timestep] = !rule.hide;
                }
            }
        }
    }
    ObservationMask::from_fn(n_agents, n_timesteps, |agent_idx, timestep| observed[agent_idx * n_timesteps + timestep])
}

impl AgentChoice {
    /// The chosen agents of a scene, given the chosen timesteps.
    fn of(&self, subject: &Subject<'_>, timesteps: &[usize], seed: Seed) -> Vec<usize> {
        let Subject { scene, ego_idx, roles } = *subject;
        let one = |agent: &AgentRef| agent.resolve(scene, ego_idx, roles).into_iter().collect();
        match self {
            Self::All => (0..scene.tracks.len()).collect(),
            Self::Ego => one(&AgentRef::Ego),
            Self::Role(role) => one(&AgentRef::Role(role.clone())),
            Self::Track(track) => one(&AgentRef::Track(track.clone())),
            Self::NRandom(n) => {
                let is_tracked = |agent_idx: &usize| timesteps.iter().all(|t| scene.state(*agent_idx, *t).is_some());
                let eligible: Vec<usize> = (0..scene.tracks.len()).filter(is_tracked).collect();
                seed.rng().choose(&eligible, *n)
            }
        }
    }
}

impl TimeChoice {
    /// Whether a timestep of a scene is chosen.
    fn holds(&self, scene: &Scene, timestep: usize) -> bool {
        match self {
            Self::All => true,
            Self::History => timestep < scene.n_history,
            Self::Future => timestep >= scene.n_history,
            Self::Goal => scene.has_future() && timestep + 1 == scene.n_timesteps,
            Self::Seconds(range) => {
                // Times are written with few digits, so a range includes a timestep that lies a rounding error beyond
                // its end.
                let elapsed_s = (timestep as f64 - scene.current_timestep() as f64) * scene.dt_s;
                let tolerance_s = 1e-3 * scene.dt_s;
                (range.from_s - tolerance_s..=range.to_s + tolerance_s).contains(&elapsed_s)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{Drive, scene, without_states};

    #[derive(DeserializeDerive, Serialize)]
    struct Observing {
        observe: ObserveConfig,
    }

    fn parse(toml: &str) -> ObserveConfig {
        toml::from_str::<Observing>(&format!("observe = {toml}")).unwrap().observe
    }

    /// Four observed of twelve timesteps at 10 Hz; the third agent leaves after timestep 8.
    fn three() -> Scene {
        let drives = [0.0, 4.0, 8.0].map(|y| Drive::straight(0.0, y, 0.0, 5.0));
        without_states(scene(&drives), 2, |t| t > 8)
    }

    fn observed(toml: &str, seed: u64) -> Vec<Vec<usize>> {
        let scene = three();
        let roles = Roles::from([("other", "2")]);
        let mask = parse(toml).mask(&Subject { scene: &scene, ego_idx: 1, roles: &roles }, Seed(seed)).unwrap();
        (0..3).map(|agent| (0..12).filter(|t| mask.is_observed(agent, *t)).collect()).collect()
    }

    #[test]
    fn rules_observe_what_they_say_and_later_ones_win() {
        let history: Vec<usize> = (0..4).collect();
        let found = observed("[{ agents = 'all', times = 'history' }, { agents = 'all', times = 'goal' }]", 0);
        let with_goal: Vec<usize> = vec![0, 1, 2, 3, 11];
        assert_eq!(found, [with_goal.clone(), with_goal, history.clone()], "who is gone has no goal");
        // The present is timestep 3; 0.2 to 0.5 s after it are timesteps 5 to 8.
        let window = "[{ agents = 'all', times = 'all' },
            { agents = { role = 'other' }, times = { seconds = { from_s = 0.2, to_s = 0.5 } }, hide = true }]";
        let all: Vec<usize> = (0..12).collect();
        assert_eq!(observed(window, 0), [all.clone(), vec![0, 1, 2, 3, 4, 9, 10, 11], all.clone()]);
        let one = "[{ agents = { track = '1' }, times = { seconds = { from_s = -0.2, to_s = 0.1 } } },
            { agents = 'ego', times = 'future' }]";
        assert_eq!(observed(one, 0), [(1..5).collect(), (4..12).collect(), vec![]]);
    }

    #[test]
    fn random_agents_are_tracked_at_the_rules_times_and_follow_the_seed() {
        let rule = "[{ agents = 'all', times = 'history' }, { agents = { n_random = 1 }, times = 'all' }]";
        let chosen = |seed: u64| observed(rule, seed).iter().position(|timesteps| timesteps.len() == 12);
        assert!((0..30).all(|seed| chosen(seed) == chosen(seed) && chosen(seed) != Some(2)));
        assert!((0..30).any(|seed| chosen(seed) == Some(0)) && (0..30).any(|seed| chosen(seed) == Some(1)));
        let both = observed("[{ agents = { n_random = 9 }, times = 'all' }]", 0);
        assert_eq!(both.iter().map(Vec::len).collect::<Vec<_>>(), [12, 12, 0]);
    }

    #[test]
    fn tasks_are_drawn_from_the_seed_alone() {
        for task in ["predictive", "goal_conditioned", "agent_conditioned", "ego_conditioned", "windowed", "upsampling"]
        {
            let config = format!("'{task}'");
            assert_eq!(parse(&config).name(), task);
            assert_eq!(observed(&config, 5), observed(&config, 5));
        }
        assert!((1..9).any(|seed| observed("'imputation'", seed) != observed("'imputation'", 0)));
        assert_eq!(observed("'ego_conditioned'", 0)[1].len(), 12);
    }

    #[test]
    fn mistakes_are_named() {
        let refusal = |toml: &str| match toml::from_str::<Observing>(&format!("observe = {toml}")) {
            Ok(sweep) => sweep.observe.validate(&["ego", "other"]).unwrap_err().to_string(),
            Err(error) => error.to_string(),
        };
        assert!(refusal("'windowd'").contains("windowed"), "{}", refusal("'windowd'"));
        assert!(refusal("3").contains("task or a list of rules"));
        assert!(refusal("[{ agents = 'all', times = 'past' }]").contains("past"));
        assert!(refusal("[{ agents = 'all' }]").contains("times"));
        assert!(refusal("[{ agents = { role = 'third' }, times = 'all' }]").contains("third"));
        assert!(refusal("[{ agents = 'all', times = 'all', hide = true }]").contains("no rule"));
        let backward = refusal("[{ agents = 'all', times = { seconds = { from_s = 2.0, to_s = 1.0 } } }]");
        assert_eq!(backward, "observe.0.times.seconds.from_s is 2, expected at most to_s, which is 1");
    }

    #[test]
    fn what_is_written_reads_as_itself() {
        for toml in
            ["'imputation'", "[{ agents = { n_random = 2 }, times = { seconds = { from_s = 0.0, to_s = 1.5 } } }]"]
        {
            let config = parse(toml);
            let text = toml::to_string(&Observing { observe: config.clone() }).unwrap();
            assert_eq!(toml::from_str::<Observing>(&text).unwrap().observe, config);
        }
    }

    #[test]
    fn a_scene_that_shows_nothing_is_refused() {
        let scene = three();
        let subject = Subject { scene: &scene, ego_idx: 0, roles: Roles::none() };
        let nobody = parse("[{ agents = { track = '77' }, times = 'all' }]");
        assert!(nobody.mask(&subject, Seed(0)).unwrap_err().0.contains("no observed state"));
        let history_only = Scene { n_timesteps: 4, ..scene.clone() };
        let subject = Subject { scene: &history_only, ..subject };
        assert!(parse("'windowed'").mask(&subject, Seed(0)).unwrap_err().0.contains("no recorded future"));
        assert!(parse("'predictive'").mask(&subject, Seed(0)).is_ok());
    }
}
