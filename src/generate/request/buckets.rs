//! The buckets of a request: which one does an event fall into, and how many scenarios does each need?

use super::config::{Divisions, RequestConfig};
use super::facts::{Facts, SIDE, side, text_of_scene};
use crate::behavior::Outcome;
use crate::guidance::Target;
use crate::scene::Scene;
use crate::settings::{self, Issue};
use serde::{Deserialize, Serialize};

/// How far inside a bucket's edges samples aim: a share of its width, and at most this much in the parameter's unit.
const INSET_SHARE: f64 = 0.15;
const MAX_INSET: f64 = 0.5;

/// The buckets of a request: all combinations of the parts of its parameters, the last parameter changing fastest.
#[derive(Debug, Clone, PartialEq)]
pub struct Buckets {
    dimensions: Vec<(String, Divisions)>,
    wanted: Vec<u64>,
}

/// The part of one parameter that belongs to a bucket.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BucketPart {
    /// The parameter.
    pub parameter: String,
    /// `0..5` for an interval from 0 (included) to 5 (excluded); otherwise the text.
    pub range: String,
}

impl Divisions {
    pub(super) fn len(&self) -> usize {
        match self {
            Self::Edges(edges) => edges.len().saturating_sub(1),
            Self::Texts(texts) => texts.len(),
        }
    }

    fn range(&self, part: usize) -> String {
        match self {
            Self::Edges(edges) => format!("{}..{}", edges[part], edges[part + 1]),
            Self::Texts(texts) => texts[part].clone(),
        }
    }

    /// Rejects divisions of the parameter `key` that cannot work.
    pub(super) fn validate(&self, key: &str) -> settings::Result {
        let refuse = |why: &str| Err(Issue::new(key, why));
        match self {
            Self::Edges(edges) if edges.len() < 2 => refuse("has fewer than two edges"),
            Self::Edges(edges) if edges.iter().any(|edge| !edge.is_finite()) => {
                refuse("has an edge that is not finite; use a very large number for an open end")
            }
            Self::Edges(edges) if edges.windows(2).any(|edges| edges[0] >= edges[1]) => {
                refuse("has edges that do not ascend")
            }
            Self::Texts(texts) if texts.is_empty() => refuse("is empty"),
            Self::Texts(texts) if texts.iter().enumerate().any(|(i, text)| texts[..i].contains(text)) => {
                refuse("names a text twice")
            }
            _ => Ok(()),
        }
    }
}

impl Buckets {
    /// The buckets of a checked request.
    pub(super) fn new(request: &RequestConfig) -> Self {
        let dimensions: Vec<(String, Divisions)> =
            request.buckets.iter().map(|(name, divisions)| (name.clone(), divisions.clone())).collect();
        let mut buckets = Self { dimensions, wanted: Vec::new() };
        let n_buckets = buckets.dimensions.iter().map(|(_, divisions)| divisions.len()).product();
        buckets.wanted = match (request.per_bucket, request.n_total) {
            (Some(n), _) => vec![n; n_buckets],
            (None, n_total) => {
                let weights: Vec<f64> = (0..n_buckets).map(|bucket| buckets.weight(request, bucket)).collect();
                apportion(n_total.unwrap_or(0), &weights)
            }
        };
        buckets
    }

    /// Number of buckets.
    pub fn len(&self) -> usize {
        self.wanted.len()
    }

    /// Whether there are none; a checked request has at least one.
    pub fn is_empty(&self) -> bool {
        self.wanted.is_empty()
    }

    /// The number of scenarios requested in each bucket.
    pub fn wanted(&self) -> &[u64] {
        &self.wanted
    }

    /// The parts of bucket `bucket`, parameter by parameter.
    pub fn parts(&self, bucket: usize) -> Vec<BucketPart> {
        let part = |((parameter, divisions), part): (&(String, Divisions), usize)| BucketPart {
            parameter: parameter.clone(),
            range: divisions.range(part),
        };
        self.dimensions.iter().zip(self.part_indices(bucket)).map(part).collect()
    }

