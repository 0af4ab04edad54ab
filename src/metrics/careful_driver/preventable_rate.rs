//! The share of cut-ins in which a careful driver avoids a collision.

use super::CarefulReplay;
use crate::metrics::{Direction, Metric, MetricSpec, SampleGroup};

/// Among samples in which the requested `other` enters the lane of the requested `ego`, the share in which the careful
/// driver avoids a collision. Not defined if no such roles were requested, or no such sample exists.
#[derive(Debug, Clone, Default)]
pub struct PreventableRate;

impl Metric for PreventableRate {
    fn spec(&self) -> MetricSpec {
        MetricSpec::new(
            "preventable_rate",
            "1",
            Direction::Neither,
            "of samples in which the other comes into the ego's lane, the share in which UN R157's \
                          careful driver avoids a collision",
        )
    }

    fn evaluate(&self, group: &SampleGroup<'_>) -> Option<f64> {
        let (ego, other) = (group.asked.track("ego")?, group.asked.track("other")?);
        group.recorded.has_future().then_some(())?;
        group.mean_over_whole(|sample| {
            let (replay, other) = (CarefulReplay::of(sample, sample.track_idx(ego)?)?, sample.track_idx(other)?);
            replay.intrudes(other).then(|| f64::from(u8::from(replay.contact().is_none())))
        })
    }
}
