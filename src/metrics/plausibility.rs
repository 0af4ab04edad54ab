//! Plausibility: the share of a scene's motion within the recorded ranges.

use super::motion::{MOTION, MotionHistograms};
use crate::scene::Scene;

/// The share of recorded values that may lie beyond either end of a range.
const BEYOND: f64 = 0.001;

/// For each quantity of motion ([`MOTION`]), the range of all recorded values except a thousandth at either end.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedRanges(Vec<Option<[f64; 2]>>);

impl RecordedRanges {
    /// The ranges of recorded motion.
    pub fn of(recorded: &MotionHistograms) -> Self {
        Self(recorded.iter().map(|(_, histogram)| histogram.central_range(BEYOND)).collect())
    }

    /// The plausibility of a scene: the share of a quantity's future values that lie within the recorded range,
    /// averaged over quantities. Recorded scenes have 0.998 on average. `None` without values.
    pub fn plausibility(&self, scene: &Scene) -> Option<f64> {
        let share = |(quantity, range): (&super::MotionQuantity, &Option<[f64; 2]>)| {
            let [low, high] = (*range)?;
            let values = quantity.values(scene);
            let n_within = values.iter().filter(|value| (low..=high).contains(*value)).count();
            (!values.is_empty()).then(|| n_within as f64 / values.len() as f64)
        };
        let shares: Vec<f64> = MOTION.iter().zip(&self.0).filter_map(share).collect();
        (!shares.is_empty()).then(|| shares.iter().sum::<f64>() / shares.len() as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{self, Drive};

    #[test]
    fn motion_beyond_all_recorded_is_implausible() {
        let alone = |speed_mps: f64| testing::scene(&[Drive::straight(0.0, 0.0, 0.0, speed_mps)]);
        let recorded: Vec<Scene> = (0..20).map(|i| alone(8.0 + 0.2 * f64::from(i))).collect();
        let ranges = RecordedRanges::of(&MotionHistograms::of(&recorded));
        assert_eq!(ranges.plausibility(&alone(10.0)), Some(1.0));
        // One of four quantities, speed, acceleration, jerk and yaw rate, is out of range; there is no other agent
        // nearby.
        assert_eq!(ranges.plausibility(&alone(14.0)), Some(0.75));
        assert_eq!(RecordedRanges::of(&MotionHistograms::default()).plausibility(&alone(14.0)), None);
    }
}
