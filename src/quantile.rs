//! Quantiles of samples.

/// The quantile at `share`, 0 to 1, of increasing values, linear between neighbors; `None` without values.
pub fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let at = share * sorted.len().checked_sub(1)? as f64;
    let (below, above) = (sorted[at.floor() as usize], sorted[at.ceil() as usize]);
    Some(below + (above - below) * at.fract())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_lie_on_the_line_between_neighbors() {
        let found = [0.0, 0.125, 0.5, 0.75, 1.0].map(|share| quantile(&[1.0, 3.0, 4.0, 8.0, 10.0], share));
        assert_eq!(found, [1.0, 2.0, 4.0, 8.0, 10.0].map(Some));
        assert_eq!(quantile(&[2.0], 0.3), Some(2.0));
        assert_eq!(quantile(&[], 0.5), None);
    }
}
