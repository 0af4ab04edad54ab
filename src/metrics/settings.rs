//! The settings of metrics: common to evaluation and limits of requests.

use super::{ALL, DrivableAreaCompliance, MapGaps, Metric, OffroadRate, ValidityConfig, ValidityRate};
use crate::settings;
use serde::{Deserialize, Serialize};

/// The settings of metrics. Metrics without settings have one definition.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct MetricSettings {
    /// The limits of `validity_rate`.
    pub validity: ValidityConfig,
    /// Where maps lack parts of the road: no metric looks for departures from it there.
    #[serde(default, skip_serializing_if = "MapGaps::is_empty")]
    pub map_gaps: MapGaps,
}

impl MetricSettings {
    /// Every metric, in the order of tables.
    pub fn metrics(&self) -> Vec<Box<dyn Metric>> {
        ALL.iter().map(|metric| self.configured(*metric).unwrap_or_else(|| Box::new(*metric))).collect()
    }

    /// The metric with this name. `None` if there is no such metric.
    pub fn by_id(&self, id: &str) -> Option<Box<dyn Metric>> {
        let metric = super::by_id(id)?;
        Some(self.configured(metric).unwrap_or_else(|| Box::new(metric)))
    }

    /// Whether the value of the metric of this name depends on them.
    pub fn decide(&self, id: &str) -> bool {
        super::by_id(id).is_some_and(|metric| self.configured(metric).is_some())
    }

    /// The metric with these settings; `None` if it has no settings.
    fn configured(&self, metric: &dyn Metric) -> Option<Box<dyn Metric>> {
        let validity = ValidityRate { settings: Some(self.clone()) };
        let places_without_road = || self.map_gaps.places.clone();
        let offroad = OffroadRate { places_without_road: places_without_road() };
        let drivable = DrivableAreaCompliance { places_without_road: places_without_road() };
        match metric.spec().id {
            id if id == validity.spec().id => Some(Box::new(validity)),
            id if id == offroad.spec().id => Some(Box::new(offroad)),
            id if id == drivable.spec().id => Some(Box::new(drivable)),
            _ => None,
        }
    }

    /// Checks the settings.
    ///
    /// # Errors
    /// Names its key below `evaluate`, its value and the expectation.
    pub fn validate(&self) -> settings::Result {
        settings::check_ranges(&self.validity).map_err(|issue| issue.within("validity"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::testing::SceneSpec;
    use crate::metrics::{Check, SampleGroup};
    use crate::scene::testing::{Drive, scene};
    use std::collections::BTreeSet;

    #[test]
    fn metrics_with_settings_judge_by_them() {
        // The first car passes through one that stands in its way; nothing else is wrong.
        let crash = scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(10.0, 0.0, 0.0, 0.0)]);
        let group = SampleGroup::equally_likely(&crash, std::slice::from_ref(&crash));
        let rate = |settings: &MetricSettings| settings.by_id("validity_rate").expect("known").evaluate(&group);
        let lenient = ValidityConfig { skip: vec![Check::Collision], ..ValidityConfig::default() };
        let lenient = MetricSettings { validity: lenient, ..MetricSettings::default() };
        assert_eq!((rate(&MetricSettings::default()), rate(&lenient)), (Some(0.0), Some(1.0)));
        let ids: Vec<&str> = lenient.metrics().iter().map(|metric| metric.spec().id).collect();
        assert_eq!(ids, ALL.iter().map(|metric| metric.spec().id).collect::<Vec<_>>());
        assert!(lenient.decide("validity_rate") && !lenient.decide("preventable_rate"));
        assert!(lenient.decide("offroad_rate") && lenient.decide("drivable_area_compliance"));
        assert!(!lenient.decide("min_ade_m") && !lenient.decide("objectives"));
    }

    #[test]
    fn where_the_map_does_not_say_where_the_road_is_nobody_leaves_it() {
        // A car on the only lane, which drives off it.
        let spec: Result<SceneSpec, _> = toml::from_str(
            "agents = [{ id = \"a\", start = { x_m = 0, y_m = 0, speed_mps = 10 }, segments = [{ duration_s = 2.0 }, \
             { duration_s = 1.0, turn_deg = 60 }] }]
            lanes = [{ id = 1, centerline = [[-50, 0], [100, 0]], width_m = 3.6 }]",
        );
        let leaving = spec.expect("valid").build("leaving");
        let group = SampleGroup::equally_likely(&leaving, std::slice::from_ref(&leaving));
        let unsaid = BTreeSet::from([leaving.source.place.clone()]);
        let map_gaps = MapGaps { places: unsaid, ..MapGaps::default() };
        let unsaid = MetricSettings { map_gaps, ..MetricSettings::default() };
        // Workers read the settings from the plan.
        let read = serde_json::from_value::<MetricSettings>(serde_json::to_value(&unsaid).unwrap()).unwrap();
        assert_eq!(read, unsaid);
        for (id, value) in [("offroad_rate", 1.0), ("drivable_area_compliance", 0.0)] {
            let by = |settings: &MetricSettings| settings.by_id(id).expect("known").evaluate(&group);
            assert_eq!((by(&MetricSettings::default()), by(&unsaid)), (Some(value), None), "{id}");
        }
    }
}
