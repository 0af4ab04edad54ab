//! The quantities that are compared between recorded and generated scenes.

use super::distribution::Distribution;
use crate::behavior::BehaviorEvent;
use crate::metrics::{MOTION, MotionQuantity};
use crate::scene::Scene;
use std::collections::{BTreeMap, BTreeSet};

/// Bins of each histogram.
const N_BINS: usize = 40;
/// Collects the motion of road users in the futures of scenes, group by group.
///
/// The values themselves are kept, for their median and for bins that fit them; for whole sweeps there are
/// [`MotionHistograms`](crate::metrics::MotionHistograms). Scenes may be dropped once added.
#[derive(Debug, Clone, Default)]
pub struct MotionDistributions {
    groups: Vec<(String, [Vec<f64>; MOTION.len()])>,
}

impl MotionDistributions {
    /// Adds a scene to a group. The first group to be added is the reference.
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

/// The maximum number of values of a parameter, beyond which they are thinned.
const MAX_VALUES: usize = 20_000;

/// The parameters of events, by name. With many events every second one counts, with twice as many every fourth, and so
/// on, so that memory is bounded and the values come from the whole run.
#[derive(Debug, Clone, Default)]
pub struct EventParameters(BTreeMap<String, Thinned>);

#[derive(Debug, Clone, Default)]
struct Thinned {
    n_seen: usize,
    /// One of 2 to the power of this many values is kept.
    halvings: u32,
    values: Vec<f64>,
}

impl EventParameters {
    /// Adds an event.
    pub fn add(&mut self, event: &BehaviorEvent) {
        for (name, value) in &event.parameters {
            if !self.0.contains_key(name) {
                self.0.insert(name.clone(), Thinned::default());
            }
            self.0.get_mut(name).into_iter().for_each(|values| values.add(*value));
        }
    }

    /// Whether there are no values.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

impl Thinned {
    fn add(&mut self, value: f64) {
        if self.n_seen.is_multiple_of(1 << self.halvings) {
            self.values.push(value);
        }
        self.n_seen += 1;
        if self.values.len() == MAX_VALUES {
            let mut idx = 0;
            self.values.retain(|_| {
                idx += 1;
                idx % 2 == 1
            });
            self.halvings += 1;
        }
    }
}

/// Distributions of the parameters of events, one for each parameter that any event has; the first group is the
/// reference.
pub fn event_distributions(groups: &[(&str, &EventParameters)]) -> Vec<Distribution> {
    let names: BTreeSet<&String> = groups.iter().flat_map(|(_, events)| events.0.keys()).collect();
    let none = Thinned::default();
    let of_parameter = |name: &String| {
        let found: Vec<(&str, &Thinned)> =
            groups.iter().map(|(group, events)| (*group, events.0.get(name).unwrap_or(&none))).collect();
        let thinned = found.iter().filter(|(_, values)| values.halvings > 0);
        let thinned = thinned.map(|(group, values)| format!("; every {}th of the {group}", 1_u64 << values.halvings));
        let description = format!("of the events{}", thinned.collect::<String>());
        let groups: Vec<(&str, &[f64])> =
            found.iter().map(|(group, values)| (*group, values.values.as_slice())).collect();
        let (title, unit) = title_and_unit(name);
        Distribution::of(&title, unit, &description, N_BINS / 2, &groups)
    };
    names.into_iter().map(of_parameter).collect()
}

/// The title and unit of a parameter: `relative_speed_mps` is the relative speed in m/s.
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
    use crate::store::testing::event;

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
        let scene_id = SceneId::from("s");
        let event = |gap_m: f64| event(&scene_id, "cut_in", &[("gap_m", gap_m), ("relative_speed_mps", -1.0)]);
        let parameters = |gaps_m: &[f64]| {
            let mut parameters = EventParameters::default();
            gaps_m.iter().for_each(|gap_m| parameters.add(&event(*gap_m)));
            parameters
        };
        let distributions =
            event_distributions(&[("recorded", &parameters(&[4.0])), ("generated", &parameters(&[4.0, 6.0]))]);
        let titles: Vec<(&str, &str)> = distributions.iter().map(|d| (d.title.as_str(), d.unit.as_str())).collect();
        assert_eq!(titles, [("gap", "m"), ("relative speed", "m/s")]);
        assert_eq!(distributions[0].series[1].mean, Some(5.0));
        assert_eq!(distributions[0].series[1].distance, Some(1.0));
        assert_eq!(distributions[0].description, "of the events");
    }

    #[test]
    fn of_many_values_evenly_spread_ones_stay_in_bounded_memory() {
        let mut thinned = Thinned::default();
        (0..150_000).for_each(|value| thinned.add(f64::from(value)));
        // 20 000 values were reached after 20 000, 40 000 and 80 000 events: every eighth of 150 000 is left.
        assert_eq!((thinned.values.len(), thinned.halvings), (18_750, 3));
        assert!((0..).step_by(8).map(f64::from).zip(&thinned.values).all(|(expected, value)| expected == *value));
        let groups =
            [("few", &EventParameters::default()), ("many", &EventParameters([("gap_m".into(), thinned)].into()))];
        let distribution = &event_distributions(&groups)[0];
        assert_eq!(distribution.description, "of the events; every 8th of the many");
        assert_eq!(distribution.series[1].n, 18_750);
    }
}
