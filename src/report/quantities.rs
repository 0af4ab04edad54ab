//! What is compared between recorded and generated scenes: how road users move, and how close they come.

use super::distribution::Distribution;
use crate::behavior::BehaviorEvent;
use crate::metrics::{MOTION, MotionQuantity};
use crate::scene::Scene;
use std::collections::BTreeSet;

/// Bins of each histogram.
const N_BINS: usize = 40;
/// Collects how road users move in the futures of scenes, group by group.
///
/// The values themselves are kept, for their median and for bins that fit them; [`MotionHistograms`](crate::metrics::MotionHistograms)
/// serve for whole sweeps. Scenes may be dropped once added.
#[derive(Debug, Clone, Default)]
pub struct MotionDistributions {
    groups: Vec<(String, [Vec<f64>; MOTION.len()])>,
}

impl MotionDistributions {
    /// Adds a scene to a group. The first group that is added to is the reference.
    pub fn add(&mut self, group: &str, scene: &Scene) {
        let at = self.groups.iter().position(|(name, _)| name == group).unwrap_or_else(|| {
            self.groups.push((group.to_owned(), Default::default()));
            self.groups.len() - 1
        });
        for (collected, quantity) in self.groups[at].1.iter_mut().zip(&MOTION) {
            collected.extend(quantity.values(scene));
        }
    }

    /// One distribution for each quantity.
    pub fn finish(&self) -> Vec<Distribution> {
        let one = |(i, MotionQuantity { title, unit, description, .. }): (usize, &MotionQuantity)| {
            let groups: Vec<(&str, &[f64])> =
                self.groups.iter().map(|(name, values)| (name.as_str(), values[i].as_slice())).collect();
            Distribution::of(title, unit, description, N_BINS, &groups)
        };
        MOTION.iter().enumerate().map(one).collect()
    }
}

/// Distributions of the parameters of events, one for each parameter that any event has; the first group is the reference.
pub fn event_distributions(groups: &[(&str, &[&BehaviorEvent])]) -> Vec<Distribution> {
    let names: BTreeSet<&String> =
        groups.iter().flat_map(|(_, events)| events.iter()).flat_map(|e| e.parameters.keys()).collect();
    names
        .into_iter()
        .map(|name| {
            let values: Vec<Vec<f64>> = groups
                .iter()
                .map(|(_, events)| events.iter().filter_map(|event| event.parameters.get(name).copied()).collect())
                .collect();
            let groups: Vec<(&str, &[f64])> =
                groups.iter().zip(&values).map(|((group, _), values)| (*group, values.as_slice())).collect();
            let (title, unit) = title_and_unit(name);
            Distribution::of(&title, unit, "of the events", N_BINS / 2, &groups)
        })
        .collect()
}

/// `relative_speed_mps` is the relative speed in m/s.
pub(super) fn title_and_unit(parameter: &str) -> (String, &'static str) {
    for (suffix, unit) in
        [("_mps2", "m/s²"), ("_mps", "m/s"), ("_m", "m"), ("_s", "s"), ("_radps", "rad/s"), ("_rad", "rad")]
    {
        if let Some(name) = parameter.strip_suffix(suffix) {
            return (name.replace('_', " "), unit);
        }
    }
    (parameter.replace('_', " "), "")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::SceneId;
    use crate::scene::testing::{self, Drive};
    use std::collections::BTreeMap;

    fn scene() -> Scene {
        testing::scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(0.0, 6.0, 0.0, 10.0)])
    }

    #[test]
    fn groups_keep_the_order_in_which_they_came() {
        let mut collected = MotionDistributions::default();
        for group in ["recorded", "generated", "recorded"] {
            collected.add(group, &scene());
        }
        let distributions = collected.finish();
        let series: Vec<(&str, u64)> = distributions[0].series.iter().map(|s| (s.name.as_str(), s.n)).collect();
        let n = 2 * (scene().n_timesteps - scene().n_history) as u64;
        assert_eq!(series, [("recorded", 2 * n), ("generated", n)]);
        assert!(distributions[0].series[1].distance.unwrap() < 1e-9);
    }

    #[test]
    fn event_parameters_get_titles_and_units() {
        let event = |gap_m: f64| BehaviorEvent {
            behavior: "cut_in".into(),
            scene_id: SceneId::from("s"),
            label: crate::behavior::EventLabel::Positive,
            roles: crate::scene::Roles::default(),
            start_timestep: 0,
            end_timestep: 1,
            parameters: BTreeMap::from([("gap_m".to_owned(), gap_m), ("relative_speed_mps".to_owned(), -1.0)]),
        };
        let (a, b) = (event(4.0), event(6.0));
        let distributions = event_distributions(&[("recorded", &[&a]), ("generated", &[&a, &b])]);
        let titles: Vec<(&str, &str)> = distributions.iter().map(|d| (d.title.as_str(), d.unit.as_str())).collect();
        assert_eq!(titles, [("gap", "m"), ("relative speed", "m/s")]);
        assert_eq!(distributions[0].series[1].mean, Some(5.0));
        assert_eq!(distributions[0].series[1].distance, Some(1.0));
    }
}
