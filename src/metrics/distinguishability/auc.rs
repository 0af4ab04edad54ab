//! The area under the ROC curve: how often does a generated item have the higher score than a recorded one?

use crate::quantile::quantile;
use crate::seed::Seed;

/// Number of resampled sets of scenes behind an interval.
const N_RESAMPLES: usize = 200;

/// An item with its score.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scored {
    pub(super) scene: usize,
    /// Whether it was generated.
    pub(super) generated: bool,
    pub(super) score: f64,
}

/// An area under the curve with its interval of 95 % over scenes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Auc {
    /// P(generated > recorded) + P(equal) / 2 of a random pair.
    pub value: f64,
    /// The 2.5 % and 97.5 % quantiles over sets of scenes drawn with replacement.
    pub interval: [f64; 2],
}

/// The area for these items; `None` without items of both kinds.
pub(super) fn area(items: &[Scored]) -> Option<f64> {
    sorted(items).area(|_| 1.0)
}

pub(super) fn area_with_interval(items: &[Scored]) -> Option<Auc> {
    let sorted = sorted(items);
    let value = sorted.area(|_| 1.0)?;
    let mut scenes: Vec<usize> = items.iter().map(|item| item.scene).collect();
    scenes.sort_unstable();
    scenes.dedup();
    let mut rng = Seed(0).derive("resampled scenes", &[]).rng();
    let mut times = vec![0.0; scenes.last().map_or(0, |last| last + 1)];
    let mut areas: Vec<f64> = (0..N_RESAMPLES)
        .filter_map(|_| {
            times.fill(0.0);
            (0..scenes.len()).for_each(|_| times[scenes[rng.below(scenes.len())]] += 1.0);
            sorted.area(|scene| times[scene])
        })
        .collect();
    areas.sort_by(f64::total_cmp);
    let interval = [0.025, 0.975].map(|share| quantile(&areas, share).unwrap_or(value));
    Some(Auc { value, interval })
}

/// Items by increasing score.
struct Sorted(Vec<Scored>);

fn sorted(items: &[Scored]) -> Sorted {
    let mut items = items.to_vec();
    items.sort_by(|a, b| a.score.total_cmp(&b.score));
    Sorted(items)
}

impl Sorted {
    /// The area if the items of a scene count `times`.
    fn area(&self, times: impl Fn(usize) -> f64) -> Option<f64> {
        let (mut recorded, mut generated, mut won) = (0.0, 0.0, 0.0);
        for equal in self.0.chunk_by(|a, b| a.score == b.score) {
            let count = |is_generated: bool| -> f64 {
                equal.iter().filter(|item| item.generated == is_generated).map(|item| times(item.scene)).sum()
            };
            let (own_recorded, own_generated) = (count(false), count(true));
            won += own_generated * (recorded + own_recorded / 2.0);
            recorded += own_recorded;
            generated += own_generated;
        }
        (recorded > 0.0 && generated > 0.0).then(|| won / (recorded * generated))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn items(of: &[(usize, bool, f64)]) -> Vec<Scored> {
        of.iter()
            .map(|(scene, generated, score)| Scored { scene: *scene, generated: *generated, score: *score })
            .collect()
    }

    #[test]
    fn the_area_is_the_share_of_pairs_in_order_and_ties_count_half() {
        // Pairs of (1, 3, 3) generated and (0, 3) recorded: 1 wins 1 of 2, each 3 wins one and ties one.
        let found = area(&items(&[(0, true, 1.0), (0, true, 3.0), (1, true, 3.0), (0, false, 0.0), (1, false, 3.0)]));
        assert_eq!(found, Some((1.0 + 1.5 + 1.5) / 6.0));
        assert_eq!(area(&items(&[(0, true, 1.0)])), None);
    }

    #[test]
    fn the_interval_is_that_of_scenes_not_of_tracks() {
        // In half of the scenes all ten tracks are told apart, in the other half none: the scene decides, so the area
        // of n drawn scenes spreads like a binomial share.
        let n = 40;
        let of_scene = |scene: usize| {
            let told = if scene.is_multiple_of(2) { 1.0 } else { 0.0 };
            (0..10).flat_map(move |_| [(scene, true, told), (scene, false, 0.0)])
        };
        let found = area_with_interval(&items(&(0..n).flat_map(of_scene).collect::<Vec<_>>())).expect("an area");
        assert_eq!(found.value, 0.75);
        let half_width = 1.96 * (0.25 / n as f64).sqrt() / 2.0;
        let [low, high] = found.interval;
        assert!((low - (0.75 - half_width)).abs() < 0.02 && (high - (0.75 + half_width)).abs() < 0.02, "{found:?}");
    }
}
