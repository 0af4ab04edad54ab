//! Sums along a binary tree, whose bytes do not depend on how the work is divided.

/// The sum of 2^k leaves along a balanced binary tree, fed leaf by leaf; it keeps one sum a level. The sum of an
/// aligned subtree may replace its leaves.
#[derive(Debug, Default)]
pub(super) struct TreeSum {
    /// Sums of subtrees that wait for their right neighbor, with the number of leaves in each.
    waiting: Vec<(usize, Vec<f32>)>,
}

impl TreeSum {
    /// Adds the next leaf.
    pub(super) fn push(&mut self, leaf: Vec<f32>) {
        let (mut n_leaves, mut sum) = (1, leaf);
        while let Some((_, mut left)) = self.waiting.pop_if(|(n_left, _)| *n_left == n_leaves) {
            left.iter_mut().zip(&sum).for_each(|(left, right)| *left += right);
            (n_leaves, sum) = (2 * n_leaves, left);
        }
        self.waiting.push((n_leaves, sum));
    }

    /// The sum; empty without leaves.
    pub(super) fn finish(mut self) -> Vec<f32> {
        self.waiting.pop().map(|(_, sum)| sum).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sum(leaves: &[f32]) -> f32 {
        let mut tree = TreeSum::default();
        leaves.iter().for_each(|leaf| tree.push(vec![*leaf]));
        tree.finish()[0]
    }

    #[test]
    fn neighbors_are_added_first() {
        // Next to 2^24, 1 is lost and 2 is not: (2^24 + 1) + (1 + 1) in single precision, where one after the other gives 2^24.
        let big = 16_777_216.0;
        assert_eq!(sum(&[big, 1.0, 1.0, 1.0]), big + 2.0);
        assert_eq!(sum(&[1.0, 1.0, 1.0, big]), big + 2.0);
        assert_eq!(sum(&[big, 1.0]), big);
        assert_eq!(TreeSum::default().finish(), Vec::<f32>::new());
    }

    #[test]
    fn sums_of_aligned_subtrees_take_the_place_of_their_leaves() {
        let leaves: Vec<f32> = (0..16).map(|i| (i as f32).sin() * 10f32.powi(i % 5)).collect();
        for n_ranks in [1, 2, 4, 8, 16] {
            let subtrees: Vec<f32> = leaves.chunks(16 / n_ranks).map(sum).collect();
            assert_eq!(sum(&subtrees).to_bits(), sum(&leaves).to_bits(), "{n_ranks}");
        }
    }
}
