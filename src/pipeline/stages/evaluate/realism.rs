//! Do road users in a sweep move as in the recordings it continues? Distances between their distributions.

use super::cells::{Cell, CellMotion};
use crate::metrics::MotionHistograms;
use crate::report::RealismRow;

/// The motion of one group of a sweep.
struct Group {
    name: String,
    sweep: String,
    strength: f64,
    motion: MotionHistograms,
}

/// Collects motion group by group; its size depends on the number of groups alone.
#[derive(Default)]
pub(super) struct RealismTable {
    groups: Vec<Group>,
}

/// The group that others of a sweep are compared with.
const REFERENCE: &str = "recorded";

impl RealismTable {
    /// Adds a cell of `sweep`.
    pub(super) fn add(&mut self, sweep: &str, cell: &Cell<'_>, motion: &CellMotion) {
        let strength = cell.records[0].scenario.provenance.guidance.strength;
        if let Some([recorded, constant_velocity]) = &motion.references {
            self.add_to(REFERENCE, sweep, 0.0, recorded);
            self.add_to("constant_velocity", sweep, 0.0, constant_velocity);
        }
        self.add_to(if strength == 0.0 { "unguided" } else { sweep }, sweep, strength, &motion.together);
    }

    fn add_to(&mut self, name: &str, sweep: &str, strength: f64, motion: &MotionHistograms) {
        let is_same = |group: &&mut Group| {
            group.name == name && group.sweep == sweep && group.strength.to_bits() == strength.to_bits()
        };
        match self.groups.iter_mut().find(is_same) {
            Some(group) => group.motion.merge(motion),
            None => {
                let (name, sweep) = (name.to_owned(), sweep.to_owned());
                self.groups.push(Group { name, sweep, strength, motion: motion.clone() });
            }
        }
    }

    /// A row for each quantity of each group but the recording's, in order of first appearance.
    pub(super) fn finish(&self) -> Vec<RealismRow> {
        let reference = |sweep: &str| self.groups.iter().find(|group| group.name == REFERENCE && group.sweep == sweep);
        let generated = self.groups.iter().filter(|group| group.name != REFERENCE);
        let pairs = generated.filter_map(|group| Some((group, reference(&group.sweep)?)));
        pairs.flat_map(|(group, reference)| rows(group, reference)).collect()
    }
}

fn rows<'g>(group: &'g Group, reference: &'g Group) -> impl Iterator<Item = RealismRow> + 'g {
    group.motion.iter().zip(reference.motion.iter()).map(|((quantity, own), (_, recorded))| RealismRow {
        group: group.name.clone(),
        sweep: group.sweep.clone(),
        strength: group.strength,
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
            table.add_to(name, sweep, strength, &at(speed_mps));
        }
        let rows = table.finish();
        let speeds: Vec<_> = rows
            .iter()
            .filter(|row| row.quantity == "speed")
            .map(|row| (row.group.as_str(), row.n_recorded, row.n, row.wasserstein.expect("values")))
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
