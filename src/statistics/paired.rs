//! Do paired differences show more than chance?

/// Whether the mean of these differences exceeds zero by more than its standard error; of fewer than two, whether it
/// exceeds zero.
pub fn exceeds_chance(differences: &[f64]) -> bool {
    let n = differences.len() as f64;
    let mean = differences.iter().sum::<f64>() / n;
    let squares: f64 = differences.iter().map(|difference| (difference - mean).powi(2)).sum();
    mean > (squares / (n * (n - 1.0).max(1.0))).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_are_compared_with_their_standard_errors() {
        // A mean of 4.5 and a standard error of 2.6; 1.25 and 1.25; 0 and 0.
        assert!(exceeds_chance(&[9.0, 9.0, 0.0, 0.0]));
        assert!(!exceeds_chance(&[0.0, 0.0, 0.0, 5.0]));
        assert!(!exceeds_chance(&[0.0; 4]) && !exceeds_chance(&[-1.0, -1.1]));
        assert!(exceeds_chance(&[0.1]) && !exceeds_chance(&[]));
    }
}
