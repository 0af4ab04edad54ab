//! Precision, recall, accuracy, area under the ROC curve and calibration of a classifier, by noise level.

use serde::{Deserialize, Serialize};

/// A classifier's figures on held-out pairs at one noise level. Decisions are taken at probability 1/2.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NoiseLevelReport {
    /// The noise level σ.
    pub sigma: f64,
    /// Number of positive pairs.
    pub n_positive: u64,
    /// Number of negative pairs.
    pub n_negative: u64,
    /// Share of positive pairs among those classified as positive; `None` if there are none.
    pub precision: Option<f64>,
    /// Share of positive pairs that are classified as positive.
    pub recall: Option<f64>,
    /// Share of negative pairs that are classified as positive.
    pub false_positive_rate: Option<f64>,
    /// Share of pairs that are classified correctly.
    pub accuracy: Option<f64>,
    /// Probability that a random positive pair scores higher than a random negative one, ties counting half.
    pub auc: Option<f64>,
    /// Expected calibration error: the mean distance of probabilities from the share of positive pairs in ten bins of
    /// probability, with positive pairs weighted as in training.
    pub calibration_error: Option<f64>,
}

/// Bins of probability of the calibration error.
const N_BINS: usize = 10;

impl NoiseLevelReport {
    /// The figures of pairs with these logits and labels at noise level `sigma`, of a classifier for which positive
    /// pairs counted `pos_weight` times as much as negative ones.
    pub fn new(sigma: f64, logits: &[f64], is_positive: &[bool], pos_weight: f64) -> Self {
        let count = |called: bool, label: bool| {
            let matches = |(logit, is_positive): (&f64, &bool)| (*logit > 0.0) == called && *is_positive == label;
            logits.iter().zip(is_positive).filter(|pair| matches(*pair)).count() as u64
        };
        let (hits, misses) = (count(true, true), count(false, true));
        let (false_alarms, rejections) = (count(true, false), count(false, false));
        let share = |part: u64, whole: u64| (whole > 0).then(|| part as f64 / whole as f64);
        Self {
            sigma,
            n_positive: hits + misses,
            n_negative: false_alarms + rejections,
            precision: share(hits, hits + false_alarms),
            recall: share(hits, hits + misses),
            false_positive_rate: share(false_alarms, false_alarms + rejections),
            accuracy: share(hits + rejections, hits + misses + false_alarms + rejections),
            auc: area_under_roc(logits, is_positive),
            calibration_error: calibration_error(logits, is_positive, pos_weight),
        }
    }
}

/// Σ over bins of |Σ w (p - y)| / Σ w, with w = `pos_weight` for positive pairs and 1 for negative ones; `None` without
/// pairs.
fn calibration_error(logits: &[f64], is_positive: &[bool], pos_weight: f64) -> Option<f64> {
    let (mut excess, mut total) = ([0.0; N_BINS], 0.0);
    for (logit, is_positive) in logits.iter().zip(is_positive) {
        let p = 1.0 / (1.0 + (-logit).exp());
        let (weight, label) = if *is_positive { (pos_weight, 1.0) } else { (1.0, 0.0) };
        excess[((p * N_BINS as f64) as usize).min(N_BINS - 1)] += weight * (p - label);
        total += weight;
    }
    (total > 0.0).then(|| excess.iter().map(|excess| excess.abs()).sum::<f64>() / total)
}

/// The Mann-Whitney statistic of the positive scores, scaled to [0, 1]; `None` unless both classes are present.
fn area_under_roc(scores: &[f64], is_positive: &[bool]) -> Option<f64> {
    let mut order: Vec<usize> = (0..scores.len()).collect();
    order.sort_by(|a, b| scores[*a].total_cmp(&scores[*b]));
    let (mut rank_sum, mut below) = (0.0, 0usize);
    for ties in order.chunk_by(|a, b| scores[*a] == scores[*b]) {
        // Equal scores share the mean of their ranks.
        let rank = below as f64 + (ties.len() as f64 + 1.0) / 2.0;
        rank_sum += rank * ties.iter().filter(|i| is_positive[**i]).count() as f64;
        below += ties.len();
    }
    let n_positive = is_positive.iter().filter(|label| **label).count() as f64;
    let n_negative = is_positive.len() as f64 - n_positive;
    (n_positive > 0.0 && n_negative > 0.0)
        .then(|| (rank_sum - n_positive * (n_positive + 1.0) / 2.0) / (n_positive * n_negative))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hand_counted_figures() {
        // Scores:          called + + - - +; labels + - + - +.
        let report = NoiseLevelReport::new(0.5, &[2.0, 1.0, -0.5, -2.0, 0.3], &[true, false, true, false, true], 1.0);
        assert_eq!((report.n_positive, report.n_negative), (3, 2));
        assert_eq!(report.precision, Some(2.0 / 3.0));
        assert_eq!(report.recall, Some(2.0 / 3.0));
        assert_eq!(report.false_positive_rate, Some(0.5));
        assert_eq!(report.accuracy, Some(0.6));
        // Four of the six pairs of a positive and a negative are in order: 2 > 1, 2 > -2, -0.5 > -2, 0.3 > -2.
        assert!((report.auc.unwrap() - 4.0 / 6.0).abs() < 1e-12);
    }

    /// p = 1/2 twice, one of which is positive, and p = 0.9, which is negative. Weights of 1: |0.5 - 0.5| and 0.9, of 3
    /// pairs. If positive pairs count three times: 0.5 - 1.5 in the first bin, and 0.9, of 5.
    #[test]
    fn probabilities_are_compared_with_shares_bin_by_bin() {
        let logits = [0.0, 0.0, 9f64.ln()];
        let labels = [true, false, false];
        assert!((calibration_error(&logits, &labels, 1.0).unwrap() - 0.3).abs() < 1e-12);
        assert!((calibration_error(&logits, &labels, 3.0).unwrap() - 1.9 / 5.0).abs() < 1e-12);
        assert_eq!(calibration_error(&[], &[], 1.0), None);
    }

    #[test]
    fn ties_count_half_and_one_class_has_no_area() {
        assert_eq!(area_under_roc(&[1.0, 1.0], &[true, false]), Some(0.5));
        assert_eq!(area_under_roc(&[1.0, 2.0], &[true, true]), None);
        let nothing = NoiseLevelReport::new(1.0, &[], &[], 1.0);
        assert_eq!((nothing.precision, nothing.recall, nothing.accuracy), (None, None, None));
    }
}