    /// Its parts in one line: `gap_m 0..5, relative_speed_mps -5..0`.
    pub fn ranges(&self, bucket: usize) -> String {
        let parts = self.parts(bucket).into_iter().map(|part| format!("{} {}", part.parameter, part.range));
        parts.collect::<Vec<_>>().join(", ")
    }

    /// The bucket of an event. `None` if it falls into none or lacks a parameter.
    pub(super) fn place(&self, facts: &Facts<'_>) -> Option<usize> {
        self.dimensions
            .iter()
            .try_fold(0, |bucket, (name, divisions)| Some(bucket * divisions.len() + facts.part(name, divisions)?))
    }

    /// The target of a bucket: the intervals of its parameters, a little inside its edges.
    pub(super) fn target(&self, bucket: usize) -> Target {
        let interval = |((name, divisions), part): (&(String, Divisions), usize)| match divisions {
            Divisions::Edges(edges) => {
                let (least, most) = (edges[part], edges[part + 1]);
                let inset = (INSET_SHARE * (most - least)).min(MAX_INSET);
                Some((name.clone(), [least + inset, most - inset]))
            }
            // The only parameter whose texts stand for numbers.
            Divisions::Texts(texts) => {
                let value = [-1.0, 1.0].into_iter().find(|value| name == SIDE && side(*value) == texts[part]);
                value.map(|value| (name.clone(), [value - INSET_SHARE, value + INSET_SHARE]))
            }
        };
        self.dimensions.iter().zip(self.part_indices(bucket)).filter_map(interval).collect()
    }

    /// Whether an outcome can lie in a bucket, judged by the parameters of the bucket that it has.
    pub(super) fn allows(&self, bucket: usize, outcome: &Outcome) -> bool {
        self.dimensions.iter().zip(self.part_indices(bucket)).all(|((name, divisions), part)| {
            let Some(value) = outcome.get(name) else { return true };
            match divisions {
                Divisions::Edges(edges) => (edges[part]..edges[part + 1]).contains(&value),
                Divisions::Texts(texts) => side(value) == texts[part],
            }
        })
    }

    /// The buckets that events of a scene can lie in, judged by its place and its tags.
    pub(super) fn of_scene(&self, scene: &Scene) -> Vec<usize> {
        let own: Vec<Option<&str>> = self.dimensions.iter().map(|(name, _)| text_of_scene(name, scene)).collect();
        let is_possible = |bucket: &usize| {
            let parts = self.dimensions.iter().zip(self.part_indices(*bucket)).zip(&own);
            parts.into_iter().all(|(((_, divisions), part), own)| match (divisions, own) {
                (Divisions::Texts(texts), Some(own)) => texts[part] == *own,
                _ => true,
            })
        };
        (0..self.len()).filter(is_possible).collect()
    }

    /// The index of a bucket's part of each parameter.
    fn part_indices(&self, bucket: usize) -> Vec<usize> {
        let mut rest = bucket;
        let mut parts: Vec<usize> = Vec::new();
        for (_, divisions) in self.dimensions.iter().rev() {
            parts.push(rest % divisions.len());
            rest /= divisions.len();
        }
        parts.reverse();
        parts
    }

    fn weight(&self, request: &RequestConfig, bucket: usize) -> f64 {
        let parts = self.dimensions.iter().zip(self.part_indices(bucket));
        parts.map(|((name, _), part)| request.weights.get(name).map_or(1.0, |weights| weights[part])).product()
    }
}

