//! The ranges of figures to filter by: figures in which scenes differ, in groups that open one by one.

use crate::metrics;
use crate::report::card::{SceneCard, Verdict};
use crate::report::number::value;
use crate::report::quantities::title_and_unit;
use maud::{Markup, html};

/// A figure that scenes differ in.
pub(super) struct Range<'a> {
    pub(super) name: &'a str,
    low: f64,
    high: f64,
}

/// The subject of a figure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Group {
    Event,
    Criticality,
    Validity,
    Recording,
}

impl Group {
    const ALL: [Self; 4] = [Self::Event, Self::Criticality, Self::Validity, Self::Recording];

    const fn title(self) -> &'static str {
        match self {
            Self::Event => "The event",
            Self::Criticality => "How critical",
            Self::Validity => "How valid",
            Self::Recording => "How far from the recording",
        }
    }

    /// Metrics are recognized by their names; other figures are parameters of an event, or the number of events.
    pub(super) fn of(name: &str) -> Self {
        let is_of = |parts: &[&str]| parts.iter().any(|part| name.contains(part));
        match () {
            () if metrics::by_id(name).is_none() => Self::Event,
            () if is_of(&["ade_", "fde_", "miss_rate"]) => Self::Recording,
            () if is_of(&["pair_", "preventable"]) || name.starts_with("scene_") => Self::Criticality,
            () => Self::Validity,
        }
    }
}

/// The figures in which scenes differ: parameters of events, then metrics.
pub(super) fn ranges<'a>(cards: impl Iterator<Item = &'a SceneCard>) -> Vec<Range<'a>> {
    let mut ranges: Vec<Range<'_>> = Vec::new();
    // Scenes with an event name its parameters first.
    let has_event = |card: &&SceneCard| matches!(card.key.verdict, Verdict::New | Verdict::Recorded);
    let (with, without): (Vec<&SceneCard>, Vec<&SceneCard>) = cards.partition(has_event);
    let values = with.into_iter().chain(without).flat_map(|card| &card.key.values);
    for found in values.filter(|found| found.value.is_finite()) {
        match ranges.iter_mut().find(|range| range.name == found.name) {
            Some(range) => (range.low, range.high) = (range.low.min(found.value), range.high.max(found.value)),
            None => ranges.push(Range { name: &found.name, low: found.value, high: found.value }),
        }
    }
    ranges.retain(|range| range.high > range.low);
    ranges
}

/// A closed part of the form for each group. The script writes beside its title how many of its fields are set.
pub(super) fn groups(ranges: &[Range<'_>]) -> Markup {
    html! {
        @for group in Group::ALL {
            @let own: Vec<&Range<'_>> = ranges.iter().filter(|range| Group::of(range.name) == group).collect();
            @if !own.is_empty() {
                details {
                    summary {
                        (group.title()) " " small { (own.len()) @if own.len() == 1 { " figure" } @else { " figures" } }
                        " " strong class="set" {}
                    }
                    div class="ranges" { @for range in own { (inputs(range)) } }
                }
            }
        }
    }
}

fn inputs(range: &Range<'_>) -> Markup {
    let (title, unit) = title_and_unit(range.name);
    let input = |end: &str, words: &str, least: f64| {
        html! {
            input type="number" step="any" name=(format!("{}.{end}", range.name)) placeholder=(value(least))
                aria-label=(format!("{title}, {words}")) ;
        }
    };
    html! {
        div {
            span { (title) @if !unit.is_empty() { small { " (" (unit) ")" } } }
            (input("min", "at least", range.low)) "to" (input("max", "at most", range.high))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_metric_has_a_group_that_fits() {
        for (name, group) in [
            ("gap_m", Group::Event),
            ("min_distance_m", Group::Event),
            ("cut_in_rate", Group::Event),
            ("pair_min_ttc_s", Group::Criticality),
            ("scene_max_drac_mps2", Group::Criticality),
            ("preventable_rate", Group::Criticality),
            ("min_scene_ade_m", Group::Recording),
            ("brier_min_fde_m", Group::Recording),
            ("consistent_min_joint_miss_rate", Group::Recording),
            ("validity_rate", Group::Validity),
            ("cross_collision_rate", Group::Validity),
            ("jerk_violation_rate", Group::Validity),
        ] {
            assert_eq!(Group::of(name), group, "{name}");
        }
        let n_in = |group: Group| metrics::ALL.iter().filter(|metric| Group::of(metric.spec().id) == group).count();
        assert_eq!((n_in(Group::Event), n_in(Group::Criticality)), (0, 8));
    }
}
