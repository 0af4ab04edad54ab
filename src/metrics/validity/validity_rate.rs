//! The share of valid samples.

use super::{Judged, ValidityConfig};
use crate::metrics::{Direction, Metric, MetricSpec, SampleGroup};
use crate::scene::Scene;
use std::sync::LazyLock;

/// Share of samples whose future keeps all limits. The whole future counts as generated, in recordings as in samples.
#[derive(Debug, Clone, Default)]
pub struct ValidityRate {
    /// The limits; `None` for the defaults.
    pub limits: Option<ValidityConfig>,
}

static DEFAULTS: LazyLock<ValidityConfig> = LazyLock::new(ValidityConfig::default);

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
        let limits = self.limits.as_ref().unwrap_or(&DEFAULTS);
        let is_valid = |sample: &Scene| {
            let judged = Judged::future_of(sample, group.asked).excused_if(group.asked_to_collide);
            vec![judged.violations(limits).is_empty()]
        };
        group.share_over_samples(is_valid).filter(|_| group.recorded.has_future())
    }
}