/// Distributes `n` in proportion to weights: whole numbers first, the rest to the largest fractions, the first among
/// equal ones.
fn apportion(n: u64, weights: &[f64]) -> Vec<u64> {
    let sum: f64 = weights.iter().sum();
    let exact: Vec<f64> = weights.iter().map(|weight| n as f64 * weight / sum).collect();
    let mut counts: Vec<u64> = exact.iter().map(|share| share.floor() as u64).collect();
    let mut order: Vec<usize> = (0..weights.len()).filter(|i| weights[*i] > 0.0).collect();
    order.sort_by(|a, b| exact[*b].fract().total_cmp(&exact[*a].fract()).then(a.cmp(b)));
    let missing = n.saturating_sub(counts.iter().sum());
    order.iter().take(missing as usize).for_each(|i| counts[*i] += 1);
    counts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{Drive, scene};

    fn request(toml: &str) -> RequestConfig {
        let head = "name = 'r'\nbehavior = 'cut_in'\narms = ['a']\nbudget = { n_samples = 9 }\n";
        toml::from_str(&format!("{head}{toml}")).unwrap()
    }

    #[test]
    fn buckets_are_all_combinations_and_are_named() {
        let buckets = Buckets::new(&request(
            "per_bucket = 4\nbuckets = { relative_speed_mps = [-5, 0, 5.5], gap_m = [0, 5, 10, 20] }",
        ));
        assert_eq!((buckets.len(), buckets.wanted()), (6, [4; 6].as_slice()));
        assert_eq!(buckets.ranges(0), "gap_m 0..5, relative_speed_mps -5..0");
        assert_eq!(buckets.ranges(1), "gap_m 0..5, relative_speed_mps 0..5.5");
        assert_eq!(buckets.ranges(5), "gap_m 10..20, relative_speed_mps 0..5.5");
    }

    #[test]
    fn targets_are_a_little_inside_of_their_buckets() {
        let buckets = Buckets::new(&request("per_bucket = 1\nbuckets = { gap_m = [0, 2, 12] }"));
        // 15 % of 2 m, and at most half a meter.
        for (bucket, expected) in [[0.3, 1.7], [2.5, 11.5]].into_iter().enumerate() {
            let found = buckets.target(bucket)["gap_m"];
            assert!(found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-12), "{found:?}");
        }
    }

    #[test]
    fn totals_are_distributed_by_weights() {
        let toml =
            "n_total = 10\nbuckets = { side = ['left', 'right'], gap_m = [0, 5, 10] }\nweights = { side = [3, 1] }";
        // In the order gap_m, side: 3.75, 1.25, 3.75, 1.25; one is missing after rounding down twice.
        assert_eq!(Buckets::new(&request(toml)).wanted(), [4, 1, 4, 1]);
        assert_eq!(apportion(7, &[1.0, 1.0, 0.0, 1.0]), [3, 2, 0, 2]);
        assert_eq!(apportion(2, &[0.0, 5.0]), [0, 2]);
    }

    #[test]
    fn outcomes_lie_in_buckets_as_far_as_they_name_their_parameters() {
        let toml = "per_bucket = 1\nbuckets = { side = ['left', 'right'], gap_m = [0, 5, 10] }";
        let buckets = Buckets::new(&request(toml));
        // In the order gap_m, side. The left is positive, and an edge belongs to the bucket above it.
        let allowing = |outcome: Outcome| (0..4).filter(|bucket| buckets.allows(*bucket, &outcome)).collect::<Vec<_>>();
        assert_eq!(allowing(Outcome::default().with("gap_m", 7.0).with("side", 1.0)), [2]);
        assert_eq!(allowing(Outcome::default().with("gap_m", 5.0)), [2, 3]);
        assert_eq!(allowing(Outcome::default().with("side", -1.0)), [1, 3]);
        assert!(allowing(Outcome::default().with("gap_m", 10.0)).is_empty());
    }

    #[test]
    fn a_scene_reaches_the_buckets_of_its_place_and_its_tags() {
        let toml = "junction = ['merge', 'none'], gap_m = [0, 5, 10], place = ['Test', 'Elsewhere']";
        let buckets = Buckets::new(&request(&format!("per_bucket = 1\nbuckets = {{ {toml} }}")));
        // In the order gap_m, junction, place: the scene has a straight lane at the place Test.
        let reached = buckets.of_scene(&scene(&[Drive::straight(0.0, 0.0, 0.0, 5.0)]));
        assert_eq!(reached, [2, 6]);
        assert_eq!(buckets.ranges(6), "gap_m 5..10, junction none, place Test");
    }
}
