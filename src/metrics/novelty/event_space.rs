//! Distances of events from the recorded events of their behavior, by their parameters.

use super::nearest::NearestIndex;
use crate::behavior::{BehaviorEvent, EventLabel};
use crate::quantile::quantile;

/// The recorded positive events of one behavior as points, one coordinate a parameter.
///
/// A parameter counts if every recorded event has it, and it has a unit and is not a time in the scene (`t_…_s`): for a
/// cut-in these are gap, speeds, lateral speed, shift and smallest distance. Each is divided by its spread among the
/// recorded events: 0.7413 of the interquartile range, which is the standard deviation of normally distributed values
/// (the standard deviation itself if the quartiles coincide), but at least 0.1 of its unit; a parameter that never
/// varies is left out. The distance of two events is the root mean square of the differences: 1 means that they differ
/// by a typical spread in every parameter.
pub struct EventSpace {
    /// Names and spreads.
    axes: Vec<(String, f64)>,
    index: NearestIndex<Vec<f64>>,
}

impl EventSpace {
    /// The space of the positive events of `behavior` among `events`; `None` if there are fewer than two, or none of
    /// their parameters varies.
    pub fn new(behavior: &str, events: &[BehaviorEvent]) -> Option<Self> {
        let recorded: Vec<&BehaviorEvent> =
            events.iter().filter(|event| event.behavior == behavior && event.label == EventLabel::Positive).collect();
        let names = recorded.first()?.parameters.keys().filter(|name| is_coordinate(name));
        let axes: Vec<(String, f64)> = names
            .filter_map(|name| {
                let values: Option<Vec<f64>> =
                    recorded.iter().map(|event| event.parameters.get(name).copied()).collect();
                Some((name.clone(), spread(values?)?))
            })
            .collect();
        if axes.is_empty() {
            return None;
        }
        let mut space = Self { axes, index: NearestIndex::default() };
        for event in recorded {
            if let Some(point) = space.point(event) {
                space.index.insert(point, |a, b| distance(a, b));
            }
        }
        Some(space)
    }

    /// The distance of `event` from the nearest recorded one; `None` if it lacks a parameter that recorded events have.
    pub fn distance_to_nearest(&self, event: &BehaviorEvent) -> Option<f64> {
        self.index.nearest(&self.point(event)?, |a, b| distance(a, b)).map(|(_, distance)| distance)
    }

    fn point(&self, event: &BehaviorEvent) -> Option<Vec<f64>> {
        self.axes.iter().map(|(name, spread)| Some(event.parameters.get(name)? / spread)).collect()
    }
}

/// Whether a parameter describes the event itself, not its time in the scene or its side.
fn is_coordinate(name: &str) -> bool {
    let has_unit =
        ["_m", "_s", "_mps", "_mps2", "_mps3", "_rad", "_radps", "_deg", "_per_m"].iter().any(|u| name.ends_with(u));
    has_unit && !name.starts_with("t_")
}

/// The least spread, in the unit of the parameter. If egos keep their lanes to the micrometer, a shift of a centimeter
/// is nothing new.
const LEAST_SPREAD: f64 = 0.1;

/// The robust standard deviation of values, at least [`LEAST_SPREAD`]; `None` if they do not vary.
fn spread(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    let robust = 0.7413 * (quantile(&values, 0.75)? - quantile(&values, 0.25)?);
    if robust > 0.0 {
        return Some(robust.max(LEAST_SPREAD));
    }
    let mean = values.iter().sum::<f64>() / n as f64;
    let variance = values.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / n as f64;
    (variance > 0.0).then(|| variance.sqrt().max(LEAST_SPREAD))
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    let sum: f64 = a.iter().zip(b).map(|(x, y)| (x - y) * (x - y)).sum();
    (sum / a.len().max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    fn event(label: EventLabel, parameters: &[(&str, f64)]) -> BehaviorEvent {
        BehaviorEvent {
            behavior: "cut_in".to_owned(),
            scene_id: "a/b/c/d".into(),
            label,
            roles: crate::scene::Roles::default(),
            start_timestep: 0,
            end_timestep: 1,
            parameters: parameters.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect::<BTreeMap<_, _>>(),
        }
    }

    #[test]
    fn distances_are_in_spreads_of_what_was_recorded() {
        // Gaps of 0, 10, …, 40 m: quartiles 10 and 30 m, spread 14.826 m. The speed never varies, the time does not
        // count, one event lacks a TTC.
        let recorded = |i: u32| {
            let gap = ("gap_m", 10.0 * f64::from(i));
            let mut all = vec![gap, ("ego_speed_mps", 5.0), ("t_other_s", f64::from(i)), ("side", 1.0), ("ttc_s", 1.0)];
            all.truncate(if i == 3 { 4 } else { 5 });
            event(EventLabel::Positive, &all)
        };
        let mut events: Vec<BehaviorEvent> = (0..5).map(recorded).collect();
        events.push(event(EventLabel::Negative, &[("gap_m", 1000.0)]));
        let space = EventSpace::new("cut_in", &events).expect("they vary");
        assert_eq!(space.axes.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>(), ["gap_m"]);
        let novelty = |gap_m: f64| space.distance_to_nearest(&event(EventLabel::Positive, &[("gap_m", gap_m)]));
        assert_eq!(novelty(20.0), Some(0.0));
        assert!((novelty(54.826).expect("a gap") - 1.0).abs() < 1e-9);
        assert_eq!(space.distance_to_nearest(&event(EventLabel::Positive, &[])), None);
        assert!(EventSpace::new("near_miss", &events).is_none() && EventSpace::new("cut_in", &events[..1]).is_none());
    }

    #[test]
    fn what_hardly_varies_does_not_decide() {
        let recorded = |i: u32| {
            event(EventLabel::Positive, &[("gap_m", 10.0 * f64::from(i)), ("ego_shift_m", 1e-6 * f64::from(i))])
        };
        let events: Vec<BehaviorEvent> = (0..5).map(recorded).collect();
        let space = EventSpace::new("cut_in", &events).expect("they vary");
        let shifted = event(EventLabel::Positive, &[("gap_m", 20.0), ("ego_shift_m", 0.01)]);
        assert!(space.distance_to_nearest(&shifted).expect("complete") < 0.1);
    }

    #[test]
    fn every_parameter_counts_the_same() {
        let recorded =
            |i: u32| event(EventLabel::Positive, &[("gap_m", 10.0 * f64::from(i)), ("ego_speed_mps", f64::from(i))]);
        let events: Vec<BehaviorEvent> = (0..5).map(recorded).collect();
        let space = EventSpace::new("cut_in", &events).expect("they vary");
        // One spread off in the gap alone: √(1 / 2).
        let off = event(EventLabel::Positive, &[("gap_m", 40.0 + 14.826), ("ego_speed_mps", 4.0)]);
        assert!((space.distance_to_nearest(&off).expect("complete") - 0.5_f64.sqrt()).abs() < 1e-9);
    }
}
