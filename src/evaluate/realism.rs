//! Do road users in a sweep move as in the recordings that it continues? Measures distances between distributions of
//! motion.

use super::cells::CellMotion;
use crate::metrics::{Group, MotionHistograms, SeriesKey};
use crate::scene::GuidanceLevel;
use serde::{Deserialize, Serialize};

/// How far the distribution of a quantity of motion over a sweep is from that over its recordings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RealismRow {
    /// The series whose motion is compared with the recordings.
    pub group: Group,
    /// The sweep that continues these recordings.
    pub sweep: String,
    /// The level of its guidance.
    #[serde(flatten)]
    pub level: GuidanceLevel,
    /// The quantity, such as `yaw rate`.
    pub quantity: String,
    /// Its unit.
    pub unit: String,
    /// Number of recorded values.
    pub n_recorded: u64,
    /// Number of values of the group.
    pub n: u64,
    /// Mean of the recorded values.
    pub recorded_mean: Option<f64>,
    /// Mean of the group's values.
    pub mean: Option<f64>,
    /// Wasserstein-1 distance in the quantity's unit.
    pub wasserstein: Option<f64>,
    /// Jensen-Shannon divergence in bits, 0 to 1.
    pub jensen_shannon: Option<f64>,
}

impl RealismRow {
    /// The compared series.
    pub fn series(&self) -> SeriesKey {
        SeriesKey { group: self.group.clone(), sweep: self.sweep.clone(), level: self.level }
    }
}

/// Collects motion series by series; its size depends on the number of series alone.
#[derive(Default)]
pub(super) struct RealismTable {
    series: Vec<(SeriesKey, MotionHistograms)>,
}

impl RealismTable {
    /// Adds a cell whose samples are of `series`.
    pub(super) fn add(&mut self, series: &SeriesKey, motion: &CellMotion) {
        let sweep = &series.sweep;
        if let Some([recorded, constant_velocity]) = &motion.references {
            self.add_to(SeriesKey::reference(Group::Recorded, sweep), recorded);
            self.add_to(SeriesKey::reference(Group::ConstantVelocity, sweep), constant_velocity);
        }
        self.add_to(series.clone(), &motion.together);
    }

    fn add_to(&mut self, key: SeriesKey, motion: &MotionHistograms) {
        match self.series.iter_mut().find(|(known, _)| *known == key) {
            Some((_, known)) => known.merge(motion),
            None => self.series.push((key, motion.clone())),
        }
    }

    /// A row for each quantity of each series except the recording, in order of first appearance.
    pub(super) fn finish(&self) -> Vec<RealismRow> {
        let of_recording = |sweep: &str| {
            let is_it = |(key, _): &&(SeriesKey, _)| key.group == Group::Recorded && key.sweep == sweep;
            self.series.iter().find(is_it).map(|(_, motion)| motion)
        };
        let others = self.series.iter().filter(|(key, _)| key.group != Group::Recorded);
        let pairs = others.filter_map(|(key, own)| Some((key, own, of_recording(&key.sweep)?)));
        pairs.flat_map(|(key, own, recorded)| rows(key, own, recorded)).collect()
    }
}

fn rows<'m>(
    key: &'m SeriesKey,
    own: &'m MotionHistograms,
    recorded: &'m MotionHistograms,
) -> impl Iterator<Item = RealismRow> + 'm {
    own.iter().zip(recorded.iter()).map(|((quantity, own), (_, recorded))| RealismRow {
        group: key.group.clone(),
        sweep: key.sweep.clone(),
        level: key.level,
        quantity: quantity.title.to_owned(),
        unit: quantity.unit.to_owned(),
        n_recorded: recorded.n(),
        n: own.n(),
        recorded_mean: recorded.mean(),
        mean: own.mean(),
        wasserstein: own.wasserstein(recorded),
        jensen_shannon: own.jensen_shannon(recorded),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{self, Drive};

    fn at(speed_mps: f64) -> MotionHistograms {
        MotionHistograms::of([&testing::scene(&[Drive::straight(0.0, 0.0, 0.0, speed_mps)])])
    }

    #[test]
    fn groups_are_compared_with_the_recording_of_their_sweep() {
        let mut table = RealismTable::default();
        for (name, sweep, strength, speed_mps) in [
            ("recorded", "a", 0.0, 10.05),
            ("unguided", "a", 0.0, 11.05),
            ("recorded", "a", 0.0, 12.05),
            ("a", "a", 2.0, 10.05),
            ("recorded", "b", 0.0, 5.05),
            ("b", "b", 2.0, 10.05),
        ] {
            let level = GuidanceLevel::of_strength(strength);
            let key = SeriesKey { group: name.to_owned().into(), sweep: sweep.to_owned(), level };
            table.add_to(key, &at(speed_mps));
        }
        let rows = table.finish();
        let speeds: Vec<_> = rows
            .iter()
            .filter(|row| row.quantity == "speed")
            .map(|row| (row.group.name(), row.n_recorded, row.n, row.wasserstein.expect("values")))
            .collect();
        // Half of the recorded speeds of a are 10 m/s and half 12 m/s. Distances are good to a bin's width of 0.1 m/s.
        let expected = [("unguided", 16, 8, 1.0), ("a", 16, 8, 1.0), ("b", 8, 8, 5.0)];
        for (found, expected) in speeds.iter().zip(expected) {
            assert_eq!((found.0, found.1, found.2), (expected.0, expected.1, expected.2));
            assert!((found.3 - expected.3).abs() < 0.1, "{found:?}");
        }
        assert_eq!(speeds.len(), 3);
        // Nobody else is there to come close to.
        assert!(
            rows.iter()
                .all(|row| (row.unit == "s") == row.jensen_shannon.is_none() || row.quantity.contains("nearest"))
        );
    }
}
