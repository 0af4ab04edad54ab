//! The share of valid samples.

use super::Judged;
use crate::metrics::{Direction, Metric, MetricSettings, MetricSpec, SampleGroup};
use crate::scene::Scene;
use std::sync::LazyLock;

/// Share of samples whose future keeps all limits. The whole future counts as generated, in recordings as in samples.
#[derive(Debug, Clone, Default)]
pub struct ValidityRate {
    /// The limits, and the gaps of maps; `None` for the defaults.
    pub settings: Option<MetricSettings>,
}

static DEFAULTS: LazyLock<MetricSettings> = LazyLock::new(MetricSettings::default);

impl Metric for ValidityRate {
    fn spec(&self) -> MetricSpec {
        MetricSpec::new(
            "validity_rate",
            "1",
            Direction::HigherIsBetter,
            "share of samples that pass every validity check",
        )
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        let MetricSettings { validity, map_gaps } = self.settings.as_ref().unwrap_or(&DEFAULTS);
        let is_valid = |sample: &Scene| {
            let judged = Judged::future_of(sample, group.asked).excused_if(group.asked_to_collide);
            vec![judged.with_gaps(map_gaps).violations(validity).is_empty()]
        };
        group.share_over_samples(is_valid).filter(|_| group.recorded.has_future())
    }
}
