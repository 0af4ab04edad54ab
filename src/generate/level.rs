//! In what do the samples of one scene differ beside their noise?

use super::SweepConfig;

/// How strongly samples are guided, and how much they lean toward wanted states.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Level {
    /// The number that varies within the sweep, by which samples are told apart: one of the two below.
    pub value: f64,
    /// Strength α of the guidance by classifier and objectives; 0 is none.
    pub strength: f64,
    /// Weight λ of classifier-free guidance; 0 is none.
    pub weight: f64,
}

impl SweepConfig {
    /// What samples of a scene differ in beside their noise: the strengths α of guidance, or the weights λ of classifier-free
    /// guidance. Where a sweep has both, one of them is a single number.
    pub fn levels(&self) -> Vec<Level> {
        match &self.classifier_free {
            None => self.strengths.iter().map(|&value| Level { value, strength: value, weight: 0.0 }).collect(),
            Some(config) if self.varies_weight() => {
                let strength = self.strengths.first().copied().unwrap_or_default();
                config.weights.iter().map(|&value| Level { value, strength, weight: value }).collect()
            }
            Some(config) => {
                let weight = config.weights.first().copied().unwrap_or_default();
                self.strengths.iter().map(|&value| Level { value, strength: value, weight }).collect()
            }
        }
    }

    /// Whether samples are told apart by the weight of classifier-free guidance.
    pub(super) fn varies_weight(&self) -> bool {
        self.classifier_free.as_ref().is_some_and(|config| config.weights.len() > 1 || !self.is_guided())
    }
}

#[cfg(test)]
mod tests {
    use crate::generate::testing::config;

    fn levels(toml: &str) -> Vec<[f64; 3]> {
        let sweep = config(&format!("[[sweeps]]\nname = 's'\nn_scenes = 1\n{toml}")).sweeps.remove(0);
        sweep.levels().iter().map(|level| [level.value, level.strength, level.weight]).collect()
    }

    #[test]
    fn the_one_that_varies_tells_samples_apart() {
        let goals = |weights: &str| {
            format!("classifier_free = {{ extra = [{{ agents = 'all', times = 'goal' }}], weights = {weights} }}")
        };
        assert_eq!(levels("strengths = [0.0, 2.0]"), [[0.0, 0.0, 0.0], [2.0, 2.0, 0.0]]);
        assert_eq!(levels(&goals("[0.5, 1.0]")), [[0.5, 0.0, 0.5], [1.0, 0.0, 1.0]]);
        assert_eq!(levels(&goals("[0.5]")), [[0.5, 0.0, 0.5]]);
        let both = |strengths: &str, weights: &str| levels(&format!("strengths = {strengths}\n{}", goals(weights)));
        assert_eq!(both("[0.0, 2.0]", "[0.5]"), [[0.0, 0.0, 0.5], [2.0, 2.0, 0.5]]);
        assert_eq!(both("[2.0]", "[0.5]"), [[2.0, 2.0, 0.5]]);
        assert_eq!(both("[2.0]", "[0.0, 1.0]"), [[0.0, 2.0, 0.0], [1.0, 2.0, 1.0]]);
    }
}
