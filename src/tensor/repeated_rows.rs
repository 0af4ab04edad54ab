//! Repeats the rows of a batch in its tensors and host data.

use candle_core::{Device, Result, Tensor};

/// Every row `n` times in a row: row b becomes rows b·n to b·n + n - 1.
#[derive(Debug, Clone)]
pub struct RepeatedRows {
    n: usize,
    /// The row that each new row is taken from, (B n).
    sources: Tensor,
}

impl RepeatedRows {
    /// Repeats each of `n_rows` rows `n` times.
    pub fn new(n_rows: usize, n: usize, device: &Device) -> Result<Self> {
        let sources: Vec<u32> = (0..n_rows * n).map(|row| (row / n) as u32).collect();
        Ok(Self { n, sources: Tensor::from_vec(sources, n_rows * n, device)? })
    }

    /// The rows of a tensor (B, …): (B n, …). Differentiable.
    ///
    /// # Errors
    /// Fails when the tensor has fewer rows, or the device runs out of memory.
    pub fn tensor(&self, tensor: &Tensor) -> Result<Tensor> {
        if self.n == 1 { Ok(tensor.clone()) } else { tensor.index_select(&self.sources, 0) }
    }

    /// The host data of each row.
    pub fn items<T: Clone>(&self, items: &[T]) -> Vec<T> {
        items.iter().flat_map(|item| std::iter::repeat_n(item, self.n)).cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tensors_and_items_are_repeated_alike() {
        let x = Tensor::new(&[[1u32, 2], [3, 4]], &Device::Cpu).unwrap();
        for (n, expected) in [(1, vec![1, 3]), (3, vec![1, 1, 1, 3, 3, 3])] {
            let rows = RepeatedRows::new(2, n, &Device::Cpu).unwrap();
            let repeated = rows.tensor(&x).unwrap().to_vec2::<u32>().unwrap();
            assert_eq!(repeated.iter().map(|row| row[0]).collect::<Vec<_>>(), expected);
            assert_eq!(rows.items(&[1, 3]), expected);
        }
    }
}
