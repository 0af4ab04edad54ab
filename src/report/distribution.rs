//! Distributions of a quantity, and distances between recorded and generated ones.

use crate::quantile::quantile;

/// Histograms of one quantity over common bins.
#[derive(Debug, Clone, PartialEq)]
pub struct Distribution {
    /// The quantity, such as `speed`.
    pub title: String,
    /// Its unit.
    pub unit: String,
    /// Its definition.
    pub description: String,
    /// Bin edges, ascending; one more than there are bins.
    pub edges: Vec<f64>,
    /// One histogram a group; the first is the reference, normally the recorded data.
    pub series: Vec<DistributionSeries>,
}

/// The histogram of one group.
#[derive(Debug, Clone, PartialEq)]
pub struct DistributionSeries {
    /// The group, such as `recorded`.
    pub name: String,
    /// Values a bin. Values beyond the edges are counted in the outermost bins.
    pub counts: Vec<u64>,
    /// Number of values.
    pub n: u64,
    /// Their mean.
    pub mean: Option<f64>,
    /// Their median.
    pub median: Option<f64>,
    /// Wasserstein-1 distance to the reference in the quantity's unit; `None` for the reference itself and for empty
    /// groups.
    pub distance: Option<f64>,
}

/// Share of values at either end beyond the range of the bins: they count in the outermost bins.
const TAIL: f64 = 0.005;

impl Distribution {
    /// Bins the finite values of each group; the first group is the reference.
    ///
    /// The bins span the middle 99 % of all values, so that outliers do not compress the rest into one bin.
    pub fn of(title: &str, unit: &str, description: &str, n_bins: usize, groups: &[(&str, &[f64])]) -> Self {
        let sorted: Vec<Vec<f64>> = groups.iter().map(|(_, values)| sorted_finite(values)).collect();
        let edges = bin_edges(&sorted_finite(&sorted.concat()), n_bins.max(1));
        let series = groups
            .iter()
            .zip(&sorted)
            .enumerate()
            .map(|(i, ((name, _), values))| DistributionSeries {
                name: (*name).to_owned(),
                counts: bin_counts(values, &edges),
                n: values.len() as u64,
                mean: (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64),
                median: quantile(values, 0.5),
                distance: if i == 0 { None } else { wasserstein(&sorted[0], values) },
            })
            .collect();
        Self { title: title.to_owned(), unit: unit.to_owned(), description: description.to_owned(), edges, series }
    }
}

fn sorted_finite(values: &[f64]) -> Vec<f64> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    sorted
}

fn bin_edges(sorted: &[f64], n_bins: usize) -> Vec<f64> {
    let low = quantile(sorted, TAIL).unwrap_or(0.0);
    let high = quantile(sorted, 1.0 - TAIL).unwrap_or(1.0);
    let (low, high) = if high > low { (low, high) } else { (low - 0.5, low + 0.5) };
    (0..=n_bins).map(|i| low + (high - low) * i as f64 / n_bins as f64).collect()
}

fn bin_counts(values: &[f64], edges: &[f64]) -> Vec<u64> {
    let n_bins = edges.len() - 1;
    let mut counts = vec![0; n_bins];
    for value in values {
        let bin = edges.partition_point(|edge| edge <= value).saturating_sub(1).min(n_bins - 1);
        counts[bin] += 1;
    }
    counts
}

/// The Wasserstein-1 distance of two samples: the area between their cumulative distributions.
fn wasserstein(a: &[f64], b: &[f64]) -> Option<f64> {
    if a.is_empty() || b.is_empty() {
        return None;
    }
    let (mut i, mut j, mut area) = (0, 0, 0.0);
    let mut position = a[0].min(b[0]);
    while i < a.len() || j < b.len() {
        let next = match (a.get(i), b.get(j)) {
            (Some(x), Some(y)) => x.min(*y),
            (Some(x), None) | (None, Some(x)) => *x,
            (None, None) => break,
        };
        area += (i as f64 / a.len() as f64 - j as f64 / b.len() as f64).abs() * (next - position);
        position = next;
        i += a[i..].iter().take_while(|x| **x <= next).count();
        j += b[j..].iter().take_while(|x| **x <= next).count();
    }
    Some(area)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_of_shifted_and_spread_samples() {
        let a: Vec<f64> = (0..100).map(f64::from).collect();
        let shifted: Vec<f64> = a.iter().map(|x| x + 2.5).collect();
        assert!((wasserstein(&a, &shifted).unwrap() - 2.5).abs() < 1e-9);
        assert!((wasserstein(&[0.0, 1.0], &[0.0, 0.0, 1.0, 3.0]).unwrap() - 0.5).abs() < 1e-12);
        assert_eq!(wasserstein(&a, &a), Some(0.0));
        assert_eq!(wasserstein(&a, &[]), None);
    }

    #[test]
    fn every_finite_value_is_counted_once() {
        let recorded: Vec<f64> = (0..1000).map(|i| f64::from(i) / 100.0).chain([1e9]).collect();
        let generated = vec![-5.0, 2.0, f64::NAN, f64::INFINITY];
        let both = Distribution::of("speed", "m/s", "", 10, &[("recorded", &recorded), ("generated", &generated)]);
        assert_eq!(both.edges.len(), 11);
        assert!(both.edges[10] < 11.0, "one outlier must not stretch the bins: {:?}", both.edges);
        let totals: Vec<u64> = both.series.iter().map(|s| s.counts.iter().sum()).collect();
        assert_eq!(totals, [1001, 2]);
        assert_eq!((both.series[0].distance, both.series[1].n, both.series[1].mean), (None, 2, Some(-1.5)));
    }

    #[test]
    fn nothing_and_constants_have_bins_too() {
        assert_eq!(Distribution::of("x", "", "", 4, &[("recorded", &[])]).series[0].counts, [0; 4]);
        let found = Distribution::of("x", "", "", 4, &[("recorded", &[3.0; 5])]).series[0].counts.iter().sum::<u64>();
        assert_eq!(found, 5);
    }
}
