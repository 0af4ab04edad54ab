//! The levels of a sweep: strengths or weights, but not both.

use super::SweepConfig;
use crate::scene::GuidanceLevel;
use crate::settings::{self, Issue, Result};

impl SweepConfig {
    /// The levels at which samples of a scene are drawn: strengths α of guidance, or weights λ of classifier-free
    /// guidance. If a sweep has both, one of them is a single number.
    pub(super) fn all_levels(&self) -> Result<Vec<GuidanceLevel>> {
        let strengths = numbers("strengths", &self.strengths)?;
        let weights = self.classifier_free.as_ref().map(|config| numbers("classifier_free.weights", &config.weights));
        let at = |strength: f64, weight: f64| GuidanceLevel { strength, weight };
        match (strengths, weights.transpose()?) {
            (strengths, None) => Ok(strengths.iter().map(|&strength| at(strength, 0.0)).collect()),
            (&[strength], Some(weights)) => Ok(weights.iter().map(|&weight| at(strength, weight)).collect()),
            (strengths, Some(&[weight])) => Ok(strengths.iter().map(|&strength| at(strength, weight)).collect()),
            (strengths, Some(weights)) => Err(Issue::new(
                "classifier_free.weights",
                format_args!(
                    "has {} values and strengths has {}, but only one of them may vary in a sweep; give the other a \
                     single value, or use several sweeps",
                    weights.len(),
                    strengths.len()
                ),
            )),
        }
    }
}

/// Refuses a list that is empty or has duplicates.
fn numbers<'a>(key: &str, numbers: &'a [f64]) -> Result<&'a [f64]> {
    if numbers.is_empty() {
        return Err(Issue::new(key, "is empty, expected at least one number"));
    }
    settings::distinct(key, numbers).map(|()| numbers)
}

#[cfg(test)]
mod tests {
    use crate::generate::testing::resolve;

    fn levels(toml: &str) -> Vec<[f64; 2]> {
        let sweep =
            resolve(&format!("[[sweeps]]\nname = 's'\nn_scenes = 1\nbehavior = 'drift'\n{toml}")).sweeps.remove(0);
        sweep.levels().iter().map(|level| [level.strength, level.weight]).collect()
    }

    #[test]
    fn strengths_or_weights_vary() {
        let goals = |weights: &str| {
            format!("classifier_free = {{ extra = [{{ agents = 'all', times = 'goal' }}], weights = {weights} }}")
        };
        assert_eq!(levels("strengths = [0.0, 2.0]"), [[0.0, 0.0], [2.0, 0.0]]);
        assert_eq!(levels(&goals("[0.5, 1.0]")), [[0.0, 0.5], [0.0, 1.0]]);
        let both = |strengths: &str, weights: &str| levels(&format!("strengths = {strengths}\n{}", goals(weights)));
        assert_eq!(both("[0.0, 2.0]", "[0.5]"), [[0.0, 0.5], [2.0, 0.5]]);
        assert_eq!(both("[2.0]", "[0.5]"), [[2.0, 0.5]]);
        assert_eq!(both("[2.0]", "[0.0, 1.0]"), [[2.0, 0.0], [2.0, 1.0]]);
    }
}
